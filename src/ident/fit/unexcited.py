"""What a motion does not tell, why, and which motion would.

A motion is compared with one made up in which everything moves (`fit.structure.excitation`). An
unknown that leads a base parameter there and none here is lost to this motion. What would bring it
back is tried: the log's motion again, in which joint u swings beside what it did, with rows A_u,

    C_u = (Σ A_uᵀ A_u / σ² + diag(1 / plausible²))⁻¹

and the joints whose swing narrows an unknown most are named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ident.equations.columns import Columns
from ident.errors import IdentError
from ident.fit.accumulate import accumulate, coordinates
from ident.fit.estimate import estimate, totals
from ident.fit.naming import absorbed_by
from ident.fit.settle import initial
from ident.fit.structure import excitation
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion, complete
from ident.show.html import Shown
from ident.solve.factor import Factor

if TYPE_CHECKING:
    from ident.fit.fit import Fit

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


@dataclass(frozen=True)
class Unexcited(Shown):
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
        """One sentence for all unknowns that the same joints tell."""
        groups: dict[str, list[Lost]] = {}
        for each in self.lost:
            groups.setdefault(each.joints[0] if each.joints else "", []).append(each)
        return tuple(self._sentence(joint, some) for joint, some in groups.items())

    def _sentence(self, joint: str, some: list[Lost]) -> str:
        names = ", ".join(each.name for each in some[:5])
        names += f" and {len(some) - 5} more" if len(some) > 5 else ""
        if not joint:
            return (
                f"to tell {names}: no swing of one joint beside this motion will do; move several "
                "at once, farther and faster"
            )
        far, fast, unit = self.moved[joint]
        size, top = self.swing[joint]
        return (
            f"to tell {names}: swing {joint} by ±{size:.2g} {unit} with up to {top:.2g} {unit}/s² "
            f"(it moved through {far:.2g} {unit} with up to {fast:.2g} {unit}/s²)"
        )

    def __str__(self) -> str:
        if not self.lost:
            return "this motion tells all that a motion can tell"
        reasons = {
            "noise": "too little of it for a residual of this size",
            "same columns": "acts as {}",
            "unfelt": "no torque feels it in this motion",
        }
        lines = ["this motion does not tell what another one would:"]
        for each in self.lost:
            why = reasons[each.why].format(", ".join(each.carriers[:3]))
            lines.append(f"  {each.name}: {why}")
        return "\n".join([*lines, *self.advice])

    __repr__ = __str__


def unexcited(fit: Fit) -> Unexcited:
    """What the motion of a fit does not tell, why, and which swing would.

    Raises:
        MotionError: if no motion can be made up for the mechanism.
    """
    mechanism, columns, base = fit.mechanism, fit.columns, fit.estimate.base
    able = _able(mechanism, columns)
    lost = [int(i) for i in able if i not in base.independent]
    moved = {name: _moved(mechanism, fit.motion, name) for name in fit.motion.independent}
    if not lost:
        return Unexcited((), moved, {})
    sensible, sigma = fit.regression.sensible, fit.worth
    prior = np.diag(1 / sensible[able] ** 2)
    at = np.searchsorted(able, lost)
    now = _spread(_information(fit.regression.factors, sigma, able) + prior)[at]
    swings, after = {}, {}
    for joint in fit.motion.independent:
        trial = _swing(mechanism, fit.motion, joint)
        if trial is None:
            continue
        motion, size = trial
        share = fit.rows / motion.samples
        factors = _factors(mechanism, columns, motion)
        after[joint] = _spread(share * _information(factors, sigma, able) + prior)[at]
        swings[joint] = (size, _moved(mechanism, motion, joint)[1])
    found = []
    carriers = absorbed_by(columns, base)
    for k, i in enumerate(lost):
        best = min((x[k] for x in after.values()), default=np.inf)
        tell = [j for j, x in after.items() if x[k] < min(ALIKE * best, TELLS * now[k])]
        tell = sorted(tell, key=lambda j: after[j][k])[:2]
        carried = tuple(filter(None, carriers.get(columns.names[i], "").split(", ")))
        why = "noise" if fit.estimate.held[i] else "same columns" if carried else "unfelt"
        name, unit = columns.names[i], columns.units[i]
        found.append(Lost(name, unit, why, carried, tuple(tell), float(now[k]), float(best)))
    return Unexcited(tuple(found), moved, swings)


def _able(mechanism: Mechanism, columns: Columns) -> np.ndarray:
    """Unknowns that lead a base parameter if everything moves, ascending."""
    factors = _factors(mechanism, columns, excitation(mechanism))
    ones = np.ones(len(factors))
    return estimate(factors, columns.prior, ones, sigma=ones).base.independent


def _factors(mechanism: Mechanism, columns: Columns, motion: Motion) -> list[Factor]:
    cells = accumulate(mechanism, columns, motion, None, initial(mechanism, motion))
    return totals(cells, len(columns), coordinates(mechanism, motion))


def _information(factors: Sequence[Factor], sigma: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Σ AᵀA / σ² in some columns."""
    rows = [f.R[:, columns] / s for f, s in zip(factors, sigma, strict=True)]
    return np.asarray(sum(R.T @ R for R in rows))


def _spread(information: np.ndarray) -> np.ndarray:
    """Standard errors from an information matrix, equilibrated before it is inverted."""
    unit = 1 / np.sqrt(np.diag(information))
    inverse = np.linalg.pinv(information * np.outer(unit, unit), rcond=1e-14, hermitian=True)
    return np.sqrt(np.maximum(np.diag(inverse), 0.0)) * unit


def _moved(mechanism: Mechanism, motion: Motion, joint: str) -> tuple[float, float, str]:
    """How far a joint moved, its top acceleration, and its unit."""
    at = mechanism.joint_index[joint]
    y, ydd = (
        np.concatenate([getattr(e, name)[e.usable][:, at] for e in motion.experiments])
        for name in ("y", "ydd")
    )
    return float(np.ptp(y)), float(np.abs(ydd).max()), mechanism.joint(joint).unit


def _swing(mechanism: Mechanism, motion: Motion, joint: str) -> tuple[Motion, float] | None:
    """The first log's motion, thinned, with one joint swinging beside, and by how much [rad | m];
    None if the mechanism cannot follow.
    """
    e = motion.experiments[0]
    run = max(e.segments(), key=lambda s: s.stop - s.start, default=None)
    if run is None:
        return None
    every = max(1, (run.stop - run.start) // SAMPLES)
    some = slice(run.start, run.stop, every)
    t = e.t[some] - e.t[run.start]
    for size in AMPLITUDES:
        columns: dict[str, np.ndarray] = {}
        for name in motion.independent:
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
            columns |= {f"q.{name}": q, f"v.{name}": v, f"a.{name}": a}
        try:
            log = Log.from_arrays("a swing", t, columns)
            made = complete(mechanism, log, cutoff=None, torques=False)
        except IdentError:
            continue
        return made, size
    return None
