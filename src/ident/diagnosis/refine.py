"""Shapes of an effect refined on the rows, everything else refitted (variable projection).

[C̃ D̃] [c; δs] = r        D = ∂(C c)/∂s        C̃, D̃: what the model cannot make of C and D
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ident.diagnosis.candidates import Contest, Shape
from ident.effects import Effect
from ident.information.hypotheses import Array, PartialRegression, Refit

STEPS = 8  # of Gauss-Newton
LONGEST = 0.3  # of a shape's range, the longest step
RISE = 1e-3  # of the error, that a further step must bring
RANK = 1e-6  # of a unit column's square: less of it is new
SLOPE = 1e-4  # of a shape's range, for its slope


def refined(
    contest: Contest, regression: PartialRegression, effect: Effect, shape: Shape
) -> tuple[Shape, list[Array], Refit]:
    """Refine the shapes of an effect that have slopes, from where they are.

    Returns:
        The shapes; columns, then slopes, (m, u) in each part; everything refitted with both.
        Without slopes where the change that they ask for is beyond the shapes' bounds.
    """
    free = [each.name for each in effect.searched if not each.discrete]
    bounds, shape = contest.table.bounds(effect), dict(shape)
    u, C = len(effect.unknowns), contest.columns(effect, shape)
    S, g = normal_equations(regression, C)
    now = fall(S, g)
    low, high = (np.array([bounds[name][i] for name in free]) for i in (0, 1))
    for _ in range(STEPS if free else 0):
        both = contest.with_slopes(effect, shape, C, solved(S, g), _steps(shape, free, bounds))
        step = solved(*normal_equations(regression, both))[u:]
        before, at = now, np.array([shape[name] for name in free])
        for half in range(4):
            most = LONGEST * (high - low)
            new = np.clip(at + 0.5**half * np.clip(step, -most, most), low, high)
            tried = {**shape, **dict(zip(free, map(float, new), strict=True))}
            trial = contest.columns(effect, tried)
            S_new, g_new = normal_equations(regression, trial)
            if fall(S_new, g_new) > now:
                shape, C, S, g, now = tried, trial, S_new, g_new, fall(S_new, g_new)
                break
        if now - before < RISE * max(_squares(regression, C) - now, 0.0):
            break
    if free:
        both = contest.with_slopes(effect, shape, C, solved(S, g), _steps(shape, free, bounds))
        refit = regression.refit_with(both)
        end = np.array([shape[name] for name in free]) + refit.theta[u:]
        if (low <= end).all() and (end <= high).all():  # else the slopes are no change of shape
            return shape, both, refit
    return shape, C, regression.refit_with(C)


def _steps(
    shape: Shape, free: Sequence[str], bounds: Mapping[str, tuple[float, float]]
) -> dict[str, float]:
    """Return by shape the step of its central difference."""
    return {
        name: max(
            min(SLOPE * (bounds[name][1] - bounds[name][0]), 1e-2 * abs(shape[name]) or np.inf),
            1e-9,
        )
        for name in free
    }


def _squares(regression: PartialRegression, C: Sequence[Array]) -> float:
    """Return |r|² in the coordinates in which columns are."""
    pairs = zip(regression.residual, C, strict=True)
    return sum(float(r[:, 0] @ r[:, 0]) for r, c in pairs if c.any())


def screened(regression: PartialRegression, C: Sequence[np.ndarray], groups: int) -> Array:
    """(groups,) in-sample fall of the squares by each group of columns, equal in number."""
    S, g = normal_equations(regression, C)
    u = len(g) // groups
    parts = (slice(k * u, (k + 1) * u) for k in range(groups))
    return np.array([fall(S[at, at], g[at]) for at in parts])


def normal_equations(regression: PartialRegression, C: Sequence[np.ndarray]) -> tuple[Array, Array]:
    """C̃ᵀC̃ and C̃ᵀr, weighted, of columns C (m, u) in each part; (0, u) where they are zero.

    What is left of a column is set to zero where it is less than RANK of its squares.
    """
    u = C[0].shape[1]
    S, g, P = np.zeros((u, u)), np.zeros(u), np.zeros((regression.rank, u))
    for part, Q, r, c in zip(regression.parts, regression.Q, regression.residual, C, strict=True):
        if c.any():
            c = c * regression.weight[part.coordinate]
            S += c.T @ c
            g += c.T @ r[:, 0]
            P += Q.T @ c
    rest = S - P.T @ P
    new = np.diag(rest) > RANK * np.diag(S)
    return rest * np.outer(new, new), g * new


def fall(S: Array, g: Array) -> float:
    """gᵀ S⁺ g in the directions that are new."""
    return float(g @ solved(S, g))


def solved(S: Array, g: Array) -> Array:
    """S⁺ g in the directions that are new."""
    size = np.sqrt(np.where(np.diag(S) > 0, np.diag(S), 1.0))
    values, V = np.linalg.eigh(S / size[:, None] / size)
    good = values > RANK
    return np.asarray((V[:, good] / values[good]) @ (V[:, good].T @ (g / size)) / size)
