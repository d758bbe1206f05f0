"""Whether a motion keeps the limits of the URDF: positions, speeds, torques."""

from __future__ import annotations

import numpy as np

from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion

SLACK = 1e-6


def allowed(mechanism: Mechanism, now: Motion, then: Motion) -> bool:
    """Whether a motion keeps all limits that the present one keeps."""
    for i, joint in enumerate(mechanism.joints):
        for series, low, high in (
            ("y", joint.lower, joint.upper),
            ("yd", -joint.velocity, joint.velocity),
        ):
            before, after = (_extent(m, series, i) for m in (now, then))
            slack = SLACK * (1 + abs(after[0]) + abs(after[1]))
            if before[0] >= low and after[0] < low - slack:
                return False
            if before[1] <= high and after[1] > high + slack:
                return False
    for i, name in enumerate(mechanism.driven):
        was, is_ = (max(map(abs, _extent(m, "tau", i))) for m in (now, then))
        if was <= (most := mechanism.joint(name).effort) and is_ > most > 0:
            return False
    return True


def _extent(motion: Motion, series: str, i: int) -> tuple[float, float]:
    x = np.concatenate([getattr(e, series)[e.usable, i] for e in motion.experiments])
    return float(x.min()), float(x.max())
