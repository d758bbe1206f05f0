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
from ident.solve.reflect import reflect, release

Index = NDArray[np.intp]


class Blocks(NamedTuple):
    """Rows X a + Y [p; -1] = 0 of some intervals, ascending; a is the two knots' coefficients."""

    interval: Index  # (n,)
    X: Array  # (n, c, c), c = 2 group m
    Y: Array  # (n, c, k + 1), the last column is the right-hand side


class Free(NamedTuple):
    """Rows that touch no multiplier any more, of some intervals or knots, ascending."""

    place: Index  # (n,)
    Y: Array  # (n, r, k + 1)


def compress(chunk: Chunk, group: int, tol: float) -> tuple[Blocks, list[Free]]:
    """Reduce a chunk's rows to blocks; an interval with many rows has several of them.

    Rows that weigh multipliers less than `tol` are free.
    """
    width, m = chunk.L.shape[1:]
    interval = chunk.first // group
    slot, owner, height = _pack(interval, 2 * group * m)
    X = np.zeros((len(owner) * height, 2 * group, m))
    if group == 1:
        X[slot, :width] = chunk.L
    else:
        X[slot[:, None], (chunk.first % group)[:, None] + np.arange(width)] = chunk.L
    Y = np.zeros((len(owner) * height, chunk.A.shape[1] + 1))
    Y[slot, :-1] = chunk.A
    Y[slot, -1] = chunk.b
    return _reduce(owner, X, Y, height, tol)


def unite(blocks: list[Blocks], intervals: int, tol: float) -> tuple[Array, Array, list[Free]]:
    """One block an interval: X (intervals + 2, c, c), Y (intervals + 2, c, k + 1).

    An interval without rows is zero; so are the two that are added, one at either end: with them
    every knot is an inner one. Intervals of several blocks (chunks met in them, or their rows were
    many) are reduced further, which frees rows.
    """
    owner, X, Y = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
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
            flat_X, flat_Y = (np.zeros((len(owner) * height, part.shape[-1])) for part in (X, Y))
            flat_X[slot], flat_Y[slot] = X.reshape(-1, c), Y.reshape(-1, Y.shape[-1])
            (owner, X, Y), free = _reduce(owner, flat_X, flat_Y, height, tol)
            freed += free
    return whole_X, whole_Y, freed


def _pack(interval: Index, c: int) -> tuple[Index, Index, int]:
    """Where rows go in blocks of equal height that hold rows of one interval each.

    Returns slot (rows,) in the stacked blocks, owner (blocks,) the blocks' interval, ascending, and
    the height. It is bounded by the mean number of rows, so that one crowded interval does not pad
    all the others: memory stays linear in rows.
    """
    order = np.argsort(interval, kind="stable")
    owner, start, rows = np.unique(interval[order], return_index=True, return_counts=True)
    height = min(max(int(rows.max()), c), max(4 * c, 2 * int(rows.mean())))
    blocks = -(-rows // height)
    within = np.arange(len(interval)) - np.repeat(start, rows)
    slot = np.empty_like(order)
    slot[order] = np.repeat((np.cumsum(blocks) - blocks) * height, rows) + within
    return slot, np.repeat(owner, blocks), height


def _reduce(owner: Index, X: Array, Y: Array, height: int, tol: float) -> tuple[Blocks, list[Free]]:
    R, Y = reflect(X.reshape(len(owner), height, -1), Y.reshape(len(owner), height, -1))
    c = R.shape[-1]
    own = Y[:, :c].copy()
    released, rows = release(R, own, tol)
    return Blocks(owner, R, own), [Free(owner, Y[:, c:]), Free(owner[released], rows)]
