"""Cells of one block that come from several portions become one: the reduce of the map-reduce."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from ident.fit.accumulate import Cell
from ident.solve.factor import Factor
from ident.solve.stretch import Stretch

Key = tuple[int, int, int]  # log, block, coordinate


class Joined:
    """Portions' cells, absorbed in the order of portions, whatever the order in which they come.

    Memory stays that of one cell a block and coordinate, and of what came too early.

    Attributes:
        cells: by log, block and coordinate.
        stretches: by log, what portions have left of its stack, together.
        absorbed: portions, from the first, without gaps.
        worked: portions that were handed in.
    """

    def __init__(
        self,
        cells: Iterable[Cell] = (),
        absorbed: int = 0,
        stretches: Mapping[int, Stretch] | None = None,
    ) -> None:
        self.cells: dict[Key, Cell] = {key_of(cell): cell for cell in cells}
        self.stretches = dict(stretches or {})
        self.absorbed = absorbed
        self.worked = 0
        self._early: dict[int, tuple[tuple[Cell, ...], tuple[int, Stretch] | None]] = {}

    def add(
        self, number: int, cells: Iterable[Cell], stretch: tuple[int, Stretch] | None = None
    ) -> None:
        """Hands in the cells of a portion, none for one that failed; the first has number 0.

        `stretch` is that of a log, with its number.
        """
        self._early[number] = tuple(cells), stretch
        self.worked += 1
        while self.absorbed in self._early:
            mine, left = self._early.pop(self.absorbed)
            for cell in mine:
                key = key_of(cell)
                self.cells[key] = merged(self.cells[key], cell) if key in self.cells else cell
            if left is not None:
                log, stretched = left
                before = self.stretches.get(log)
                self.stretches[log] = stretched if before is None else before + stretched
            self.absorbed += 1

    def without(self, logs: Iterable[int]) -> list[Cell]:
        """All cells in order of log, block and coordinate, but for those of some logs."""
        out = set(logs)
        return [self.cells[key] for key in sorted(self.cells) if key[0] not in out]


def key_of(cell: Cell) -> Key:
    """What a cell is of."""
    return cell.experiment, cell.block, cell.coordinate


def joined(cells: Iterable[Cell]) -> list[Cell]:
    """Cells, one for each log, block and coordinate."""
    whole = Joined()
    whole.add(0, cells)
    return whole.without(())


def merged(a: Cell, b: Cell) -> Cell:
    """The cell of the rows of both, of one block and coordinate."""
    span = min(a.span[0], b.span[0]), max(a.span[1], b.span[1])
    factor, rest = _both(a.factor, b.factor), _both(a.rest, b.rest)
    return Cell(*key_of(a), factor, rest, a.support, a.tau + b.tau, span)


def _both(a: Factor, b: Factor) -> Factor:
    if not (a.rows and b.rows):
        return a if a.rows else b
    return a + b
