"""Which parameters these data do not determine: those a model can do without, those a motion hides.

Essential parameters: base parameters are set to zero one after the other, the one with the largest
relative standard error first (M. T. Pham, M. Gautier, Essential parameters of robots, IEEE CDC
1991), the others estimated anew, as long as no joint's held-out error rises by more than LOSS.

Unexcited parameters: a motion is compared with one made up in which everything moves
(`excitation`). An unknown that leads a base parameter there and none here is lost to this motion.
What would bring it back is tried: the log's motion again, in which joint u swings beside what it
did, with rows A_u,

    C_u = (Σ A_uᵀ A_u / σ² + diag(1 / plausible²))⁻¹

and the joints whose swing narrows an unknown most are named.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from ident.display import Displayed, render
from ident.equations.unknowns import Columns
from ident.errors import IdentError, MotionError
from ident.fit.problem import Problem, information_of
from ident.fit.shapes import initial
from ident.fit.values import absorbed_by
from ident.information import linear
from ident.information.blocks import Error, Squares
from ident.information.estimate import Estimate, estimate
from ident.information.held_out import fold_count, folds, rises, without_each
from ident.information.triangle import Triangle
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.motion.closures import LoopSolver, best_conditioned, independent_joints
from ident.motion.motion import prescribed

LOSS = 0.01  # share by which any joint's held-out error may rise in all
REGULAR = 1e-12  # of a column's norm: a smaller pivot is rounding
SAMPLES = 600  # of a log in which swings are tried
AMPLITUDES = (0.5, 0.15, 0.05)  # [rad | m], the largest that the mechanism can follow
FREQUENCIES = (0.7, 1.1)  # [Hz]
STILL = 0.01  # 1/s, of the swing: a joint that never was faster beside it stood still
TELLS = 0.5  # of its present uncertainty: a swing that leaves less tells an unknown
ALIKE = 1.5  # uncertainties of two swings that are called equally good


@dataclass(frozen=True)
class Dropped:
    """A base parameter that is not needed.

    Attributes:
        name: its leading unknown; relative: its standard error over its size when it was dropped.
        rise: of the held-out error with it and all before it at zero, over that of the full model,
            in the joint where it rises most; below zero where it falls in all.
    """

    name: str
    relative: float
    rise: float


@dataclass(frozen=True, repr=False)
class Essential(Displayed):
    """The essential base parameters of a fit.

    Attributes:
        names: leading unknowns of those that stay.
        values, stderr: estimated without the others, by name.
        dropped: in the order in which they were set to zero.
        full, reduced: held-out errors of both models, by joint.
    """

    names: tuple[str, ...]
    values: Mapping[str, float]
    stderr: Mapping[str, float]
    dropped: tuple[Dropped, ...]
    full: Mapping[str, Error]
    reduced: Mapping[str, Error]

    @property
    def line(self) -> str:
        """Number of essential parameters, and what the others would change, in one line."""
        return str(render(self, "line"))

    def json(self) -> dict[str, object]:
        """Return the entry of fit.json."""
        return {
            "parameters": [
                {"name": n, "value": self.values[n], "stderr": self.stderr[n]} for n in self.names
            ],
            "dropped": [
                {"name": d.name, "relative_stderr": min(d.relative, 1e30), "rise": d.rise}
                for d in self.dropped
            ],
            "held_out": {
                joint: {"full": self.full[joint].rms, "reduced": self.reduced[joint].rms}
                for joint in self.full
            },
        }


def essential(problem: Problem, found: Estimate, covariance: np.ndarray) -> Essential | None:
    """Return the essential parameters of an estimate with a covariance of its base parameters;
    None for data that cannot be parted into stretches of time.
    """
    columns, own = problem.columns, found.base.independent
    trial = _HeldOutTrial.of(problem, found)
    if trial is None or not len(own):
        return None
    alone = np.linalg.norm(lapack.dtrtri(trial.total.R)[0], axis=1)  # errors for unit noise
    stderr = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    wider = np.where(np.isfinite(stderr) & (alone > 0), stderr / np.maximum(alone, 1e-300), 1.0)
    may_go = ~np.isin(own, columns.shapes)  # a shape's column is a slope, no size
    needed, dropped = np.ones(len(own), dtype=bool), []
    full = best = trial.held_out(needed)
    while (needed & may_go).any():
        beta, stderr = _solved(trial.total, needed, wider)
        relative = np.where(needed & may_go, stderr / np.maximum(np.abs(beta), 1e-300), -np.inf)
        weakest = int(relative.argmax())
        fewer = needed.copy()
        fewer[weakest] = False
        after = trial.held_out(fewer)
        change = float(rises(after, full).max(initial=-1.0))
        if change > LOSS:
            break
        needed, best = fewer, after
        dropped.append(Dropped(columns.names[own[weakest]], float(relative[weakest]), change))
    beta, stderr = _solved(trial.total, needed, wider)
    names = tuple(columns.names[i] for i in own[needed])
    joints = problem.motion.independent
    return Essential(
        names,
        dict(zip(names, map(float, beta[needed]), strict=True)),
        dict(zip(names, map(float, stderr[needed]), strict=True)),
        tuple(dropped),
        full.errors(joints, problem.units),
        best.errors(joints, problem.units),
    )


@dataclass(frozen=True, eq=False)
class _HeldOutTrial:
    """Triangles in the base parameters alone, weighted: of all rows, by stretch, and to score."""

    total: Triangle
    others: tuple[Triangle, ...]
    scored: tuple[tuple[Triangle, ...], ...]
    torque: np.ndarray

    @classmethod
    def of(cls, problem: Problem, found: Estimate) -> _HeldOutTrial | None:
        information = problem.information
        parted = folds(information, fold_count(information))
        if len(parted) < 2:
            return None
        own, sigma = found.base.independent, problem.row_scale(found)
        known = np.where(found.held, found.x, 0.0)  # x_D = 0: then x_I = β
        fitting, scored = [], []
        for part in parted.values():
            small = [t.restricted(own, known) for t in part.totals]
            rest = [t.restricted(own, known) for t in part.at_rest]
            fitting.append(
                Triangle.merge([t.scaled(1 / s) for t, s in zip(small, sigma, strict=True)])
            )
            scored.append(tuple(Triangle.merge(pair) for pair in zip(small, rest, strict=True)))
        others = tuple(without_each(fitting))
        return cls(Triangle.merge(fitting), others, tuple(scored), information.measured[0])

    def held_out(self, needed: np.ndarray) -> Squares:
        """Return errors in each stretch of the model fitted to the others, some β being zero."""
        found = Squares.zero(len(self.torque))
        for triangle, both in zip(self.others, self.scored, strict=True):
            beta, _ = _solved(triangle, needed, None)
            error = np.array([t.residual_norm(beta) ** 2 for t in both])
            found = found + Squares(error, 0 * error, np.array([t.rows for t in both]))
        return Squares(found.error, self.torque, found.rows)


def _solved(
    triangle: Triangle, needed: np.ndarray, wider: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return β (n,), zero where not needed, and standard errors (n,)."""
    own = triangle.restricted(np.flatnonzero(needed))
    beta, stderr = np.zeros(len(needed)), np.zeros(len(needed))
    if own.k == 0:
        return beta, stderr
    if (np.abs(own.R.diagonal()) > REGULAR * np.linalg.norm(own.R, axis=0)).all():
        beta[needed] = lapack.dtrtrs(own.R, own.d)[0]
    else:  # a stretch alone determined something
        beta[needed] = linear.lstsq(own.R, own.d, rcond=REGULAR)[0]
    if wider is not None:
        inverse, _ = lapack.dtrtri(own.R)
        stderr[needed] = np.linalg.norm(inverse, axis=1) * wider[needed]
    return beta, stderr


# --- unexcited parameters -------------------------------------------------------------------------


@dataclass(frozen=True)
class Lost:
    """An unknown that another motion would tell.

    Attributes:
        name: of the unknown.
        why: `noise`: excited, but less than the residual hides, so it was held at the prior;
            `same columns`: in this motion it acts as `carriers` do; `unfelt`: no torque feels it.
        carriers: what stands for it here.
        joints: whose swing would tell it, best first; empty if no joint alone does.
        before, after: its standard error as it is, given a plausible prior, and with that swing.
    """

    name: str
    why: str
    carriers: tuple[str, ...]
    joints: tuple[str, ...]
    before: float
    after: float


@dataclass(frozen=True, repr=False)
class Unexcited(Displayed):
    """Parameters that the motion of a fit does not determine.

    Attributes:
        lost: unknowns that another motion would tell.
        moved: by joint (how far it moved, its top acceleration, unit of the coordinate).
        swing: what was tried: (± amplitude, top acceleration), by joint.
    """

    lost: tuple[Lost, ...]
    moved: dict[str, tuple[float, float, str]]
    swing: dict[str, tuple[float, float]]

    @property
    def advice(self) -> tuple[str, ...]:
        """One sentence for all unknowns that the same joints determine."""
        return tuple(render(self, "advice"))


def excitation(mechanism: Mechanism) -> Motion:
    """Return a made-up motion around the start in which every degree of freedom moves.

    For a structural answer only: sines of unrelated frequencies, smaller where loops are tight.
    """
    choices = [
        best_conditioned(mechanism, mechanism.assembled[None]),
        independent_joints(mechanism, [*mechanism.driven, *mechanism.joint_index]),
        independent_joints(mechanism, [*reversed(mechanism.driven), *mechanism.joint_index]),
    ]
    why: MotionError | None = None
    for names in dict.fromkeys(choices):
        for amplitude in (0.8, 0.3, 0.1, 0.03, 0.003):
            try:
                t, known = _sines(mechanism, names, amplitude)
                return prescribed(mechanism, "a made-up motion", t, names, known)
            except MotionError as error:
                why = error
    raise MotionError(
        f"{mechanism.name}: no motion made up around [joints] start can be followed ({why}); "
        "give a start farther from a singular position, or a log"
    )


def _sines(
    mechanism: Mechanism, names: tuple[str, ...], amplitude: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return times (n,) [s] and coordinates, rates, accelerations (3, n, d) of these joints,
    which move by about the amplitude [rad | m] around the start.
    """
    t = np.linspace(0.0, 10.0, 801)
    rng = np.random.default_rng(1)
    frequency = rng.uniform(0.5, 1.5, (len(names), 3))
    phase = rng.uniform(0, 2 * np.pi, (len(names), 3))
    start = LoopSolver(mechanism, names).coordinates(mechanism.assembled[None]).value[0]
    w = 2 * np.pi * frequency
    angle = w * t[:, None, None] + phase  # (n, d, 3)
    series = (np.sin(angle) - np.sin(phase), w * np.cos(angle), -(w**2) * np.sin(angle))
    known = amplitude / 3 * np.stack([x.sum(axis=2) for x in series])
    known[0] += start
    return t, known


def unexcited(problem: Problem, found: Estimate) -> Unexcited:
    """Return what the motion of a fit does not determine, why, and which swing would.

    Raises:
        MotionError: if no motion can be made up for the mechanism.
    """
    mechanism, motion, columns = problem.mechanism, problem.motion, problem.columns
    totals = _totals(mechanism, columns, excitation(mechanism))
    ones = np.ones(len(totals))  # unknowns that lead a base parameter if everything moves:
    able = estimate(totals, columns.prior, ones, sigma=ones).base.independent
    lost = [int(i) for i in able if i not in found.base.independent]
    moved = {name: _moved(mechanism, motion, name) for name in motion.independent}
    if not lost:
        return Unexcited((), moved, {})
    sigma, prior = problem.row_scale(found), np.diag(1 / problem.plausible[able] ** 2)
    at = np.searchsorted(able, lost)
    now = _spread(_information(problem.information.totals, sigma, able) + prior)[at]
    swings, after = {}, {}
    for joint in motion.independent:
        if (trial := _swing(mechanism, motion, joint)) is None:
            continue
        swing, size = trial
        share = problem.information.rows // problem.d / swing.samples
        rows = _information(_totals(mechanism, columns, swing), sigma, able)
        after[joint] = _spread(share * rows + prior)[at]
        swings[joint] = (size, _moved(mechanism, swing, joint)[1])
    unknowns = []
    carriers = absorbed_by(columns, found.base)
    for k, i in enumerate(lost):
        name, left = columns.names[i], {joint: float(x[k]) for joint, x in after.items()}
        best = min(left.values(), default=np.inf)
        enough = min(ALIKE * best, TELLS * float(now[k]))
        joints = sorted((joint for joint in left if left[joint] < enough), key=left.__getitem__)
        carried = tuple(filter(None, carriers.get(name, "").split(", ")))
        why = "noise" if found.held[i] else "same columns" if carried else "unfelt"
        unknowns.append(Lost(name, why, carried, tuple(joints[:2]), float(now[k]), best))
    return Unexcited(tuple(unknowns), moved, swings)


def _totals(mechanism: Mechanism, columns: Columns, motion: Motion) -> Sequence[Triangle]:
    return information_of(mechanism, columns, motion, initial(mechanism, motion)).totals


def _information(totals: Sequence[Triangle], sigma: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return Σ AᵀA / σ² in some columns."""
    rows = [f.R[:, columns] / s for f, s in zip(totals, sigma, strict=True)]
    return np.asarray(sum(R.T @ R for R in rows))


def _spread(information: np.ndarray) -> np.ndarray:
    """Return standard errors from an information matrix, equilibrated before it is inverted."""
    unit = 1 / np.sqrt(np.diag(information))
    inverse = linear.pinv(information * np.outer(unit, unit), rcond=1e-14, hermitian=True)
    return np.sqrt(np.maximum(np.diag(inverse), 0.0)) * unit


def _moved(mechanism: Mechanism, motion: Motion, joint: str) -> tuple[float, float, str]:
    """Return how far a joint moved, its top acceleration, and its unit."""
    at = mechanism.joint_index[joint]
    y, ydd = (
        np.concatenate([getattr(e, name)[e.usable][:, at] for e in motion.experiments])
        for name in ("y", "ydd")
    )
    return float(np.ptp(y)), float(np.abs(ydd).max()), mechanism.joint(joint).unit


def _swing(mechanism: Mechanism, motion: Motion, joint: str) -> tuple[Motion, float] | None:
    """Return the first log's motion, thinned, with one joint swinging beside, and by how much.

    The amplitude is in rad or m; None if the mechanism cannot follow.
    """
    e = motion.experiments[0]
    run = max(e.segments(), key=lambda s: s.stop - s.start, default=None)
    if run is None:
        return None
    every = max(1, (run.stop - run.start) // SAMPLES)
    some = slice(run.start, run.stop, every)
    t = e.t[some] - e.t[run.start]
    for size in AMPLITUDES:
        known = np.empty((3, len(t), len(motion.independent)))
        for i, name in enumerate(motion.independent):
            at = mechanism.joint_index[name]
            q, v, a = (getattr(e, x)[some, at].copy() for x in ("y", "yd", "ydd"))
            if np.abs(v).max() < STILL * size:  # what is left of its motion is noise
                q, v, a = np.full_like(q, q.mean()), 0 * v, 0 * a
            if name == joint:
                for f in FREQUENCIES:
                    w, half = 2 * np.pi * f, size / len(FREQUENCIES)
                    q += half * np.sin(w * t)
                    v += half * w * np.cos(w * t)
                    a -= half * w**2 * np.sin(w * t)
            known[:, :, i] = q, v, a
        try:
            made = prescribed(mechanism, "a swing", t, motion.independent, known)
        except IdentError:
            continue
        return made, size
    return None
