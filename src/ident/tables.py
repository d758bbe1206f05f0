"""Numbers and tables as words."""

from __future__ import annotations

import numpy as np


def rounded(value: float, stderr: float | None) -> str:
    """A value with the digits that its standard error justifies: `0.2003 ± 0.0004`."""
    if stderr is None:
        return f"{value:.5g}"
    if not np.isfinite(stderr):
        return f"{value:.5g} ± ?"
    if stderr == 0:
        return f"{value:.9g}"
    digits = int(np.floor(np.log10(abs(value) / stderr))) + 2 if value else 2
    return f"{value:.{int(np.clip(digits, 2, 12))}g} ± {stderr:.2g}"


def table(rows: list[list[str]], indent: str = "  ") -> list[str]:
    """Columns of text, the first aligned left and the others right."""
    if not rows:
        return []
    width = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return [
        indent
        + "  ".join(
            cell.ljust(width[i]) if i == 0 else cell.rjust(width[i]) for i, cell in enumerate(row)
        ).rstrip()
        for row in rows
    ]


def percent(relative: float | None) -> str:
    """A relative error, or a dash where nothing was measured."""
    return "–" if relative is None else f"{100 * relative:.3g} %"


def shortened(name: str, most: int = 72) -> str:
    """A long combination with its tail counted."""
    if len(name) <= most:
        return name
    cut = max(name.rfind(" + ", 0, most), name.rfind(" - ", 0, most))
    rest = name[cut:].count(" + ") + name[cut:].count(" - ")
    return f"{name[:cut]} + … ({rest} more)"
