"""Frames about an axis."""

from __future__ import annotations

import numpy as np


def perpendicular(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors x, y with x × y = axis, x nearest to the frame's own x (or y)."""
    axis = axis / np.linalg.norm(axis)
    seed = np.eye(3)[0] if abs(axis[0]) < 0.9 else np.eye(3)[1]
    x = seed - axis * (axis @ seed)
    x /= np.linalg.norm(x)
    return x, np.cross(axis, x)


def align_z(axis: np.ndarray) -> np.ndarray:
    """A rotation (3, 3) whose z is `axis`, for closures that stand for a joint about it."""
    x, y = perpendicular(axis)
    return np.column_stack([x, y, axis / np.linalg.norm(axis)])
