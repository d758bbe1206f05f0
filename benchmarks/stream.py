"""Logs larger than memory: time and memory of a streamed fit, as the number of samples grows.

    python benchmarks/stream.py [1000 10000 100000 1000000 10000000]

A serial arm of seven joints, rigid bodies with viscous and Coulomb friction (84 unknowns); t, q, v,
a and tau of a rich motion, 29 columns of Parquet, which are made piece by piece. Beside the
streamed fit stands the one in memory (`complete`, `identify`), as long as it fits. Every fit is a
process of its own, whose peak of resident memory is what the system says of it; one BLAS thread.
"""

import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SIZES = (1_000, 10_000, 100_000, 1_000_000, 10_000_000)
IN_MEMORY = 1_000_000  # samples up to which the fit in memory is made too
PART = 131_072  # samples that are made together
NOISE = 0.01  # of a torque's own standard deviation


def make(samples: int, path: str) -> None:
    """The log: exact inverse dynamics of Pinocchio, friction, and noise in the torques."""
    import arm7
    import numpy as np
    import pinocchio as pin
    import polars as pl

    model, rng = arm7.mechanism(), np.random.default_rng(0)
    w = 2 * np.pi * rng.uniform(0.1, 0.8, (7, 4, 1))
    phase = rng.uniform(0, 2 * np.pi, (7, 4, 1))
    data, size = model.model.createData(), 0.35
    noise = None
    with tempfile.TemporaryDirectory(dir=Path(path).parent) as folder:
        for number, first in enumerate(range(0, samples, PART)):
            t = np.arange(first, min(first + PART, samples)) / 1000.0
            q = size * np.sin(w * t + phase).sum(axis=1).T
            v = size * (w * np.cos(w * t + phase)).sum(axis=1).T
            a = size * (-(w**2) * np.sin(w * t + phase)).sum(axis=1).T
            tau = np.array(
                [pin.rnea(model.model, data, *each) for each in zip(q, v, a, strict=True)]
            )
            tau += 0.5 * v + 0.5 * np.sign(v)
            noise = NOISE * tau.std(axis=0) if noise is None else noise
            tau += noise * rng.normal(size=tau.shape)
            columns = {"t": t}
            for letter, x in (("q", q), ("v", v), ("a", a), ("tau", tau)):
                columns |= {f"{letter}.{n}": x[:, i] for i, n in enumerate(model.driven)}
            pl.DataFrame(columns).write_parquet(f"{folder}/{number:05d}.parquet")
        parts = pl.scan_parquet(f"{folder}/*.parquet")
        parts.sink_parquet(path, row_group_size=65_536, maintain_order=True)


def stream(path: str, jobs: int = 1) -> dict[str, float]:
    """One streamed fit, in this process."""
    import arm7

    import ident

    model = arm7.mechanism()
    wall, start = time.perf_counter(), time.process_time()
    found = ident.gather(model, path, cutoff=None, jobs=jobs)
    used = {"seconds": time.perf_counter() - wall, "cpu": time.process_time() - start}
    assert found.fit.rank == 57
    return used | _known(found.fit)


def in_memory(path: str) -> dict[str, float]:
    """The same fit of all samples at once."""
    import arm7

    import ident

    model = arm7.mechanism()
    wall, start = time.perf_counter(), time.process_time()
    motion = ident.complete(model, ident.read_log(path), cutoff=None)
    fit = ident.identify(model, motion, estimator="least-squares")
    used = {"seconds": time.perf_counter() - wall, "cpu": time.process_time() - start}
    return used | _known(fit)


def _known(fit) -> dict[str, float]:
    value = fit["coulomb.joint_4.Fc"]
    return {"rows": fit.rows, "value": value.value, "stderr": value.stderr,
            "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6}  # fmt: skip


def table(sizes=SIZES, most=IN_MEMORY, told=None) -> list[dict[str, object]]:
    """A row a size: time and peak memory [GB] of both ways; `told` is called with each."""
    rows = []
    with tempfile.TemporaryDirectory(dir=os.environ.get("IDENT_BENCHMARKS")) as folder:
        path = Path(folder) / "log.parquet"
        for samples in sizes:
            run("--make", str(samples), str(path))
            found = json.loads(run("--stream", str(path)))
            row = {"samples": samples, "file GB": path.stat().st_size / 1e9}
            row |= _costs("streamed", found, samples)
            if samples <= most:
                row |= _costs("in memory", json.loads(run("--in-memory", str(path))), samples)
            row["Fc of joint 4 (0.5)"] = f"{found['value']:.5f} ± {found['stderr']:.1g}"
            rows.append(row)
            if told:
                told(row)
    return rows


def _costs(way: str, found: dict[str, float], samples: int) -> dict[str, float]:
    return {
        f"{way}: s": found["seconds"],
        f"{way}: CPU µs a sample": 1e6 * found["cpu"] / samples,
        f"{way}: GB": found["memory"],
    }


def run(*arguments: str) -> str:
    return subprocess.run(
        [sys.executable, __file__, *arguments],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    ).stdout


def main() -> None:
    sizes = [int(text) for text in sys.argv[1:]] or SIZES
    sys.stdout.write(f"{platform.machine()}, Python {platform.python_version()}, one BLAS thread\n")

    def told(row: dict[str, object]) -> None:
        cells = [
            f"{key} {x:.3g}" if isinstance(x, float) else f"{key} {x}" for key, x in row.items()
        ]
        sys.stdout.write("; ".join(cells) + "\n")
        sys.stdout.flush()

    table(sizes, told=told)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--make"]:
        make(int(sys.argv[2]), sys.argv[3])
    elif sys.argv[1:2] == ["--stream"]:
        print(json.dumps(stream(sys.argv[2])))
    elif sys.argv[1:2] == ["--in-memory"]:
        print(json.dumps(in_memory(sys.argv[2])))
    else:
        main()
