"""The closures' multipliers of a fit: which are determined, which rest on priors, known ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.display import Plotted
from ident.equations.corrections import Scene
from ident.errors import FitError, one_of
from ident.fit.problem import Problem
from ident.information import linear
from ident.information.estimate import Estimate
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion

SAMPLES = 200  # of an experiment that are looked at
MATTERS = 0.01  # share of a multiplier that priors may move unmentioned
OPEN = 1e-8  # of the largest singular value of J: smaller ones leave a direction of λ open


def identifiable_multipliers(mechanism: Mechanism, motion: Motion) -> np.ndarray:
    """Return (m,) whether each multiplier is determined: no null direction of Jᵀ touches it.

    Redundant closure equations, such as the normal row of a planar loop closed by a `point`, carry
    loads that no motion shows.
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


def resting_on_priors(problem: Problem, estimate: Estimate) -> dict[str, list[str]]:
    """Return by multiplier the unknowns whose priors it rests on, most important first.

    Some inertial directions change λ and never a torque: with A the columns of all rows and
    K⁺ = [J; W_u]⁺, λ = −K⁺ᵀ(A x − b) moves by −K⁺ᵀ(A_D − A_I K) when an unknown x_D that torques
    do not determine moves and the base parameters stay.
    """
    mechanism, motion, columns = problem.mechanism, problem.motion, problem.columns
    base = estimate.base
    names, m = mechanism.kinematics.multipliers, len(mechanism.kinematics.multipliers)
    if not m or not len(base.dependent):
        return {}
    point = problem.point_at(estimate.x)
    moved, size = np.zeros((m, len(base.dependent))), np.zeros(m)
    for e in motion.experiments:
        at = np.flatnonzero(e.usable)[:: max(1, len(e) // SAMPLES)]
        found = Scene.of(mechanism, columns, e, point, motion.band.cutoff).terms(at, full=True)
        extract = -e.pinv[at][:, :, :m].transpose(0, 2, 1)
        A, unbalanced = found.A, found.A @ columns.prior - found.b
        change = extract @ (A[:, :, base.dependent] - A[:, :, base.independent] @ base.K)
        moved = np.maximum(moved, np.abs(change).max(axis=0, initial=0.0))
        loads = np.einsum("nmi,ni->nm", extract, unbalanced)
        size = np.maximum(size, np.abs(loads).max(axis=0, initial=0.0))
    by = moved * problem.plausible[base.dependent]
    resting = {}
    for i, name in enumerate(names):
        order = np.argsort(-by[i])
        mine = [columns.names[base.dependent[j]] for j in order if by[i, j] > MATTERS * size[i]]
        if mine:
            resting[name] = mine
    return resting


@dataclass(frozen=True, eq=False, repr=False)
class Reactions(Plotted):
    """Known reactions of a log, from a simulation or load cells, beside identified multipliers.

    Attributes:
        mechanism: with m multipliers; log: name of the log.
        identified: (t (n,) [s], λ (n, m)).
        t: (r,) [s]; known: (r, m), NaN where nothing is known.
        off: (r, m) identified − known.
    """

    mechanism: Mechanism
    log: str
    identified: tuple[np.ndarray, np.ndarray]
    t: np.ndarray
    known: np.ndarray
    off: np.ndarray

    @classmethod
    def of(
        cls,
        mechanism: Mechanism,
        log: str,
        identified: tuple[np.ndarray, np.ndarray],
        reactions: Log,
    ) -> Reactions:
        """Compare multipliers with a log of known reactions on their clock.

        Raises:
            FitError: if no column is a multiplier of this mechanism.
        """
        names = mechanism.kinematics.multipliers
        if not any(name in reactions for name in names):
            column = next(iter(reactions.columns), "t")
            raise FitError(f"{reactions.name}: no column is a multiplier; {one_of(column, names)}")
        t, values = identified
        known = np.full((len(reactions.t), len(names)), np.nan)
        off = known.copy()
        for i, name in enumerate(names):
            if name in reactions:
                known[:, i] = reactions.columns[name]
                at = np.interp(reactions.t, t, values[:, i], left=np.nan, right=np.nan)
                off[:, i] = at - known[:, i]
        return cls(mechanism, log, identified, reactions.t, known, off)
