"""Old names of `ident.fit.problem`, until all callers have moved."""

from ident.fit.problem import bands_of, stacks_information, time_blocks
from ident.fit.problem import equal_blocks as cells_of_blocks

__all__ = ["banded", "cells_of", "cells_of_blocks", "time_blocks"]


def banded(mechanism, columns, motion, progress=None, point=None):  # type: ignore[no-untyped-def]
    """Return the stacks of all runs of samples."""
    return bands_of(mechanism, columns, motion, point, progress)


def cells_of(bands, motion):  # type: ignore[no-untyped-def]
    """Return the blocks of stacks."""
    return list(stacks_information(bands, motion))
