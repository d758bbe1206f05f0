"""Old names of `ident.fit.problem`, until all callers have moved."""

from ident.fit.problem import FEWEST, LENGTH, MOST, block_edges, coordinates, information_of
from ident.fit.problem import blocks_of as block_cells
from ident.fit.problem import split_rows as split
from ident.information.blocks import Block as Cell

__all__ = ["FEWEST", "LENGTH", "MOST", "Cell", "accumulate", "block_cells", "block_edges"]
__all__ += ["coordinates", "split"]


def accumulate(mechanism, columns, motion, progress=None, point=None):  # type: ignore[no-untyped-def]
    """Return the blocks of all experiments."""
    return list(information_of(mechanism, columns, motion, point, progress))
