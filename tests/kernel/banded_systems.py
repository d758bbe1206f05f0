"""Systems that several tests of the solver share, and their dense forms."""

import numpy as np

from ident.information.time_bases import Basis, Chunk


def chunk_of(first, values, J_T, A, b):
    """The rows of N samples: L = Jᵀ B(t) (paper, eq. 7)."""
    N, n, m = J_T.shape
    L = np.einsum("tw,tim->tiwm", values, J_T).reshape(N * n, values.shape[1], m)
    return Chunk(np.repeat(first, n), L, A.reshape(N * n, A.shape[2]), b.reshape(-1))


class System:
    """Smooth random columns: N samples of n rows, m multipliers, k parameters, noisy right side."""

    def __init__(self, N=301, n=4, m=3, k=3, degree=1, spacing=0.05, t_end=3.0, seed=0):
        rng = np.random.default_rng(seed)
        self.t = np.linspace(0, t_end, N)
        wave = 2 * np.pi * self.t[:, None, None]
        self.basis = Basis.spanning(0, t_end, spacing, degree)
        self.first, self.values = self.basis.window(self.t)
        self.J_T = np.cos(rng.uniform(0, 6, (n, m)) + wave * rng.uniform(0.1, 0.4, (n, m)))
        self.A = np.sin(rng.uniform(0, 6, (n, k)) + wave * rng.uniform(0.1, 0.9, (n, k)))
        self.b = rng.standard_normal((N, n))

    def chunks(self, size=10**9):
        for start in range(0, len(self.t), size):
            part = slice(start, start + size)
            yield chunk_of(
                self.first[part], self.values[part], self.J_T[part], self.A[part], self.b[part]
            )

    def window_matrix(self):
        B = np.zeros((len(self.t), self.basis.count))
        np.put_along_axis(
            B, self.first[:, None] + np.arange(self.values.shape[1]), self.values, axis=1
        )
        return B

    def dense(self):
        L = np.einsum("tj,tim->tijm", self.window_matrix(), self.J_T)
        rows = self.b.size
        return np.hstack([self.A.reshape(rows, -1), L.reshape(rows, -1)]), self.b.reshape(-1)

    def dense_solution(self):
        M, b = self.dense()
        x, *_ = np.linalg.lstsq(M, b)
        k = self.A.shape[2]
        return x[:k], x[k:].reshape(self.basis.count, self.J_T.shape[2]), np.linalg.norm(M @ x - b)


def relative(found, expected):
    return np.abs(np.asarray(found) - expected).max() / np.abs(expected).max()
