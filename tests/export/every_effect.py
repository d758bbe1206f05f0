"""An arm with every effect that MuJoCo holds, and its torques."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import ident
from ident.log import Log

EVERY = {  # of an effect that MuJoCo holds, with values of its parameters
    "viscous": (0.31,), "coulomb": (0.23,), "rotor_inertia": (0.017,), "drag:elbow": (0.11,),
    "spring:shoulder": (3.7, 0.4), "cable:elbow:degree=3": (0.3, -0.7, 0.4, 0.9),
    "torque_offset:yaw": (0.6,), "torque_gain:wrist": (0.07,), "encoder_offset:elbow": (0.03,),
    "payload:hand": (0.4, 0.01, 0.02, 0.03, 425e-5, -5e-4, 37e-4, -75e-5, -15e-4, 275e-5),
    "coupling:elbow,wrist": (0.013, 0.05, 0.07), "gravity_tilt": (0.02, -0.03),
}  # fmt: skip
AWAY = 0.2  # [rad/s] from a reversal, where dry friction is soft in MuJoCo and smooth in C


def every_effect(
    robots: Path,
) -> tuple[ident.Mechanism, dict[str, float], list[tuple[np.ndarray, ...]]]:
    """Return the arm, its values, and states with torques: q, v, a, tau (4,) as they are logged."""
    mechanism, values = ident.load(robots / "arm"), {}
    for label, numbers in EVERY.items():
        mechanism = mechanism.with_effect(label)
        for effect in mechanism.effects:
            if effect.kind == label.partition(":")[0]:
                values |= dict(zip(effect.names, numbers, strict=True))
    t = np.arange(0.0, 2.0, 0.07)
    columns = {}
    for i, joint in enumerate(mechanism.driven):
        phase = 3.0 * t + i
        columns |= {f"q.{joint}": 0.4 * np.sin(phase), f"v.{joint}": 1.2 * np.cos(phase),
                    f"a.{joint}": -3.6 * np.sin(phase)}  # fmt: skip
    log, _ = ident.simulate(mechanism, Log.from_arrays("run", t, columns), values=values)
    series = [np.stack([log.columns[f"{c}.{joint}"] for joint in mechanism.driven], axis=1)
              for c in ("q", "v", "a", "tau")]  # fmt: skip
    v = series[1]
    away = np.abs(np.column_stack([v, v[:, 2] + v[:, 3]])).min(axis=1) > AWAY
    assert away.sum() > 10
    return mechanism, values, list(zip(*(x[away] for x in series), strict=True))
