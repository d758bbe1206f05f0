"""The working point: values of all parameters, at which what is not linear is evaluated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ident.effects import Effect
from ident.equations.columns import Columns
from ident.mechanism.mechanism import Mechanism


@dataclass(frozen=True, eq=False)
class Point:
    """Values of all parameters of a mechanism.

    Attributes:
        pi: (10 · bodies,) dynamic parameters in Γ's order.
        values: of all effects' parameters, by full name.
    """

    pi: np.ndarray
    values: Mapping[str, float]

    @classmethod
    def prior(cls, mechanism: Mechanism) -> Point:
        """The URDF's inertias; effects' known values."""
        known = {
            name: float(effect.values[parameter.name])
            for effect in mechanism.effects
            for name, parameter in zip(effect.names, effect.parameters, strict=True)
            if parameter.name in effect.values
        }
        return cls(mechanism.prior, known)

    def at(self, mechanism: Mechanism, columns: Columns, x: np.ndarray) -> Point:
        """The point with the unknowns at x (k,)."""
        found = {columns.names[i]: float(x[i]) for i in range(len(columns.rigid), len(columns))}
        known = Point.prior(mechanism).values
        return Point(columns.dynamic_parameters(mechanism, x), {**self.values, **known, **found})

    def unknowns(self, columns: Columns) -> np.ndarray:
        """x (k,), the values of the unknowns here."""
        own = columns.names[len(columns.rigid) :]
        return np.append(self.pi[columns.rigid], [self.values.get(name, 0.0) for name in own])

    def with_values(self, values: Mapping[str, float]) -> Point:
        """The point with some effects' parameters at other values."""
        return replace(self, values={**self.values, **values})

    def of(self, effect: Effect) -> tuple[np.ndarray, dict[str, float]]:
        """c (unknowns,) and shapes s by name, 0 for unknowns that have no value yet."""
        u = len(effect.unknowns)
        c = np.array([self.values.get(name, 0.0) for name in effect.names[:u]])
        s = {
            shape.name: self.values[name]
            for name, shape in zip(effect.names[u:], effect.shapes, strict=True)
            if name in self.values
        }
        return c, s

    def all_of(self, effect: Effect) -> np.ndarray:
        """(parameters,) values of unknowns and shapes; NaN for a shape that has none."""
        c, s = self.of(effect)
        return np.concatenate([c, [s.get(shape.name, np.nan) for shape in effect.shapes]])
