"""Dry friction of joints at rest: which stick, which break away, and in which direction.

    A α = b − Bᵀ f,   u̇ = B α + δ,   f_k ∈ F_k Sgn(u̇_k)

The accelerations α of the coordinates and the friction torques f of the joints at rest solve a
strictly convex problem in α (Moreau, C. R. Acad. Sci. 262A, 1966; Glocker, Set-Valued Force Laws,
2001), whose dual is the quadratic programme with box bounds solved here:

    min_f  ½ fᵀ H f − gᵀ f,   |f_k| ≤ F_k,      H = B A⁻¹ Bᵀ,   g = B A⁻¹ b + δ      u̇ = g − H f

u̇ is unique. f is not where several joints of a loop hold the same motion (H is singular).
"""

from __future__ import annotations

import numpy as np

SMALL = 1e-12  # of the largest term: what counts as zero


def box_programme(H: np.ndarray, g: np.ndarray, F: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """f (k,) and at which bound each is: −1, 0 (inside), +1 (k,), by active sets.

    Args:
        H: (k, k), symmetric and positive semidefinite.
        g: (k,).
        F: (k,) bounds, none negative.
    """
    k = len(g)
    f, side = np.zeros(k), np.zeros(k, dtype=int)
    scale = np.abs(g).max(initial=0.0) + float(np.abs(H).max(initial=0.0) * F.max(initial=0.0))
    for _ in range(20 * k + 20):
        free = np.flatnonzero(side == 0)
        slope = g - H @ f
        if len(free) and (moved := _towards_least(H, slope, free, scale)) is not None:
            step, whole = moved
            share, first = _reach(f[free], step, F[free], 1.0 if whole else np.inf)
            f[free] += share * step
            if first >= 0:
                at = free[first]
                side[at] = 1 if step[first] > 0 else -1
                f[at] = side[at] * F[at]
            continue
        wrong = np.where(side != 0, -side * slope, -np.inf)
        worst = int(wrong.argmax()) if k else -1
        if k == 0 or wrong[worst] <= SMALL * scale:
            break
        side[worst] = 0
    return f, side


def _towards_least(
    H: np.ndarray, slope: np.ndarray, free: np.ndarray, scale: float
) -> tuple[np.ndarray, bool] | None:
    """A step of the free f to the least value, or a direction without one (False); None: there."""
    part = slope[free]
    if np.abs(part).max() <= SMALL * scale:
        return None
    inner = H[np.ix_(free, free)]
    step = np.linalg.lstsq(inner, part, rcond=SMALL)[0]
    left = part - inner @ step
    if np.abs(left).max() > 1e3 * SMALL * scale:
        return left, False
    return (step, True) if np.abs(inner @ step).max() > SMALL * scale else None


def _reach(f: np.ndarray, step: np.ndarray, F: np.ndarray, most: float) -> tuple[float, int]:
    """The share of a step up to the first bound (its index; −1 if none is met)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        room = np.where(step > 0, (F - f) / step, np.where(step < 0, (-F - f) / step, np.inf))
    first = int(room.argmin())
    if room[first] >= most:
        return most, -1
    return max(float(room[first]), 0.0), first
