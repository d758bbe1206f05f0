"""Numbers, lists of names and tables as text."""

from __future__ import annotations

import math
import re
import shutil
import sys
import textwrap
from collections.abc import Iterable, Sequence
from functools import partial
from itertools import chain

WIDTH = 100  # shown: characters of a line, where no terminal is narrower
NARROW = 40  # shown: of a terminal, in which nothing is set narrower
MUCH = 10.0  # shown: relative error above which its size says nothing more
NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?![\w.])")
LARGE = 1e6  # shown: below, a number with an error is written without an exponent


def rounded(value: float, stderr: float | None) -> str:
    """Return a value with the digits that its standard error justifies: `0.2003 ± 0.0004`."""
    if stderr is None:
        return significant(value, 5)
    if not math.isfinite(stderr):
        return f"{significant(value, 5)} ± ?"
    if stderr == 0:
        return f"{value:.9g}"
    digits = math.floor(math.log10(abs(value) / stderr)) + 2 if value else 2
    texts = f"{value:.{min(max(digits, 2), 12)}g}", f"{stderr:.2g}"
    small = abs(value) < LARGE  # hundreds and thousands as they are read, not as 1e+02
    return " ± ".join(f"{float(text):.0f}" if small and "e+" in text else text for text in texts)


def significant(x: float, digits: int = 3) -> str:
    """Return a number with some digits, below a million without an exponent.

    >>> significant(60412.0), significant(0.0567, 2), significant(2.5e6)
    ('60400', '0.057', '2.5e+06')
    """
    text = f"{float(f'{x:.{digits}g}'):g}"
    return f"{float(text):.0f}" if "e+" in text and abs(x) < LARGE else text


two_digits = partial(significant, digits=2)


def table(rows: Sequence[Sequence[str]], indent: str = "  ") -> list[str]:
    """Return rows of cells as lines, the first column aligned left and the others right."""
    width = [max(map(len, column)) for column in zip(*rows, strict=True)]
    form = "  ".join(f"{{:{'>' if i else '<'}{w}}}" for i, w in enumerate(width))
    return [indent + form.format(*row).rstrip() for row in rows]


def stamp(t: float) -> str:
    """Return a time [s] with six digits, or to 10 ms where it counts from 1970 or a boot."""
    return f"{t:.6g}" if abs(t) < 1e5 else f"{t:.2f}"


def width() -> int:
    """Return the characters of a line: 100, or those of a narrower terminal."""
    if not sys.stdout.isatty():
        return WIDTH
    return max(NARROW, min(WIDTH, shutil.get_terminal_size((WIDTH, 0)).columns))


def wrapped(text: str, indent: str = "") -> list[str]:
    """Return lines of at most `width` characters, all but the first indented."""
    return textwrap.wrap(
        text, width(), subsequent_indent=indent, break_on_hyphens=False, break_long_words=False
    )


def lines_of(text: str) -> int:
    """Return how many lines a text takes in a terminal, which breaks those that are too long."""
    return sum(max(1, -(-len(line) // width())) for line in text.splitlines())


def listed(names: Iterable[str], word: str = "and") -> str:
    """Return names as an enumeration.

    >>> listed(["a", "b", "c"])
    'a, b and c'
    """
    *first, last = list(names) or ["none"]
    return f"{', '.join(first)} {word} {last}" if first else last


def shortlist(names: Sequence[str], most: int = 4) -> str:
    """Return the first few names and the number of the others.

    >>> shortlist(["a", "b", "c"], 2)
    'a, b and 1 more'
    """
    if len(names) <= most:
        return listed(names)
    return f"{', '.join(names[:most])} and {len(names) - most} more"


def places(names: Iterable[str]) -> str:
    """Return names as an enumeration, three or more with numbers in a row as a range.

    >>> places(["b1", "a4", "a3", "a5", "b2"])
    'a3 to a5, b1 and b2'
    """
    parts = [(name, re.fullmatch(r"(.*?)(\d*)", name)) for name in names]
    if all(part and part[2] for _, part in parts):
        parts.sort(key=lambda p: (p[1][1], int(p[1][2])) if p[1] else ("", 0))
    runs: list[list[str]] = []
    for name, part in parts:
        before = part and part[2] and f"{part[1]}{int(part[2]) - 1}"
        if not runs or before != runs[-1][-1]:
            runs.append([])
        runs[-1].append(name)
    ranges = [[f"{run[0]} to {run[-1]}"] if len(run) > 2 else run for run in runs]
    return listed(chain.from_iterable(ranges))


def percent(relative: float | None) -> str:
    """Return a relative error in percent, or a dash where nothing was measured."""
    if relative is None:
        return "–"
    return "over 1000 %" if relative > MUCH else f"{significant(100 * relative)} %"


def shortened(name: str, most: int = 72) -> str:
    """Return a sum of names cut to `most` characters, with the number of terms left out."""
    if len(name) <= most:
        return name
    cut = max(name.rfind(" + ", 0, most), name.rfind(" - ", 0, most))
    if cut < 0:
        return f"{name[: most - 1]}…"
    rest = name[cut:].count(" + ") + name[cut:].count(" - ")
    return f"{name[:cut]} + … ({rest} more)"


def merged(lines: Iterable[str]) -> list[str]:
    """Join lines that differ in the name at their beginning only; after a name with a colon, also
    those that differ in numbers, which become ranges.

    >>> merged(["a.csv: 9 samples are left out", "b.csv: 12 samples are left out", "x"])
    ['a.csv … b.csv (2): 9 to 12 samples are left out', 'x']
    >>> merged(["yaw may turn on and on", "wrist may turn on and on"])
    ['yaw … wrist (2) may turn on and on']
    """
    kinds: dict[str, list[tuple[str, str]]] = {}
    for line in dict.fromkeys(lines):
        name, space, rest = line.partition(" ")
        form = NUMBER.sub("#", rest) if name.endswith(":") else rest
        named = space and not name[:1].isdigit()
        kinds.setdefault(form if named else line, []).append((name, space + rest))
    lines_merged = []
    for kind in kinds.values():
        names = list(dict.fromkeys(name for name, _ in kind))
        numbers = zip(*(NUMBER.findall(text) for _, text in kind), strict=True)
        columns = [sorted(column, key=float) for column in numbers]
        ranges = [f"{c[0]} to {c[-1]}" if c[0] != c[-1] else c[0] for c in columns]
        pieces = zip(NUMBER.split(kind[0][1]), [*ranges, ""], strict=True)
        text = "".join(chain.from_iterable(pieces))
        of, colon = names[0], ""
        if len(names) > 1:
            of, colon = of.removesuffix(":"), ":" * of.endswith(":")
            of += f" … {names[-1].removesuffix(':')} ({len(names)})"
        lines_merged.append(f"{of}{colon}{text}")
    return lines_merged
