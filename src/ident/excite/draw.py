"""Random courses that keep the limits: touching those of the drives, then grown from home.

Every sample comes to its place along the straight line from home, so that it is on the branch of
the start and no loop passes through a singular position on its way.
"""

from __future__ import annotations

import numpy as np

from ident.excite.course import Track
from ident.excite.stage import LEAP, Seen
from ident.motion import Experiment

HALVINGS = 4  # of the last step from home
INSIDE = 0.97  # of the limits that a drawn course reaches


def drawn(track: Track, random: np.random.Generator) -> tuple[np.ndarray, Seen, np.ndarray] | None:
    """A random course x (d, P) with its rows and limited quantities; None if home alone is left."""
    x = random.standard_normal(track.fourier.shape)
    shift = random.uniform(-1.0, 1.0, len(x))
    return grown(track, _touching(track, x, shift))


def _touching(track: Track, x: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Each drive's series made as large as its own limits allow, and put where there is room."""
    family, basis = track.fourier, track.basis
    x = x.copy()
    x[:, 0] = 0.0
    y, v, a = family.placed(basis, x)
    y = y - family.home
    joints = track.stage.mechanism.joint_index
    middle = track.box.middle[[joints[name] for name in track.rest.independent]]
    low, high = y.min(axis=0), y.max(axis=0)
    top = [np.abs(each).max(axis=0) + 1e-300 for each in (v, a)]
    size = INSIDE * np.minimum(
        2 * family.half / (high - low),
        np.minimum(family.speed / top[0], family.acceleration / top[1]),
    )
    x *= size[:, None]
    room = INSIDE * family.half - 0.5 * size * (high - low)
    x[:, 0] = (middle - family.home - 0.5 * size * (high + low) + shift * room) / family.half
    return x


def grown(track: Track, x: np.ndarray) -> tuple[np.ndarray, Seen, np.ndarray] | None:
    """The largest share of a course x (d, P) that keeps all limits, from home outward."""
    far = np.abs(track.fourier.placed(track.basis, x)[0] - track.fourier.home).max()
    count = int(np.ceil(far / (0.9 * LEAP))) if track.stage.mechanism.closures else 1
    near: Experiment = track.rest
    best = None
    share, step, halved = 0.0, 1.0 / max(count, 1), 0
    while share < 1.0 - 1e-12 and halved <= HALVINGS:
        found = track.motion((share + step) * x, near)
        if found is None:
            step, halved = 0.5 * step, halved + 1
            continue
        share += step
        near = found[0].e
        best = share * x, *found
        if halved:
            step, halved = 0.5 * step, halved + 1
    return best
