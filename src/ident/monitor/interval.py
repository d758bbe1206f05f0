"""Rows cut into intervals of time, each one triangle and a few sums: constant memory.

[A_u | b_u] / σ_u of all coordinates u  →  one triangular factor
score  s = Aᵀ(b − A x),  information  I_k = |A_k|²        of any x, from the triangle alone
squares  Σ r_u²,  Σ (G r)_j²                              of coordinates u and multipliers j
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields
from itertools import pairwise

import numpy as np

from ident.solve.factor import Factor

FEWEST = 0.5  # of the rows that an interval usually has; one with fewer is left out


@dataclass(frozen=True, eq=False)
class Piece:
    """Consecutive rows: n of them, d coordinates, k columns, m multipliers.

    Attributes:
        t: (n,) [s]; A: (n, d, k); b, tau: (n, d); informed: (n, d).
        G: (n, m, d), what residuals do to the multipliers.
    """

    t: np.ndarray
    A: np.ndarray
    b: np.ndarray
    tau: np.ndarray
    informed: np.ndarray
    G: np.ndarray

    def cut(self, part: slice) -> Piece:
        """Some of the rows."""
        return Piece(**{each.name: getattr(self, each.name)[part] for each in fields(self)})

    @classmethod
    def joined(cls, parts: Sequence[Piece]) -> Piece:
        """One after the other."""
        named = [each.name for each in fields(cls)]
        return cls(**{name: np.concatenate([getattr(p, name) for p in parts]) for name in named})


@dataclass(frozen=True, eq=False)
class Interval:
    """The rows of one interval of time that inform, weighted.

    Attributes:
        start, end: first and last row [s].
        factor: of [A | b] over all coordinates, each divided by its σ.
        squares, rows: (d + m,) sums of squares of the residual of each coordinate, over σ², and of
            what it does to each multiplier [N² | (N m)²]; and of how many rows.
        torque: sum of squares of the measured torques over σ².
    """

    start: float
    end: float
    factor: Factor
    squares: np.ndarray
    rows: np.ndarray
    torque: float

    @classmethod
    def of(cls, piece: Piece, sigma: np.ndarray, x: np.ndarray) -> Interval:
        """The interval of some rows; sigma (d,) weighs them, the residual is that of x (k,)."""
        weight = np.where(piece.informed, 1.0 / sigma, 0.0)
        told = piece.informed.ravel()
        A = (piece.A * weight[:, :, None]).reshape(-1, piece.A.shape[2])
        r = np.where(piece.informed, piece.b - piece.A @ x, 0.0)
        lifted = np.einsum("nmd,nd->nm", piece.G, r)
        whole = piece.informed.all(axis=1)
        squares = [((r * weight) ** 2).sum(axis=0), (lifted[whole] ** 2).sum(axis=0)]
        rows = [piece.informed.sum(axis=0), np.full(lifted.shape[1], whole.sum())]
        return cls(
            start=float(piece.t[0]),
            end=float(piece.t[-1]),
            factor=Factor.of(A[told], (piece.b * weight).ravel()[told]),
            squares=np.concatenate(squares),
            rows=np.concatenate(rows),
            torque=float(((piece.tau * weight) ** 2).sum()),
        )

    def score(self, x: np.ndarray) -> np.ndarray:
        """(k,) s at x."""
        return self.factor.gradient(x)

    @property
    def information(self) -> np.ndarray:
        """(k,) I."""
        return (self.factor.R**2).sum(axis=0)


@dataclass(eq=False)
class Cutter:
    """Cuts rows at multiples of `seconds`; holds the rows of the interval that is not over yet."""

    seconds: float
    at: int | None = None
    waiting: list[Piece] = field(default_factory=list)
    usual: int = 0

    def cut(self, piece: Piece) -> Iterator[Piece]:
        """The rows of every interval that these rows complete."""
        number = np.floor(piece.t / self.seconds).astype(int)
        edges = [0, *(np.flatnonzero(np.diff(number)) + 1), len(number)]
        for i, j in pairwise(edges):
            if j > i and number[i] != self.at:
                yield from self.flush()
                self.at = int(number[i])
            self.waiting += [piece.cut(slice(i, j))] if j > i else []

    def flush(self) -> Iterator[Piece]:
        """The rows held, if they are about as many as usual."""
        waiting, self.waiting = self.waiting, []
        count = sum(len(part.t) for part in waiting)
        self.usual = max(self.usual, count)
        if count and count >= FEWEST * self.usual:
            yield Piece.joined(waiting)
