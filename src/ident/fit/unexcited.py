"""Unknowns that a motion does not determine, why, and a motion that would.

A motion is compared with one made up in which everything moves (`excitation`). An unknown that
leads a base parameter there and none here is lost to this motion. What would bring it back is
tried: the log's motion again, in which joint u swings beside what it did, with rows A_u,

    C_u = (Σ A_uᵀ A_u / σ² + diag(1 / plausible²))⁻¹

and the joints whose swing narrows an unknown most are named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.display import Displayed, render
from ident.equations.unknowns import Columns
from ident.errors import IdentError, MotionError
from ident.fit.problem import Problem, information_of
from ident.fit.shapes import initial
from ident.fit.values import absorbed_by
from ident.information.estimate import Estimate, estimate
from ident.information.triangle import Triangle
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.motion.closures import LoopSolver, best_conditioned, independent_joints
from ident.motion.motion import prescribed

SAMPLES = 600  # of a log in which swings are tried
AMPLITUDES = (0.5, 0.15, 0.05)  # [rad | m], the largest that the mechanism can follow
FREQUENCIES = (0.7, 1.1)  # [Hz]
STILL = 0.01  # 1/s, of the swing: a joint that never was faster beside it stood still
TELLS = 0.5  # of its present uncertainty: a swing that leaves less tells an unknown
ALIKE = 1.5  # uncertainties of two swings that are called equally good


@dataclass(frozen=True)
class Lost:
    """An unknown that another motion would tell.

    Attributes:
        name, unit: of the unknown.
        why: `noise`: excited, but less than the residual hides, so it was held at the prior;
            `same columns`: in this motion it acts as `carriers` do; `unfelt`: no torque feels it.
        carriers: what stands for it here.
        joints: whose swing would tell it, best first; empty if no joint alone does.
        before, after: its standard error as it is, given a plausible prior, and with that swing.
    """

    name: str
    unit: str
    why: str
    carriers: tuple[str, ...]
    joints: tuple[str, ...]
    before: float
    after: float


@dataclass(frozen=True, repr=False)
class Unexcited(Displayed):
    """What a fit's motion does not tell.

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
        before = float(now[k])
        unknowns.append(Lost(name, columns.units[i], why, carried, tuple(joints[:2]), before, best))
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
    inverse = np.linalg.pinv(information * np.outer(unit, unit), rcond=1e-14, hermitian=True)
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
