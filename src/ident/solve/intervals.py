"""Rows gathered by knot interval, and all intervals reduced at once to one small block each.

Basis functions are grouped into knots of `group` functions, wide enough for a row to touch two
neighbouring knots only: the band becomes block-bidiagonal whatever the degree or the filter.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ident.solve.chunk import Chunk
from ident.solve.factor import Array
from ident.solve.reflect import reflect_rows, release

Index = NDArray[np.intp]


class Blocks(NamedTuple):
    """Rows X a + Y [p; -1] = 0 of some intervals, ascending, or of spans of several of them.

    a are the coefficients of the knots inside a span, then of the two at its ends.
    """

    interval: Index  # (n,)
    X: Array  # (n, c, c), c = (span + 1) group m
    Y: Array  # (n, c, k + 1), the last column is the right-hand side


class Free(NamedTuple):
    """Rows that touch no multiplier any more, of some intervals or knots, ascending."""

    place: Index  # (n,)
    Y: Array  # (n, r, k + 1)


def compress(chunk: Chunk, group: int, tol: float, span: int = 1) -> tuple[Blocks, list[Free]]:
    """Reduce a chunk's rows to blocks of `span` intervals; one with many rows has several of them.

    Rows that weigh multipliers less than `tol` are free.
    """
    width, m, k = chunk.shape
    c = (span + 1) * group * m
    number, place = np.divmod(chunk.first, group * span)
    slot, owner, height = _pack(number, c)
    rows = np.zeros((len(owner) * height, c + k + 1))
    if m:
        by_function = rows[:, :c].reshape(len(rows), -1, m)
        column = np.arange((span + 1) * group)  # the first knot's stand behind those inside
        column[: span * group] = (column[: span * group] - group) % (span * group)
        for i in range(width):
            by_function[slot, column[place + i]] = chunk.L[:, i]
    rows[slot, c:-1], rows[slot, -1] = chunk.A, chunk.b
    return _reduce(owner, rows.reshape(len(owner), height, -1), c, tol)


def unite(blocks: list[Blocks], intervals: int, tol: float) -> tuple[Array, Array, list[Free]]:
    """One block an interval: X (intervals + 2, c, c), Y (intervals + 2, c, k + 1).

    An interval without rows is zero; so are the two that are added, one at either end: with them
    every knot is an inner one. Intervals of several blocks (chunks met in them, or their rows were
    many) are reduced further, which frees rows.
    """
    owner, X, Y = (
        np.concatenate(parts) if len(parts) > 1 else parts[0] for parts in zip(*blocks, strict=True)
    )
    c = X.shape[-1]
    freed: list[Free] = []
    whole_X = np.zeros((intervals + 2, c, c))
    whole_Y = np.zeros((intervals + 2, c, Y.shape[-1]))
    while len(owner) and c:
        several = (np.bincount(owner) > 1)[owner]
        single = owner[~several] + 1
        whole_X[single], whole_Y[single] = X[~several], Y[~several]
        owner, X, Y = owner[several], X[several], Y[several]
        if len(owner):
            slot, owner, height = _pack(np.repeat(owner, c), c)
            rows = np.zeros((len(owner) * height, c + Y.shape[-1]))
            rows[slot, :c], rows[slot, c:] = X.reshape(-1, c), Y.reshape(-1, Y.shape[-1])
            rows = rows.reshape(len(owner), height, -1)
            (owner, X, Y), free = _reduce(owner, rows, c, tol)
            freed += free
    return whole_X, whole_Y, freed


def _pack(interval: Index, c: int) -> tuple[Index, Index, int]:
    """Where rows go in blocks of equal height that hold rows of one interval each.

    Returns slot (rows,) in the stacked blocks, owner (blocks,) the blocks' interval, ascending, and
    the height. It is bounded by the mean number of rows, so that one crowded interval does not pad
    all the others: memory stays linear in rows.
    """
    order = np.argsort(interval, kind="stable")
    ordered = interval[order]
    start = np.flatnonzero(np.diff(ordered, prepend=ordered[0] - 1))
    owner, rows = ordered[start], np.diff(start, append=len(ordered))
    height = min(max(int(rows.max()), c), max(4 * c, 2 * int(rows.mean())))
    blocks = -(-rows // height)
    within = np.arange(len(interval)) - np.repeat(start, rows)
    slot = np.empty_like(order)
    slot[order] = np.repeat((np.cumsum(blocks) - blocks) * height, rows) + within
    return slot, np.repeat(owner, blocks), height


def _reduce(owner: Index, rows: Array, c: int, tol: float) -> tuple[Blocks, list[Free]]:
    """Of stacks of rows (n, height, c + k + 1)."""
    R, Y = reflect_rows(rows, c)
    R, own = R.copy(), Y[:, :c].copy()  # the rest of the stack may go
    released, more = release(R, own, tol)
    return Blocks(owner, R, own), [Free(owner, Y[:, c:]), Free(owner[released], more)]
