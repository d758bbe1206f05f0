"""What may be wrong with a log, as one table of hypotheses: what it would be without the fault.

sign, factor, exchange, delay of torques      τ_j → g τ_i(t + l)      `torque_faults`
sign, axis, scale, exchange of positions      q_j → −q_j, …           `_positions`
positions counted from another link           q_j → q_j − q_i − …     `_positions`
motors that do not sit at the joints          q → A⁻¹ m, τ → Aᵀ τ_m   `motors.motor_faults`
scale of time                                 v, a → v/s, a/s²        `scale_of_time`
direction of gravity                          g → g'                  `motion_faults`
sign of wrenches, or none of them             f_e → −f_e, 0           `motion_faults`
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, combinations
from typing import Any

import numpy as np

from ident.effects import KINDS
from ident.finding import Finding
from ident.information.cause import Cause
from ident.information.linear import Array
from ident.log import Column
from ident.mechanism.description import is_rotational, joint_axis
from ident.mechanism.mechanism import Mechanism
from ident.motion import State
from ident.motion.unforced import free_slides
from ident.text import listed, percent, places

PARALLEL = 0.999  # numerics: cosine of two axes that are one, up to rounding in a URDF
DEGREES = 10.0  # range: smallest range of a position that may be in degrees
EARTH = 9.81  # range: m/s²
CLOCKS = (1 / 60, 0.1, 0.3, 0.7, 0.9, 1.1, 1.5, 3.0, 10.0, 60.0)  # work: true over logged time
UNITS = {  # by which factors units of torque differ, or their inverses
    1e3: "mN m for N m",
    100.0: "N cm for N m",
    180 / np.pi: "degrees for radians",
    10.0: "a factor of ten",
    9.81: "kgf m for N m",
    8.851: "lbf in for N m",
}
LINKS_PASSED = 2  # range: joints that a shaft or a cable to an encoder passes
LARGE_UNIT = 500.0  # shown: factor of a unit beyond which it is hardly a gear ratio
UNIT = 0.1  # shown: difference of logarithms within which a factor is that of a unit
StateChange = Callable[[Mechanism, State], tuple[Mechanism, State]]


@dataclass(frozen=True, kw_only=True)
class Fault(Cause):
    """A hypothesis: what each joint is given instead of its own torque, and another motion.

    `kind` is the code of its finding, `places` are its joints, of exchanged ones those that are
    read instead.
    """

    driven: tuple[str, ...]  # names of the J driven joints
    take: tuple[int, ...]  # by driven joint, the channel that is its torque
    gain: tuple[float, ...]  # the channel's factor
    shift: tuple[int, ...]  # the number of its shift in time, 0: none
    # the factor, those of several positions, the delay [s] (positive: the torque is late), the
    # scale of time, or the three components of gravity [m/s²]
    number: tuple[float, ...] = ()
    state: StateChange | None = None  # makes mechanism and state as they would be; None: as is
    at: Callable[[float], Fault] | None = None  # the same fault with another factor or scale

    @classmethod
    def none(cls, driven: tuple[str, ...]) -> Fault:
        """Return the log as it is."""
        J = len(driven)
        take, gain, shift = tuple(range(J)), (1.0,) * J, (0,) * J
        return cls("the log as it is", driven=driven, take=take, gain=gain, shift=shift)

    @property
    def identity(self) -> Hashable:
        """What tells it from other faults of one log."""
        matrix = getattr(self.state, "matrix", None)  # of motors
        given = self.take, self.gain, self.shift
        return (*given, self.kind, self.places, self.number, matrix)

    def replaced(
        self,
        kind: str,
        *number: float,
        joints: tuple[str, ...] = (),
        state: StateChange | None = None,
        **torques: Mapping[int, float],
    ) -> Fault:
        """Return the fault with further changes, by driven joint, in `take`, `gain` or `shift`."""
        rows: dict[str, Any] = {
            name: tuple(values.get(j, x) for j, x in enumerate(getattr(self, name)))
            for name, values in torques.items()
        }
        changed = sorted({j for values in torques.values() for j in values})
        joints = joints or tuple(self.driven[j] for j in changed)
        name = f"{kind} of {listed(joints)}" if joints else kind
        return replace(
            self, name=name, kind=kind, places=joints, number=number, state=state, at=None, **rows
        )


# --- torques ------------------------------------------------------------------------------------


def torque_faults(now: Fault, lags: Array, J: Sequence[int]) -> Iterator[Fault]:
    """Yield what may be wrong with torques one step from a fault, simple hypotheses first.

    `lags` are the shifts [s] that can be a delay, the first 0; J numbers the driven joints whose
    torque is measured.
    """
    for j in J:
        yield now.replaced("sign", -1.0, gain={j: -now.gain[j]})
    if len(J) > 2:
        yield now.replaced("sign", -1.0, gain={j: -now.gain[j] for j in J})
    for j in J:
        for i in (i for i in J if i < j):
            both = now.driven[j], now.driven[i]
            yield now.replaced("swapped", 1.0, joints=both, take={i: now.take[j], j: now.take[i]})
            yield now.replaced("sign", -1.0, gain={i: -now.gain[i], j: -now.gain[j]})
    sets = [(j,) for j in J] + ([tuple(J)] if len(J) > 1 else [])
    if now.take == tuple(range(len(now.take))):
        for shift, lag in [*enumerate(lags)][1:]:
            for joints in sets:
                yield now.replaced("delay", float(lag), shift=dict.fromkeys(joints, shift))


def scale_of_torque(now: Fault, j: int, factor: float) -> Fault:
    """Return a fault with another factor of the torque of a driven joint."""
    scaled = now.replaced("scale", factor, gain={j: factor * now.gain[j]})
    return replace(scaled, at=lambda x: scale_of_torque(now, j, x))


def exact_factor(factor: float) -> float:
    """Return the factor of a unit that a large factor is near, else the factor itself."""
    for unit in (x**sign for x in UNITS for sign in (1, -1) if x > LARGE_UNIT):
        if abs(np.log(abs(factor) / unit)) < UNIT:
            return float(np.copysign(unit, factor))
    return factor


# --- positions, time, gravity, wrenches ---------------------------------------------------------


def motion_faults(
    none: Fault, mechanism: Mechanism, states: Sequence[State], poor: Collection[str]
) -> list[Fault]:
    """Return what may be wrong with the motion; positions only where some torques are `poor`."""
    faults, given = list[Fault](), np.asarray(mechanism.model.gravity.linear)
    for g in (*EARTH * np.eye(3), *-EARTH * np.eye(3), np.zeros(3)):

        def turned(mechanism: Mechanism, e: State, g: Array = g) -> tuple[Mechanism, State]:
            model = mechanism.model.copy()
            model.gravity.linear = g
            return mechanism.with_same_kinematics(model=model), e

        if np.linalg.norm(g - given) >= 0.05 * EARTH:
            faults.append(none.replaced("gravity", *map(float, g), state=turned))
    faults += (scale_of_time(none, s) for s in CLOCKS)
    faults += _positions(none, mechanism, states, poor) if poor else ()
    # without what alone moves a base, masses of 0 would fit exactly
    factors = (-1.0,) if free_slides(mechanism) else (-1.0, 0.0)
    for factor in factors if any(e.wrench is not None for e in states) else ():

        def wrenched(mechanism: Mechanism, e: State, f: float = factor) -> tuple[Mechanism, State]:
            return mechanism, replace(e, wrench=None if e.wrench is None else f * e.wrench)

        faults.append(none.replaced("wrench", factor, state=wrenched))
    return faults


def scale_of_time(none: Fault, s: float) -> Fault:
    """Return another scale of time: true over logged."""

    def state(mechanism: Mechanism, e: State) -> tuple[Mechanism, State]:
        return mechanism, replace(
            e, t=s * e.t, v=e.v / s, a=e.a / s**2, yd=e.yd / s, ydd=e.ydd / s**2, still=e.still / s
        )

    return replace(none.replaced("time", s, state=state), at=lambda x: scale_of_time(none, x))


def _positions(
    none: Fault, mechanism: Mechanism, states: Sequence[State], poor: Collection[str]
) -> Iterator[Fault]:
    """Yield positions turned (alone, and with their torque: an axis), in degrees, and exchanged
    (alone, and with their torques) where the torque of one is poor.
    """
    names = states[0].logged
    driven = {name: j for j, name in enumerate(mechanism.driven)}

    with_positions = partial(positions_changed, names)
    for j, name in enumerate(names):
        turned = with_positions({j: {j: -1.0}})
        yield none.replaced("position sign", -1.0, joints=(name,), state=turned)
        if name in driven:
            yield none.replaced("axis", -1.0, state=turned, gain={driven[name]: -1.0})
        at = mechanism.joint_index[name]
        if max(float(np.ptp(e.y[:, at])) for e in states) > DEGREES:
            state = with_positions({j: {j: np.pi / 180}})
            yield none.replaced("position scale", np.pi / 180, joints=(name,), state=state)
        row = {j: 1.0}
        for other, sign in joints_before(mechanism, name):
            if other not in names:
                break
            row = {**row, names.index(other): -sign}
            joints = tuple(names[i] for i in row)
            if set(joints) & set(poor):
                state = with_positions({j: row})
                yield none.replaced("position from", *row.values(), joints=joints, state=state)
        before = joints_before(mechanism, name)
        counted = next(before, None)  # with the joint before it that is parallel: tried above
        for other in _geared_within(mechanism, name):
            if other not in names or (counted and other == counted[0]):
                continue
            for sign in (1.0, -1.0) if {name, other} & {*poor} else ():
                state = with_positions({j: {j: 1.0, names.index(other): sign}})
                yield none.replaced("position from", 1.0, sign, joints=(name, other), state=state)
    count = len(names)
    orders = [{i: j, j: i} for i, j in combinations(range(count), 2)]
    if count > 2 and set(names) <= set(driven):  # a column too few, or another sorting
        by_name = sorted(range(count), key=names.__getitem__)
        back = [by_name.index(i) for i in range(count)]
        shifted = [[(i + k) % count for i in range(count)] for k in (1, -1)]
        for taken in (*shifted, [*range(count)][::-1], by_name, back):
            order = {i: j for i, j in enumerate(taken) if i != j}
            orders += [order] if order not in orders else []
    for order in orders:
        joints = tuple(names[j] for j in order.values())
        if not set(joints) & set(poor):
            continue
        state = with_positions({i: {j: 1.0} for i, j in order.items()})
        if len(order) == 2:
            yield none.replaced("position swapped", 1.0, joints=joints, state=state)
        if set(joints) <= set(driven):
            torques = {driven[names[i]]: driven[names[j]] for i, j in order.items()}
            yield none.replaced("joints swapped", 1.0, joints=joints, state=state, take=torques)


def positions_changed(
    names: tuple[str, ...], rows: Mapping[int, Mapping[int, float]]
) -> StateChange:
    """Return the state in which q_j = Σ_i M_ji q_i of joints by `names`, with the `rows` j of M
    where it is not the unit matrix.
    """
    M = np.eye(len(names))
    for j, row in rows.items():
        M[j] = [row.get(i, 0.0) for i in range(len(names))]

    def state(mechanism: Mechanism, e: State) -> tuple[Mechanism, State]:
        start = "follow" if mechanism.closures else "near"
        return mechanism, e.at(mechanism, e.known(mechanism, names) @ M.T, names, start=start)

    return state


def turned_positions(
    now: Fault, joints: Collection[str], names: tuple[str, ...], turned: Collection[str] = ()
) -> tuple[Fault, Fault]:
    """Return what a wrong sign of the torques of some `joints`, in a fault with it, may be instead:
    that of their positions, or of their axes, which turns both.

    Args:
        now: the fault with the torques turned; joints: these.
        names: joints of which positions are logged, all of `joints` among them.
        turned: further joints of which the positions are turned.
    """
    rows = {j: {j: -1.0} for j, name in enumerate(names) if name in {*joints, *turned}}
    state = positions_changed(names, rows)
    back = {j: -now.gain[j] for j, name in enumerate(now.driven) if name in joints}
    where = tuple(joints)
    return (
        now.replaced("position sign", -1.0, joints=where, state=state, gain=back),
        now.replaced("axis", -1.0, joints=where, state=state),
    )


def _geared_within(mechanism: Mechanism, name: str) -> list[str]:
    """Return the names of joints behind whose gears the encoder of a joint may be, whatever their
    axes: its neighbours of one type and theirs, as cables and shafts pass two joints of a wrist.
    """
    pairs = mechanism.sites.geared
    near = {name}
    for _ in range(LINKS_PASSED):
        near |= {*chain.from_iterable(pair for pair in pairs if near & {*pair})}
    return sorted(near - {name})


def joints_before(mechanism: Mechanism, name: str) -> Iterator[tuple[str, float]]:
    """Yield the joints before a joint that turn (or slide) as it does, the nearest first, with the
    sign of their axis against its own: it may be counted from the links before them.
    """
    model, names = mechanism.model, list(mechanism.model.names)
    i = names.index(name) if name in names else 0  # 0: of a closure
    axis, turns = joint_axis(model, i) if i else np.zeros(3), mechanism.joint(name).rotational
    while (p := model.parents[i]) > 0 and model.joints[p].nv == 1:
        axis = model.jointPlacements[i].rotation @ axis
        sign = float(axis @ joint_axis(model, p))
        if abs(sign) < PARALLEL:
            return
        if is_rotational(model, p) == turns:
            yield names[p], float(np.sign(sign))
        i = p


# --- in words -----------------------------------------------------------------------------------

EXCHANGED = "{q}{alike} look exchanged: with {order}"
WORDS = {  # by kind: in a rival's place, what it is, and the remedy
    "sign": (
        "turning {tau}",
        "{tau}: the sign is against that of {q}: as logged, inertia or friction would be negative; "
        "turned,",
        "write {tau_lines}{or_turned}",
    ),
    "scale": (
        "scaling {tau} by {number:.3g}",
        "{tau}: reads {inverse:.3g} times what the other joints' torques and what is known of "
        "bodies require ({unit}): scaled,",
        "check its unit; {tau_lines}",
    ),
    "swapped": (
        "exchanging {tau}",
        "{tau}: exchanged: with one in the other's place",
        "{tau_exchange}; if the error stays, exchange {q} instead",
    ),
    "delay": (
        "shifting {tau} by {number:.3g} s",
        "{tau}: {ms:.3g} ms {late} against the positions; without the delay",
        "shift the column{several}{effect}",
    ),
    "position sign": (
        "turning {q}",
        "{q}: the sign is wrong: corrected,",
        "write {q_lines}, velocity alike",
    ),
    "position scale": (
        "taking {q} for degrees",
        "{q}: in degrees, not in radians: corrected,",
        "write {q_lines}, velocity alike",
    ),
    "position from": (
        "taking {sum} for {first}",
        "{first}: counted from the world or another link, not from the link before, or through a "
        "neighbour's gears: {sum} in its place,",
        "write {sum} into {first}, velocity alike",
    ),
    "motors": (
        "taking {q} for motors with {formula}",
        "{joints}: position and torque are of motors that do not sit at these joints: with "
        "{formula}",
        "write in mechanism.toml: {motor_lines}",
    ),
    "position swapped": ("exchanging {q}", EXCHANGED, "write {q_exchange}, velocities alike"),
    "joints swapped": (
        "exchanging {q}, torques alike,",
        EXCHANGED,
        "write {q_exchange}, velocities, torques alike",
    ),
    "axis": (
        "turning {q} and {tau}",
        "{joints}: the axis points the other way: with position and torque turned",
        "turn the axis of {joints} in the URDF, or write {q_lines}, {tau_lines}",
    ),
    "gravity": (
        "gravity of {vector} m/s²",
        "gravity: with {vector} m/s² instead of {gravity}",
        "write gravity = {vector}, or turn the base of the URDF",
    ),
    "time": (
        "a clock {number:.3g} times as long",
        "time or lengths: with a clock {number:.4g} times as long, or lengths in the URDF "
        "{lengths:.3g} times as long, which torques can hardly tell apart,",
        "check the unit of t and the rate of the log; {t_line}",
    ),
    "wrench": (
        "wrenches times {number:g}",
        "columns wrench.…: {wrench},",
        "a wrench is what acts on the link, in the link's frame; check its sign",
    ),
}


def fault_finding(
    mechanism: Mechanism, fault: Fault, before: float, after: float, rivals: Sequence[Fault] = ()
) -> Finding:
    """Return a fault in words; `before`, `after`: relative errors of its joints."""
    of_motion, fields = fault.state is not None, _fields(mechanism, fault)
    position_too = any(rival.kind == "position sign" for rival in rivals)
    fields["or_turned"] = f", or turn {fields['q']}" if position_too else ""
    _, text, remedy = (words.format(**fields) for words in WORDS[fault.kind])
    text += f" the error of the predicted torque falls from {percent(before)} to {percent(after)}"
    if fault.kind == "gravity" and not any(fault.number):
        text += (
            "; or gravity is subtracted from these torques already, as Panda, iiwa and UR deliver "
            "them"
        )
        remedy += "; log torques with gravity, or keep gravity = [0, 0, 0] for such columns alone"
    for rival in rivals:
        named = WORDS[rival.kind][0].format(**_fields(mechanism, rival))
        text += f"; {named} would do nearly as well"
    channels = sorted(fault.places, key=mechanism.joint_index.__getitem__)
    where = tuple(f"{'q' if of_motion else 'tau'}.{name}" for name in channels)
    number = after / before if of_motion else fault.number[0]
    number *= 1e3 if fault.kind == "delay" else 1.0  # [ms]
    effects = _effects(fault, channels)
    return Finding(fault.kind, text, remedy, where, number, effects=effects)


def _effects(fault: Fault, joints: Sequence[str]) -> tuple[str, ...]:
    """Return the labels of the effects of the library that are this fault of the torques."""
    kinds = [kind for kind, effect_class in KINDS.items() if effect_class.fault == fault.kind]
    return tuple(f"{kind}:{','.join(joints)}" for kind in kinds)


def _fields(mechanism: Mechanism, fault: Fault) -> dict[str, object]:
    """Return what the words of a fault speak of, by name."""
    number, joints = fault.number[0], fault.places
    size = max(abs(number) or 1.0, 1 / (abs(number) or 1.0))
    unit = min(UNITS, key=lambda known: abs(np.log(size / known)))
    other = abs(np.log(size / unit)) >= UNIT
    unit_text = "a gear ratio, a torque constant or a unit?" if other else f"{UNITS[unit]}?"
    # as channels, joints as sources
    ordered = sorted(joints, key=mechanism.joint_index.__getitem__)
    fields: dict[str, object] = {
        "number": number, "inverse": 1 / number if number else 0.0, "ms": abs(1e3 * number),
        "lengths": number**-2 if number else 0.0, "unit": unit_text,
        "late": "late" if number > 0 else "early", "joints": listed(ordered),
        "several": "s together: two clocks, or a filter on one of them" if ordered[1:] else "",
        "wrench": "with the other sign" if number else "left out",
        "effect": "".join(f", or give --with {label}" for label in _effects(fault, ordered)),
        "alike": " and their torques" if fault.kind == "joints swapped" else "",
        "order": "one in the other's place" if len(ordered) == 2 else "columns in another order",
        "t_line": log_entry(mechanism, "t", number),
        "first": "".join(f"q.{name}" for name in joints[:1]), "sum": "".join(
            f" {'-' if x < 0 else '+'} q.{name}"
            for x, name in zip(fault.number, joints, strict=False)
        )[3:],
    }  # fmt: skip
    fields["formula"] = fields["motor_lines"] = ""
    if (lines := getattr(fault.state, "lines", "")) and fault.kind == "motors":
        motors = [motor for motor in fault.state.motors if not motor.is_joint]  # type: ignore[union-attr]
        fields["motor_lines"] = lines
        fields["formula"] = listed(f"{motor.name} = {motor.formula}" for motor in motors)
    for name, vector in (("vector", fault.number), ("gravity", mechanism.model.gravity.linear)):
        fields[name] = "[" + ", ".join(f"{x + 0.0:.4g}" for x in vector) + "]"
    factor = exact_factor(number) if number else number
    for kind in ("q", "tau"):
        channels, sources = ([f"{kind}.{name}" for name in names] for names in (ordered, joints))
        fields[kind] = places(channels)
        fields[f"{kind}_lines"] = log_entries(mechanism, channels, factor)
        columns = [x.column if (x := mechanism.columns.get(c)) else c for c in sources]
        fields[f"{kind}_exchange"] = " and ".join(
            log_entry(mechanism, c, 1.0, column)
            for c, column in zip(channels, columns, strict=True)
        )
    return fields


def log_entry(mechanism: Mechanism, channel: str, factor: float, column: str = "") -> str:
    """Return the line of `[log]` that multiplies a channel, or takes another column for it."""
    source = mechanism.columns.get(channel, Column(channel))
    same = column and (source.scale, source.offset) == (1.0, 0.0)
    scaled = "" if same else f", {_conversion(source, factor)}"
    return f'[log] "{channel}" = {{ column = "{column or source.column}"{scaled} }}'


def _conversion(source: Column, factor: float) -> str:
    offset = f", offset = {factor * source.offset:.8g}" if factor * source.offset else ""
    return f"scale = {factor * source.scale:.8g}{offset}"  # a small difference of large numbers


def log_entries(mechanism: Mechanism, channels: Sequence[str], factor: float) -> str:
    """Return the lines of `[log]` that multiply channels of one kind by a factor: one with `*`
    where it makes, or can make, all of them and no other, else the first if they are many.
    """
    if not channels[1:]:
        return "".join(log_entry(mechanism, c, factor) for c in channels)
    first, kind = channels[0], channels[0].partition(".")[0]
    names = mechanism.driven if kind == "tau" else mechanism.joint_index
    every = {
        channel: mechanism.columns.get(channel, Column(channel, group=f"{kind}.*"))
        for channel in (f"{kind}.{name}" for name in names)
    }
    source = every.get(first, Column(first))  # that of a passive joint has no torque
    same_group = {c: x for c, x in every.items() if x.group and x.group == source.group}
    if {*same_group} == {*channels}:
        before, _, after = source.group.partition("*")
        patterns = {
            x.column.replace(c[len(before) : len(c) - len(after)], "*")
            for c, x in same_group.items()
        }
        if len(patterns) == 1 and (pattern := patterns.pop()).count("*") == 1:
            entry = f'column = "{pattern}", {_conversion(source, factor)}'
            return f'[log] "{before}*{after}" = {{ {entry} }}'
    if channels[2:]:
        return f"{log_entry(mechanism, first, factor)}, and the same for the others"
    return ", ".join(log_entry(mechanism, c, factor) for c in channels)
