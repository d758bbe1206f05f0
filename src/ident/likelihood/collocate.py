"""One run's rows, with the motion's coefficients beside the parameters.

torque    A x − F G B (c − ĉ) = b − F G B (c₀ − ĉ)        each over its σ; F: the rows' filter
motion             U (c − ĉ) = 0
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.equations.filter import Decimator
from ident.motion.spline import WIDTH, Spline
from ident.solve.basis import Basis
from ident.solve.chunk import Chunk


@dataclass(frozen=True, eq=False)
class Torques:
    """The rows of one run, at c₀, before they are weighed.

    With n rows of each of d independent coordinates, k unknowns and w functions in reach:

    Attributes:
        A: (n, d, k); b: (n, d); informed: (n, d).
        first: (n,) the first function in reach; L: (n, w, coordinates, d), F G B.
        t: (n,) [s].
    """

    A: np.ndarray
    b: np.ndarray
    informed: np.ndarray
    first: np.ndarray
    L: np.ndarray
    t: np.ndarray

    def informed_as(self, other: Torques) -> Torques:
        """The rows, of which those inform that do in `other`, if they are the same instants."""
        same = np.array_equal(self.t, other.t)
        return replace(self, informed=other.informed) if same else self


def reach(
    basis: Basis, t: np.ndarray, G: np.ndarray, decimator: Decimator, sample: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """F G B: (first (n,), L (n, w, coordinates, d)) of rows kept at some samples of a run.

    Args:
        basis: of the splines; t: (N,) the run's clock [s].
        G: (N, d, coordinates, 3).
        decimator: F; sample: (n,) kept, counted from the start of the run.
    """
    inside = np.clip(t, basis.t0, basis.t_end)
    first = basis.window(inside)[0]
    values = np.zeros((len(t), WIDTH, G.shape[2], G.shape[1]))
    for order in range(3):
        B = basis.window(inside, order)[1]
        values += B[:, :, None, None] * G[:, :, :, order].transpose(0, 2, 1)[:, None]
    half = decimator.half
    if decimator.taps is None:
        return first[sample], values[sample]
    span = 2 * half * (t[1] - t[0]) / basis.spacing
    width = min(WIDTH + 1 + int(np.ceil(span)), basis.count)
    low = np.minimum(first[sample - half], basis.count - width)
    L = np.zeros((len(sample), width, *values.shape[2:]))
    row = np.arange(len(sample))[:, None]
    for tap, h in enumerate(decimator.taps):
        at = sample - half + tap
        L[row, (first[at] - low)[:, None] + np.arange(WIDTH)] += h * values[at]
    return low, L


def weighed(torques: Torques, spline: Spline, c: np.ndarray, sigma: np.ndarray) -> list[Chunk]:
    """The run's rows divided by their noise, for `solve.eliminate`.

    Args:
        torques: the run's; spline: with ĉ and U.
        c: (count, coordinates) the coefficients c₀ at which the rows were made.
        sigma: (d,) noise of the torque rows.
    """
    w, d = torques.L.shape[1], torques.L.shape[3]
    off = c - spline.c
    known = np.einsum("nwid,nwi->nd", torques.L, off[torques.first[:, None] + np.arange(w)])
    chunks = []
    for u in range(d):
        told = torques.informed[:, u]
        chunks.append(
            Chunk(
                torques.first[told],
                -torques.L[told, :, :, u] / sigma[u],
                torques.A[told, u] / sigma[u],
                (torques.b - known)[told, u] / sigma[u],
            )
        )
    k, rows = torques.A.shape[2], len(spline.first)
    first, U = widened(spline.first, spline.U, w, spline.basis)
    return [*chunks, Chunk(first, U, np.zeros((rows, k)), np.zeros(rows))]


def widened(
    first: np.ndarray, U: np.ndarray, width: int, basis: Basis
) -> tuple[np.ndarray, np.ndarray]:
    """Rows with windows of WIDTH functions as rows with windows of `width`."""
    low = np.minimum(first, basis.count - width)
    wide = np.zeros((len(first), width, U.shape[2]))
    row = np.arange(len(first))[:, None]
    wide[row, (first - low)[:, None] + np.arange(WIDTH)] = U
    return low, wide


def joined(parts: Sequence[Torques]) -> Torques:
    """The rows of several stretches of one run."""
    names = Torques.__dataclass_fields__
    return Torques(**{n: np.concatenate([getattr(part, n) for part in parts]) for n in names})
