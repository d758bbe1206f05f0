"""Eliminating the multipliers against dense least squares, and what a sample costs.

python benchmarks/elimination.py [--repeat 5] [--samples 2000 20000 200000] [--no-dense]

One BLAS thread. First the paper's own system (sect. 3.2): the stack of robots/slider_crank and
its log, 2001 samples of 4 rows, 3 parameters, 3 multipliers on hats of 5 ms: 8004 x 1206. Then
systems of the same shape with smooth columns, larger and larger.
"""

import os

os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"

import argparse
import time
import tracemalloc
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy.linalg
from scipy.linalg import lapack

import ident
from ident.equations.corrections import Scene
from ident.equations.multipliers import full_rows
from ident.equations.unknowns import Columns
from ident.information.band import Elimination, eliminate
from ident.information.base import rank_revealing, solve
from ident.information.reduction import Chunk
from ident.information.splines import Basis

ROBOTS = Path(__file__).resolve().parent.parent / "robots"


class System:
    def __init__(self, samples: int, n: int = 4, k: int = 3, m: int = 3, degree: int = 1) -> None:
        rng = np.random.default_rng(0)
        t = np.arange(samples) * 1e-3  # s
        self.basis = Basis.spanning(0.0, t[-1], 0.005, degree)
        self.first, self.values = self.basis.window(t)
        wave = 2 * np.pi * t[:, None, None]
        self.J_T = np.cos(rng.uniform(0, 6, (n, m)) + wave * rng.uniform(0.5, 3, (n, m)))
        self.A = np.sin(rng.uniform(0, 6, (n, k)) + wave * rng.uniform(0.5, 9, (n, k)))
        lam = np.sin(wave[:, 0] * rng.uniform(0.5, 2, m))
        noise = 0.01 * rng.standard_normal((samples, n))
        self.b = self.A @ np.ones(k) + (self.J_T @ lam[..., None])[..., 0] + noise

    def chunks(self, size: int = 5000) -> Iterator[Chunk]:
        for start in range(0, len(self.b), size):
            part = slice(start, start + size)
            parts = (x[part] for x in (self.first, self.values, self.J_T, self.A, self.b))
            yield Chunk.of_samples(*parts)

    def eliminated(self) -> tuple[np.ndarray, np.ndarray, Elimination]:
        elimination = eliminate(self.chunks(), self.basis.count)
        border = elimination.border
        x = solve(border, rank_revealing(border)).x
        return x, elimination.back_substitute(x), elimination

    def dense(self) -> tuple[np.ndarray, np.ndarray]:
        samples, n, m = self.J_T.shape
        L = np.zeros((samples, n, self.basis.count, m))
        for r in range(self.values.shape[1]):
            L[np.arange(samples), :, self.first + r] = self.values[:, r, None, None] * self.J_T
        rows = samples * n
        return np.hstack([self.A.reshape(rows, -1), L.reshape(rows, -1)]), self.b.reshape(rows)


def paper() -> System:
    """The stack of the paper's slider-crank in place of made-up columns."""
    mechanism = ident.load(ROBOTS / "slider_crank")
    mechanism = replace(mechanism, multipliers=ident.Multipliers("linear", 0.005))
    motion = ident.complete(mechanism, ROBOTS / "slider_crank" / "run.csv")
    (e,) = motion.experiments
    system = System(len(e))
    every = slice(0, len(e))
    scene = Scene.of(mechanism, Columns.of(mechanism), e)
    system.A, system.b, _ = full_rows(scene, every)
    system.J_T = mechanism.kinematics.closure_rows(e.q).rate.transpose(0, 2, 1)
    return system


def best(run: Callable[[], object], repeat: int) -> float:
    seconds = []
    for _ in range(repeat):
        start = time.process_time()
        run()
        seconds.append(time.process_time() - start)
    return min(seconds)


def against_dense(repeat: int) -> None:
    system = paper()
    x, a, _ = system.eliminated()
    own = best(system.eliminated, 4 * repeat)
    M, b = system.dense()
    M = np.asfortranarray(M)
    solvers: dict[str, Callable[[], np.ndarray]] = {
        "LAPACK dgels (QR)": lambda: lapack.dgels(M, b, lwork=64 * M.shape[1])[1][: M.shape[1]],
        "scipy lstsq (SVD)": lambda: scipy.linalg.lstsq(M, b)[0],
    }
    print(f"{M.shape[0]} x {M.shape[1]}: eliminated in {own * 1e3:.2f} ms")
    print(f"{'':20}{'seconds':>9}{'ratio':>8}{'difference of p':>17}{'of lambda':>11}")
    for name, run in solvers.items():
        y = run()
        seconds = best(run, 1 + repeat // 3)
        p, lam = y[: len(x)], y[len(x) :]
        apart = [np.abs(p - x).max() / np.abs(p).max()]
        apart.append(np.abs(lam - a.ravel()).max() / np.abs(lam).max())
        print(f"{name:20}{seconds:9.3f}{seconds / own:8.0f}{apart[0]:17.1e}{apart[1]:11.1e}")


def cost(samples: int, repeat: int, **shape: int) -> None:
    system = System(samples, **shape)
    seconds = best(system.eliminated, max(1, repeat if samples < 50_000 else 2))
    tracemalloc.start()
    system.eliminated()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    _, n, m = system.J_T.shape
    print(
        f"{samples:8d}{n:5d}{system.A.shape[2]:4d}{m:4d}{system.basis.degree:8d}"
        f"{seconds * 1e3:11.1f}{seconds / samples * 1e6:11.2f}"
        f"{peak / 1e6:10.1f}{peak / samples:12.0f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--samples", type=int, nargs="+", default=[2000, 20_000, 200_000])
    parser.add_argument("--no-dense", action="store_true")
    arguments = parser.parse_args()
    if not arguments.no_dense:
        against_dense(arguments.repeat)
    print("\n samples rows   k   m  degree         ms  us/sample   peak MB  B/sample")
    for samples in arguments.samples:
        cost(samples, arguments.repeat)
    cost(20_000, arguments.repeat, degree=3)
    cost(20_000, arguments.repeat, degree=5)
    cost(20_000, arguments.repeat, n=7, k=60, m=3)


if __name__ == "__main__":
    main()
