"""Pieces of HTML. Words that come in are escaped, whatever file they are from."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

from markupsafe import Markup, escape

CODE = re.compile(r"`([^`]*)`")
TIE = "\u00a0"
SHORT = 32  # characters of a cell that stays on one line
LONG = 30  # rows of a table, beyond which it is folded


def paragraph(words: str, kind: str = "") -> Markup:
    """Words, with what stands between backticks as code."""
    inside = Markup(CODE.sub(r"<code>\1</code>", str(escape(words))))
    return Markup('<p class="{}">{}</p>').format(kind, inside) if kind else _in("p", inside)


def strong(words: str) -> Markup:
    """A paragraph that is to be read first."""
    return _in("p", _in("strong", escape(words)))


def folded(title: str, *blocks: Markup) -> Markup:
    """Blocks under a title that opens them."""
    frame = Markup("<details><summary>{}</summary>{}</details>")
    return frame.format(title, Markup("\n").join(blocks)) if blocks else Markup("")


def code(words: str) -> Markup:
    """Words as they are, line by line."""
    return _in("pre", escape(words))


def headed(words: str) -> Markup:
    """A heading within a section."""
    return _in("h3", escape(words))


def items(words: Iterable[str]) -> Markup:
    """A list, with what stands between backticks as code."""
    inside = (CODE.sub(r"<code>\1</code>", str(escape(each))) for each in words)
    return _in("ul", Markup("".join(f"<li>{each}</li>" for each in inside)))


def definitions(pairs: Mapping[str, str]) -> Markup:
    """Words and what they stand for."""
    rows = (Markup("<dt>{}</dt><dd>{}</dd>").format(k, v) for k, v in pairs.items() if v)
    return _in("dl", Markup("").join(rows))


def table(rows: Sequence[Sequence[str]], caption: str, *, tied: bool = True) -> Markup:
    """A table whose first row is its head and whose first column names the rows.

    Args:
        rows: cells as words, the head first.
        caption: what it shows, for who comes upon it alone.
        tied: whether short cells stay on one line.
    """
    head, *body = rows
    cells = Markup("").join(Markup('<th scope="col">{}</th>').format(cell) for cell in head)
    lines = Markup("").join(_row(row, tied) for row in body)
    whole = Markup(
        '<div class="wide" tabindex="0" role="region" aria-label="{0}"><table><caption>{0}'
        "</caption><thead><tr>{1}</tr></thead><tbody>{2}</tbody></table></div>"
    ).format(caption, cells, lines)
    if len(body) <= LONG:
        return whole
    said = Markup("<details><summary>{}: {} rows</summary>{}</details>")
    return said.format(caption, len(body), whole)


def _row(row: Sequence[str], tied: bool) -> Markup:
    first, *rest = (_tied(cell) if tied else cell for cell in row)
    cells = Markup("").join(Markup("<td>{}</td>").format(cell) for cell in rest)
    return Markup('<tr><th scope="row">{}</th>{}</tr>').format(first, cells)


def _tied(cell: str) -> str:
    return cell.replace(" ", TIE) if len(cell) <= SHORT else cell


def _in(tag: str, inside: Markup) -> Markup:
    return Markup(f"<{tag}>{inside}</{tag}>")
