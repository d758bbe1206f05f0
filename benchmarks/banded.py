"""The paper's system by orthogonal transformations, against its banded normal equations.

python benchmarks/banded.py

The slider-crank's 8004 × 1206 (see elimination.py), both from the same arrays of samples: A, b, Jᵀ
and the hat functions' values. The peer forms the banded part of MᵀM, its dense border and its right
side in vectorised NumPy, factors the band by LAPACK (`cholesky_banded`) and takes the border by its
Schur complement: as fast as this can be written, at the price of the squared condition number. It
knows this problem (hats, every knot with samples, full rank); `eliminate` does not.
One BLAS thread, processor time, the best of REPEAT, both in turn.
"""

import os

os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"

import time
from collections.abc import Callable

import elimination
import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from ident.information.triangle import Array

REPEAT = 200


def normal_equations(system: elimination.System) -> tuple[Array, Array]:
    """Parameters (k,) and coefficients (count, m) of a system on hat functions."""
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
    """Milliseconds of both, their ratio, and the largest relative differences of p and λ."""
    system = elimination.paper()
    (x, a, _), (y, c) = system.eliminated(), normal_equations(system)
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
