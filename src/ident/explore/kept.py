"""Rows of a model that remember effects' columns from one model of a motion to the next.

What an effect's columns are depends on the motion, not on what else is in the model, as long as
nothing corrects the motion and the effect asks for no prediction.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ident.effects import Correcting, Effect
from ident.fit import Fit
from ident.fit.table import Table

Shapes = Sequence[Mapping[str, float]]
ROOM = 200_000_000  # bytes of columns that are kept


@dataclass(frozen=True, eq=False)
class Store:
    """Columns (N, c, unknowns · shapes) by what they were asked for, of one motion."""

    columns: dict[tuple[object, ...], np.ndarray] = field(default_factory=dict)

    @property
    def size(self) -> int:
        """Bytes."""
        return sum(x.nbytes for x in self.columns.values())


@dataclass(frozen=True, eq=False)
class Kept(Table):
    """A table that looks a column up before it makes it."""

    store: Store = field(default_factory=Store)

    @classmethod
    def of_fit(cls, fit: Fit, store: Store) -> Kept:
        """The rows of a fit; what `store` has of the same motion is not made again."""
        made = Table.of(fit.mechanism, fit.columns, fit.motion, fit.point)
        own = {name: getattr(made, name) for name in Table.__dataclass_fields__}
        return cls(**own, store=store)

    def with_effect(self, effect: Effect, shapes: Shapes) -> np.ndarray:
        """As `Table.with_effect`."""
        corrected = any(isinstance(each, Correcting) for each in self.mechanism.effects)
        if corrected or effect.implicit or len(shapes) == 0:
            return super().with_effect(effect, shapes)
        asked = [tuple(sorted(each.items())) for each in (effect.values, *shapes)]
        key = (type(effect), effect.label, self.motion.independent, *asked)
        if key not in self.store.columns:
            found = super().with_effect(effect, shapes)
            if self.store.size + found.nbytes > ROOM:
                return found
            self.store.columns[key] = found
        return self.store.columns[key]
