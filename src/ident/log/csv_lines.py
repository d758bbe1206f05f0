"""Where the lines of a CSV text begin, which are blank, and how many cells each has."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ident.errors import LogError

NEWLINE, RETURN, QUOTE = 10, 13, 34
QUOTED = re.compile(rb'"[^"]*"')
Places = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Lines:
    """The lines of a text, split where `bytes.splitlines` splits.

    Attributes:
        text: of the lines.
        start, stop: (n,) where each begins, and ends without its line break.
        cells: (n,) separators in it, and one; quotes are not looked at.
        filled: (m,) which lines hold more than blanks.
    """

    text: bytes
    start: Places
    stop: Places
    cells: Places
    filled: Places

    @classmethod
    def of(cls, text: bytes, separator: bytes) -> Lines:
        """The lines of a text whose cells are parted by one byte."""
        data = np.frombuffer(text, dtype=np.uint8)
        ends = np.flatnonzero(data == NEWLINE)
        width = np.zeros(len(ends), dtype=np.int64)  # of a carriage return before the newline
        if b"\r" in text:
            returns = np.flatnonzero(data == RETURN)
            before = data[np.minimum(returns + 1, len(data) - 1)] == NEWLINE
            alone = returns[~before | (returns == len(data) - 1)]
            width = (data[np.maximum(ends - 1, 0)] == RETURN).astype(np.int64)
            order = np.argsort(np.concatenate([ends, alone]), kind="stable")
            width = np.concatenate([width, np.zeros(len(alone), dtype=np.int64)])[order]
            ends = np.concatenate([ends, alone])[order]
        if len(data) and (not len(ends) or ends[-1] < len(data) - 1):
            ends, width = np.append(ends, len(data)), np.append(width, 0)
        start = np.concatenate([[0], ends[:-1] + 1]) if len(ends) else ends
        stop = ends - width
        parts = np.flatnonzero(data == separator[0])
        cells = np.diff(np.searchsorted(parts, np.append(start, len(data)))) + 1
        blank = [i for i in np.flatnonzero(cells == 1) if not text[start[i] : stop[i]].strip(b" ")]
        filled = np.delete(np.arange(len(start)), blank)
        return cls(text, start.astype(np.int64), stop, cells, filled)

    def __len__(self) -> int:
        return len(self.start)

    def __getitem__(self, i: int) -> bytes:
        return self.text[self.start[i] : self.stop[i]]

    @property
    def rows(self) -> bytes:
        """The filled lines alone, parted by newlines."""
        if len(self.filled) < len(self):
            return b"\n".join([self[i] for i in self.filled])
        if b"\r" in self.text:
            return self.text.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        return self.text

    def refuse_ragged(
        self, separator: bytes, width: int, file: str, before: int, last: bool
    ) -> None:
        """Raise LogError at the first line without `width` cells: readers fill it up in silence.

        Args:
            separator: of the cells.
            width: cells of every line.
            file: what messages call it.
            before: lines of the file before this text.
            last: whether the file ends with this text.
        """
        doubtful = self.cells[self.filled] != width
        if b'"' in self.text:
            quotes = np.flatnonzero(np.frombuffer(self.text, dtype=np.uint8) == QUOTE)
            doubtful[np.isin(self.filled, np.searchsorted(self.start, quotes, "right") - 1)] = True
        for i in self.filled[doubtful]:
            line = self[i]
            if line.count(b'"') % 2:
                raise LogError(
                    f"{file}: line {before + i + 1}: a quote is opened and not closed; close it"
                )
            cells = QUOTED.sub(b"", line).count(separator) + 1
            if cells != width:
                cut = " (the last line, cut off while it was written? delete it)"
                ended = last and i == self.filled[-1] and cells < width
                raise LogError(
                    f"{file}: line {before + i + 1} has {cells} cells, the header has {width}"
                    f"{cut if ended else ''}; every row needs as many cells as the header"
                )
