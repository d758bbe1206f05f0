"""An experiment with all that rows are made of: corrected at the working point, and beside it.

S = −∂(b − A x)/∂s        of a correcting effect, by central differences over the scenes s ± h
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ident.effects import Effect
from ident.equations.columns import Columns
from ident.equations.correct import Seen, corrected, shapes_of
from ident.equations.point import Point
from ident.equations.samples import STEP, Samples, reduced
from ident.errors import MotionError
from ident.mechanism.mechanism import Mechanism
from ident.motion import Experiment


@dataclass(frozen=True, eq=False)
class Beside:
    """The scenes at s + h and s − h of the shape in column `place`, at value s."""

    place: int
    value: float
    h: float
    above: Seen
    below: Seen


@dataclass(frozen=True, eq=False)
class Scene:
    """One experiment as the equations see it.

    Attributes:
        seen: mechanism and experiment, corrected at the working point.
        columns: the unknowns.
        point: values of all parameters.
        beside: for every unknown shape of a correcting effect.
    """

    seen: Seen
    columns: Columns
    point: Point
    beside: tuple[Beside, ...] = ()

    @classmethod
    def of(
        cls,
        mechanism: Mechanism,
        columns: Columns,
        e: Experiment,
        point: Point | None = None,
        cutoff: float | None = None,
    ) -> Scene:
        """The scene of an experiment; `cutoff` [Hz] is that of the rows' filter."""
        check_needs(mechanism, e)
        point = point or Point.prior(mechanism)
        bare = Seen(mechanism, e)
        beside = []
        for effect, places in columns.effects:
            if not effect.corrects:
                continue
            shapes = shapes_of(effect, point)
            for (name, value), full, place in zip(
                shapes.items(), effect.names, places, strict=True
            ):
                if place < 0:
                    continue
                h = step_of(effect, bare, point, name)
                above, below = (
                    corrected(bare, point.with_values({full: value + sign * h}), cutoff)
                    for sign in (1, -1)
                )
                beside.append(Beside(int(place), value, h, above, below))
        return cls(corrected(bare, point, cutoff), columns, point, tuple(beside))

    @property
    def mechanism(self) -> Mechanism:
        """Corrected."""
        return self.seen.mechanism

    @property
    def e(self) -> Experiment:
        """Corrected."""
        return self.seen.e

    def samples(self, part: slice | np.ndarray) -> Samples:
        """Some samples in the independent coordinates."""
        return reduced(self.mechanism, self.e, part, self.point, self.seen.memo)

    def generalised(self, part: slice | np.ndarray) -> Samples:
        """The same in generalised coordinates."""
        return Samples(self.mechanism, self.e, part, self.point, self.seen.memo)

    def sensitivities(
        self, part: slice | np.ndarray, full: bool
    ) -> Iterator[tuple[Beside, Samples, Samples]]:
        """For every unknown correction the samples above and below, reduced or in full."""
        for each in self.beside:
            above, below = (
                Samples(seen.mechanism, seen.e, part, self.point, seen.memo)
                if full
                else reduced(seen.mechanism, seen.e, part, self.point, seen.memo)
                for seen in (each.above, each.below)
            )
            yield each, above, below


def check_needs(mechanism: Mechanism, e: Experiment) -> None:
    """Refuse an effect without the other effect, or the column of the log, that it needs.

    Raises:
        MotionError: naming the effect, what is missing and what to do.
    """
    present = {effect.label for effect in mechanism.effects}
    for effect in mechanism.effects:
        for kind in effect.needs:
            other = f"{kind}:{','.join(effect.joints)}"
            if other not in present:
                raise MotionError(
                    f"{mechanism.name}: effect '{effect.label}' changes '{other}', which is not "
                    f"there; add it (--with {other}), or leave out {effect.label}"
                )
        for name in effect.reads():
            if name not in e.extra:
                raise MotionError(
                    f"{e.name}: has no column '{name}', which effect '{effect.label}' needs; log "
                    f"it, map it in [log], or leave out {effect.label}"
                )


def step_of(effect: Effect, seen: Seen, point: Point, name: str) -> float:
    """h [the shape's unit], a thousandth of what these data could tell."""
    whole = Samples(seen.mechanism, seen.e, slice(None), point, seen.memo)
    _, shape = point.of(effect)
    low, high = effect.bounds(replace(whole.signals(effect.joints), shape=shape))[name]
    return STEP * (high - low)
