"""Commands of servos with which a planned motion is made: the drive's law solved for them.

    ref(t) = q(t + l) + (τ(t + l) + kd q̇(t + l)) / kp,      l = delay + half a hold

τ is what the model needs for the motion. A servo that has rates as commands gets them as well, and
its kd then acts on nothing. Without gains, which a fit finds, no command makes a wanted motion.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.interpolate import CubicSpline

from ident.effects.effect import Signals
from ident.effects.servo import Drive, Servo
from ident.equations.unknowns import Point
from ident.mechanism.mechanism import Mechanism
from ident.motion import State
from ident.text import listed


def planned_commands(
    mechanism: Mechanism, point: Point, known: Mapping[str, float], e: State
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Return the columns `ref.` and `dref.` (n,) of a motion's servos, and notes.

    Args:
        mechanism: with drives; point: the values of all parameters.
        known: of `point`, those that were given by name; others are starts of a search.
        e: the motion, with the torques that it needs.
    """
    columns, unknown = dict[str, np.ndarray](), list[str]()
    nothing = np.zeros(0)
    for name, drive in mechanism.drives.items():
        if not isinstance(drive, Servo):
            continue
        gains = {
            shape.name: drive.values.get(shape.name, known.get(drive.full[shape.name]))
            for shape in drive.shapes
        }
        kp, kd = gains["kp"], gains["kd"]
        if not kp or kd is None:
            unknown.append(name)
            continue
        late = Signals(nothing, nothing, nothing, nothing, nothing, {}, {}, point.values)
        hold = 0.0 if drive.setting("linear") > 0.5 else 1 / e.rate
        t = np.minimum(e.t + drive.delay(late) + 0.5 * hold, e.t[-1])
        at, motor = mechanism.joint_index[name], mechanism.driven.index(name)
        q, v, torque = (CubicSpline(e.t, x)(t) for x in (e.y[:, at], e.yd[:, at], e.tau[:, motor]))
        if drive.setting("follows_velocity") > 0.5:
            columns[f"dref.{name}"] = v
            v = np.zeros_like(v)
        columns[f"ref.{name}"] = q + (torque + kd * v) / kp
    if not unknown:
        return columns, []
    key = f"{unknown[0]}:kp=…,kd=…"
    return columns, [
        f"no command is planned for {listed(unknown)}, whose gains are not known: give them "
        f"(--drive {key}), or plan from the folder of a fit"
    ]


def torque_limit(mechanism: Mechanism, joint: str) -> float:
    """Return the largest torque [N m | N] of a joint's drive; infinite where none is given."""
    drive = mechanism.drives.get(joint)
    return drive.setting("limit") if isinstance(drive, Drive) else np.inf
