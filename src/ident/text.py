"""Numbers and tables as text."""

from __future__ import annotations

import numpy as np


def rounded(value: float, stderr: float | None) -> str:
    """Return a value with the digits that its standard error justifies: `0.2003 ± 0.0004`."""
    if stderr is None:
        return f"{value:.5g}"
    if not np.isfinite(stderr):
        return f"{value:.5g} ± ?"
    if stderr == 0:
        return f"{value:.9g}"
    digits = int(np.floor(np.log10(abs(value) / stderr))) + 2 if value else 2
    return f"{value:.{int(np.clip(digits, 2, 12))}g} ± {stderr:.2g}"


def table(rows: list[list[str]], indent: str = "  ") -> list[str]:
    """Return rows of cells as lines, the first column aligned left and the others right."""
    width = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        indent
        + "  ".join(
            cell.rjust(w) if i else cell.ljust(w)
            for i, (cell, w) in enumerate(zip(row, width, strict=True))
        ).rstrip()
        for row in rows
    ]


def percent(relative: float | None) -> str:
    """Return a relative error in percent, or a dash where nothing was measured."""
    return "–" if relative is None else f"{100 * relative:.3g} %"


def shortened(name: str, most: int = 72) -> str:
    """Return a sum of names cut to `most` characters, with the number of terms left out."""
    if len(name) <= most:
        return name
    cut = max(name.rfind(" + ", 0, most), name.rfind(" - ", 0, most))
    rest = name[cut:].count(" + ") + name[cut:].count(" - ")
    return f"{name[:cut]} + … ({rest} more)"
