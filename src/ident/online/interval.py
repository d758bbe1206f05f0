"""The factors of some time, which can grow old and merge with those that come after.

An old equation counts less, by the weight exp(−age/T) on its square; its factor shrinks with

    R → exp(−Δt/2T) R,   d → exp(−Δt/2T) d,   ρ → exp(−Δt/2T) ρ

and what counts is Σ exp(−age/T) equations. Source: L. Ljung, System Identification, 2nd ed., sect.
11.2; on triangles as Björck (solve.factor).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.equations.rows import Rows
from ident.solve.factor import Factor


@dataclass(frozen=True, eq=False)
class Interval:
    """The factors of some time.

    Attributes:
        span: (first t, last t) [s] of its rows; at: to which time the weights refer [s].
        factors, rest: of the d coordinates, of the rows that inform and of those that do not.
        weights: (2, d) Σ exp(−age/T) of the rows in both.
        tau: (d,) weighted sum of squares of the measured torques.
    """

    span: tuple[float, float]
    at: float
    factors: tuple[Factor, ...]
    rest: tuple[Factor, ...]
    weights: np.ndarray
    tau: np.ndarray

    @classmethod
    def empty(cls, supports: Sequence[np.ndarray], t: float) -> Interval:
        """No rows yet, from the time t [s] on."""
        none, d = tuple(Factor.empty(len(support)) for support in supports), len(supports)
        return cls((t, t), t, none, none, np.zeros((2, d)), np.zeros(d))

    def updated(self, rows: Rows, supports: Sequence[np.ndarray], T: float | None) -> Interval:
        """With further rows, which come later.

        Args:
            rows: of the d coordinates.
            supports: for each coordinate the unknowns that can appear in its rows.
            T: time constant of forgetting [s]; None: all rows count alike.
        """
        told, at = rows.informed, float(rows.t[-1])
        age = np.zeros(len(rows.t)) if T is None else (at - rows.t) / T
        share, w = np.exp(-age), np.exp(-age / 2)
        old = self.aged(at, T)
        factors, rest = list(old.factors), list(old.rest)
        for u, support in enumerate(supports):
            A, b = rows.A[:, u, support] * w[:, None], rows.b[:, u] * w
            for which, inside in ((factors, told[:, u]), (rest, ~told[:, u])):
                if inside.all():
                    which[u] = which[u].updated(A, b)
                elif inside.any():
                    which[u] = which[u].updated(A[inside], b[inside])
        weights = old.weights + np.stack([share @ told, share @ ~told])
        tau = old.tau + share @ rows.tau**2
        return Interval((old.span[0], at), at, tuple(factors), tuple(rest), weights, tau)

    def aged(self, to: float, T: float | None) -> Interval:
        """The same with weights that refer to a later time [s]."""
        if T is None or to == self.at:
            return replace(self, at=to)
        share = np.exp((self.at - to) / T)
        w = float(np.sqrt(share))
        return Interval(
            self.span,
            to,
            tuple(factor.scaled(w) for factor in self.factors),
            tuple(factor.scaled(w) for factor in self.rest),
            share * self.weights,
            share * self.tau,
        )

    def merged(self, later: Interval, T: float | None) -> Interval:
        """Both together."""
        mine = self.aged(later.at, T)
        return Interval(
            (self.span[0], later.span[1]),
            later.at,
            tuple(a + b for a, b in zip(mine.factors, later.factors, strict=True)),
            tuple(a + b if a.rows else b for a, b in zip(mine.rest, later.rest, strict=True)),
            mine.weights + later.weights,
            mine.tau + later.tau,
        )
