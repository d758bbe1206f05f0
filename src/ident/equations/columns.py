"""The columns of [Γ E S]: which unknown each belongs to. The only file that counts columns.

Rigid parameters first, in the order in which base parameters read best, then the effects in the
order in which they were added, so that an effect that a rigid parameter can replace is the one
that is regrouped.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ident.effects import Effect
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import unit_of


@dataclass(frozen=True, eq=False)
class Columns:
    """Names, units, priors and places of the unknowns x = [p; c].

    Attributes:
        names: (k,) full names; units: (k,).
        prior: (k,) the URDF's values, 0 for effects.
        rigid: columns of Γ that are unknown, in this order.
        known: columns of Γ that are known, with `known_values`.
        effects: every effect with, for each of its parameters (unknowns, then shapes), its place in
            x, or −1 if it is known or discrete. A shape's column is its sensitivity.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    prior: np.ndarray
    rigid: np.ndarray
    known: np.ndarray
    known_values: np.ndarray
    effects: tuple[tuple[Effect, np.ndarray], ...]

    @classmethod
    def of(cls, mechanism: Mechanism) -> Columns:
        """The unknowns of a mechanism."""
        names = mechanism.bodies.names
        unknown = set(mechanism.unknown)
        order = mechanism.bodies.reading_order()
        rigid = np.array([i for i in order if names[i] in unknown], dtype=int)
        known = np.array([i for i in range(len(names)) if names[i] not in unknown], dtype=int)
        known = known[mechanism.prior[known] != 0.0] if len(known) else known
        all_names = [names[i] for i in rigid]
        units = [unit_of(name) for name in all_names]
        prior = list(mechanism.prior[rigid])
        effects = []
        for effect in mechanism.effects:
            places = []
            for name, unit, parameter in zip(
                effect.names, effect.units, effect.parameters, strict=True
            ):
                if parameter.name in effect.values or parameter.discrete:
                    places.append(-1)
                    continue
                places.append(len(all_names))
                all_names.append(name)
                units.append(unit)
                prior.append(0.0)
            effects.append((effect, np.array(places, dtype=int)))
        return cls(
            names=tuple(all_names),
            units=tuple(units),
            prior=np.array(prior),
            rigid=rigid,
            known=known,
            known_values=mechanism.prior[known],
            effects=tuple(effects),
        )

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def index(self) -> dict[str, int]:
        """Where an unknown stands in x, by name."""
        return {name: i for i, name in enumerate(self.names)}

    @cached_property
    def shapes(self) -> np.ndarray:
        """Places (…,) in x of shape parameters, whose columns are sensitivities."""
        found = [
            places[len(effect.unknowns) :][places[len(effect.unknowns) :] >= 0]
            for effect, places in self.effects
        ]
        return np.concatenate([np.empty(0, dtype=int), *found])

    def prior_at(self, values: Mapping[str, float]) -> np.ndarray:
        """(k,) the prior, with shapes at their present values: that is where they stay if no data
        move them.
        """
        prior = self.prior.copy()
        for i in self.shapes:
            prior[i] = values.get(self.names[i], 0.0)
        return prior

    def dynamic_parameters(self, mechanism: Mechanism, x: np.ndarray) -> np.ndarray:
        """All dynamic parameters (10 · bodies,) in Γ's order, unknown ones from x (k,)."""
        pi = mechanism.prior.copy()
        pi[self.rigid] = x[: len(self.rigid)]
        return pi
