"""What an effect is: named columns E(q, v, a, …) whose unknowns c add E c to the joints' torques.

A new kind is one class: what it is called, its unknowns with units, its columns, and the words that
`ident effects` prints. Everything else (names, known values, files, commands) comes from here.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from ident.errors import MechanismError, one_of


@dataclass(frozen=True)
class Unknown:
    """One unknown of an effect: its name, and its unit at a turning and at a sliding joint."""

    name: str
    units: tuple[str, str]  # (rotational, linear)
    meaning: str
    nonnegative: bool = False


@dataclass(frozen=True)
class Signals:
    """What effects see: time series of the joints they act on, in the order of `joints`.

    Attributes:
        t: (n,) [s].
        q, v, a: (n, joints) [rad | m], [.../s], [.../s²].
        still: (joints,) speed [rad/s | m/s] below which a joint counts as standing still.
        extra: the log's other columns on the same clock, each (n,).
    """

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    still: np.ndarray
    extra: Mapping[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class Effect(ABC):
    """A physical cause beyond rigid bodies at some joints; `mechanism + effect` is a new model.

    Args:
        joints: names of the joints that it acts on, `arity` of them.
        values: unknowns that are known, with their values.
        rotational: whether the first joint turns (it decides the units).
    """

    kind: ClassVar[str]
    arity: ClassVar[int] = 1
    unknowns: ClassVar[tuple[Unknown, ...]]
    equation: ClassVar[str]
    signature: ClassVar[str]
    confused_with: ClassVar[tuple[str, ...]] = ()
    source: ClassVar[str]

    joints: tuple[str, ...]
    values: Mapping[str, float] = field(default_factory=dict)
    rotational: bool = True

    def __post_init__(self) -> None:
        if len(self.joints) != self.arity:
            raise MechanismError(
                f"effect '{self.kind}' acts on {self.arity} joint(s), given: "
                f"{', '.join(self.joints) or 'none'}; write {self.kind}:"
                + ",".join(["joint"] * self.arity)
            )
        if len(set(self.joints)) != len(self.joints):
            raise MechanismError(
                f"effect '{self.label}' names a joint twice; give different joints"
            )
        names = [unknown.name for unknown in self.unknowns]
        for name, value in self.values.items():
            if name not in names:
                raise MechanismError(
                    f"effect '{self.label}' has no parameter '{name}'; {one_of(name, names)}"
                )
            if not np.isfinite(value):
                raise MechanismError(
                    f"effect '{self.label}': {name} = {value}; give a finite number"
                )

    @property
    def label(self) -> str:
        """`viscous:elbow`, as commands take it."""
        return f"{self.kind}:{','.join(self.joints)}"

    @property
    def names(self) -> tuple[str, ...]:
        """Full names of the unknowns, `<kind>.<joint>.<parameter>`."""
        stem = f"{self.kind}.{','.join(self.joints)}"
        return tuple(f"{stem}.{unknown.name}" for unknown in self.unknowns)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the unknowns at these joints."""
        return tuple(unknown.units[0 if self.rotational else 1] for unknown in self.unknowns)

    @abstractmethod
    def columns(self, s: Signals) -> np.ndarray:
        """E (n, arity, unknowns): the torque each joint must supply per unit of each unknown."""

    def informed(self, s: Signals) -> np.ndarray:
        """(n, arity), false where a sample says nothing about this effect's torque on a joint."""
        return np.ones(s.q.shape, dtype=bool)

    def __str__(self) -> str:
        return self.label
