"""Drives that play a log's commands: their law closes the loop over the simulated motion.

    τ(t, q, v) = on(t) · clip(T₀(t) + T_q(t) q + T_v(t) v, ±limit)

T₀, T_q and T_v are taken from the drive's own law at unit states, so that what is simulated and
what is identified cannot disagree. Commands are late by the drive's delay and held until the next
sample, or go straight on between samples where the drive does so; gains and `on` are held, so that
T₀ goes straight on too, and jumps where a gain does.
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
# numerics: share of the largest below which a term does not change, and of a sample within which
# times are one: delays that differ by whole samples leave 3e-18 s
SAME = 1e-9


@dataclass(frozen=True, eq=False)
class CommandLaw:
    """The torque of one drive over time and state."""

    drive: int  # place among the driven joints
    joint: int  # and among all joints
    t: np.ndarray  # (n,) [s] of all changes
    terms: np.ndarray  # (3, n) T₀, T_q, T_v from then on
    ends: np.ndarray  # (n,) T₀ to which it goes straight on until the next change; T₀ if it is held
    limit: float  # [N m | N]
    on: np.ndarray  # (n,) 1, or 0 where the drive is off

    def torque(self, t: float, y: np.ndarray, yd: np.ndarray) -> float:
        """Return the torque [N m | N] at an instant, coordinates and rates (J,) of all joints."""
        at = max(int(self.t.searchsorted(t, side="right")) - 1, 0)
        T0, Tq, Tv = self.terms[:, at].tolist()
        if at + 1 < len(self.t) and self.ends[at] != T0:
            since, until = self.t[at : at + 2]
            T0 += (self.ends[at] - T0) * max(t - since, 0.0) / (until - since)
        torque = T0 + Tq * y[self.joint] + Tv * yd[self.joint]
        return float(min(max(torque, -self.limit), self.limit) * self.on[at])

    @property
    def jumps(self) -> np.ndarray:
        """Whether (n − 1,) a term is another from a change on than just before it."""
        largest = np.abs(self.terms).max(axis=1)
        least = SAME * np.maximum(largest[0], largest[1:, None])  # they are differences from T₀
        slopes = (np.abs(np.diff(self.terms[1:])) > least).any(axis=0)
        return np.asarray(slopes | (self.terms[0, 1:] != self.ends[:-1]))


def command_laws(mechanism: Mechanism, point: Point, e: State) -> list[CommandLaw]:
    """Return the laws of all drives whose commands a log has."""
    laws, instants = list[CommandLaw](), e.t
    near = SAME * float(np.median(np.diff(e.t)))
    for name, drive in mechanism.drives.items():
        if not isinstance(drive, Drive) or not e.extra.keys() >= {*drive.reads()}:
            continue
        shape = {**drive.values, **point.of(drive)[1]}
        straight = not e.extra.get(HOLD + name, np.ones(1))[0]
        t, extra = _played(drive, point, e, straight)
        arrived = {key: np.append(x[1:], x[-1:]) if _is_late(drive, key) else x
                   for key, x in extra.items()}  # fmt: skip
        zero = np.zeros((len(t), 1))
        T0, Tq, Tv, ends = (
            drive.unlimited(
                Signals(t, zero + q, zero + v, zero, np.zeros(1), columns, shape, point.values)
            )
            for columns, q, v in (
                (extra, 0.0, 0.0), (extra, 1.0, 0.0), (extra, 0.0, 1.0), (arrived, 0.0, 0.0),
            )
        )  # fmt: skip
        terms = np.stack([T0, Tq - T0, Tv - T0])
        on = extra.get(f"on.{name}", np.ones(len(t))) > 0.5
        joint = mechanism.joint_index[name]
        at = mechanism.driven.index(name)
        limit = drive.setting("limit")
        t = _snapped(t, instants, near)
        instants = np.union1d(instants, t)
        laws.append(
            CommandLaw(at, joint, t, terms, ends if straight else T0, limit, on.astype(float))
        )
    return laws


def _snapped(t: np.ndarray, instants: np.ndarray, near: float) -> np.ndarray:
    """Return times (n,) [s], those near one of some instants (m,), ascending, at the instant."""
    after = np.clip(np.searchsorted(instants, t), 1, len(instants) - 1)
    before, after = instants[after - 1], instants[after]
    nearest = np.where(t - before < after - t, before, after)
    return np.where(np.abs(nearest - t) <= near, nearest, t)


def _is_late(drive: Drive, column: str) -> bool:
    """Return whether a column is a command of a drive, which acts late."""
    kind, _, joint = column.partition(".")
    return joint == drive.joints[0] and kind in drive.late


def _played(
    drive: Drive, point: Point, e: State, straight: bool
) -> tuple[np.ndarray, Mapping[str, np.ndarray]]:
    """Return the times (n,) at which commands or gains change, and the columns that the drive reads
    there as they act: commands late, gains at once.
    """
    name, nothing = drive.joints[0], np.zeros(0)
    at = Signals(nothing, nothing, nothing, nothing, nothing, {}, {}, point.values)
    late = drive.delay(at) if "delay" in drive.settings else 0.0
    commands = {key: x for key, x in e.extra.items() if _is_late(drive, key)}
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
    """Return the times (n,) [s] at which held commands and gains change, where integration steps
    end.
    """
    times = [law.t[1:][law.jumps] for law in laws]
    return np.unique(np.concatenate(times)) if times else None
