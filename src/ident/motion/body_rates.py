"""Orientations as matrices, and rates of a body held against what its pose did over a while.

    p(t + T) − p(t) = ∫ R v dt          log(R(t)ᵀ R(t + T)) = ∫ ω dt, for a short T

Rates are asked in the axes of the body; those of the world fit with R and its transpose exchanged.
"""

from __future__ import annotations

import numpy as np

from ident.errors import MotionError

LAG = 0.1  # range: [s] over which the steps of a pose are compared with its rates
RATES_OFF = 0.2  # range: share of the steps that rates in the right axes miss
BETTER = 0.5  # range: of that share, what the other axes may miss to be the right ones


def rotations(quaternion: np.ndarray) -> np.ndarray:
    """Return R (n, 3, 3) of unit quaternions (n, 4), x y z w."""
    x, y, z, w = quaternion.T
    return np.stack(
        [
            1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
            2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
            2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
        ],
        axis=1,
    ).reshape(-1, 3, 3)  # fmt: skip


def check_linear(where: str, t: np.ndarray, p: np.ndarray, R: np.ndarray, v: np.ndarray) -> None:
    """Refuse velocities v (n, 3) [m/s] in the world's axes where those of the body are asked."""
    if not 0 < _lag(t) < len(t) // 2:
        return
    steps = _increments(t, p)
    _refuse_world_axes(where, "v", steps, *(_lagged(t, x) for x in (turned(R, v), v)))


def check_angular(where: str, t: np.ndarray, R: np.ndarray, w: np.ndarray) -> None:
    """Refuse angular velocities w (n, 3) [rad/s] in the world's axes, not the body's."""
    k = _lag(t)
    if not 0 < k < len(t) // 2:
        return
    relative = R[:-k].transpose(0, 2, 1) @ R[k:]
    skew = 0.5 * np.stack(
        [relative[:, 2, 1] - relative[:, 1, 2], relative[:, 0, 2] - relative[:, 2, 0],
         relative[:, 1, 0] - relative[:, 0, 1]], axis=1,
    )  # fmt: skip
    sine = np.linalg.norm(skew, axis=1)
    angle = np.arctan2(sine, 0.5 * (np.trace(relative, axis1=1, axis2=2) - 1))
    steps = skew * (angle / np.maximum(sine, 1e-12))[:, None]  # log of the step, in the body's axes
    in_body = np.einsum("nji,nj->ni", R, w)
    _refuse_world_axes(where, "w", steps, *(_lagged(t, x) for x in (w, in_body)))


def _lag(t: np.ndarray) -> int:
    return max(1, round(LAG / float(np.median(np.diff(t))))) if len(t) > 1 else 0


def _increments(t: np.ndarray, p: np.ndarray) -> np.ndarray:
    k = _lag(t)
    return p[k:] - p[: len(p) - k]


def _lagged(t: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Return the integral (n − k, 3) of a rate (n, 3) over k samples, by trapezia."""
    k = _lag(t)
    area = np.diff(t)[:, None] * 0.5 * (rate[1:] + rate[:-1])
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(area, axis=0)])
    return total[k:] - total[: len(total) - k]


def turned(R: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return R x (n, 3) of rotations (n, 3, 3) and vectors (n, 3)."""
    return np.asarray(np.einsum("nij,nj->ni", R, x))


def _refuse_world_axes(
    where: str, letter: str, steps: np.ndarray, read: np.ndarray, other: np.ndarray
) -> None:
    known = np.isfinite(steps + read + other).all(axis=1)
    size = float(np.sqrt((steps[known] ** 2).sum()))
    if not size:
        return
    missed, missed_other = (
        float(np.sqrt(((x[known] - steps[known]) ** 2).sum())) / size for x in (read, other)
    )
    if missed > RATES_OFF and missed_other < BETTER * missed:
        raise MotionError(
            f"{where}{letter}x {letter}y {letter}z: rates in the axes of the body are asked, and "
            f"those of the log are in the world's: they miss the steps of the pose by "
            f"{missed:.0%}, turned into the body by {missed_other:.0%}; turn them by the pose, or "
            "leave them out (the pose is differentiated)"
        )
