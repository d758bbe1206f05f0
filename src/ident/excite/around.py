"""Home and limits from a logged motion: what the machine has done before, it can do again.

    home = q(t_k),    k = argmin_t max_j |y_j(t) − c_j| / w_j

c, w: middle and width of a joint's range in the log.

A configuration of the log itself is home, not the middles of all joints, since those of a closed
loop need not fit together.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ident.errors import MotionError
from ident.excite.limits import TURN, Limits
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion

INSIDE = 0.005, 0.995  # level: quantiles of a logged position that are its range


def around_motion(
    mechanism: Mechanism, limits: Limits, motion: Motion, *, as_logged: bool = False
) -> tuple[Mechanism, Limits]:
    """Return the mechanism with its start in the middle of a motion, and the limits with the
    motion's range and speed for the joints of which neither they nor the URDF have one;
    `as_logged`: for all independent joints that the limits do not name.

    Raises:
        MotionError: if the motion has no usable sample.
    """
    states = [e for e in motion.experiments if e.usable.any()]
    if not states:
        raise MotionError(f"{mechanism.name}: no usable sample in the log around which to move")
    q, y, yd = (np.concatenate([getattr(e, n)[e.usable] for e in states]) for n in ("q", "y", "yd"))
    low, high = np.quantile(y, INSIDE, axis=0)
    width = np.where(high > low, high - low, np.inf)
    middle = int((np.abs(y - 0.5 * (low + high)) / width).max(axis=1).argmin())
    ranges, speeds = {}, {}
    for i, joint in enumerate(mechanism.joints):
        free = not np.isfinite(joint.upper - joint.lower)
        free |= joint.rotational and joint.upper - joint.lower > TURN
        kept = as_logged and joint.name in motion.independent
        if (free or kept) and high[i] > low[i]:
            ranges[joint.name] = float(low[i]), float(high[i])
        if (kept or not joint.velocity) and (fastest := float(np.abs(yd[:, i]).max())) > 0:
            speeds[joint.name] = fastest
    given = limits.speed
    if given is None or not isinstance(given, float | int):
        limits = replace(limits, speed=speeds | dict(given or {}))
    limits = replace(limits, range=ranges | dict(limits.range))
    return mechanism.with_same_kinematics(start=q[middle]), limits
