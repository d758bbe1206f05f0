"""`excite` against the best of many random motions of the same family, limits and duration.

python benchmarks/excitation.py [--random 1000] [--logs 20] [--robots arm five_bar]

First what the rows say: log-determinant and condition number of the base parameters' information.
Then what identification finds: each motion is simulated with white noise on torques and positions
and identified, `--logs` times; errors are against the URDF, which made the logs.
"""

import os

os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"

import argparse
import time
from pathlib import Path

import numpy as np

import ident
from ident import Excitation, Limits, Mechanism, Noise
from ident.excite.design import DesignProblem

ROBOTS = Path(__file__).resolve().parent.parent / "robots"
DURATION, PERIODS, RATE, HARMONICS, SEED = 30.0, 3, 100.0, 5, 0
ENCODER = 2e-5  # rad


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--random", type=int, default=1000)
    parser.add_argument("--logs", type=int, default=20)
    parser.add_argument("--robots", nargs="*", default=["arm", "five_bar"])
    given = parser.parse_args()
    for name in given.robots:
        compared(ident.load(ROBOTS / name), given.random, given.logs)


def compared(mechanism: Mechanism, count: int, logs: int) -> None:
    began = time.perf_counter()
    problem = DesignProblem(mechanism, Limits(), DURATION / PERIODS, HARMONICS, {}, SEED)
    names = (f"best log det of {count}", f"best condition of {count}")
    tried = dict(zip(names, best_of(problem, count), strict=True))
    drawing = time.perf_counter() - began
    found, *others = (
        ident.excite(
            mechanism, duration=DURATION, periods=PERIODS, rate=RATE, harmonics=HARMONICS,
            balance=balance, seed=SEED,
        )
        for balance in (0.5, 0.0, 2.0)
    )  # fmt: skip
    climbing = time.perf_counter() - began - drawing
    print(
        f"\n{mechanism.name}: {count} random motions in {drawing:.0f} s, `excite` {climbing:.0f} s"
    )
    print("| motion | log det | condition | expected ± | found ± | error |")
    print("|---|---|---|---|---|---|")
    tried |= {f"`excite --balance {w}`": x for w, x in zip((0, 2), others, strict=True)}
    tried["`excite`"] = found
    measured = {name: identified(mechanism, x, logs) for name, x in tried.items()}
    for name, x in tried.items():
        expected = ratio([b.stderr for b in x.base], [b.stderr for b in found.base])
        stderr, error = (
            ratio(a, b) for a, b in zip(measured[name], measured["`excite`"], strict=True)
        )
        print(
            f"| {name} | {x.log_det:.1f} | {x.condition_number:.2f} | {expected:.2f} "
            f"| {stderr:.2f} | {error:.2f} |"
        )
    print("± and error: of the base parameters, geometric mean, those of `excite` = 1")


def best_of(problem: DesignProblem, count: int) -> tuple[Excitation, Excitation]:
    """The random motions with the largest log-determinant and the smallest condition number."""
    random = np.random.default_rng(SEED + 1000)
    criterion = problem.criterion(None, 0.0)
    by_det: tuple[float, np.ndarray] | None = None
    by_condition: tuple[float, np.ndarray] | None = None
    for _ in range(count):
        if (candidate := problem.draw(random, criterion)) is None:
            continue
        W = problem.W(candidate.rows)
        condition = float(np.linalg.cond(W / np.linalg.norm(W, axis=0)))
        if by_det is None or by_det[0] < candidate.J:
            by_det = candidate.J, candidate.x
        if by_condition is None or condition < by_condition[0]:
            by_condition = condition, candidate.x
    assert by_det is not None
    assert by_condition is not None
    a, b = (
        problem.excitation(x, DURATION, PERIODS, RATE, None, SEED)
        for _, x in (by_det, by_condition)
    )
    return a, b


def identified(mechanism: Mechanism, x: Excitation, logs: int) -> tuple[np.ndarray, np.ndarray]:
    """Root mean squares over logs of the base parameters' standard errors and true errors."""
    noise = [Noise("q", ENCODER), *(Noise(f"tau.{j}", s) for j, s in x.noise.items())]
    names = [b.name for b in x.base]
    true = np.array([b.prior for b in x.base])
    found = []
    for seed in range(logs):
        log, _ = ident.simulate(mechanism, x.log, noise=noise, columns=("q", "tau"), seed=seed)
        fit = ident.identify(mechanism, ident.complete(mechanism, log))
        values = [fit[name] for name in names]
        found.append([[v.stderr, v.value - t] for v, t in zip(values, true, strict=True)])
    stderr, error = np.sqrt(np.mean(np.square(np.array(found, dtype=float)), axis=0)).T
    return stderr, error


def ratio(a: object, b: object) -> float:
    return float(np.exp(np.mean(np.log(np.asarray(a, dtype=float) / np.asarray(b, dtype=float)))))


if __name__ == "__main__":
    main()
