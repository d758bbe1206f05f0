"""The whole way from CSV to files: what each step costs, and how much of it is not arithmetic.

python benchmarks/whole_way.py [10000 100000]

A serial arm of seven joints with viscous and Coulomb friction at these numbers of samples, and
robots/slider_crank with its log. Steps: `read_log`, `complete`, `identify`, and `write` with its
report. Processor time of one thread, BLAS on one thread, the best of REPEAT.

`kernels` is what a step spends inside of Γ and Γ π (Pinocchio or NumPy at once), LAPACK, compiled
CasADi and the filter's matrix products: one more run in which each of their calls is timed. The
rest is Python, NumPy's own passes over arrays (copies, sums, other products) and allocation: `not
arithmetic` is its share of the step, an upper bound, since what NumPy computes by itself counts as
none.
"""

import os

os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"

import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from unittest import mock

import arm7
import numpy as np
import pinocchio as pin

import ident
from ident.equations import filter as filtering
from ident.equations import table as tables
from ident.equations import thinning
from ident.information.lapack import lapack
from ident.mechanism import batched
from ident.mechanism.kinematics import Mapped

SIZES = (10_000, 100_000)
ROBOTS = Path(__file__).resolve().parent.parent / "robots"
STEPS = ("read", "complete", "identify", "write")
REPEAT = 3


def table(sizes: tuple[int, ...] = SIZES, crank: bool = True) -> list[dict[str, object]]:
    """One row a case and step: µs a sample in all, in kernels, and the share that is neither."""
    found = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "arm7.urdf").write_text(arm7.urdf())
        arm = ident.load(folder / "arm7.urdf").with_effect("viscous").with_effect("coulomb")
        for samples in sizes:
            path = folder / f"{samples}.csv"
            arm7.log(arm, samples, 0.01).write(path)
            found += _case(f"arm, {samples} samples", arm, path, folder / "out")
        if crank:
            robot = ROBOTS / "slider_crank"
            found += _case("slider-crank", ident.load(robot), robot / "run.csv", folder / "out")
    return found


def _case(
    name: str, mechanism: ident.Mechanism, path: Path, out: Path
) -> Iterator[dict[str, object]]:
    runs = [_run(mechanism, path, out, lambda: 0.0) for _ in range(REPEAT)]
    samples = runs[0][0]
    seconds = np.min([spent for _, spent, _ in runs], axis=0)
    with kernels() as inside:
        _, _, arithmetic = _run(mechanism, path, out, inside)
    for step, whole, part in zip(STEPS, 1e6 * seconds / samples, arithmetic, strict=True):
        us = 1e6 * part / samples
        share = max(0.0, 1 - us / whole)
        yield {"case": name, "step": step, "us": whole, "kernels": us, "not arithmetic": share}


def _run(
    mechanism: ident.Mechanism, path: Path, out: Path, inside: Callable[[], float]
) -> tuple[int, list[float], list[float]]:
    """Samples, seconds of each step, and seconds of `inside` in each."""
    marks = [(time.process_time(), inside())]

    def mark() -> None:
        marks.append((time.process_time(), inside()))

    log = ident.read_log(path, mechanism.columns)
    mark()
    motion = ident.complete(mechanism, log)
    mark()
    fit = ident.identify(mechanism, motion)
    mark()
    fit.write(out)
    mark()
    spent, arithmetic = np.diff(marks, axis=0).T
    return len(log.t), list(spent), list(arithmetic)


@contextmanager
def kernels() -> Iterator[Callable[[], float]]:
    """While it lasts, a function that says how many seconds have been spent in kernels."""
    spent, empty, depth = 0.0, 0.0, 0

    def timed(function: Callable) -> Callable:
        def call(*arguments: object, **options: object) -> object:
            nonlocal spent, depth
            depth += 1
            start = time.process_time()
            try:
                return function(*arguments, **options)
            finally:
                depth -= 1
                spent += time.process_time() - start - empty if depth == 0 else 0.0

        return call

    def compiled(self: Mapped, *arguments: object) -> None:
        made(self, *arguments)
        self._run = timed(self._run)

    for _ in range(2000):  # what timing nothing takes
        timed(int)()
    spent, empty = 0.0, spent / 2000
    made = Mapped.__init__
    with ExitStack() as stack:
        for module, names in (
            (pin, ("computeJointTorqueRegressor", "rnea")),
            (batched, ("regressor", "rigid_forces")),
            *((module, ("multiplied",)) for module in (filtering, thinning, tables)),
            (lapack, ("dtpqrt", "dtrtrs", "dtrtri", "dgeqrf")),
            (np.linalg, ("qr", "svd", "solve", "pinv", "eigh", "eigvalsh", "lstsq")),
        ):
            for name in names:
                wrapped = timed(getattr(module, name))
                stack.enter_context(mock.patch.object(module, name, wrapped))
        stack.enter_context(mock.patch.object(Mapped, "__init__", compiled))
        yield lambda: spent


def main() -> None:
    print(f"{'':24}{'':10}{'µs/sample':>12}{'kernels':>10}{'not arithmetic':>17}")
    for row in table(tuple(map(int, sys.argv[1:])) or SIZES):
        print(
            f"{row['case']:24}{row['step']:10}{row['us']:12.2f}{row['kernels']:10.2f}"
            f"{100 * float(row['not arithmetic']):15.0f} %"
        )


if __name__ == "__main__":
    main()
