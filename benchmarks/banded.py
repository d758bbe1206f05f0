"""The paper's system by orthogonal transformations, against its banded normal equations.

python benchmarks/banded.py

The matrix of robots/slider_crank and its log (sect. 3.2 of the paper): 2001 samples of 4 rows, 3
parameters, 3 multipliers in hat functions of 5 ms, 8004 × 1206 in all. The peer forms the banded
part of MᵀM, its dense border and its right side in vectorised NumPy, factors the band by LAPACK
(`cholesky_banded`) and the border by its Schur complement: as fast as this can be written, with the
squared condition number. It knows this problem (hat functions, samples at every knot, full rank);
`eliminate` does not. One BLAS thread, processor time, the best of REPEAT, both in turn.
"""

import os

os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

import ident
from ident.equations.rows import Scene, full_rows
from ident.equations.unknowns import Columns
from ident.information.estimate import rank_revealing, solve
from ident.information.linear import Array, Index, Triangle
from ident.information.time_bases import Basis, Chunk, eliminate

REPEAT = 200
CRANK = Path(__file__).resolve().parent.parent / "robots" / "slider_crank"


@dataclass(frozen=True, eq=False)
class System:
    """A p + Jᵀ λ = b with λ in hat functions.

    Attributes:
        basis: the hat functions; first (N,), values (N, 2): those that differ from zero.
        J_T: (N, n, m); A: (N, n, k); b: (N, n).
    """

    basis: Basis
    first: Index
    values: Array
    J_T: Array
    A: Array
    b: Array

    def eliminated(self) -> tuple[Array, Array]:
        """Return parameters (k,) and coefficients (count, m) by orthogonal transformations."""
        (N, n, m), width, k = self.J_T.shape, self.values.shape[1], self.A.shape[2]
        L = np.tile(self.J_T.reshape(N * n, m), width)  # Jᵀ B(t)
        L *= self.values.repeat(n, axis=0).repeat(m, axis=1)
        rows = L.reshape(N * n, width, m), self.A.reshape(N * n, k), self.b.reshape(N * n)
        elimination = eliminate([Chunk(np.repeat(self.first, n), *rows)], self.basis.count)
        border = Triangle.merge(elimination.factors)
        x = solve(border, rank_revealing(border)).x
        return x, elimination.back_substitute(x)


def paper() -> System:
    """Return the system of the paper's slider-crank."""
    mechanism = replace(ident.load(CRANK), multipliers=ident.Multipliers("linear", 0.005))
    (e,) = ident.complete(mechanism, CRANK / "run.csv").experiments
    A, b, _ = full_rows(Scene.of(mechanism, Columns.of(mechanism), e), slice(0, len(e)))
    basis = Basis.spanning(0.0, (len(e) - 1) * 1e-3, 0.005, 1)
    first, values = basis.window(np.arange(len(e)) * 1e-3)
    J_T = mechanism.kinematics.closure_rows(e.q).rate.transpose(0, 2, 1)
    return System(basis, first, values, J_T, A, b)


def normal_equations(system: System) -> tuple[Array, Array]:
    """Return parameters (k,) and coefficients (count, m) by banded normal equations."""
    J_T, A, b, count = system.J_T, system.A, system.b, system.basis.count
    (N, n, m), k = J_T.shape, A.shape[2]
    rows = np.empty((N, n, m + k + 1))
    rows[..., :m], rows[..., m:-1], rows[..., -1] = J_T, A, b
    P = J_T.transpose(0, 2, 1) @ rows  # (N, m, m + k + 1): J Jᵀ, J A, J b
    begins = np.flatnonzero(np.diff(system.first, prepend=-1))
    low, high = system.values.T
    weights = np.stack([low**2, low * high, high**2], axis=1)
    G, C = P[..., :m].reshape(N, 1, -1), P[..., m:].reshape(N, 1, -1)
    G = np.add.reduceat(weights[..., None] * G, begins).reshape(-1, 3, m, m)
    C = np.add.reduceat(system.values[..., None] * C, begins).reshape(-1, 2, m, k + 1)

    at = system.first[begins]
    own, next_, border = (np.zeros((count, m, size)) for size in (m, m, k + 1))
    own[at], next_[at], border[at] = G[:, 0], G[:, 1], C[:, 0]
    own[at + 1] += G[:, 2]
    border[at + 1] += C[:, 1]
    band = np.zeros((2 * m, count, m))  # LAPACK's: by distance below the diagonal, and column
    for j in range(m):
        band[: m - j, :, j] = own[:, j:, j].T
        band[m - j : 2 * m - j, :, j] = next_[:, j].T
    factor = cholesky_banded(
        band.reshape(2 * m, -1), lower=True, check_finite=False, overwrite_ab=True
    )
    border = border.reshape(-1, k + 1)
    solved = cho_solve_banded((factor, True), border, check_finite=False)
    right = rows[..., m:].reshape(-1, k + 1)
    S = right.T @ right - border.T @ solved
    x = np.linalg.solve(S[:k, :k], S[:k, k])
    return x, (solved[:, k] - solved[:, :k] @ x).reshape(count, m)


def table() -> list[dict[str, object]]:
    """Return milliseconds of both, their ratio, and the largest relative differences of p and λ."""
    system = paper()
    (x, a), (y, c) = system.eliminated(), normal_equations(system)
    own, peer = [], []
    for _ in range(REPEAT):
        own.append(seconds(system.eliminated))
        peer.append(seconds(lambda: normal_equations(system)))
    apart = [float(np.abs(p - q).max() / np.abs(q).max()) for p, q in ((y, x), (c, a))]
    return [
        {"who": "orthogonal, eliminate", "ms": 1e3 * min(own), "ratio": min(own) / min(peer)},
        {
            "who": "banded normal equations",
            "ms": 1e3 * min(peer),
            "ratio": 1.0,
            "p, λ apart": apart,
        },
    ]


def seconds(run: Callable[[], object]) -> float:
    start = time.process_time()
    run()
    return time.process_time() - start


def main() -> None:
    own, peer = table()
    for row in (own, peer):
        print(f"{row['who']:26}{row['ms']:8.3f} ms{row['ratio']:8.2f}")
    print("largest relative difference of p and λ: {:.1e} {:.1e}".format(*peer["p, λ apart"]))


if __name__ == "__main__":
    main()
