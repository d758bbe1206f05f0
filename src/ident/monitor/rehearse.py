"""The stated rate, checked: clean intervals drawn again in blocks, hour after hour.

The supermartingale of `charts` holds if scores scatter like a normal distribution of variance φ² I,
one interval from the next. Blocks of a clean log keep its tails and its correlation; where the
charts alarm more often on them than stated, φ² is raised until they do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.monitor.charts import Charts, Design, Statistics
from ident.monitor.clean import Clean
from ident.monitor.interval import Interval

STREAMS, BLOCKS = 20, 8  # rehearsed beside each other; blocks that a clean log has, at least
OFTEN = 20.0  # alarms that a rehearsal would have at the stated rate, at a lowered threshold
STEPS = 2000  # intervals of each stream
WIDER, MOST = 1.15, 12  # factor of φ² a step, and steps


@dataclass(frozen=True, eq=False)
class Rehearsal:
    """What the charts did on clean intervals, at a threshold so low that alarms can be counted.

    Attributes:
        design: of the charts; raised: factor by which φ² had to be raised.
        alarms: counted; stated: that the theory allows in as many intervals.
    """

    design: Design
    raised: float
    alarms: int
    stated: float

    def __str__(self) -> str:
        return (
            f"on normal running drawn again {self.alarms} alarms where {self.stated:g} were allowed"
        )


def rehearsed(
    clean: Clean, mask: np.ndarray, intervals: Sequence[Interval], x: np.ndarray, seed: int = 0
) -> Rehearsal:
    """Charts that hold their rate on a clean log's own intervals.

    Args:
        clean: normal running; mask: (k,) columns with a chart.
        intervals: of the clean log; x: (k,) the reference.
        seed: of the blocks drawn.
    """
    seen = Statistics.of(intervals, x)
    order = _drawn(len(intervals), np.random.default_rng(seed))
    threshold, raised = float(np.log(STEPS * STREAMS / OFTEN)), 1.0
    for _ in range(MOST):
        design = Design.of(clean.wider(raised), mask)
        alarms = _alarms(design, design.evidence(seen), order, threshold)
        if alarms <= OFTEN:
            break
        raised *= WIDER
    return Rehearsal(design, raised, alarms, OFTEN)


def _drawn(n: int, random: np.random.Generator) -> np.ndarray:
    """(steps, streams) intervals in blocks, drawn with replacement."""
    length = n // BLOCKS
    first = random.integers(0, n - length + 1, (-(-STEPS // length), 1, STREAMS))
    return (first + np.arange(length)[:, None]).reshape(-1, STREAMS)[:STEPS]


def _alarms(design: Design, evidence: np.ndarray, order: np.ndarray, threshold: float) -> int:
    charts = Charts.fresh(evidence.shape[1], (order.shape[1],))
    found = 0
    for at in order:
        charts.update(evidence[at])
        over = charts.height(design.weight) > threshold
        found += int(over.sum())
        charts.restart(over)
    return found
