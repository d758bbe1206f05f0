"""The intervals from which a change is named: those since its onset, which it decides itself."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.monitor.clean import Clean
from ident.monitor.interval import Interval
from ident.monitor.naming import Naming, named, onset
from ident.monitor.watched import Watched

EARLIER = 10  # intervals before the leading chart's onset in which it can have been
LATELY = 40  # intervals before the onset that tell how large errors have been of late


def since_onset(
    watched: Watched,
    held: Sequence[Interval],
    since: int,
    x: np.ndarray,
    clean: Clean,
    least: float,
    *,
    forgiving: bool,
) -> tuple[Naming, list[Interval]]:
    """The suspects, and the intervals since the onset that the best of them gives.

    Args:
        watched: with the suspects.
        held: intervals, the last one now; since: of them, since the leading chart's onset.
        x: (k,) the reference; clean: normal running.
        least: worth that a cause must have to be one.
        forgiving: whether errors that have been larger of late need no explanation.
    """

    def naming_from(start: int) -> Naming:
        window = held[start + 1 :] or held[start:]  # without the interval in which the onset was
        before = held[max(start - LATELY, 0) : start] if forgiving else []
        return named(watched, window, x, clean, least, before)

    start = max(len(held) - since, 0)
    naming = naming_from(start)
    if naming.best is not None:
        first = max(start - EARLIER, 0)
        start = first + onset(held[first:], x, naming.best)
        naming = naming_from(start)
    return naming, list(held[start:])
