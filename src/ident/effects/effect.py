"""The base class of all effects: columns E(q, v, a, …; s) whose unknowns c add E c to the torques.

A new kind is one class and one line in `library.py`. The class states everything about the kind,
and no other file asks for a kind by its name or class. Names, known values, search of shapes,
files, commands and candidates follow from what it states. Units of signals and of expressions of
them come first.
"""

from __future__ import annotations

import ast
import inspect
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from pathlib import Path, PurePath
from typing import ClassVar

import numpy as np

from ident.errors import MechanismError, one_of
from ident.information.evidence import NEGATIVE

UNITS: Mapping[str, tuple[str, str]] = {  # at a rotational and at a linear joint
    "q": ("rad", "m"), "v": ("rad/s", "m/s"), "a": ("rad/s²", "m/s²"), "t": ("s", "s"),
    "load": ("N m", "N"), "temperature": ("°C", "°C"),
}  # fmt: skip
Powers = Mapping[str, float]  # of signals
# begins a column that is made: the time [s] between samples, of a joint whose drive supplies torque
SAMPLED = "(time between samples) "


def dimension(text: str, of: Mapping[str, Powers] | None = None) -> Powers:
    """Return the powers of signals in the unit of a text, given those of its constants."""
    return _dimension(ast.parse(text or "1", mode="eval").body, of or {})


def _dimension(node: ast.expr, of: Mapping[str, Powers]) -> Powers:
    match node:
        case ast.Name(id=name):
            return {name: 1.0} if name.removesuffix("_o") in UNITS else of.get(name, {})
        case ast.UnaryOp(operand=x) | ast.Call(func=ast.Name(id="abs"), args=[x]):
            return _dimension(x, of)
        case ast.Call(func=ast.Name(id="sqrt"), args=[x]):
            return scaled(_dimension(x, of), 0.5)
        case ast.BinOp(left=x, op=ast.Pow(), right=ast.Constant(value=power)):
            return scaled(_dimension(x, of), power)  # type: ignore[arg-type]
        case ast.BinOp(left=x, op=ast.Mult() | ast.Div() as op, right=y):
            powers = dict(_dimension(x, of))
            for name, power in _dimension(y, of).items():
                powers[name] = powers.get(name, 0) + (power if isinstance(op, ast.Mult) else -power)
            return {name: power for name, power in powers.items() if power}
        case ast.BinOp(left=x, op=ast.Add() | ast.Sub()):
            return _dimension(x, of)
    return {}  # a number, a power that is searched, sin, cos, exp, …


def scaled(powers: Powers, by: float) -> Powers:
    """Return the powers of a power."""
    return {name: by * power for name, power in powers.items()}


def unit_of(powers: Powers, turns: bool, second: bool, force: float = 0.0) -> str:
    """Return the unit of powers of the joint's force and of signals, of joints that turn or not."""
    force_unit = "N m" if turns else "N"
    by_unit = {force_unit: force}
    for signal, power in powers.items():
        place = 0 if (second if signal.endswith("_o") else turns) else 1
        unit = force_unit if signal == "load" else UNITS[signal.removesuffix("_o")][place]
        base, _, time = unit.replace("°C", "K").partition("/")
        by_unit[base] = by_unit.get(base, 0.0) + power
        if time:
            by_unit["s"] = by_unit.get("s", 0.0) - power * (2 if "²" in time else 1)
    numerator = [_raised(u, p) for u, p in by_unit.items() if p > 0]
    denominator = [_raised(u, -p, " " in u) for u, p in by_unit.items() if p < 0]
    top = " ".join(numerator) or "1"
    if len(denominator) > 1:
        return f"{top}/({' '.join(denominator)})"
    return "/".join([top, *denominator])


def _raised(unit: str, power: float, bracket: bool = False) -> str:
    mark = {1.0: "", 2.0: "²", 3.0: "³"}.get(power, f"^{power:g}")
    return f"({unit}){mark}" if bracket or (mark and " " in unit) else f"{unit}{mark}"


@dataclass(frozen=True)
class Signals:
    """Time series of the joints that an effect acts on, and predictions of the present model."""

    t: np.ndarray  # (n,) [s]
    q: np.ndarray  # q, v, a: (n, joints) [rad | m], [.../s], [.../s²]
    v: np.ndarray
    a: np.ndarray
    still: np.ndarray  # (joints,) speed [rad/s | m/s] below which a joint counts as standing still
    extra: Mapping[str, np.ndarray] = field(default_factory=dict)  # the log's other columns (n,)
    shape: Mapping[str, float] = field(default_factory=dict)  # values of the shape parameters
    present: Mapping[str, float] = field(default_factory=dict)  # all effects' values, by name
    # gives (torque, load), both (n, joints) [N m | N]: the torque that the present model predicts
    # for each joint, and the part of it that the links need, without effects at that joint. In a
    # closure's own joint both are the size of the closure's force
    predicted: Callable[[], tuple[np.ndarray, np.ndarray]] | None = None
    # gives (joints,) the loads before the log, where it begins at rest
    resting: Callable[[], np.ndarray | None] | None = None
    finest: float = 0.0  # [s] between knots of the splines behind the motion
    # gives (3, n, joints) the slopes of each joint's load along its q, v and a
    slopes: Callable[[], np.ndarray] | None = None

    @property
    def load_slopes(self) -> np.ndarray:
        """Slopes (3, n, joints) of the load along a joint's q, v, a: stiffness, damping, inertia of
        what it carries; 0, 0, 1 without a model.
        """
        if self.slopes:
            return self.slopes()
        return np.stack([np.zeros_like(self.q), np.zeros_like(self.q), np.ones_like(self.q)])

    @property
    def torque(self) -> np.ndarray:
        """Torque (n, joints) [N m | N] that the present model predicts; zero without a model."""
        return self.predicted()[0] if self.predicted else np.zeros_like(self.q)

    @property
    def load(self) -> np.ndarray:
        """Torque (n, joints) [N m | N] that the joint transmits; zero without a model."""
        return self.predicted()[1] if self.predicted else np.zeros_like(self.q)

    @property
    def load_at_rest(self) -> np.ndarray | None:
        """Load (joints,) [N m | N] before the log; None where it does not begin at rest."""
        return self.resting() if self.resting else None

    @property
    def travel(self) -> np.ndarray:
        """Lowest and highest coordinates (joints, 2)."""
        return np.stack([self.q.min(axis=0), self.q.max(axis=0)], axis=1)


@dataclass(frozen=True)
class Unknown:
    """One parameter of an effect: its name, and its unit at a rotational and at a linear joint."""

    name: str
    units: tuple[str, ...]  # (rotational, linear)
    meaning: str
    nonnegative: bool = False  # whether a negative value makes no physical sense
    discrete: bool = False  # of a shape: it takes a few values only, without slope
    largest: float = np.inf  # size above which a value is not plausible
    # how the part E_i c_i of an unknown enters a simulation: `torque` (any smooth function of the
    # state), `linear` (linear in q and v), `inertia` (c times the acceleration, summed over the
    # joints), `dry` (|E c| is the limit of dry friction at the summed rate), `level` (a dry limit
    # that no state changes), `state` (c times a state z with ż = `state_rate`), `body` (one of a
    # link's ten parameters)
    acts: str = "torque"
    range: tuple[float, float] | None = None  # of a shape that signals do not decide
    negative: str = ""  # what a negative value means, in words, where its name says the opposite
    smallest: float = 0.0  # size below which it is another cause

    def possible(self, value: float, error: float, largest: float = np.inf) -> bool:
        """Return whether there can be a value with a standard error: none above its largest size,
        or another one here, none clearly below its smallest, or below zero that must not be.
        """
        if abs(value) > min(self.largest, largest) or abs(value) < self.smallest - NEGATIVE * error:
            return False
        return not (self.nonnegative and value < -NEGATIVE * error)


@dataclass(frozen=True)
class Sites:
    """Names of all that an effect of a mechanism can sit on; `Effect.sits` names a field."""

    joint: tuple[str, ...] = ()  # all coordinates, closures' own as well
    driven: tuple[str, ...] = ()  # joints with a drive
    geared: tuple[tuple[str, str], ...] = ()  # pairs whose motors may have a common shaft
    sensed: tuple[str, ...] = ()  # joints whose torque a sensor measures
    commanded: tuple[str, ...] = ()  # joints whose drive follows a command
    loaded: tuple[str, ...] = ()  # whose load the model predicts, closures' own among them
    logged: tuple[str, ...] = ()  # joints whose position is logged
    link: tuple[str, ...] = ()  # moving links
    closure: tuple[str, ...] = ()  # closures of every kind
    loop: tuple[str, ...] = ()  # closures between two frames
    place: tuple[str, ...] = ()  # lengths of the URDF and the closures, zero or not
    frame: tuple[str, ...] = ()  # links that move, those fixed to another one as well
    flying: tuple[str, ...] = ()  # links of a body that nothing but forces at places moves
    length: tuple[str, ...] = ()  # places whose coordinate is not zero, beyond the first joint


@dataclass(frozen=True)
class Correction:
    """Changes of the data or the geometry by an effect, instead of a torque."""

    # by joint, true − logged: a number, (n,), or (3, n) with its first and second rate
    dq: Mapping[str, np.ndarray | float] = field(default_factory=dict)
    # the same of a joint's link, where the joint's own effects act on the motor, which is logged
    twist: Mapping[str, np.ndarray] = field(default_factory=dict)
    delay: Mapping[str, float] = field(default_factory=dict)  # by joint, of its torque [s]
    # by joint, of its position with both rates [s]
    position_delay: Mapping[str, float] = field(default_factory=dict)
    tilt: tuple[float, float] = (0.0, 0.0)  # rotation of the base about x and y [rad]
    compensated: float = 0.0  # share of the given bodies' gravity that torques lack
    displaced: Mapping[str, float] = field(default_factory=dict)  # by place, displacement [m]
    gap: Mapping[str, float] = field(default_factory=dict)  # by closure, C in Φ = C λ [m/N]
    torque: Mapping[str, np.ndarray] = field(default_factory=dict)  # by joint, of its drive (n,)
    late: Mapping[str, float] = field(default_factory=dict)  # by joint, of its torque as predicted
    clock: float = 0.0  # true time over logged time, less 1
    since: float = 0.0  # [s] from the log's first sample, before which it is not known


PER_LOG = "log"  # of an effect that each log has with values of its own
NOWHERE = "nowhere"  # `Effect.tried` of a kind that a diagnosis does not try by itself
Bounds = Mapping[str, tuple[float, float]]
Shape = Mapping[str, float]
Estimates = Mapping[
    str, tuple[float, float | None]
]  # value ± standard error of parameters, by name


def log_word(log: str) -> str:
    """Return the name of a log as a part of a parameter's name: of `runs/a b.csv` it is `a_b`."""
    return re.sub(r"[^\w-]+", "_", PurePath(log).stem or PER_LOG) if log else PER_LOG


@dataclass(frozen=True)
class Effect(ABC):
    """A physical cause beyond rigid bodies; `mechanism + effect` is a new model.

    Args:
        joints: names of what it acts on, `arity` of them: joints, or a link, a closure or a place,
            according to `sits`.
        values: parameters (unknowns, shapes) that are known, and settings, with their values.
        rotational: whether the first joint is rotational (it decides the units).
        signal: one of `signals`, of a kind that is a function of a signal of one's choice.
        per: `log` where each log has values of its own; log: the one whose values these are, empty
            until the logs are known (`Mechanism.for_logs`).
    """

    # identity and site
    kind: ClassVar[str]
    arity: ClassVar[int] = 1
    shared: ClassVar[bool] = False  # whether several joints may have it with the same parameters
    sits: ClassVar[str] = "joint"  # a field of `Sites`, or `mechanism` for the whole of it
    candidate_sites: ClassVar[str] = ""  # the field of `Sites` where a diagnosis tries it
    unknowns: ClassVar[tuple[Unknown, ...]] = ()
    shapes: ClassVar[tuple[Unknown, ...]] = ()
    settings: ClassVar[Mapping[str, float]] = {}  # further keys of `values`, with defaults
    signals: ClassVar[tuple[str, ...]] = ()  # that `signal` can name
    needs: ClassVar[tuple[str, ...]] = ()  # kinds that must be at the same joints

    # text
    noun: ClassVar[str] = ""  # a noun for it, where its kind's name alone does not say what it is
    equation: ClassVar[str]
    signature: ClassVar[str]
    confused_with: ClassVar[tuple[str, ...]] = ()
    source: ClassVar[str]
    remedy: ClassVar[str] = ""  # how to observe it at {joint} where no motion shows it
    separated_by: ClassVar[Mapping[str, str]] = {}  # by rival kind: the experiment that separates

    # columns, or corrections of data and geometry instead
    implicit: ClassVar[bool] = False  # its columns depend on the present model
    memory: ClassVar[bool] = False  # its columns depend on the past, not on the sample alone
    smooth: ClassVar[bool] = False  # its columns are as smooth as the motion: few samples do
    fades: ClassVar[bool] = False  # its memory of the distant past fades: portions can start anew
    corrects: ClassVar[bool] = False  # it has a correction instead of columns
    supplies_torque: ClassVar[bool] = False  # it is a drive: the log has no torque of its joint
    scale: ClassVar[str] = ""  # the shape that multiplies the torque which it supplies
    # of a correction that is not linear in its shapes: the one that is 0 where there is none; its
    # column at a start is that of all the way from 0 to there
    extent: ClassVar[str] = ""
    # its twist is linear in its joint's load (`twists`), from a state that no log knows
    by_load: ClassVar[bool] = False
    through_drives: ClassVar[bool] = False  # it corrects by the torques that drives supply
    shifts_in_time: ClassVar[bool] = False  # the motion, or what is predicted of it
    margin: ClassVar[float] = 0.0  # [s] at both ends of a log that its correction cannot use
    whole_log: ClassVar[bool] = False  # its correction depends on statistics of the whole log
    asks: ClassVar[tuple[str, ...]] = ()  # of `a`, `torque`, `load`: predictions in its columns

    # diagnosis and monitor
    nested_in: ClassVar[tuple[str, ...]] = ()  # kinds that contain this one as a special case
    common: ClassVar[bool] = False  # every machine has it, to some extent
    rare: ClassVar[bool] = False  # few have it, and noise resembles it: another as good goes first
    slow: ClassVar[bool] = False  # it shows at low speed
    at_reversals: ClassVar[bool] = False  # its torque acts while its joint turns round
    jumps: ClassVar[bool] = False  # its torque jumps where the speed reverses
    by_direction: ClassVar[bool] = False  # a difference: of one direction it is other effects
    descriptive: ClassVar[bool] = False  # a curve rather than a law: a formula may replace it
    of_position: ClassVar[bool] = False  # its torque depends on its joint's position alone
    waves: ClassVar[str] = ""  # of position: the shape parameter that is their number a radian
    companions: ClassVar[tuple[str, ...]] = ()  # kinds that act and change with it at a joint
    fault: ClassVar[str] = ""  # the wrong torque channel, by the code of its finding, that it is
    model_words: ClassVar[tuple[str, ...]] = ()  # for it in MuJoCo models and SDF
    watched: ClassVar[str] = "never"  # by a monitor: `always`, on `request`, `never`

    in_rows_alone: ClassVar[bool] = False  # of filtered rows, and no torque at any one instant

    file: ClassVar[Path | None] = None  # of a user's own kind: the Python file that defines it

    joints: tuple[str, ...]
    values: Mapping[str, float] = field(default_factory=dict)
    rotational: bool = True
    signal: str = ""
    per: str = ""
    log: str = ""

    def __post_init__(self) -> None:
        if self.per not in ("", PER_LOG) or (self.per and self.supplies_torque):
            valid = "a drive is the same in each log" if self.per == PER_LOG else 'valid: "log"'
            raise MechanismError(f"effect '{self.kind}': per = \"{self.per}\"; {valid}")
        if self.signal and not self.signals:
            raise MechanismError(
                f"effect '{self.kind}' has no signal to choose, given: {self.signal}; "
                f"write {self.call}"
            )
        if len(self.joints) != self.arity and not (self.shared and len(self.joints) > 1):
            what = f"{self.arity} {self.site}(s)" if self.arity else "the whole mechanism"
            raise MechanismError(
                f"effect '{self.kind}' acts on {what}, given: "
                f"{', '.join(self.joints) or 'none'}; write {self.call}"
            )
        if len(set(self.joints)) != len(self.joints):
            raise MechanismError(
                f"effect '{self.label}' names a joint twice; give different joints"
            )
        names = [parameter.name for parameter in self.parameters]
        for name, value in self.values.items():
            if name not in names and name not in self.settings:
                raise MechanismError(
                    f"effect '{self.label}' has no parameter '{name}'; "
                    f"{one_of(name, [*names, *self.settings])}"
                )
            if not np.isfinite(value):
                raise MechanismError(
                    f"effect '{self.label}': {name} = {value}; give a finite number"
                )

    # --- names ----------------------------------------------------------------------------------

    @property
    def parameters(self) -> tuple[Unknown, ...]:
        """Unknowns c, then shape parameters s."""
        return (*self.unknowns, *self.shapes)

    @cached_property
    def label(self) -> str:
        """`viscous:elbow`, as commands take it."""
        return self.common_label + (f"@{log_word(self.log)}" if self.per else "")

    @cached_property
    def common_label(self) -> str:
        """The label without the log of one that each log has of its own."""
        return ":".join(filter(None, [self.kind, ",".join(self.joints), self.signal]))

    @property
    def names(self) -> tuple[str, ...]:
        """Full names of the parameters, `<kind>.<joint>.<parameter>`."""
        stem = self.label.replace(":", ".")
        return tuple(f"{stem}.{parameter.name}" for parameter in self.parameters)

    @property
    def full(self) -> dict[str, str]:
        """Full names of all parameters by their short ones."""
        return dict(zip((parameter.name for parameter in self.parameters), self.names, strict=True))

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the parameters at these joints."""
        return tuple(parameter.units[0 if self.rotational else 1] for parameter in self.parameters)

    def units_with(self, columns: Collection[str]) -> tuple[str, ...]:
        """Return the units where logs have these columns, on which some depend."""
        return self.units

    @property
    def site(self) -> str:
        """The word for each of `joints`: joint, link, closure, place or frame."""
        return self.sits if self.sits in ("link", "closure", "place", "frame") else "joint"

    @property
    def acting(self) -> tuple[str, ...]:
        """Names of the joints whose torques its columns are, in the columns' order."""
        return self.joints

    @property
    def call(self) -> str:
        """`coupling:joint,joint`, the form in which a command names an effect of this kind."""
        sites = ",".join([self.site] * self.arity)
        return ":".join(filter(None, [self.kind, sites, "signal" if self.signals else ""]))

    @classmethod
    def example(cls) -> Effect:
        """Return an effect of this kind, for a description."""
        return cls(tuple(f"joint{i + 1}" for i in range(cls.arity)))

    @classmethod
    def summary(cls) -> str:
        """The first paragraph of the class's docstring, to stand within a sentence."""
        text = " ".join((inspect.getdoc(cls) or "").split("\n\n")[0].split()).rstrip(".")
        return text[:1].lower() + text[1:]

    def __str__(self) -> str:
        return self.label

    def source_file(self, estimates: Estimates) -> tuple[str, bytes] | None:
        """Return name and content of the Python file that defines a kind outside of the library.

        Args:
            estimates: values of its parameters, by short name, for a file written from them.
        """
        return None if self.file is None else (self.file.name, self.file.read_bytes())

    # --- sites ----------------------------------------------------------------------------------

    @classmethod
    def candidates(cls, sites: Sites) -> list[tuple[str, ...]]:
        """Return the `joints` with which a diagnosis tries this kind, given a mechanism's sites.

        One that joints may share is tried at all of them together, too.
        """
        if cls.candidate_sites == NOWHERE:
            return []
        places = getattr(sites, cls.candidate_sites or cls.sits, ())
        together = [tuple(places)] if cls.shared and len(places) > 1 else []
        return [*together, *combinations(places, cls.arity)]

    def placed(self, rotational: Sequence[bool]) -> Effect:
        """Return the effect with the units of joints of which each is `rotational` or not."""
        return replace(self, rotational=rotational[0])

    def reads(self) -> tuple[str, ...]:
        """Columns of the log that it needs beside the motion."""
        return ()

    @property
    def required(self) -> tuple[str, ...]:
        """Labels of the effects that it changes, which must be in the model."""
        return tuple(f"{kind}:{','.join(self.joints)}" for kind in self.needs)

    @property
    def local(self) -> bool:
        """Return whether it acts in the rows of its own joints only."""
        return self.site == "joint" and self.arity > 0 and not self.corrects

    @property
    def joined(self) -> bool:
        """Return whether several joints have it with the same parameters."""
        return self.shared and len(self.joints) > self.arity

    @property
    def loaded_link(self) -> str | None:
        """The link whose columns of Γ, times the unknowns, are this effect; None for torques."""
        return self.joints[0] if any(unknown.acts == "body" for unknown in self.unknowns) else None

    # --- parameters -----------------------------------------------------------------------------

    def setting(self, name: str) -> float:
        """Value of the setting `name`, or its default."""
        return float(self.values.get(name, self.settings[name]))

    @property
    def searched(self) -> tuple[Unknown, ...]:
        """Shape parameters that are not known and need an outer search."""
        return tuple(shape for shape in self.shapes if shape.name not in self.values)

    @property
    def known(self) -> bool:
        """Return whether all its parameters are given."""
        return all(parameter.name in self.values for parameter in self.parameters)

    @property
    def freed(self) -> Effect:
        """The effect with its unknowns open, or the shapes of a correction, which has none."""
        open_ = {unknown.name for unknown in self.unknowns or self.shapes}
        return replace(self, values={n: x for n, x in self.values.items() if n not in open_})

    @property
    def rescaled(self) -> Effect | None:
        """A drive with its scale open, where that is given; None of another effect."""
        if self.scale not in self.values:
            return None
        return replace(self, values={n: x for n, x in self.values.items() if n != self.scale})

    @property
    def linear(self) -> bool:
        """Return whether one solve suffices: nothing to search, no prediction in the columns."""
        return not self.searched and not self.implicit

    # --- columns --------------------------------------------------------------------------------

    @abstractmethod
    def columns(self, s: Signals) -> np.ndarray:
        """E (n, acting, unknowns): the torque each joint must supply per unit of each unknown.

        The signals `s` are those of `acting`, in their order, with the values of its shapes.
        """

    def informed(self, s: Signals) -> np.ndarray:
        """(n, arity), false where a sample of s does not inform the effect's torque on a joint."""
        return np.ones(s.q.shape, dtype=bool)

    def bounds(self, s: Signals) -> Bounds:
        """The range of each shape parameter that the signals `s` can determine."""
        return {shape.name: shape.range for shape in self.shapes if shape.range}

    def starts(self, s: Signals) -> list[Shape]:
        """Shapes from which the outer search starts, so close that one leads to the optimum.

        The signals `s` are those of its joints in all experiments.
        """
        return [{}]

    def possible(self, s: Signals) -> bool:
        """Whether the effect can have the shape `s.shape` in a motion with these signals."""
        return True

    # --- correction and simulation --------------------------------------------------------------

    def correction(self, s: Signals) -> Correction:
        """The corrections at the shape `s.shape`; none for an effect that is a torque."""
        return Correction()

    def twists(
        self, s: Signals, loads: np.ndarray, at_rest: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the twists and their two rates (3, n, m) of an effect that is linear in its loads;
        none of another one.

        Args:
            s: signals of its joint, with the shape; loads: (n, m) that act on it.
            at_rest: (m,) the loads before the log, where it begins at rest.
        """
        return np.zeros((3, *loads.shape))

    def frequency(self, s: Signals) -> float:
        """Return the frequency [Hz] at which it swings with the shape `s.shape`; 0: at none."""
        return 0.0

    def scale_column(self, s: Signals, predicted: np.ndarray) -> np.ndarray:
        """Return ∂τ/∂scale (n,) of a drive.

        Args:
            s: signals of its joint, with the values of its shapes.
            predicted: (n,) the torque that the model predicts for it [N m | N].
        """
        return np.zeros(len(s.t))

    def state_rate(self, z: np.ndarray, v: np.ndarray, shape: Shape) -> np.ndarray:
        """ż of the state z that multiplies unknowns that act by `state`, of rates v and a shape."""
        raise MechanismError(
            f"effect '{self.kind}' has an unknown that acts by `state`: define its `state_rate`"
        )

    @property
    def not_integrable(self) -> str:
        """The reason why it has no place in a forward simulation; empty where it has one."""
        if self.memory and not any(unknown.acts == "state" for unknown in self.unknowns):
            return "it depends on the past, and its state has no differential equation"
        return ""


@dataclass(frozen=True)
class Correcting(Effect):
    """An effect without columns of its own: it corrects positions, torques, gravity or lengths.

    Its shape parameters enter the equations by their sensitivities, −∂(b − A x)/∂s.
    """

    corrects: ClassVar[bool] = True

    def columns(self, s: Signals) -> np.ndarray:
        return np.zeros((*s.q.shape, 0))

    def starts(self, s: Signals) -> list[Shape]:
        # no correction at all
        return [{shape.name: 0.0 for shape in self.shapes}]
