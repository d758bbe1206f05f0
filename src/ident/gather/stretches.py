"""Which stretches of a long log stand for all of it, where something is decided or drawn."""

from __future__ import annotations

from ident.gather.survey import Survey

COUNT = 3  # stretches of a log
LONGEST = 16_384  # samples of one


def stretches(survey: Survey, samples: int = COUNT * LONGEST) -> list[tuple[int, int]]:
    """Rows (first, stop) of the middles of the thirds of a log; all of a short one.

    Not its ends, at which machines stand still.

    Args:
        survey: of the log.
        samples: how many in all.
    """
    rows = survey.log.rows
    if rows <= 1.5 * samples:
        return [(0, rows)]
    each = samples // COUNT
    first = [rows * (2 * k + 1) // (2 * COUNT) - each // 2 for k in range(COUNT)]
    return [(start, start + each) for start in first]
