"""Drives that play a log's commands: their law closes the loop over the simulated motion.

    τ(t, q, v) = on(t) · clip(T₀(t) + T_q(t) q + T_v(t) v, ±limit)

T₀, T_q and T_v are taken from the drive's own law at unit states, so that what is simulated and
what is identified cannot disagree. Commands are late by the drive's delay and held until the next
sample, or go straight on between samples where the drive does so; gains and `on` are held.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ident.effects.effect import Signals
from ident.effects.servo import AS_IT_ACTS, HOLD, Drive
from ident.equations.unknowns import Point
from ident.mechanism.mechanism import Mechanism
from ident.motion import State
from ident.simulate.dynamics import Actuator
from ident.simulate.plant import InstantTerms

GAINS = ("kp", "kd", "on")  # columns of a joint that act at once, and are held


@dataclass(frozen=True, eq=False)
class CommandLaw:
    """The torque of one drive over time and state."""

    drive: int  # place among the driven joints
    joint: int  # and among all joints
    t: np.ndarray  # (n,) [s] of all changes
    terms: np.ndarray  # (3, n) T₀, T_q, T_v
    straight: bool  # whether the first goes straight on between them, or is held like the others
    limit: float  # [N m | N]
    on: np.ndarray  # (n,) 1, or 0 where the drive is off

    def torque(self, t: float, y: np.ndarray, yd: np.ndarray) -> float:
        """Return the torque [N m | N] at an instant, coordinates and rates (J,) of all joints."""
        at = max(int(np.searchsorted(self.t, t, side="right")) - 1, 0)
        T0, Tq, Tv = self.terms[:, at]
        if self.straight:
            T0 = np.interp(t, self.t, self.terms[0])
        torque = T0 + Tq * y[self.joint] + Tv * yd[self.joint]
        return float(min(max(torque, -self.limit), self.limit) * self.on[at])


def command_laws(mechanism: Mechanism, point: Point, e: State) -> list[CommandLaw]:
    """Return the laws of all drives whose commands a log has."""
    laws = []
    for name, drive in mechanism.drives.items():
        if not isinstance(drive, Drive) or not e.extra.keys() >= {*drive.reads()}:
            continue
        shape = {**drive.values, **point.of(drive)[1]}
        straight = not e.extra.get(HOLD + name, np.ones(1))[0]
        t, extra = _played(drive, point, e, straight)
        zero = np.zeros((len(t), 1))
        T0, Tq, Tv = (
            drive.unlimited(
                Signals(t, zero + q, zero + v, zero, np.zeros(1), extra, shape, point.values)
            )
            for q, v in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
        )
        terms = np.stack([T0, Tq - T0, Tv - T0])
        on = extra.get(f"on.{name}", np.ones(len(t))) > 0.5
        joint = mechanism.joint_index[name]
        at = mechanism.driven.index(name)
        limit = drive.setting("limit")
        laws.append(CommandLaw(at, joint, t, terms, straight, limit, on.astype(float)))
    return laws


def _played(
    drive: Drive, point: Point, e: State, straight: bool
) -> tuple[np.ndarray, Mapping[str, np.ndarray]]:
    """Return the times (n,) at which commands or gains change, and the columns that the drive reads
    there as they act: commands late, gains at once.
    """
    name, nothing = drive.joints[0], np.zeros(0)
    at = Signals(nothing, nothing, nothing, nothing, nothing, {}, {}, point.values)
    late = drive.delay(at) if "delay" in drive.settings else 0.0
    commands = {key: x for key, x in e.extra.items()
                if key.endswith(f".{name}") and key.partition(".")[0] in drive.late}  # fmt: skip
    gains = {key: x for key, x in e.extra.items()
             if key.endswith(f".{name}") and key.partition(".")[0] in GAINS}  # fmt: skip
    t = np.unique(np.concatenate([e.t + late, e.t])) if gains and late else e.t + late
    since = np.clip(np.searchsorted(e.t + late, t, side="right") - 1, 0, None)
    extra = {
        key: np.interp(t, e.t + late, x) if straight else x[since] for key, x in commands.items()
    }
    now = np.clip(np.searchsorted(e.t, t, side="right") - 1, 0, None)
    extra |= {key: x[now] for key, x in gains.items()}
    return t, extra | {HOLD + name: np.full(len(t), AS_IT_ACTS)}


def commanded(laws: list[CommandLaw], otherwise: Actuator) -> Actuator:
    """Return an actuator in which drives play their commands; other joints do as `otherwise`."""
    if not laws:
        return otherwise

    def torques(m: InstantTerms, against: np.ndarray) -> np.ndarray:
        tau = np.array(otherwise(m, against), dtype=float)
        for law in laws:
            tau[law.drive] = law.torque(m.t, m.y, m.yd)
        return tau

    return torques


def steps_of(laws: list[CommandLaw]) -> np.ndarray | None:
    """Return the times (n,) [s] at which held commands change, at which integration steps end."""
    times = [law.t[1:][np.diff(law.terms[0]) != 0] for law in laws if not law.straight]
    return np.unique(np.concatenate(times)) if times else None
