"""Rows of the stack [A | L] [p; a] = b (paper, eq. 8), each touching a short window of L."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ident.errors import FitError
from ident.solve.factor import Array


@dataclass(frozen=True, eq=False)
class Chunk:
    """Some rows, in any order: A p + sum_w L[:, w] a[first + w] = b.

    first: (r,) the first basis function that a row touches.
    L: (r, width, m) its entries for basis functions first .. first + width - 1, m multipliers each.
        width is the basis' degree + 1, or more where rows were filtered in time.
    A: (r, k), b: (r,).
    """

    first: NDArray[np.intp]
    L: Array
    A: Array
    b: Array

    def __post_init__(self) -> None:
        r = len(self.first)
        shapes = self.L.shape, self.A.shape, self.b.shape
        if [len(shape) for shape in shapes] != [3, 2, 1] or {shape[0] for shape in shapes} != {r}:
            raise FitError(f"L, A, b {shapes}; valid: ({r}, width, m), ({r}, k), ({r},)")
        if not np.isfinite([self.L.sum(), self.A.sum(), self.b.sum()]).all():
            raise FitError("an equation has a number that is not finite; valid: finite ones only")

    @classmethod
    def of_samples(
        cls, first: NDArray[np.intp], values: Array, J_T: Array, A: Array, b: Array
    ) -> Chunk:
        """The rows of N samples: L = J^T B(t) (paper, eq. 7).

        first (N,), values (N, width): the basis at the samples' times, `Basis.window`.
        J_T (N, n, m): transposed constraint Jacobians; A (N, n, k), b (N, n).
        """
        (N, n, m), width, k = J_T.shape, values.shape[1], A.shape[2]
        L = np.tile(J_T.reshape(N * n, m), width)
        L *= values.repeat(n, axis=0).repeat(m, axis=1)
        return cls(
            first=np.repeat(first, n),
            L=L.reshape(N * n, width, m),
            A=A.reshape(N * n, k),
            b=b.reshape(N * n),
        )

    @property
    def shape(self) -> tuple[int, int, int]:
        """Width, m, k."""
        return self.L.shape[1], self.L.shape[2], self.A.shape[1]
