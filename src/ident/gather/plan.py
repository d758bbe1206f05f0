"""What all portions of all logs must have in common, so that their equations are those of one fit.

A log of a few portions decides by itself what `complete` decides of it: its clock, how it is
smoothed, when a joint stands still. Only what several logs share (the filter, the joints in which
errors count, the working point) is decided before, on an excerpt.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ident.effects import Correcting
from ident.effects.drive import LATEST
from ident.equations.columns import Columns
from ident.equations.filter import Decimator
from ident.equations.point import Point
from ident.gather.survey import Survey
from ident.mechanism.mechanism import Mechanism
from ident.motion.decided import Decided
from ident.motion.motion import Band

SAMPLES = 65_536  # of a portion
KNOTS = 40  # from a sample to another whose noise moves a spline there by 1e-7 of itself
REMEMBERED = 4096  # samples after which an effect has forgotten where its memory began
FEWEST = 64  # samples of a margin: what is interpolated reaches no farther


@dataclass(frozen=True, eq=False)
class Part:
    """What is planned for one log.

    Attributes:
        survey: of the log.
        borders: rows (k + 1,) between its k portions.
        decided: for all portions of a log that has several; None: it decides by itself.
        still: (J,) speed [rad/s | m/s] below which a joint stands still.
        farthest: (J, d) largest leverage of every joint; None for a tree.
        largest: ‖K⁺‖ beyond which a sample is near a singular position.
        anchors: (k, nq) a configuration near the beginning of each portion; None for a tree.
    """

    survey: Survey
    borders: tuple[int, ...]
    decided: Decided | None = None
    still: np.ndarray | None = None
    farthest: np.ndarray | None = None
    largest: float = np.inf
    anchors: np.ndarray | None = None

    @property
    def name(self) -> str:
        """The log's."""
        return self.survey.name

    @property
    def samples(self) -> int:
        """Of its clock."""
        return self.survey.clock.count


@dataclass(frozen=True)
class Portion:
    """A stretch of one log, with margins on both sides.

    Attributes:
        log: its number; number: of the portion in the log.
        begin, end: rows that are read; since, until: [s] of the samples that it answers for.
    """

    log: int
    number: int
    begin: int
    end: int
    since: float
    until: float


@dataclass(frozen=True, eq=False)
class Plan:
    """What portions have in common.

    Attributes:
        mechanism: that is identified.
        logged: joints that determine the motion; independent: those in which errors count.
        band: with the cut-off of the rows' filter.
        smoothing: as it was asked for.
        parts: one a log.
        point: values of all parameters, at which what is not linear is evaluated.
    """

    mechanism: Mechanism
    logged: tuple[str, ...]
    independent: tuple[str, ...]
    band: Band
    smoothing: float | str | None
    parts: tuple[Part, ...]
    point: Point

    @property
    def columns(self) -> Columns:
        """The unknowns."""
        return Columns.of(self.mechanism)

    @property
    def stacked(self) -> bool:
        """Whether multipliers have a time basis, so that parameters come from the paper's stack."""
        return bool(self.mechanism.closures) and self.mechanism.multipliers.basis != "free"

    @property
    def samples(self) -> int:
        """Of all logs."""
        return sum(part.samples for part in self.parts)

    @property
    def several(self) -> tuple[int, ...]:
        """Numbers of the logs that have more than one portion."""
        return tuple(i for i, part in enumerate(self.parts) if len(part.borders) > 2)

    def margin(self, part: Part) -> int:
        """Rows of the file beside a portion that it feels: by filter, splines, delays, memory."""
        clock, decided = part.survey.clock, part.decided
        reach = Decimator.of(self.band.cutoff, 1 / clock.step).half + FEWEST
        if decided is not None:
            reach += int(np.ceil((KNOTS * decided.knots + decided.ends) / clock.step))
        if self.stacked:
            reach += int(np.ceil(KNOTS * self.mechanism.multipliers.spacing / clock.step))
        if any(effect.memory for effect in self.mechanism.effects):
            reach += REMEMBERED
        if any(isinstance(effect, Correcting) for effect in self.mechanism.effects):
            reach += int(np.ceil(LATEST / clock.step))
        return int(np.ceil(reach * max(1.0, part.survey.log.rows / clock.count)))

    def portions(self, log: int | None = None) -> Iterator[Portion]:
        """All portions in order of log and time, or those of one log."""
        for i, part in enumerate(self.parts):
            if log not in (None, i):
                continue
            clock, borders = part.survey.clock, part.borders
            kept = Decimator.of(self.band.cutoff, 1 / clock.step).factor
            margin, rows = self.margin(part), part.survey.log.rows
            for k, (first, stop) in enumerate(pairwise(borders)):
                yield Portion(
                    log=i,
                    number=k,
                    begin=max(0, (first - margin) // kept * kept),  # one grid of rows for the log
                    end=min(rows, stop + margin),
                    since=part.survey.at(first) if first else -np.inf,
                    until=part.survey.at(stop) if stop < rows else np.inf,
                )

    def at(self, point: Point) -> Plan:
        """The plan at another working point."""
        return replace(self, point=point)
