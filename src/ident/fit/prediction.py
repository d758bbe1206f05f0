"""Torques that a model predicts of a motion, their parts, and the multipliers.

    f = Γ π + E c − f_e                generalised forces of rigid bodies, effects, less wrenches
    [−λ; τ̂_u] = K⁺ᵀ (f − Σ_{driven, not in u} W_jᵀ τ_j)
                                       λ from the rows of the passive joints, then τ̂ of the
                                       independent ones; τ̂_u never sees the measured torque of u
    residual = measured − predicted    predicted = Σ parts

A `Prediction` is at full rate and unfiltered; a `Trace` at the rows of the regression, filtered and
decimated as they are, so that its residual is b − A x.

Of the multipliers of a fit it is said which are determined, and which rest on priors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np

from ident.display import Plotted
from ident.equations.filter import Decimator
from ident.equations.problem import Problem
from ident.equations.rows import Scene, data_rows, in_motion, largest_transmission, smooth_step
from ident.equations.terms import RIGID, WRENCHES
from ident.equations.thinning import NodeSeries, Thinning
from ident.equations.unknowns import NOTHING, Point
from ident.information import linear
from ident.information.blocks import Squares
from ident.information.estimate import MATERIAL, Estimate
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import rigid_forces
from ident.motion import Motion

CHUNK = 2048  # work: samples whose regressor is in memory at once


@dataclass(frozen=True, eq=False)
class TorqueParts:
    """Measured torques of one experiment, and the parts of the predicted ones."""

    name: str  #: the experiment's
    t: np.ndarray  #: (n,) [s]
    measured: np.ndarray  #: (n, d) torques of the independent coordinates [N m | N]
    #: (n, d) of `rigid bodies`, each effect, less `external wrenches`; they add up to `predicted`
    parts: Mapping[str, np.ndarray]
    moving: np.ndarray  #: (n, d), false at standstill, where dry friction leaves the torque open

    @cached_property
    def predicted(self) -> np.ndarray:
        """Σ parts (n, d)."""
        total = np.zeros_like(self.measured)
        for name, force in self.parts.items():
            for u in self.acting[name]:
                total[:, u] += force[:, u]
        return total

    @cached_property
    def acting(self) -> Mapping[str, list[int]]:
        """Coordinates in which each part may differ from zero."""
        return {name: np.flatnonzero(x.any(axis=0)).tolist() for name, x in self.parts.items()}

    @cached_property
    def residual(self) -> np.ndarray:
        """measured − predicted (n, d)."""
        return self.measured - self.predicted

    @property
    def squares(self) -> Squares:
        """Sums of squares of the residual and of the measured torques."""
        return Squares.of(self.residual, self.measured, self.moving)


@dataclass(frozen=True, eq=False)
class Prediction(TorqueParts):
    """Prediction of one experiment: n samples, d independent coordinates and m multipliers."""

    multipliers: np.ndarray  #: (n, m) λ
    scene: Scene = field(repr=False)  #: the corrected state, and the working point

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the independent coordinates."""
        return self.scene.e.independent

    @property
    def usable(self) -> np.ndarray:
        """(n,) samples that take part."""
        return self.scene.e.usable

    @property
    def squares(self) -> Squares:
        """The same, of usable samples."""
        usable = slice(None) if self.usable.all() else self.usable
        return Squares.of(self.residual[usable], self.measured[usable], self.moving[usable])

    @cached_property
    def acting(self) -> Mapping[str, list[int]]:
        """The same, by where effects sit."""
        return {name: self.scene.samples.coordinates_of(name) for name in self.parts}

    def filtered(self, cutoff: float | None) -> Trace:
        """Return the residual at the rows of the regression, with a cut-off [Hz]."""
        scene, e, point = self.scene, self.scene.e, self.scene.point
        model, segments, data = scene.mechanism.model, e.segments(), data_rows(scene, cutoff)
        step, decimator = smooth_step(scene, cutoff), Decimator.of(cutoff, e.rate)
        key = "direction", cutoff, tuple((run.start, run.stop) for run in segments)
        stored = e.store.get(key, e.yd)

        def make(part: slice) -> list[np.ndarray]:
            """Return what jumps: parts of the torque and directions; and all the rest."""
            # most effects act on one coordinate: what is 0 throughout needs no filter
            columns = [self.parts[name][part, u] for name, acts in jumping.items() for u in acts]
            parts = np.array(columns).reshape(len(columns), len(e.t[part])).T
            jumps = [] if stored else [np.clip(e.yd[part] / e.still, -1.0, 1.0)]
            return [parts, *jumps, *(() if step > 1 else make_smooth(part))]

        def make_smooth(part: slice | np.ndarray) -> list[np.ndarray]:
            """Return rigid bodies' forces, gravity; joint signals: made at nodes as rows are."""
            rest = 0 * e.v[part]
            gravity = rigid_forces(model, e.q[part], rest, rest, point.pi)
            bodies = [self.parts[RIGID][part], scene.samples.reduced(part).reduce(gravity)]
            return [np.hstack(bodies), np.hstack([e.y[part], e.yd[part], e.ydd[part]])]

        jumping = {name: acts for name, acts in self.acting.items() if name != RIGID}
        d, J = self.measured.shape[1], e.y.shape[1]
        widths = [sum(map(len, jumping.values())), *([] if stored else [J]), 2 * d, 3 * J]
        pieces = [[np.zeros((0, width)) for width in widths]]
        for segment in segments:
            thinning = Thinning(decimator, step, segment.stop - segment.start)
            at_nodes = NodeSeries(thinning, make_smooth, segment.start)
            for sample, filtered in decimator.filtered(segment, make):
                pieces.append([*filtered, *(at_nodes.rows(sample) if step > 1 else ())])
        torques, *directions, bodies, joints = (
            np.concatenate(x) for x in zip(*pieces, strict=True)
        )
        if not stored:
            e.store.put(key, e.yd, directions)
        (direction,) = stored or directions
        measured, gravity, t = data.tau.copy(), bodies[:, d:], e.t[data.sample]
        by_name, first = {RIGID: bodies[:, :d]}, 0
        for name, acts in jumping.items():
            by_name[name] = np.zeros((len(t), d))
            by_name[name][:, acts] = torques[:, first : first + len(acts)]
            first += len(acts)
        for x in (measured, gravity, *by_name.values()):  # no residual where none is measured
            x[:, scene.mechanism.unmeasured_rows] = 0.0
        informed, (q, v, a) = data.informed | e.poses, np.split(joints, 3, axis=1)
        numbers = np.searchsorted([run.start for run in segments], data.sample, side="right") - 1
        return Trace(
            self.name, t, measured, by_name, informed & data.moving, numbers, gravity, q, v, a,
            direction, informed,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Trace(TorqueParts):
    """The residual of one experiment: n rows, filtered and decimated as the regression had them.

    With d independent coordinates and J named joints:
    """

    segment: np.ndarray  #: (n,), rows of one number follow each other without a gap
    gravity: np.ndarray  #: (n, d), what of the rigid bodies' part is there without motion
    q: np.ndarray  #: (n, J) [rad | m]
    v: np.ndarray  #: (n, J) [rad/s | m/s]
    a: np.ndarray  #: (n, J) [rad/s² | m/s²]
    direction: np.ndarray  #: (n, J), sign(v), v/still at standstill
    informed: np.ndarray  #: (n, d), false where dry friction in the model leaves it open

    def __len__(self) -> int:
        return len(self.t)

    @cached_property
    def load(self) -> np.ndarray:
        """Torque (n, d) that the links ask of each joint: the prediction without the effects."""
        known = [self.parts[name] for name in (RIGID, WRENCHES) if name in self.parts]
        return sum(known, np.zeros_like(self.measured))

    def runs(self) -> list[slice]:
        """Return rows without a gap between them."""
        edges = [0, *(np.flatnonzero(np.diff(self.segment)) + 1), len(self)]
        return [slice(int(i), int(j)) for i, j in pairwise(edges) if j > i]


def predict(mechanism: Mechanism, motion: Motion, point: Point) -> list[Prediction]:
    """Predict every experiment of a motion, at full rate and unfiltered."""
    predictions, others = [], {*mechanism.driven} - {*motion.independent}
    for bare in motion.experiments:
        scene = Scene.of(mechanism, NOTHING, bare, point, motion.band.cutoff)
        e, farthest = scene.e, largest_transmission(scene.e)
        n, d, m = len(e), e.leverage.shape[2], len(mechanism.kinematics.multipliers)
        samples, parts = scene.samples, dict[str, np.ndarray]()
        alone = {x.label: x for x in mechanism.effects if e.loop is None and not x.loaded_link}
        measured, moving = np.empty((d, n)).T, np.empty((d, n), bool).T
        multipliers = np.empty((n, m))
        for start in range(0, n, CHUNK):
            part = slice(start, min(start + CHUNK, n))
            s, u = samples.generalised(part), samples.reduced(part)
            forces = s.parts(without=alone)
            for name, force in forces.items():
                if name not in parts:  # by column: those of an effect on one joint take no memory
                    parts[name] = np.zeros((d, n)).T
                reduced = u.reduce(force)
                for at in samples.coordinates_of(name):
                    parts[name][part, at] = reduced[:, at]
            measured[part], moving[part] = u.measured(mechanism.driven), in_motion(u, farthest)
            if e.loop is not None:
                f = sum(forces.values()) - s.measured(others)
                multipliers[part] = -np.einsum("nij,ni->nj", e.pinv[part][:, :, :m], f)
        for label, effect in alone.items():
            if samples.makes_torque(effect):
                parts[label] = np.zeros((d, n)).T
                for name in effect.acting if samples.coordinates_of(label) else ():
                    at = mechanism.joint(name).index
                    parts[label][:, at] = samples.torque_of(effect, name)
        samples.memo.pop(RIGID, None)  # the parts hold them
        order = RIGID, *(effect.label for effect in mechanism.effects), WRENCHES
        parts = {name: parts[name] for name in order if name in parts}
        for part_series in parts.values():  # no residual where nothing is measured
            part_series[:, mechanism.unmeasured_rows] = 0.0
        predictions.append(Prediction(e.name, e.t, measured, parts, moving, multipliers, scene))
    return predictions


SAMPLES = 200  # work: of an experiment that are looked at
OPEN = 1e-8  # numerics: of J's largest singular value: smaller ones leave a direction of λ open


def identifiable_multipliers(mechanism: Mechanism, motion: Motion) -> np.ndarray:
    """Return (m,) whether each multiplier is determined: no null direction of Jᵀ touches it, as of
    redundant closure equations such as the normal row of a planar loop closed by a `point`.
    """
    m = len(mechanism.kinematics.multipliers)
    determined = np.ones(m, dtype=bool)
    for e in motion.experiments:
        q = e.q[e.usable][:: max(1, len(e) // SAMPLES)]
        if not m or not len(q):
            continue
        J = mechanism.kinematics.closure_rows(q).rate
        U, s, _ = linear.svd(J, full_matrices=True)
        for k in range(len(q)):
            null = U[k][:, int((s[k] > OPEN * s[k].max(initial=1e-300)).sum()) :]
            determined &= (null**2).sum(axis=1) < 1e-12
    return determined


@dataclass(frozen=True, eq=False)
class MultiplierErrors:
    """What the values behind the m multipliers of a fit leave open of them.

    Attributes:
        by_values: (m,) rms over time of the standard error that the base parameters' errors make.
        by_priors: (m,) rms over time of what unknowns that no torque determines make, each at the
            largest plausible distance from its prior.
        resting: by multiplier the unknowns whose priors it rests on, most important first.
    """

    by_values: np.ndarray
    by_priors: np.ndarray
    resting: Mapping[str, list[str]]


def multiplier_errors(
    problem: Problem, estimate: Estimate, covariance: np.ndarray | None = None
) -> MultiplierErrors:
    """Return the errors of the multipliers; `covariance` (n_ind, n_ind): of the base parameters.

    Some inertial directions change λ and never a torque: with A the columns of all rows and
    K⁺ = [J; W_u]⁺, λ = −K⁺ᵀ(A x − b) moves by −K⁺ᵀ(A_D − A_I K) when an unknown x_D that torques
    do not determine moves and the base parameters stay, and by −K⁺ᵀ A_I when these move.
    """
    mechanism, motion, columns = problem.mechanism, problem.motion, problem.columns
    base = estimate.base
    names, m = mechanism.kinematics.multipliers, len(mechanism.kinematics.multipliers)
    if not m:
        return MultiplierErrors(np.zeros(0), np.zeros(0), {})
    point, root = problem.point_at(estimate.x), _root(covariance)
    plausible = problem.plausible[base.dependent]
    largest, size = np.zeros((m, len(plausible))), np.zeros(m)
    squares, samples = np.zeros((2, m)), 0  # by values, by priors
    for e in motion.experiments:
        at = np.flatnonzero(e.usable)[:: max(1, len(e) // SAMPLES)]
        terms = Scene.of(mechanism, columns, e, point, motion.band.cutoff).terms(at, full=True)
        extract = -e.pinv[at][:, :, :m].transpose(0, 2, 1)
        A, unbalanced = terms.A, terms.A @ columns.prior - terms.b
        by_base = extract @ A[:, :, base.independent]
        change = (extract @ A[:, :, base.dependent] - by_base @ base.K) * plausible
        largest = np.maximum(largest, np.abs(change).max(axis=0, initial=0.0))
        loads = np.einsum("nmi,ni->nm", extract, unbalanced)
        size = np.maximum(size, np.abs(loads).max(axis=0, initial=0.0))
        if root is not None:
            squares[0] += ((by_base @ root) ** 2).sum(axis=(0, 2))
        squares[1] += (change**2).sum(axis=(0, 2))
        samples += len(at)
    resting = {}
    for i, name in enumerate(names):
        order = [j for j in np.argsort(-largest[i]) if largest[i, j] > MATERIAL * size[i]]
        if order:
            resting[name] = [columns.names[base.dependent[j]] for j in order]
    by_values, by_priors = np.sqrt(squares / max(samples, 1))
    return MultiplierErrors(by_values, by_priors, resting)


def _root(covariance: np.ndarray | None) -> np.ndarray | None:
    """Return L with L Lᵀ = covariance; None where it is not known."""
    if covariance is None or not np.isfinite(covariance).all():
        return None
    values, V = np.linalg.eigh(covariance)
    return np.asarray(V * np.sqrt(np.maximum(values, 0.0)))


@dataclass(frozen=True, eq=False, repr=False)
class Reactions(Plotted):
    """Known reactions of a log, from a simulation or load cells, beside identified multipliers."""

    mechanism: Mechanism  #: with m multipliers
    log: str  #: its name
    identified: tuple[np.ndarray, np.ndarray]  #: t (n,) [s], λ (n, m)
    t: np.ndarray  #: (r,) [s]
    known: np.ndarray  #: (r, m), NaN where nothing is known
    off: np.ndarray  #: (r, m) identified − known
