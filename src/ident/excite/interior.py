"""Interior-point search: the x of the largest J(x) with low < z(x) < high, from a point inside.

    min φ(x) = −J(x) − μ Σ log s            s = (z − low, high − z) > 0
    (B + Zᵀ D Z) δ = −∇φ                    Z = ∂z/∂x, D = Σ λ / s of both sides
    λ ← λ + α (μ / s − λ − λ ∂s/∂x δ / s)   multipliers: λ s → μ → 0

B estimates the Hessian of −J − λᵀs alone by damped BFGS: the curvature of φ near a limit, which is
much larger, is in D. So thousands of limits cost one product ZᵀDZ a step, and every point is inside
all of them: a motion can be used before the search ends.

Source: Nocedal, Wright, Numerical Optimization, 2nd ed. 2006, chapter 19 and procedure 18.2.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from scipy.linalg import cho_factor, cho_solve

LAST, SMALLER = 1e-5, 0.3  # μ of the last problem, and ratio of one problem's μ to the one before
SOLVED = 5.0  # multiple of μ by which a step must lower φ, by its model; below, μ becomes smaller
WALL = 0.95  # share of the way to the nearest limit that a step may go
ARMIJO = 1e-4  # share of the predicted decrease of φ that a step must have
HALVINGS = 12  # of a step at most
APART = 100.0  # factor by which λ s may differ from μ
CURVED = 0.2  # share of B's curvature along a step, below which the measured one is damped
DAMPING = 1e-12  # of the mean diagonal of the matrix of a step, added to it against rounding


class Candidate(Protocol):
    """A point of the search."""

    @property
    def x(self) -> np.ndarray:
        """Its place, of any shape; k numbers."""

    @property
    def z(self) -> np.ndarray:
        """The limited quantities, of any shape; m numbers."""

    @property
    def J(self) -> float:
        """What is maximised."""


C = TypeVar("C", bound=Candidate)


@dataclass(frozen=True, eq=False)
class Walls:
    """Both limits (m,) of z; infinite where there are none."""

    low: np.ndarray
    high: np.ndarray

    def room(self, z: np.ndarray) -> np.ndarray:
        """Return s (2, m) of z; infinite where there is no limit."""
        return np.stack([z.reshape(-1) - self.low, self.high - z.reshape(-1)])

    def barrier(self, s: np.ndarray) -> float:
        """Return −Σ log s of finite s (2, m); infinite outside."""
        inside = s[np.isfinite(s)]
        return -float(np.log(inside).sum()) if inside.min(initial=1.0) > 0 else np.inf


def climb(
    start: C,
    at: Callable[[np.ndarray, C], C | None],
    slopes: Callable[[C], tuple[np.ndarray, np.ndarray]],
    walls: Walls,
    first: float,
) -> Iterator[C]:
    """Yield the point after each step; all are inside the limits, the last is a local optimum.

    Args:
        start: a point inside.
        at: returns the point at x from one near it; None where there is none.
        slopes: returns ∂J/∂x (k,) and ∂z/∂x (m, k) of a point.
        walls: limits of z.
        first: μ of the first problem. A small one is faster at first, and ends at worse optima,
            since the points soon lie close to some limits.
    """
    c, s, mu = start, walls.room(start.z), first
    (g, Z), k = slopes(c), start.x.size
    multipliers, B, new = mu / s, np.eye(k), True
    while True:
        slope = -g - Z.T @ (mu / s[0] - mu / s[1])
        H = B + Z.T @ ((multipliers / s).sum(axis=0)[:, None] * Z)
        H[np.diag_indices(k)] += DAMPING * np.trace(H) / k
        step = cho_solve(cho_factor(H), -slope)
        ds = Z @ step * np.array([[1.0], [-1.0]])
        found = None
        if -slope @ step >= SOLVED * mu:
            found = _shortened(c, s, step, ds, float(slope @ step), mu, at, walls)
        elif mu <= LAST:
            return
        if found is None:
            if mu <= LAST:
                return
            mu = max(SMALLER * mu, LAST)
            continue
        share, there = found
        multipliers = multipliers + share * (mu / s - multipliers - multipliers * ds / s)
        s = walls.room(there.z)
        multipliers = np.clip(multipliers, mu / s / APART, mu / s * APART)
        g_there, Z_there = slopes(there)
        d = (there.x - c.x).reshape(-1)
        y = g - g_there - (Z_there - Z).T @ (multipliers[0] - multipliers[1])
        if new and y @ d > 0:  # the usual size of the curvature
            B, new = (y @ y) / (y @ d) * np.eye(k), False
        B = _updated(B, d, y)
        c, g, Z = there, g_there, Z_there
        yield c


def _shortened(
    c: C, s: np.ndarray, step: np.ndarray, ds: np.ndarray, slope: float, mu: float,
    at: Callable[[np.ndarray, C], C | None], walls: Walls,
) -> tuple[float, C] | None:  # fmt: skip
    """Return the share of a step that lowers φ enough, and the point there; None without one."""
    share = min(1.0, WALL / float((-ds / s).max(initial=WALL)))
    before = -c.J + mu * walls.barrier(s)
    for _ in range(HALVINGS):
        there = at(c.x + (share * step).reshape(c.x.shape), c)
        if there is not None:
            after = -there.J + mu * walls.barrier(walls.room(there.z))
            if after <= before + ARMIJO * share * slope:
                return share, there
        share *= 0.5
    return None


def _updated(B: np.ndarray, d: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return B (k, k) with the change y (k,) of a gradient along a step d (k,), positive definite.

    r = θ y + (1 − θ) B d with the largest θ ≤ 1 for which dᵀr ≥ 0.2 dᵀB d.
    """
    Bd = B @ d
    before, measured = d @ Bd, d @ y
    theta = 1.0
    if measured < CURVED * before:
        theta = (1 - CURVED) * before / (before - measured)
    r = theta * y + (1 - theta) * Bd
    return np.asarray(B - np.outer(Bd, Bd) / before + np.outer(r, r) / (r @ d))
