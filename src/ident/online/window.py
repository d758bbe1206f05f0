"""Completed samples with their neighbours, for effects that look at a sample's surroundings."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from ident.effects import Correcting
from ident.effects.drive import LATEST, Delay
from ident.equations.correct import WIDER
from ident.equations.filter import Decimator
from ident.mechanism.mechanism import Mechanism
from ident.motion import Experiment

SPLINE = 12  # samples beyond which a cubic spline forgets its ends
TWICE = 2  # samples that two differences lose at an end


@dataclass(frozen=True, eq=False)
class Window:
    """Consecutive samples, of which those `inside` have all neighbours that they need.

    Attributes:
        e: the samples; number: of the first, in steps of the clock.
        inside: which of them are answered for.
    """

    e: Experiment
    number: int
    inside: slice

    @property
    def sample(self) -> np.ndarray:
        """Numbers of the samples inside."""
        return np.arange(self.number + self.inside.start, self.number + self.inside.stop)

    @property
    def last(self) -> Window:
        """Of the last of these samples alone."""
        return Window(self.e, self.number, slice(self.inside.stop - 1, self.inside.stop))


def margin_of(mechanism: Mechanism, rate: float, cutoff: float | None) -> int:
    """Samples on either side that the corrections of a mechanism look at."""
    most = 0
    for effect in mechanism.effects:
        if isinstance(effect, Delay):
            most = max(most, int(np.ceil(LATEST * rate)) + SPLINE)
        elif isinstance(effect, Correcting) and effect.implicit:
            wide = WIDER * cutoff if cutoff and WIDER * cutoff < 0.5 * rate else None
            most = max(most, Decimator.of(wide, rate).half + TWICE)
    return most


class Windows:
    """Experiments in, windows out that overlap by twice the margin.

    Args:
        margin: samples that are needed on either side.
    """

    def __init__(self, margin: int) -> None:
        self._margin = margin
        self._before: Window | None = None

    def __call__(self, e: Experiment, number: int) -> Window | None:
        """The window of those samples that have all their neighbours by now.

        Args:
            e: consecutive samples, more of them.
            number: of the first of them.
        """
        before, m = self._before, self._margin
        if not m:
            return Window(e, number, slice(0, len(e)))
        if before is not None and before.number + len(before.e) == number:
            e, number = _joined(before.e, e), before.number
        kept = max(0, len(e) - 2 * m)
        self._before = Window(e.at_samples(slice(kept, None)), number + kept, slice(0, 0))
        return Window(e, number, slice(m, len(e) - m)) if len(e) > 2 * m else None


def _joined(a: Experiment, b: Experiment) -> Experiment:
    """One experiment after the other."""
    both: dict[str, Any] = {
        each.name: np.concatenate([x, getattr(b, each.name)])
        for each in fields(a)
        if each.name != "still" and isinstance(x := getattr(a, each.name), np.ndarray)
    }
    return replace(
        a, **both, extra={name: np.concatenate([x, b.extra[name]]) for name, x in a.extra.items()}
    )
