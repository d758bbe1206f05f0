"""Drives that play a log's commands: their law closes the loop over the simulated motion.

    τ(t, q, v) = on(t) · clip(T₀(t) + T_q(t) q + T_v(t) v, ±limit)

T₀, T_q and T_v are taken from the drive's own law at unit states, so that what is simulated and
what is identified cannot disagree: commands are late by the drive's delay and by half a sample, the
mean lateness of a command that is held, and go straight between samples; `on` is held.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.effects.effect import Signals
from ident.effects.servo import Drive
from ident.equations.unknowns import Point
from ident.mechanism.mechanism import Mechanism
from ident.motion import State
from ident.simulate.dynamics import Actuator
from ident.simulate.plant import InstantTerms


@dataclass(frozen=True, eq=False)
class CommandLaw:
    """The torque of one drive over time and state."""

    drive: int  # place among the driven joints
    joint: int  # and among all joints
    t: np.ndarray  # (n,) [s]
    terms: np.ndarray  # (3, n) T₀, T_q, T_v
    limit: float  # [N m | N]
    on: np.ndarray  # (n,) 1, or 0 where the drive is off

    def torque(self, t: float, y: np.ndarray, yd: np.ndarray) -> float:
        """Return the torque [N m | N] at an instant, coordinates and rates (J,) of all joints."""
        T0, Tq, Tv = (np.interp(t, self.t, term) for term in self.terms)
        torque = np.clip(T0 + Tq * y[self.joint] + Tv * yd[self.joint], -self.limit, self.limit)
        at = int(np.searchsorted(self.t, t, side="right")) - 1
        return float(torque * self.on[max(at, 0)])


def command_laws(mechanism: Mechanism, point: Point, e: State) -> list[CommandLaw]:
    """Return the laws of all drives whose commands a log has."""
    laws = []
    n = len(e.t)
    for name, drive in mechanism.drives.items():
        if not isinstance(drive, Drive) or not e.extra.keys() >= {*drive.reads()}:
            continue
        shape = {**drive.values, **point.of(drive)[1]}

        def unlimited(q: float, v: float, drive: Drive = drive, shape=shape) -> np.ndarray:  # type: ignore[no-untyped-def]
            zero = np.zeros((n, 1))
            s = Signals(e.t, zero + q, zero + v, zero, np.zeros(1), e.extra, shape, point.values)
            return drive.unlimited(s)

        T0 = unlimited(0.0, 0.0)
        terms = np.stack([T0, unlimited(1.0, 0.0) - T0, unlimited(0.0, 1.0) - T0])
        on = e.extra.get(f"on.{name}", np.ones(n)) > 0.5
        joint = mechanism.joint_index[name]
        at = mechanism.driven.index(name)
        limit = drive.setting("limit")
        laws.append(CommandLaw(at, joint, e.t, terms, limit, on.astype(float)))
    return laws


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
