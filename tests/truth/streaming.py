"""Logs taken apart into what a stream is given."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ident import Log
from ident.equations.rows import Rows, Scene, in_motion, informing, largest_transmission

FIELDS = ("t", "sample", "A", "b", "tau", "informed")


def samples(log: Log) -> Iterator[dict[str, float]]:
    """One mapping a sample."""
    names = ["t", *log.columns]
    for row in np.stack([log.t, *log.columns.values()], axis=1).tolist():
        yield dict(zip(names, row, strict=True))


def blocks(log: Log, sizes: list[int]) -> Iterator[dict[str, np.ndarray]]:
    """Mappings of arrays, of these sizes over and over."""
    start, number = 0, 0
    while start < len(log.t):
        stop = start + sizes[number % len(sizes)]
        yield {"t": log.t[start:stop], **{k: x[start:stop] for k, x in log.columns.items()}}
        start, number = stop, number + 1


def given(log: Log, how: str) -> list:
    """The log `one by one`, in `blocks` or `whole`."""
    if how == "one by one":
        return list(samples(log))
    return list(blocks(log, [7, 1, 64, 300])) if how == "blocks" else [log]


HOW = ["one by one", "blocks", "whole"]


def together(parts: list[Rows]) -> Rows:
    """Rows one after the other."""
    return Rows.concatenated(parts)


def raw_rows(scene: Scene, part: slice, farthest: np.ndarray | None = None) -> Rows:
    """The rows of some samples, unfiltered; `farthest` is `largest_transmission` of the state."""
    s, found = scene.samples.reduced(part), scene.terms(part)
    farthest = largest_transmission(scene.e) if farthest is None else farthest
    informed = informing(s, farthest)
    moving = informed & in_motion(s, farthest)
    sample = np.arange(part.start, part.stop)
    rest = np.zeros(informed.shape)
    return Rows(scene.e.t[part], sample, found.A, found.b, found.tau, informed, moving, rest)
