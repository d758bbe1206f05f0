"""Time bases for the multipliers: lambda_i(t) = sum_j b_j(t) a_ij on equally spaced knots.

Degree 1 are the hat functions of the paper (eq. 4-5): a_ij is lambda_i at knot j. Degrees 3 and 5
are uniform B-splines (C. de Boor, A Practical Guide to Splines, 1978, ch. IX-X). Their ends are
open simply because functions reach over them: no knot is repeated, all intervals are alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ident.errors import FitError
from ident.information.triangle import Array

_CACHED = 4  # windows
_SHORT = 20000  # times of which windows are cached
_ROUND = 1e-9  # of a spacing: times this far outside the span are rounding, not extrapolation


@dataclass(frozen=True)
class Basis:
    """`count` uniform B-splines of `degree` on the span [t0, t0 + (count - degree) spacing].

    degree: 0 constant, 1 hat functions, 3 cubic, 5 quintic: any number >= 0.
    t0: [s] where the span begins; spacing: [s] between knots; count: number of functions.
    Function j is nonzero from t0 + (j - degree) spacing over degree + 1 spacings.
    """

    degree: int
    t0: float
    spacing: float
    count: int

    def __post_init__(self) -> None:
        if self.degree < 0 or self.count <= self.degree:
            raise FitError(
                f"{self.count} functions of degree {self.degree}; "
                "valid: degree 0 or more, and more functions than the degree"
            )
        if not (np.isfinite(self.t0) and np.isfinite(self.spacing) and self.spacing > 0):
            raise FitError(f"knots from {self.t0} s every {self.spacing} s; valid: spacing > 0")

    @classmethod
    def spanning(cls, t_start: float, t_end: float, spacing: float, degree: int = 1) -> Basis:
        """Knots every `spacing` [s] from `t_start`; the last one is at `t_end` or just past it."""
        if not (spacing > 0 and t_end > t_start):
            raise FitError(
                f"[{t_start}, {t_end}] s by {spacing} s; valid: end > start, spacing > 0"
            )
        intervals = max(1, int(np.ceil((t_end - t_start) / spacing - _ROUND)))
        return cls(degree, float(t_start), float(spacing), intervals + degree)

    @classmethod
    def with_count(cls, t_start: float, t_end: float, count: int, degree: int = 1) -> Basis:
        """Exactly `count` functions on [t_start, t_end] [s]; the spacing follows."""
        intervals = max(1, count - degree)  # too small a count is refused on construction
        return cls(degree, float(t_start), float(t_end - t_start) / intervals, count)

    @property
    def t_end(self) -> float:
        """Where the span ends [s]."""
        return self.t0 + (self.count - self.degree) * self.spacing

    def window(self, t: ArrayLike, order: int = 0) -> tuple[NDArray[np.intp], Array]:
        """The functions that are nonzero at times `t` (n,) [s], or their derivatives of an order.

        Returns first (n,) and values (n, degree + 1), b_{first + r}(t) = values[:, r], of sum 1
        (order 0) or 0.
        Raises `FitError` for a time outside the span.

        Channels share their times, and fits are iterated: the last windows are cached.
        """
        t = np.asarray(t, dtype=float)
        for known, at, window in self._last:
            if known == order and np.array_equal(at, t):
                return window
        window = self._window(t, order)
        if len(t) <= _SHORT:
            self._last.append((order, t, window))
            del self._last[:-_CACHED]
        return window

    @cached_property
    def _last(self) -> list[tuple[int, Array, tuple[NDArray[np.intp], Array]]]:
        return []

    def _window(self, t: Array, order: int) -> tuple[NDArray[np.intp], Array]:
        position = (t - self.t0) / self.spacing
        intervals = self.count - self.degree
        if not ((position >= -_ROUND) & (position <= intervals + _ROUND)).all():
            raise FitError(
                f"times from {np.min(t)} to {np.max(t)} s; valid: {self.t0} to {self.t_end} s"
            )
        first = np.clip(np.floor(position).astype(np.intp), 0, intervals - 1)
        u = (position - first)[:, None]
        # de Boor's recursion on unit knots: b_r^p = ((p-r+u) b_{r-1}^{p-1} + (1-u+r) b_r^{p-1}) / p
        values = np.ones((len(u), 1))
        for p in range(1, self.degree - order + 1):
            r, edge = np.arange(p), np.zeros((len(u), p + 1))
            edge[:, 1:] += (p - 1 - r + u) * values
            edge[:, :-1] += (1 - u + r) * values
            values = edge / p
        for _ in range(order):  # d/dt b_r^p = (b_{r-1}^{p-1} − b_r^{p-1}) / spacing
            values = np.diff(values, axis=1, prepend=0.0, append=0.0) / -self.spacing
        return first, values

    def evaluate(self, a: ArrayLike, t: ArrayLike) -> Array:
        """lambda(t) = B(t) a, (n, m), of coefficients a (count, m) at times t (n,) [s] (eq. 6)."""
        a = np.asarray(a, dtype=float)
        if a.ndim != 2 or len(a) != self.count:
            raise FitError(f"coefficients of shape {a.shape}; valid: ({self.count}, multipliers)")
        first, values = self.window(t)
        lam = np.zeros((len(first), a.shape[1]))
        for r in range(self.degree + 1):
            lam += values[:, [r]] * a[first + r]
        return lam
