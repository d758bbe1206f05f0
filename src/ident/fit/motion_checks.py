"""What may be wrong with the motion, gravity or wrenches: the state as it would be.

sign, axis, scale, exchange of positions      q_j → −q_j, …       `_positions`
scale of time                                 v, a → v/s, a/s²    `_times`
direction of gravity                          g → g'              `_gravities`
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from ident.effects import KINDS
from ident.fit.channel_fits import ChannelCause, ChannelEquations, CredibleCause, unit_of_factor
from ident.fit.findings import Finding
from ident.information.hypotheses import Array
from ident.mechanism.mechanism import Mechanism
from ident.motion import State

DEGREES = 10.0  # smallest range of a position that may be in degrees
EARTH = 9.81  # m/s²
CLOCKS = (1 / 60, 0.1, 0.3, 0.7, 0.9, 1.1, 1.5, 3.0, 10.0, 60.0)  # true over logged time
Moved = Callable[[Mechanism, State], tuple[Mechanism, State]]


@dataclass(frozen=True, eq=False)
class MotionCause:
    """Something that may be wrong with positions, time or gravity.

    Attributes:
        kind: the code of its finding; joints: names; number: of it, or three of them.
        state: the mechanism and the state as they would be, from those as they are.
        gain, take: by driven joint, the factor and the channel of the torques that go with it.
    """

    kind: str
    joints: tuple[str, ...]
    number: tuple[float, ...]
    state: Moved
    gain: Mapping[int, float] = field(default_factory=dict)
    take: Mapping[int, int] = field(default_factory=dict)

    def torques(self, equations: ChannelEquations) -> ChannelCause:
        """The torques that go with it."""
        cause = equations.as_logged
        gain = tuple(self.gain.get(j, x) for j, x in enumerate(cause.gain))
        take = tuple(self.take.get(j, x) for j, x in enumerate(cause.take))
        return replace(cause, gain=gain, take=take)


def motion_causes(
    mechanism: Mechanism, states: Sequence[State], poor: Collection[str]
) -> list[MotionCause]:
    """Return all hypotheses; positions only where the torques of some joints are poor."""
    positions = _positions(mechanism, states, poor) if poor else ()
    found = [*_gravities(mechanism), *map(scale_of_time, CLOCKS), *positions]
    if any(e.wrench is not None for e in states):
        found += [_wrench(factor) for factor in (-1.0, 0.0)]
    return found


def scale_of_time(s: float) -> MotionCause:
    """Return another scale of time: true over logged."""

    def state(mechanism: Mechanism, e: State) -> tuple[Mechanism, State]:
        return mechanism, replace(
            e, t=s * e.t, v=e.v / s, a=e.a / s**2, yd=e.yd / s, ydd=e.ydd / s**2, still=e.still / s
        )

    return MotionCause("time", (), (s,), state)


def _wrench(factor: float) -> MotionCause:
    """Return logged wrenches times a factor."""

    def state(mechanism: Mechanism, e: State) -> tuple[Mechanism, State]:
        return mechanism, replace(e, wrench=None if e.wrench is None else factor * e.wrench)

    return MotionCause("wrench", (), (factor,), state)


def refined_time(s: float, error: Callable[[MotionCause], float]) -> MotionCause:
    """Return the scale of time of least error between those that were tried beside s."""
    from scipy.optimize import minimize_scalar  # takes 0.2 s to import

    at, logs = CLOCKS.index(s), np.log(CLOCKS)
    ends = logs[max(at - 1, 0)], logs[min(at + 1, len(CLOCKS) - 1)]
    found = minimize_scalar(
        lambda x: error(scale_of_time(float(np.exp(x)))),
        bounds=ends, method="bounded", options={"xatol": 0.003, "maxiter": 12},
    )  # fmt: skip
    return scale_of_time(float(np.exp(found.x)))


def _gravities(mechanism: Mechanism) -> Iterator[MotionCause]:
    """Yield gravity along the other axes and none."""
    given = np.asarray(mechanism.model.gravity.linear)
    for g in (*EARTH * np.eye(3), *-EARTH * np.eye(3), np.zeros(3)):
        if np.linalg.norm(g - given) < 0.05 * EARTH:
            continue

        def state(mechanism: Mechanism, e: State, g: Array = g) -> tuple[Mechanism, State]:
            model = mechanism.model.copy()
            model.gravity.linear = g
            return mechanism.with_model(model), e

        yield MotionCause("gravity", (), tuple(map(float, g)), state)


def _positions(
    mechanism: Mechanism, states: Sequence[State], poor: Collection[str]
) -> Iterator[MotionCause]:
    """Yield positions turned (alone, and with their torque: an axis), in degrees, and exchanged
    (alone, and with their torques) where the torque of one is poor.
    """
    names = states[0].logged
    driven = {name: j for j, name in enumerate(mechanism.driven)}

    def moved(take: Mapping[int, int], times: Mapping[int, float]) -> Moved:
        order = [take.get(j, j) for j in range(len(names))]
        factors = np.array([times.get(j, 1.0) for j in range(len(names))])

        def state(mechanism: Mechanism, e: State) -> tuple[Mechanism, State]:
            known = e.known(mechanism, names)[:, :, order] * factors
            start = "follow" if mechanism.closures else "near"
            return mechanism, e.at(mechanism, known, names, start=start)

        return state

    for j, name in enumerate(names):
        turned = moved({}, {j: -1.0})
        yield MotionCause("position sign", (name,), (-1.0,), turned)
        if name in driven:
            yield MotionCause("axis", (name,), (-1.0,), turned, {driven[name]: -1.0})
        at = mechanism.joint_index[name]
        if max(float(np.ptp(e.y[:, at])) for e in states) > DEGREES:
            state = moved({}, {j: np.pi / 180})
            yield MotionCause("position scale", (name,), (np.pi / 180,), state)
    for (i, a), (j, b) in combinations(enumerate(names), 2):
        if {a, b} & set(poor):
            state = moved({i: j, j: i}, {})
            yield MotionCause("position swapped", (a, b), (1.0,), state)
            if {a, b} <= set(driven):
                take = {driven[a]: driven[b], driven[b]: driven[a]}
                yield MotionCause("joints swapped", (a, b), (1.0,), state, {}, take)


# --- in words -----------------------------------------------------------------------------------


def motion_cause_in_words(mechanism: Mechanism, cause: MotionCause, fall: str) -> tuple[str, str]:
    """Return what a cause is, and the remedy."""
    joints, number = " and ".join(cause.joints), cause.number[0]
    channels = tuple(f"q.{name}" for name in cause.joints)
    if cause.kind == "gravity":
        g, given = (
            "[" + ", ".join(f"{x:.4g}" for x in vector) + "]"
            for vector in (cause.number, mechanism.model.gravity.linear)
        )
        text = f"gravity: with {g} m/s² instead of {given}"
        remedy = f"write gravity = {g}, or turn the base of the URDF"
    elif cause.kind == "time":
        text = f"time or lengths: with a clock {number:.4g} times as long, or lengths in the URDF "
        text += f"{number**-2:.3g} times as long, which torques can hardly tell apart,"
        remedy = f"check the unit of t and the rate of the log; {log_entry(mechanism, 't', number)}"
    elif cause.kind == "wrench":
        text = f"columns wrench.…: {'with the other sign' if number else 'left out'},"
        remedy = "a wrench is what acts on the link, in the link's frame; check its sign"
    elif cause.kind == "axis":
        entries = ", ".join(log_entry(mechanism, f"{k}.{joints}", -1.0) for k in ("q", "tau"))
        text = f"{joints}: the axis points the other way: with position and torque turned"
        remedy = f"turn the axis of {joints} in the URDF, or write {entries}"
    elif cause.kind in ("position sign", "position scale"):
        wrong = "the sign is wrong" if number < 0 else "in degrees, not in radians"
        text = f"{channels[0]}: {wrong}: corrected,"
        remedy = f"write {log_entry(mechanism, channels[0], number)}, velocity alike"
    else:
        torques = ", torques" if cause.kind == "joints swapped" else ""
        text = f"{' and '.join(channels)} look exchanged{torques}: with one in the other's place"
        remedy = f"write {exchange(mechanism, channels)}, velocities{torques} alike"
    return f"{text} {fall}", remedy


def torque_finding(
    mechanism: Mechanism, equations: ChannelEquations, found: CredibleCause
) -> Finding:
    """Return a credible cause in the torques in words."""
    cause, number = found.cause, found.cause.number
    names = [mechanism.driven[j] for j in cause.joints]
    channels = tuple(f"tau.{name}" for name in names)
    if cause.kind == "swapped":
        text, remedy = "exchanged: with one in the other's place", exchange(mechanism, channels)
    elif cause.kind == "sign":
        joints = " and ".join(f"q.{name}" for name in names)
        text = f"the sign is against that of {joints}: as logged, inertia or friction would be "
        text += "negative; turned,"
        entries = ", ".join(log_entry(mechanism, c, -1.0) for c in channels)
        remedy = f"write {entries}, or turn {joints}"
    elif cause.kind == "scale":
        known = len(mechanism.unknown) < len(mechanism.bodies.names)
        bodies = " and what is known of bodies" if known else ""
        text = f"reads {1 / number:.3g} times what the other joints' torques{bodies} require "
        text += f"({unit_of_factor(number)}): scaled,"
        remedy = f"check its unit; {log_entry(mechanism, channels[0], number)}"
    else:
        number = 1e3 * equations.refined_delay(cause)
        text = f"{abs(number):.3g} ms {'late' if number > 0 else 'early'} against the positions"
        kinds = [kind for kind, each in KINDS.items() if each.fault == cause.kind]
        remedy = "shift the column" + "".join(f", or add the effect {k}:{names[0]}" for k in kinds)
        if len(names) > 1 and len(names) == len(mechanism.driven):
            text = f"all torques are {text}: two clocks, or a filter on one of them"
            remedy = "shift the torque columns together, or filter positions and torques alike"
        text += "; without the delay"
    text += f" the error of the predicted torque falls from {100 * found.before:.3g} % to "
    text += f"{100 * found.after:.3g} %"
    how = {"swapped": "exchanging", "sign": "turning", "scale": "scaling", "delay": "shifting"}
    for each in found.rivals:
        rival = " and ".join(f"tau.{mechanism.driven[j]}" for j in each.joints)
        text += f"; {how[each.kind]} {rival}"
        unit = {"scale": "", "delay": " s"}.get(each.kind)
        text += "" if unit is None else f" by {each.number:.3g}{unit}"
        text += " would do nearly as well"
    return Finding(cause.kind, f"{', '.join(channels)}: {text}", remedy, channels, number)


def log_entry(mechanism: Mechanism, channel: str, factor: float) -> str:
    """Return the line of `[log]` that multiplies a channel by a factor."""
    source = mechanism.columns.get(channel)
    column, scale = (source.column, source.scale) if source else (channel, 1.0)
    return f'[log] "{channel}" = {{ column = "{column}", scale = {factor * scale:.4g} }}'


def exchange(mechanism: Mechanism, channels: tuple[str, ...]) -> str:
    """Return the lines of `[log]` that exchange two channels."""
    columns = [
        source.column if (source := mechanism.columns.get(c)) else c for c in reversed(channels)
    ]
    pairs = zip(channels, columns, strict=True)
    return " and ".join(f'[log] "{c}" = {{ column = "{column}" }}' for c, column in pairs)
