"""Filtered rows of smooth series from a few of their samples.

Γ of a smooth motion is smooth; after the filter one sample in dozens remains, so Γ need not be made
at all of them. It is made at nodes, PERIOD to a period of the cut-off. The filter's taps h act on
the polynomials of degree 9 through the 2 · SIDE nodes about each sample, which is one sum over
nodes with weights w that are computed once:

    Σ_s h_s x(s)  ≈  Σ_s h_s Σ_i ℓ_i(s) x(n_i)  =  Σ_i w_i x(n_i)        w_i = Σ_s h_s ℓ_i(s)

ℓ_i: Lagrange's polynomials of the nodes n_i about s. A series that is no such polynomial (a line of
the motion far above the cut-off) would be folded into the rows; `agreeing_step` makes rows both
ways and halves the distance of the nodes until they agree.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ident.equations.filter import Decimator, Product, multiplied, products
from ident.information.linear import Array, Index

PERIOD = 16.0  # numerics: nodes a period of the cut-off
SIDE = 5  # numerics: nodes on either side of a sample that its polynomial goes through
NODES = 4096  # work: nodes at which series are made at once
WINDOW = 24  # work: rows that are made both ways, of a long run
FEWEST_ROWS = 8  # work: and of a short one
SHARE = 8  # work: of so many rows of a short run one is made both ways
LONG = 3.0  # work: times what these rows need that a run has at least; a shorter one has no need
WORST = 10.0  # numerics: times the agreement asked of all rows, that the worst may lack
SIGNIFICANT = 1e-9  # numerics: of the largest column: a smaller one has rounding alone
LITTLE = 1e-3  # numerics: of the fastest joint, below which a motion may differ by as much more

Make = Callable[[Index], Sequence[Array]]


@dataclass(frozen=True, eq=False)
class Thinning:
    """The nodes of a run of samples, and the weights with which they make its filtered rows."""

    decimator: Decimator
    step: int  # samples from one node to the next
    length: int  # samples of the run

    @cached_property
    def nodes(self) -> Index:
        """Samples of the run that are nodes: its first, every `step`-th, its last."""
        nodes = np.arange(0, self.length, self.step)
        if self.length - 1 - nodes[-1] < self.step // 2:
            nodes = nodes[:-1]
        return np.append(nodes, self.length - 1)

    def products(self, at: Index) -> list[Product]:
        """Return the products that make the rows at samples `at` (N,) of the run from its nodes."""
        if not len(at):
            return []
        weights = [self._weights(int(sample)) for sample in at]
        near = max(1, (len(weights[0][1]) * self.step) // max(int(at[-1] - at[0]) // len(at), 1))
        blocks = []
        for start in range(0, len(at), near):
            group = weights[start : start + near]
            first = min(low for low, _ in group)
            stop = max(low + len(w) for low, w in group)
            W = np.zeros((len(group), stop - first))
            for row, (low, w) in zip(W, group, strict=True):
                row[low - first : low - first + len(w)] = w
            blocks.append((slice(first, stop), W))
        return blocks

    def _weights(self, sample: int) -> tuple[int, Array]:
        """The first node and the weights w of the row at a sample."""
        number, phase = divmod(sample, self.step)
        low, w = _inner_weights(self.decimator, self.step, phase)
        first, last = number + low, number + low + len(w)
        if first >= 0 and last <= len(self.nodes) - 2:
            return first, w
        half = self.decimator.half
        return _weights(self.nodes, np.arange(sample - half, sample + half + 1), self.decimator)


class NodeSeries:
    """Series at the nodes of a run, made as its rows need them, and the rows that they make."""

    def __init__(self, thinning: Thinning, make: Make, start: int) -> None:
        self.thinning, self.make = thinning, make
        self.start = start  # the run's first sample
        self._made: list[Array] = []  # series at the nodes from `_first` on, up to `_stop`
        self._first = self._stop = 0

    def rows(self, sample: Index) -> list[Array]:
        """Return the filtered series (N, c) at samples (N,), which come in ascending order."""
        blocks = self.thinning.products(sample - self.start)
        first, last = blocks[0][0].start, max(nodes.stop for nodes, _ in blocks)
        while self._stop < last:
            nodes = self.thinning.nodes[self._stop : self._stop + NODES]
            new = self.make(self.start + nodes)
            rest = [x[max(first - self._first, 0) :] for x in self._made]
            both = zip(rest, new, strict=True)
            self._made = [np.concatenate(x) for x in both] if rest else [*new]
            self._first, self._stop = max(first, self._first), self._stop + len(nodes)
        first = self._first
        blocks = [(slice(s.start - first, s.stop - first), W) for s, W in blocks]
        return [multiplied(blocks, x) for x in self._made]


@lru_cache(8192)
def _inner_weights(decimator: Decimator, step: int, phase: int) -> tuple[int, Array]:
    """The first node, counted from that before the row, and weights, far from a run's ends."""
    half = decimator.half
    span_of_taps = half // step + SIDE + 2
    nodes = step * np.arange(-span_of_taps, span_of_taps + 1)
    low, w = _weights(nodes, np.arange(phase - half, phase + half + 1), decimator)
    return low - span_of_taps, w


def _weights(nodes: Index, samples: Index, decimator: Decimator) -> tuple[int, Array]:
    """The first node and the weights w of the filtered value of samples (taps,)."""
    cell = np.searchsorted(nodes, samples, side="right") - SIDE
    cell = np.clip(cell, 0, len(nodes) - 2 * SIDE)  # the first of the nodes of each sample
    low, size = int(cell[0]), int(cell[-1] - cell[0]) + 2 * SIDE
    about = nodes[cell[:, None] + np.arange(2 * SIDE)]
    off = (samples[:, None] - about).astype(float)
    w = np.zeros(size)
    for i in range(2 * SIDE):
        others = [j for j in range(2 * SIDE) if j != i]
        ell = (off[:, others] / (about[:, i : i + 1] - about[:, others])).prod(axis=1)
        w += np.bincount(cell - low + i, taps_of(decimator) * ell, size)
    return low, w


def interpolated(make: Callable[[Index], Array], run: slice, step: int) -> Array:
    """Return a smooth series (n, c) at all samples of a run, from those at nodes and at the ends;
    `make` gives it at some samples.
    """
    length, width = run.stop - run.start, 2 * SIDE
    nodes = np.arange(0, length, step)
    cells, first = len(nodes) - width + 1, (SIDE - 1) * step
    if step == 1 or cells < 1:
        return make(run.start + np.arange(length))
    stop = first + cells * step
    ends = np.concatenate([np.arange(first), np.arange(stop, length)])
    x = make(run.start + np.concatenate([nodes, ends]))
    about, off = np.arange(width) - (SIDE - 1), np.arange(step)[:, None] / step
    w = np.stack(
        [
            ((off - np.delete(about, i)) / (about[i] - np.delete(about, i))).prod(axis=1)
            for i in range(width)
        ]
    )  # (width, step)
    out = np.empty((x.shape[1], length))
    for series, of_nodes in zip(out, x[: len(nodes)].T.copy(), strict=True):
        series[first:stop] = (sliding_window_view(of_nodes, width) @ w).ravel()
    out[:, ends] = x[len(nodes) :].T
    return out.T


# --- rows of cubic splines -----------------------------------------------------------------------

SplineProduct = list[tuple[slice, Array]]  # points m, and weights (rows, m · 2) of some rows
TOGETHER = 16  # work: rows of splines that one product makes


def spline_products(
    decimator: Decimator, at: Index, length: int, step: int, spacing: float
) -> SplineProduct:
    """Return the products that make filtered rows at samples `at` (N,) of a run, from the spline
    through one sample in `step`: the filter on the polynomials between two of these,

        Σ_s h_s Σ_p c_ip u_s^p  =  Σ_i Σ_p (Σ_s h_s u_s^p) c_ip          samples s of interval i

    whose coefficients c are those of values and slopes at both ends (Hermite). `length`: samples of
    the run, `spacing` [s] apart.
    """
    last, taps, half = (length - 1) // step - 1, taps_of(decimator), decimator.half
    H = step * spacing
    # by values and slopes at the first and at the second end, of c in 1, u, u² and u³
    hermite = np.array([
        [1, 0, -3 / H**2, 2 / H**3], [0, 1, -2 / H, 1 / H**2],
        [0, 0, 3 / H**2, -2 / H**3], [0, 0, -1 / H, 1 / H**2],
    ])  # fmt: skip
    # by the row's place between two samples: weights (points, 2) and the first point
    inner = dict[int, tuple[int, Array]]()

    def weights(sample: int) -> tuple[int, Array]:
        samples = np.arange(sample - half, sample + half + 1)
        interval = np.clip(samples // step, 0, last)
        u, low = spacing * (samples - step * interval), int(interval[0])
        size = int(interval[-1]) - low + 1
        powers = [np.bincount(interval - low, taps * u**p, size) for p in range(4)]
        both, w = hermite @ powers, np.zeros((size + 1, 2))
        w[:-1] += both[:2].T
        w[1:] += both[2:].T
        return low, w

    def of(sample: int) -> tuple[int, Array]:
        if sample + half >= step * (last + 1):  # beyond the last of the points
            return weights(sample)
        number, place = divmod(sample - half, step)
        if place not in inner:
            inner[place] = weights(place + half)
        return number, inner[place][1]

    products: SplineProduct = []
    for start in range(0, len(at), TOGETHER):
        group = [of(int(sample)) for sample in at[start : start + TOGETHER]]
        first = min(low for low, _ in group)
        W = np.zeros((len(group), max(low + len(w) for low, w in group) - first, 2))
        for row, (low, w) in zip(W, group, strict=True):
            row[low - first : low - first + len(w)] = w
        products.append((slice(first, first + W.shape[1]), W.reshape(len(W), -1)))
    return products


def multiplied_splines(products: SplineProduct, terms: Array) -> Array:
    """Return the rows (N, c) of splines with values and slopes `terms` (points, 2, c)."""
    c = terms.shape[2]
    return np.concatenate([W @ terms[at].reshape(-1, c) for at, W in products])


def taps_of(decimator: Decimator) -> Array:
    """The taps of a filter that filters."""
    assert decimator.taps is not None
    return decimator.taps


def agreeing_step(
    decimator: Decimator,
    rate: float,
    cutoff: float,
    runs: Sequence[slice],
    quick: Callable[[Index | slice], Array],
    all_rows: Callable[[Index | slice], Array],
    tolerance: float,
) -> int:
    """Return the largest distance of nodes with which filtered rows are those of all samples.

    Args:
        decimator: the rows' filter at `cutoff` [Hz], of samples at `rate` [Hz].
        runs: samples without a gap.
        quick: series (n, c) of samples that are made at once, and show in all rows what `whole`,
            series (n, C) that are slow to make, would show; these are compared where `quick` are
            worst.
        tolerance: share of a column (rms) by which it may differ.
    """
    step = int(rate / (PERIOD * cutoff))
    longest = max(runs, key=lambda run: run.stop - run.start, default=slice(0, 0))
    length, half = longest.stop - longest.start, decimator.half
    window = (length - 2 * half) // (SHARE * decimator.factor)
    window = min(max(window, FEWEST_ROWS), WINDOW)
    if length < LONG * (2 * half + window * decimator.factor):
        return 1
    while step > 1 and (worst := _worst(decimator, step, runs, quick, tolerance)) is None:
        step //= 2
    if step <= 1 or worst is None:
        return 1
    # the same rows both ways, about the worst
    run, row = worst
    rows = np.arange(run.start + half, run.stop - half, decimator.factor)
    first = max(min(row - window // 2, len(rows) - window), 0)
    at = rows[first : first + window]
    inside = slice(
        max(run.start, int(at[0]) - half - 2 * SIDE * step),
        min(run.stop, int(at[-1]) + half + 2 * SIDE * step + 1),
    )
    x = all_rows(inside)
    right = multiplied(products(taps_of(decimator), at - inside.start), x)
    size = np.sqrt((right**2).mean(axis=0))
    good = size > SIGNIFICANT * size.max(initial=0.0)
    while step > 1:
        thinning = Thinning(decimator, step, inside.stop - inside.start)
        got = multiplied(thinning.products(at - inside.start), x[thinning.nodes])
        off = np.sqrt(((got - right) ** 2).mean(axis=0))
        if (off[good] <= tolerance * size[good]).all():
            return step
        step //= 2
    return 1


def _worst(
    decimator: Decimator,
    step: int,
    runs: Sequence[slice],
    quick: Callable[[Index | slice], Array],
    tolerance: float,
) -> tuple[slice, int] | None:
    """The run and the number of the row in which `quick` series differ most; None if too much."""
    squares, off_squares, count = 0.0, 0.0, 0
    largest: list[tuple[slice, Array]] = []
    for run in runs:
        n, half = run.stop - run.start, decimator.half
        at = np.arange(half, n - half, decimator.factor)
        thinning = Thinning(decimator, step, n)
        if not len(at):
            continue
        if len(thinning.nodes) < 4 * SIDE:
            return None
        offs = []
        for start in range(0, len(at), 512):
            subset = at[start : start + 512]
            base = max(int(subset[0]) - half, 0)
            x = quick(slice(run.start + base, run.start + int(subset[-1]) + half + 1))
            right = multiplied(products(taps_of(decimator), subset - base), x)
            blocks = thinning.products(subset)
            first, stop = blocks[0][0].start, max(nodes.stop for nodes, _ in blocks)
            x = quick(run.start + thinning.nodes[first:stop])
            blocks = [(slice(s.start - first, s.stop - first), W) for s, W in blocks]
            offs.append((multiplied(blocks, x) - right) ** 2)
            squares, count = squares + (right**2).sum(axis=0), count + len(subset)
        largest.append((run, np.concatenate(offs)))
        off_squares = off_squares + largest[-1][1].sum(axis=0)
    if not count:
        return None
    size = np.maximum(squares, np.finfo(float).tiny)
    size = np.maximum(size, LITTLE**2 * size.max())
    shares = [(run, np.sqrt((off / (size / count)).max(axis=1))) for run, off in largest]
    if np.sqrt((off_squares / size).max()) > tolerance:
        return None
    run, worst = max(shares, key=lambda share: share[1].max())
    return None if worst.max() > WORST * tolerance else (run, int(worst.argmax()))
