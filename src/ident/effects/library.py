"""All kinds of effects by name, how `kind:joint[,joint]` is read, in plain words, a user's own.

These are CasADi expressions of the signals:

    def bump(s, w: "rad" = (0.1, 0.01, 1.0)):             # a shape: start, lowest, highest
        return {"A [N m]": ca.exp(-(((s.q - 0.3) / w) ** 2))}   # torque = A · column

Units, as an annotation of a shape and in brackets behind an unknown, may be left out. `s` has t
(from the log's first sample), and q, v, … as `SIGNALS` describes them. With several joints
the torque acts on the first, and each signal but t is a vector: s.q[0], s.q[1] …
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ident.effects import drive, frame, joint, servo, transmission
from ident.effects.curve import Curve, OnFirst
from ident.effects.effect import PER_LOG, Effect, Shape, Signals, Unknown
from ident.effects.user_function import Shapes, compiled_columns, members_of, split_unit
from ident.errors import MechanismError, line_of, one_of
from ident.files import function_of
from ident.lazy import lazy
from ident.text import listed, places

if TYPE_CHECKING:
    import casadi as ca
else:
    ca = lazy("casadi")

KINDS: Mapping[str, type[Effect]] = {
    effect.kind: effect
    for effect in (
        joint.Viscous, joint.Coulomb, joint.Stribeck, joint.FrictionWidth, joint.LoadFriction,
        joint.ReversalPulses, joint.Hysteresis, joint.DirectionFriction, joint.PositionFriction,
        joint.Drag, joint.Spring, joint.Cable, joint.EndStop, drive.RotorInertia, drive.Coupling,
        joint.Ripple, drive.TorqueOffset, drive.TorqueGain,
        drive.Delay, drive.PositionDelay, drive.EncoderOffset, drive.GravityTilt,
        drive.GravityCompensation, joint.Payload, transmission.Elasticity,
        transmission.Backlash, drive.Geometry, drive.ClosureCompliance, joint.TemperatureFriction,
        drive.Drift, servo.CommandDelay, servo.Servo, servo.MotorCurrent, servo.MotorVoltage,
        servo.MotorDuty, Curve,
        frame.Thrust, frame.BodyDrag, frame.Tyre, frame.TyreSaturation, frame.TyreSlip,
        frame.GroundSpring,
    )
}  # fmt: skip


def kind_of(name: str, before: str = "") -> type[Effect]:
    """Return the kind of the library called `name`; `before` begins the message of an error."""
    if name not in KINDS:
        raise MechanismError(f"{before}there is no effect '{name}'; {one_of(name, KINDS)}")
    return KINDS[name]


def create(
    kind: str,
    joints: str | Sequence[str] = (),
    values: Mapping[str, float] | None = None,
    rotational: bool = True,
    signal: str = "",
    per: str = "",
    log: str = "",
) -> Effect:
    """Return an effect of the library.

    Args:
        kind: one of `KINDS`.
        joints: the joint's name, or several; none for an effect of the whole mechanism.
        values: parameters that are known, with their values.
        rotational: whether the (first) joint is rotational; a mechanism sets it when the effect is
            added.
        signal: of a kind that is a function of a signal of one's choice.
        per: `log` where each log has values of its own; log: the one whose values these are.

    Raises:
        MechanismError: for a kind, number of joints or parameter that does not exist.
    """
    if isinstance(joints, str):
        joints = [part.strip() for part in joints.split(",")] if joints else []
    return kind_of(kind)(tuple(joints), dict(values or {}), rotational, signal, per, log)


def parse(text: str) -> tuple[str, tuple[str, ...], str, dict[str, float], str]:
    """Return kind, joints, signal, values, per of
    `kind[:joint[,joint]][:signal][@log][:name=value,…]`.
    """
    per = PER_LOG if f"@{PER_LOG}" in text else ""
    text = text.replace(f"@{PER_LOG}", "", 1)
    kind, *rest = text.split(":")
    kind_of(kind, f"effect '{text}': ")
    stated = rest.pop() if rest and "=" in rest[-1] else ""
    bare, values = text.removesuffix(stated), {}
    for part in stated.split(",") if stated else ():
        name, _, number = part.partition("=")
        try:
            values[name.strip()] = float(number)
        except ValueError:
            raise MechanismError(
                f"effect '{text}': '{part}' is no value; write {bare}{name or 'name'}=1"
            ) from None
    joints = tuple(part.strip() for part in rest[0].split(",")) if rest else ()
    if not all(joints):
        raise MechanismError(f"effect '{text}': a joint's name is missing; write {kind}:joint")
    return kind, joints, ":".join(rest[1:]).strip(), values, per


def separating(kinds: Collection[str]) -> list[str]:
    """Return the experiments that separate kinds which no motion separates, without repetition."""
    pairs = (pair for name in KINDS if name in kinds for pair in KINDS[name].separated_by.items())
    return list(dict.fromkeys(text for rival, text in pairs if rival in kinds))


# --- in plain words -------------------------------------------------------------------------------

PREPOSITIONS = {"link": "on", "place": "at", "frame": "at"}  # by site; of joints and closures: in


def by_kind(effects: Iterable[Effect]) -> list[list[Effect]]:
    """Return effects of one kind together, in the order of the first of each."""
    groups: dict[str, list[Effect]] = {}
    for effect in effects:
        groups.setdefault(effect.kind, []).append(effect)
    return list(groups.values())


def named(effects: Iterable[Effect], word: str = "and") -> str:
    """Return effects in words, those of one kind together: `dry friction in a3 to a7 (coulomb)`."""
    return listed([_of_one_kind(group, word) for group in by_kind(effects)], word)


def effect_noun(effect: Effect) -> str:
    """Return the words for an effect's kind."""
    return effect.noun or effect.kind.replace("_", " ")


def _of_one_kind(group: Sequence[Effect], word: str) -> str:
    first = group[0]
    signals = listed(dict.fromkeys(effect.signal for effect in group if effect.signal))
    of = f" of {signals}" if any(effect.signal for effect in group) else ""
    sites = [
        " with ".join(effect.joints)
        if len(effect.joints) < 3
        else f"{places(effect.joints)} together"
        for effect in group
    ]
    names = places(sites) if word == "and" else listed(sites, word)  # of rivals the best first
    if len(group) == 1:
        names = places(first.joints)
    where = f" {PREPOSITIONS.get(first.site, 'in')} {names}" if first.joints else ""
    code = "" if first.kind.replace("_", " ") in effect_noun(first) else f" ({first.kind})"
    return f"{effect_noun(first)}{of}{where}{code}"


# --- of a user ------------------------------------------------------------------------------------

SIGNALS = {
    "q": "coordinate [rad | m]",
    "v": "its rate",
    "a": "its acceleration",
    "tau": "torque that the model predicts for the joint [N m | N]",
    "lam": "the part of it that the links need, in a closure's own joint |λ| [N m | N]",
    "direction": "sign of v, smooth below the speed of standstill, so that it can be simulated",
    "temperature": "the log's column temperature.<joint> [°C]",
}
PREDICTED = {"a": 2, "torque": 3, "load": 4}  # `Effect.asks`, by their place among the inputs
DIRECTION, TEMPERATURE, TIME = 5, 6, 7  # range: their places among the inputs
STARTS = 12  # work: of the search, for each shape
MOST_SIGNAL_JOINTS = 3  # work: joints whose signals a function is tried with
UserFunction = Callable[..., Mapping[str, Any]]


class UserEffect(OnFirst):
    """Base of the classes that `user_effect` makes."""

    function: ClassVar[UserFunction]
    starting: ClassVar[Mapping[str, float]]  # where the search of each shape starts
    fewest: ClassVar[int] = 1  # joints whose signals the function asks for

    def __post_init__(self) -> None:
        if len(self.joints) < self.fewest:
            raise MechanismError(
                f"effect '{self.kind}' looks at {self.fewest} joint(s), given: "
                f"{', '.join(self.joints) or 'none'}; write "
                f"{self.kind}:{','.join(['joint'] * self.fewest)}"
            )
        _ = self._compiled
        super().__post_init__()

    @property
    def arity(self) -> int:  # type: ignore[override]
        return len(self.joints)

    @property
    def asks(self) -> tuple[str, ...]:  # type: ignore[override]
        return tuple(word for word, place in PREDICTED.items() if place in self._used)

    def reads(self) -> tuple[str, ...]:
        return tuple(f"temperature.{name}" for name in self.joints if TEMPERATURE in self._used)

    @property
    def dry(self) -> bool:
        return DIRECTION in self._used

    @property
    def _compiled(self) -> ca.Function:
        return _compiled(type(self), len(self.joints))

    @property
    def _used(self) -> list[int]:
        """The places of the inputs on which its columns depend."""
        compiled = self._compiled
        return [i for i in range(compiled.n_in()) if compiled.jac_sparsity(0, i).nnz()]

    @property
    def not_integrable(self) -> str:
        compiled = self._compiled
        used = {compiled.instruction_id(i) for i in range(compiled.n_instructions())}
        if ca.OP_SIGN in used:
            return "its function has sign(), which jumps; write s.direction for that of s.v"
        return ""

    def torque(self, s: Signals) -> np.ndarray:
        zero = np.zeros_like(s.q)
        asked = (s.torque, s.load) if self.implicit else (zero, zero)
        heat = np.stack([s.extra[name] for name in self.reads()] or list(zero.T))
        shape = np.array([s.shape[shape.name] for shape in self.shapes]).reshape(-1, 1)
        values = self._compiled(
            *(x.T for x in (s.q, s.v, s.a, *asked, joint.direction(s.v, s.still))), heat,
            (s.t - s.t[0])[None], np.tile(shape, len(s.t)),
        )  # fmt: skip
        E: np.ndarray = values.full().T
        if not np.isfinite(E).all():
            at = int(np.argmin(np.isfinite(E).all(axis=1)))
            raise MechanismError(
                f"effect '{self.label}': its function is {E[at]} at t = {s.t[at]:.4g} s, where "
                f"q = {s.q[at, 0]:.4g}, v = {s.v[at, 0]:.4g}; make it finite for every motion"
            )
        return E

    def starts(self, s: Signals) -> list[Shape]:
        # the given start, and points spread evenly between the bounds
        if not self.starting:
            return [{}]
        start = np.array(list(self.starting.values()))
        low, high = np.array([shape.range for shape in self.shapes]).T
        k = len(start)
        from scipy.stats import qmc  # takes half a second to import

        shares = qmc.Halton(k, scramble=False).random(STARTS * k + 1)[1:]
        return [
            dict(zip(self.starting, map(float, x), strict=True))
            for x in (start, *(low + shares * (high - low)))
        ]


def user_effect(name: str, function: UserFunction, file: Path | None = None) -> type[UserEffect]:
    """A kind of effect from a function of signals; `mechanism + Kind(("elbow",))` adds it.

    Args:
        name: of the kind, as in parameters' names.
        function: `s -> {unknown: column}`, CasADi expressions of s.q, s.v, s.a, … of `SIGNALS`, and
            s.t (from the log's first sample);
            keyword arguments with defaults (start, lowest, highest) are shapes, to be searched.
        file: where it was read from, if it was.

    Raises:
        MechanismError: if the function cannot be used.
    """
    if not name.isidentifier() or name in KINDS:
        why = "is in the library" if name in KINDS else "is no name"
        raise MechanismError(f"effect '{name}' {why}; give another of letters, digits and _")
    members = members_of(name, function, _shapes(name, function), file, __name__)
    members["signature"] = "as the function has it"
    kind: type[UserEffect] = type(name, (UserEffect,), members)
    first: MechanismError | None = None
    for joints in range(1, MOST_SIGNAL_JOINTS + 1):  # one of two joints' signals fails with one
        try:
            columns, inputs = _evaluated(kind, joints)
            break
        except MechanismError as error:
            first = first or error
    else:
        assert first is not None
        raise first
    kind.fewest = joints
    kind.unknowns = tuple(
        Unknown(key, (unit, unit), "of the function") for key, (_, unit) in columns.items()
    )
    kind.equation = " + ".join(f"{key} ({column})" for key, (column, _) in columns.items())
    every = ca.vertcat(*(column for column, _ in columns.values()))
    kind.memory = bool(ca.depends_on(every, inputs[TIME]))  # t from the start
    kind.implicit = bool(ca.depends_on(every, ca.vertcat(*inputs[3:5])))
    _compiled(kind, joints)
    return kind


def _shapes(name: str, function: UserFunction) -> Shapes:
    try:
        given = list(inspect.signature(function).parameters.items())[1:]
    except (TypeError, ValueError):
        raise MechanismError(f"effect '{name}': {function!r} is no function of s") from None
    starting, shapes = {}, []
    for key, parameter in given:
        try:
            start, low, high = (float(x) for x in parameter.default)
        except (TypeError, ValueError):
            start, low, high = np.nan, 0.0, 0.0
        if not -np.inf < low <= start <= high < np.inf or not low < high:
            shown = "nothing" if parameter.default is parameter.empty else repr(parameter.default)
            raise MechanismError(
                f"effect '{name}': the default of {key} is {shown}; give its start and bounds: "
                f"{key}=(start, lowest, highest)"
            )
        unit = parameter.annotation
        unit = unit.strip("'\"") if isinstance(unit, str) else "?"
        starting[key] = start
        shapes.append(Unknown(key, (unit, unit), "of the function", range=(low, high)))
    return starting, tuple(shapes)


def _evaluated(
    kind: type[UserEffect], joints: int
) -> tuple[dict[str, tuple[ca.SX, str]], list[ca.SX]]:
    symbols = {name: ca.SX.sym(name, joints) for name in SIGNALS}
    t, shapes = ca.SX.sym("t"), {name: ca.SX.sym(name) for name in kind.starting}
    try:
        returned = kind.function(SimpleNamespace(**symbols, t=t), **shapes)
        columns = {}
        for key, column in returned.items():
            name, unit = split_unit(str(key))
            columns[name] = ca.SX(column), unit
    except (Exception, SystemExit) as error:  # it is the user's code
        raise MechanismError(
            f"effect '{kind.kind}': its function fails: {line_of(error)}; it is given s with "
            f"{', '.join(SIGNALS)}, t and returns {{'unknown': CasADi expression}}"
        ) from None
    for name, (column, _) in columns.items():
        if not name.isidentifier() or column.shape != (1, 1):
            raise MechanismError(
                f"effect '{kind.kind}': its function returns {column.shape[0]} × "
                f"{column.shape[1]} numbers for the unknown '{name}'; valid: one expression for "
                "each name (of several joints take one: s.q[0])"
            )
    if not columns:
        raise MechanismError(f"effect '{kind.kind}': its function returns no unknown")
    return columns, [*symbols.values(), t, ca.vertcat(*shapes.values())]


@cache
def _compiled(kind: type[UserEffect], joints: int) -> ca.Function:
    columns, inputs = _evaluated(kind, joints)
    every = ca.vertcat(*(column for column, _ in columns.values()))
    return compiled_columns(kind.kind, inputs, every)


def parse_user(text: str) -> tuple[Path, str, tuple[str, ...]] | None:
    """`file.py:function:joint[,joint]` as (file, function, joints); None for anything else."""
    stem, python, rest = text.partition(".py:")
    if not python and not text.endswith(".py"):
        return None
    name, _, joints = rest.partition(":")
    names = tuple(part.strip() for part in joints.split(","))
    if not name or not all(names):
        file = text if text.endswith(".py") else f"{stem}.py"
        raise MechanismError(
            f"effect '{text}': write file, function and joint: {file}:{name or 'function'}:joint"
        )
    return Path(f"{stem}.py"), name, names


def read_user_effect(
    file: Path, name: str, *, allow_code: bool, where: str = "", at_frame: bool = False
) -> type[UserEffect] | type[frame.UserFrameForce]:
    """The kind of effect that a Python file's function `name` describes; runs the file.

    Args:
        file: to be run.
        name: of the function, and of the kind.
        allow_code: whether it may be run.
        where: begins the message of an error.
        at_frame: whether it is a force at a frame (`frame.user_frame_force`).

    Raises:
        MechanismError: if it may not or cannot be run, or has no such function.
    """
    before = f"{where}: " if where else ""
    try:
        function = function_of(file, name, allow_code=allow_code)
        if at_frame:
            return frame.user_frame_force(name, function, _shapes(name, function), file)
        return user_effect(name, function, file)
    except MechanismError as error:
        effect = f"effect '{name}': "
        raise MechanismError(f"{before}{effect}{str(error).removeprefix(effect)}") from None
