"""The unknowns x = [p; c; s]: the columns of [Γ E S] that belong to them, and their values.

No other file counts columns.

Rigid parameters stand first, in the order in which base parameters read best, then the effects in
the order in which they were added, so that an effect that a rigid parameter can replace is the one
that is regrouped.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ident.effects import Effect
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import COUNT, DYNAMIC, unit_of

INERTIAS = DYNAMIC.index("Lxx")  # of a body's ten: before them are its mass and first moments


@dataclass(frozen=True, eq=False)
class Columns:
    """Names, units, priors and places of the unknowns x = [p; c]."""

    names: tuple[str, ...]  # (k,) full names
    units: tuple[str, ...]  # (k,)
    prior: np.ndarray  # (k,) the URDF's values, 0 for effects
    rigid: np.ndarray  # columns of Γ that are unknown, in this order
    known: np.ndarray  # columns of Γ that are known, with `known_values`
    known_values: np.ndarray
    # every effect with, for each of its parameters (unknowns, then shapes), its place in x, or −1
    # if it is known or discrete. A shape's column is its sensitivity
    effects: tuple[tuple[Effect, np.ndarray], ...]
    # of every effect that is a load of a link, the link's columns of Γ and the places of its
    # parameters in x, or −1
    loads: tuple[tuple[np.ndarray, np.ndarray], ...] = ()

    @classmethod
    def of(cls, mechanism: Mechanism) -> Columns:
        """The unknowns of a mechanism."""
        names = mechanism.bodies.names
        unknown = set(mechanism.unknown)
        order = mechanism.bodies.reading_order()
        rigid = np.array([i for i in order if names[i] in unknown], dtype=int)
        given = np.flatnonzero(mechanism.prior)
        known = np.array([i for i in given if names[i] not in unknown], dtype=int)
        all_names = [names[i] for i in rigid]
        units = [unit_of(name) for name in all_names]
        prior = list(mechanism.plausible_prior[rigid])
        effects, loads = [], []
        for effect in mechanism.effects:
            places = []
            for parameter, unit in zip(effect.parameters, effect.units, strict=True):
                if parameter.name in effect.values or parameter.discrete:
                    places.append(-1)
                    continue
                places.append(len(all_names))
                all_names.append(effect.full[parameter.name])
                units.append(unit)
                prior.append(0.0)
            effects.append((effect, np.array(places, dtype=int)))
            if effect.loaded_link:
                link = np.arange(len(names))[mechanism.bodies.columns(effect.loaded_link)]
                loads.append((link, effects[-1][1]))
        return cls(
            tuple(all_names), tuple(units), np.array(prior), rigid, known, mechanism.prior[known],
            tuple(effects), tuple(loads),
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def index(self) -> dict[str, int]:
        """Where an unknown stands in x, by name."""
        return {name: i for i, name in enumerate(self.names)}

    @cached_property
    def of_gamma(self) -> tuple[np.ndarray, np.ndarray]:
        """Columns of Γ whose parameters are unknown, and their places in x."""
        columns, places = [self.rigid], [np.arange(len(self.rigid))]
        for link, of_load in self.loads:
            columns.append(link[of_load >= 0])
            places.append(of_load[of_load >= 0])
        return np.concatenate(columns), np.concatenate(places)

    @cached_property
    def terms(self) -> np.ndarray:
        """(k,) number of its term: masses and first moments 0, inertias 1, effects from 2 on."""
        term = np.zeros(len(self), dtype=int)
        term[: len(self.rigid)] = self.rigid % COUNT >= INERTIAS
        for number, (_, places) in enumerate(self.effects, 2):
            term[places[places >= 0]] = number
        return term

    @cached_property
    def shapes(self) -> np.ndarray:
        """Places (…,) in x of shape parameters, whose columns are sensitivities."""
        shapes = (places[len(effect.unknowns) :] for effect, places in self.effects)
        every = np.concatenate([np.empty(0, dtype=int), *shapes])
        return every[every >= 0]

    @cached_property
    def with_known_shapes(self) -> Columns:
        """The same unknowns, with columns of zeros for shapes, which are taken as known."""
        effects = tuple(
            (effect, np.where(np.arange(len(places)) < len(effect.unknowns), places, -1))
            for effect, places in self.effects
        )
        return replace(self, effects=effects)

    def prior_at(self, values: Mapping[str, float]) -> np.ndarray:
        """(k,) the prior, with shapes at their present values, where they stay without data."""
        prior = self.prior.copy()
        for i in self.shapes:
            prior[i] = values.get(self.names[i], 0.0)
        return prior

    def dynamic_parameters(self, mechanism: Mechanism, x: np.ndarray) -> np.ndarray:
        """All dynamic parameters (10 · bodies,) in Γ's order, unknown ones from x (k,)."""
        pi = mechanism.prior.copy()
        pi[self.rigid] = x[: len(self.rigid)]
        return pi


NOTHING = Columns((), (), np.empty(0), np.empty(0, int), np.empty(0, int), np.empty(0), ())
"""The unknowns of a mechanism of which all is known."""


@dataclass(frozen=True, eq=False)
class Point:
    """Values of all parameters of a mechanism."""

    pi: np.ndarray  # (10 · bodies,) dynamic parameters in Γ's order
    values: Mapping[str, float]  # of all effects' parameters, by full name

    @classmethod
    def prior(cls, mechanism: Mechanism) -> Point:
        """The URDF's inertias; effects' known values."""
        known = {
            full: float(effect.values[name])
            for effect in mechanism.effects
            for name, full in effect.full.items()
            if name in effect.values
        }
        return cls(mechanism.plausible_prior, known)

    def at(self, mechanism: Mechanism, columns: Columns, x: np.ndarray) -> Point:
        """The point with the unknowns at x (k,)."""
        unknown = {columns.names[i]: float(x[i]) for i in range(len(columns.rigid), len(columns))}
        known = Point.prior(mechanism).values
        return Point(columns.dynamic_parameters(mechanism, x), {**self.values, **known, **unknown})

    def unknowns(self, columns: Columns) -> np.ndarray:
        """x (k,), the values of the unknowns here."""
        of_effects = columns.names[len(columns.rigid) :]
        return np.append(
            self.pi[columns.rigid], [self.values.get(name, 0.0) for name in of_effects]
        )

    def with_values(self, values: Mapping[str, float]) -> Point:
        """The point with some effects' parameters at other values."""
        return replace(self, values={**self.values, **values})

    def of(self, effect: Effect) -> tuple[np.ndarray, dict[str, float]]:
        """c (unknowns,) and shapes s by name, 0 for unknowns that have no value yet."""
        full = effect.full
        c = np.array([self.values.get(full[parameter.name], 0.0) for parameter in effect.unknowns])
        names = [
            parameter.name for parameter in effect.shapes if full[parameter.name] in self.values
        ]
        return c, {name: self.values[full[name]] for name in names}
