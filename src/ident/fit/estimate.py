"""Old names of `ident.information.estimate`."""

from collections.abc import Iterable

from ident.information.blocks import Block, Information
from ident.information.estimate import CLEAR, FLOOR, ITERATIONS, TOLERANCE, Estimate, estimate
from ident.information.estimate import term_sizes as sizes
from ident.information.triangle import Triangle

__all__ = [
    "CLEAR", "FLOOR", "ITERATIONS", "TOLERANCE", "Estimate", "estimate", "sizes", "totals"
]  # fmt: skip


def totals(cells: Iterable[Block], k: int, d: int) -> list[Triangle]:
    """Return one triangle a coordinate over all given blocks, on all k columns."""
    return list(Information.of(cells, k, d).totals)
