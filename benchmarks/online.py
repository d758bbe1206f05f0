"""Identification while samples come: time of a call of `update`, one sample a call.

    python benchmarks/online.py [--samples N]

The spatial slider-crank, its positions, velocities and accelerations logged, and a serial arm of
seven joints with viscous and Coulomb friction (84 unknowns), both at 1 kHz, BLAS on one thread, no
filter. Rows are made for the samples of 0.5 s together, so one call in twenty does the work of all:
the mean is what a stream costs, the worst call what a loop waits for it. `at once` makes the rows
of every sample in its own call. A snapshot is what parameters with standard errors cost, when they
are asked for. Times are processor time of this process, after 200 samples; the table of growth has
the same stream after ever more samples, and what the state weighs.
"""

from __future__ import annotations

import argparse
import gc
import os
import pickle
import sys
import time
from collections.abc import Iterator
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import arm7
import numpy as np

import ident

ROOT = Path(__file__).resolve().parents[1]
WARM = 200
Sample = dict[str, float]


def slider_crank(samples: int) -> tuple[ident.Mechanism, ident.Log]:
    """Its log, over and over."""
    mechanism = ident.load(ROOT / "robots" / "slider_crank")
    log = ident.read_log(ROOT / "robots" / "slider_crank" / "run.csv")
    count = -(-samples // (len(log.t) - 1))
    columns = {name: np.tile(x[:-1], count)[:samples] for name, x in log.columns.items()}
    return mechanism, ident.Log.from_arrays("slider_crank", np.arange(samples) / 1000, columns)


def arm(samples: int) -> tuple[ident.Mechanism, ident.Log]:
    mechanism = arm7.mechanism()
    return mechanism, arm7.log(mechanism, samples, 0.01)


MACHINES = {"slider-crank": slider_crank, "arm of 7 joints": arm}
TARGET = {"slider-crank": 200.0, "arm of 7 joints": 500.0}  # µs a sample


def one_by_one(log: ident.Log) -> Iterator[Sample]:
    names = ["t", *log.columns]
    for row in zip(log.t, *log.columns.values(), strict=True):
        yield dict(zip(names, map(float, row), strict=True))


def timed(online: ident.Online, samples: list[Sample]) -> np.ndarray:
    """Time of every call [µs]."""
    times = np.empty(len(samples))
    gc.collect()
    gc.freeze()  # the samples that are held here are no part of the stream
    clock = time.process_time_ns
    for i, sample in enumerate(samples):
        start = clock()
        online.update(sample)
        times[i] = clock() - start
    return times / 1e3


def table(samples: int = 10_000) -> list[dict[str, float | str]]:
    """A row a machine and way: mean, 99 % and largest time of a call, and of a snapshot [µs]."""
    rows: list[dict[str, float | str]] = []
    for machine, make in MACHINES.items():
        mechanism, log = make(samples)
        motion = ident.complete(mechanism, log, cutoff=None)
        for how, options in (
            ("0.5 s together", {}),
            ("forgetting in 1 s", {"forget": 1.0}),
            ("at once", {"latency": 0.0}),
        ):
            online = ident.Online(mechanism, like=motion, **options)
            each = timed(online, list(one_by_one(log)))[WARM:]
            online.snapshot()
            start = time.process_time_ns()
            online.snapshot()
            rows.append(
                {
                    "machine": machine,
                    "rows made": how,
                    "mean": float(each.mean()),
                    "99 %": float(np.quantile(each, 0.99)),
                    "worst": float(each.max()),
                    "snapshot": (time.process_time_ns() - start) / 1e3,
                    "target": TARGET[machine],
                }
            )
    return rows


def growth(most: int = 100_000) -> list[dict[str, float | str]]:
    """A row a number of samples: mean time of a call over the last thousand, bytes of the state."""
    rows: list[dict[str, float | str]] = []
    for machine, make in MACHINES.items():
        mechanism, log = make(min(most, 10_000))
        motion = ident.complete(mechanism, log, cutoff=None)
        online, samples = ident.Online(mechanism, like=motion), list(one_by_one(log))
        length = log.t[-1] + 0.001
        done, size = 0, 1_000
        while size <= most:
            last = np.empty(0)
            while done < size:
                turn, first = divmod(done, len(samples))
                part = samples[first : first + min(1_000, size - done)]
                last = timed(online, [s | {"t": s["t"] + turn * length} for s in part])
                done += len(part)
            rows.append(
                {
                    "machine": machine,
                    "samples": size,
                    "mean": float(last.mean()),
                    "bytes": len(pickle.dumps(online)),
                }
            )
            size *= 10
    return rows


def show(rows: list[dict[str, float | str]]) -> None:
    print("  ".join(f"{name:>17}" for name in rows[0]))
    for row in rows:
        print(
            "  ".join(
                f"{x:>17.0f}" if isinstance(x, float | int) else f"{x:>17}" for x in row.values()
            )
        )


def main() -> None:
    parser = argparse.ArgumentParser(description="time of Online.update, one sample a call [µs]")
    parser.add_argument("--samples", type=int, default=10_000)
    given = parser.parse_args()
    show(table(given.samples))
    print()
    show(growth(10 * given.samples))


if __name__ == "__main__":
    sys.exit(main())
