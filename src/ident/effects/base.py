"""What an effect is: columns E(q, v, a, …; s) whose unknowns c add E c to the joints' torques.

A new kind is one class: what it is called, its unknowns c and shape parameters s with units, its
columns, and the words that `ident effects` prints. Everything else (names, known values, search for
shapes, files, commands) comes from here.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from ident.effects.signals import Signals
from ident.errors import MechanismError, one_of


@dataclass(frozen=True)
class Unknown:
    """One parameter of an effect: its name, and its unit at a turning and at a sliding joint.

    Attributes:
        nonnegative: whether a negative value makes no physical sense.
        discrete: of a shape parameter, whether it takes a few values only and has no slope.
        largest: size beyond which a value is no such thing any more.
    """

    name: str
    units: tuple[str, str]  # (rotational, linear)
    meaning: str
    nonnegative: bool = False
    discrete: bool = False
    largest: float = np.inf


Bounds = Mapping[str, tuple[float, float]]
Shape = Mapping[str, float]


@dataclass(frozen=True)
class Effect(ABC):
    """A physical cause beyond rigid bodies; `mechanism + effect` is a new model.

    Args:
        joints: names of what it acts on, `arity` of them: joints, or a link, a closure or a place,
            as `sits` says.
        values: parameters (unknowns, shapes) that are known, and settings, with their values.
        rotational: whether the first joint turns (it decides the units).
    """

    kind: ClassVar[str]
    arity: ClassVar[int] = 1
    sits: ClassVar[str] = "joint"  # joint | driven | mechanism | link | closure | place
    unknowns: ClassVar[tuple[Unknown, ...]] = ()
    shapes: ClassVar[tuple[Unknown, ...]] = ()
    settings: ClassVar[Mapping[str, float]] = {}  # further keys of `values`, with defaults
    equation: ClassVar[str]
    signature: ClassVar[str]
    confused_with: ClassVar[tuple[str, ...]] = ()
    nested_in: ClassVar[tuple[str, ...]] = ()  # kinds that contain this one as a special case
    source: ClassVar[str]
    needs: ClassVar[tuple[str, ...]] = ()  # kinds that must be at the same joints
    common: ClassVar[bool] = False  # every machine has it, to some extent
    rare: ClassVar[bool] = False  # few have it, and noise resembles it: more evidence is asked for
    implicit: ClassVar[bool] = False  # its columns depend on what the present model predicts
    memory: ClassVar[bool] = False  # its columns depend on the past, not on the sample alone

    joints: tuple[str, ...]
    values: Mapping[str, float] = field(default_factory=dict)
    rotational: bool = True

    def __post_init__(self) -> None:
        if len(self.joints) != self.arity:
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

    @property
    def parameters(self) -> tuple[Unknown, ...]:
        """Unknowns c, then shape parameters s."""
        return (*self.unknowns, *self.shapes)

    @property
    def label(self) -> str:
        """`viscous:elbow`, as commands take it."""
        return f"{self.kind}:{','.join(self.joints)}" if self.joints else self.kind

    @property
    def names(self) -> tuple[str, ...]:
        """Full names of the parameters, `<kind>.<joint>.<parameter>`."""
        stem = f"{self.kind}.{','.join(self.joints)}" if self.joints else self.kind
        return tuple(f"{stem}.{parameter.name}" for parameter in self.parameters)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the parameters at these joints."""
        return tuple(parameter.units[0 if self.rotational else 1] for parameter in self.parameters)

    @property
    def site(self) -> str:
        """What each of `joints` is: a joint, link, closure or place."""
        return self.sits if self.sits in ("link", "closure", "place") else "joint"

    @property
    def call(self) -> str:
        """`coupling:joint,joint`, how a command names an effect of this kind."""
        return ":".join([self.kind, *([",".join([self.site] * self.arity)] if self.arity else [])])

    def reads(self) -> tuple[str, ...]:
        """Columns of the log that it needs beside the motion."""
        return ()

    def setting(self, name: str) -> float:
        """Value of the setting `name`, or its default."""
        return float(self.values.get(name, self.settings[name]))

    @property
    def searched(self) -> tuple[Unknown, ...]:
        """Shape parameters that are not known, to be found by an outer search."""
        return tuple(shape for shape in self.shapes if shape.name not in self.values)

    @property
    def known(self) -> bool:
        """Whether all its parameters are given."""
        return all(each.name in self.values for each in self.parameters)

    @property
    def freed(self) -> Effect:
        """A known effect whose size has changed: unknowns open, shapes as they are; a correction,
        which has no unknowns, has its shapes open.
        """
        open_ = self.unknowns or self.shapes
        kept = {n: x for n, x in self.values.items() if n not in {each.name for each in open_}}
        return replace(self, values=kept)

    @property
    def local(self) -> bool:
        """Whether it acts in the rows of its own joints only."""
        return self.sits in ("joint", "driven")

    @property
    def linear(self) -> bool:
        """Whether one least-squares solve suffices: nothing to search, no prediction in columns."""
        return not self.searched and not self.implicit

    @abstractmethod
    def columns(self, s: Signals) -> np.ndarray:
        """E (n, arity, unknowns): the torque each joint must supply per unit of each unknown.

        Args:
            s: signals of its joints, in their order, with the values of its shapes.
        """

    def informed(self, s: Signals) -> np.ndarray:
        """(n, arity), false where a sample says nothing about this effect's torque on a joint."""
        return np.ones(s.q.shape, dtype=bool)

    def bounds(self, s: Signals) -> Bounds:
        """Within which values of each shape parameter the signals `s` could tell it."""
        return {}

    def starts(self, s: Signals) -> list[Shape]:
        """Shapes from which the outer search sets out, close enough that one leads to the best.

        Args:
            s: signals of its joints, of all experiments.
        """
        return [{}]

    def __str__(self) -> str:
        return self.label


@dataclass(frozen=True)
class Correction:
    """What an effect says of the data or the geometry, instead of a torque.

    Attributes:
        dq: by joint, what its true coordinate has beyond the logged one, (n,) or a number.
        delay: by joint, by how much its torque channel is late [s].
        tilt: rotation of the base about x and y [rad].
        moved: by place, a displacement [m] along its axis.
        gap: by closure, its compliance C in Φ = C λ [m/N].
    """

    dq: Mapping[str, np.ndarray | float] = field(default_factory=dict)
    delay: Mapping[str, float] = field(default_factory=dict)
    tilt: tuple[float, float] = (0.0, 0.0)
    moved: Mapping[str, float] = field(default_factory=dict)
    gap: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Correcting(Effect):
    """An effect without columns of its own: it corrects positions, torques, gravity or lengths.

    Its shape parameters enter the equations by their sensitivities, −∂(b − A x)/∂s.
    """

    def columns(self, s: Signals) -> np.ndarray:
        """E (n, arity, 0)."""
        return np.zeros((*s.q.shape, 0))

    @abstractmethod
    def correction(self, s: Signals) -> Correction:
        """What is corrected at the shape `s.shape`."""

    @property
    def local(self) -> bool:
        """A corrected position is in all rows."""
        return False

    def starts(self, s: Signals) -> list[Shape]:
        """No correction at all."""
        return [{shape.name: 0.0 for shape in self.shapes}]
