"""From log to fit: time a sample and memory, as the number of samples grows.

    python benchmarks/pipeline.py [10000 100000 1000000]

A serial arm of seven joints, rigid bodies with viscous and Coulomb friction (84 unknowns), all rows
kept (no decimation). Every size runs in a process of its own, BLAS on one thread.
"""

import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

SIZES = (10_000, 100_000, 1_000_000)


def make(samples: int, path: str) -> None:
    import arm7

    arm7.log(arm7.mechanism(), samples, 0.01).write(path)


def one(samples: int, path: str) -> dict[str, float]:
    import time

    import arm7

    import ident

    model = arm7.mechanism()
    log = ident.read_log(path)
    times = {}
    for _ in range(2 if samples < 500_000 else 1):  # the first one also loads libraries
        start = time.process_time()
        motion = ident.complete(model, log, cutoff=None)
        middle = time.process_time()
        fit = ident.identify(model, motion)
        times = {"complete": middle - start, "identify": time.process_time() - middle}
    assert fit.rank == 57
    times["memory"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    return times


def main() -> None:
    sizes = [int(text) for text in sys.argv[1:]] or list(SIZES)
    print(f"{platform.machine()}, Python {platform.python_version()}, one BLAS thread")
    print(f"{'samples':>10} {'complete':>12} {'identify':>12} {'memory':>9}")
    print(f"{'':>10} {'µs/sample':>12} {'µs/sample':>12} {'GB':>9}")
    for samples in sizes:
        with tempfile.TemporaryDirectory() as folder:
            path = str(Path(folder) / "log.parquet")
            run("--make", str(samples), path)
            found = json.loads(run("--one", str(samples), path))
        print(
            f"{samples:>10} {1e6 * found['complete'] / samples:12.2f} "
            f"{1e6 * found['identify'] / samples:12.2f} {found['memory']:9.2f}"
        )


def run(*arguments: str) -> str:
    return subprocess.run(
        [sys.executable, __file__, *arguments],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    ).stdout


if __name__ == "__main__":
    if sys.argv[1:2] == ["--make"]:
        make(int(sys.argv[2]), sys.argv[3])
    elif sys.argv[1:2] == ["--one"]:
        print(json.dumps(one(int(sys.argv[2]), sys.argv[3])))
    else:
        main()
