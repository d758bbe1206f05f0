"""A long run of `ident monitor`, beside a batch of the same samples after every hour.

    python benchmarks/hours.py [--hours N]

Three joints of robots/arm (its wrist is locked) with viscous and Coulomb friction, positions and
torques at 1 kHz with noise of 2e-5 rad and 0.05 to 0.15 N m, simulated by the library. The samples
come through a pipe as text; parameters are printed for every second of the log. The batch is
`ident.gather` of a file with the samples so far. Each decides for itself: the monitor by its first
five seconds, the batch by stretches of the whole log. One core; processor time, after the imports.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"

import numpy as np
import polars as pl

import ident
from ident.cli.monitor import Session
from ident.log.pieces import follow
from ident.streams.online import Online, Snapshot

ROOT = Path(__file__).resolve().parents[1]
RATE, PART = 1000, 300  # Hz; s that are simulated at once
VALUES = {
    "viscous.yaw.Fv": 0.5, "viscous.shoulder.Fv": 0.8, "viscous.elbow.Fv": 0.4,
    "coulomb.yaw.Fc": 1.0, "coulomb.shoulder.Fc": 1.5, "coulomb.elbow.Fc": 0.8,
}  # fmt: skip
RANGE = {"yaw": (0.0, 1.3), "shoulder": (-0.55, 0.5), "elbow": (0.9, 0.7)}  # rad
NOISE = {"q": 2e-5, "yaw": 0.05, "shoulder": 0.15, "elbow": 0.05}  # rad, N m


def machine() -> ident.Mechanism:
    arm = ident.load(ROOT / "robots" / "arm", locked={"wrist": 0.0})
    return arm.with_effect("viscous").with_effect("coulomb")


def part(mechanism: ident.Mechanism, start: int, samples: int) -> pl.DataFrame:
    """Some samples of six sines a joint, from the sample `start` on."""
    t = (start + np.arange(samples)) / RATE
    waves, columns = np.random.default_rng(0), {}
    for joint, (centre, half) in RANGE.items():
        w = 2 * np.pi * waves.uniform(0.15, 1.2, 6)[:, None]
        phase, size = waves.uniform(0, 2 * np.pi, 6)[:, None], waves.uniform(0.3, 1.0, 6)[:, None]
        size *= half / size.sum()
        columns[f"q.{joint}"] = centre + (size * np.sin(w * t + phase)).sum(axis=0)
        columns[f"v.{joint}"] = (size * w * np.cos(w * t + phase)).sum(axis=0)
        columns[f"a.{joint}"] = -(size * w**2 * np.sin(w * t + phase)).sum(axis=0)
    motion = ident.Log.from_arrays("arm", t, columns)
    log, _ = ident.simulate(mechanism, motion, values=VALUES, columns=("q", "tau"))
    noise = np.random.default_rng([1, start])
    return pl.DataFrame(
        {"t": t}
        | {
            name: x + NOISE["q" if name[0] == "q" else name[4:]] * noise.standard_normal(len(t))
            for name, x in log.columns.items()
        }
    )


def extend(path: Path, mechanism: ident.Mechanism, hour: int) -> None:
    """Append an hour of samples to a CSV file."""
    with path.open("ab") as file:
        for first in range(hour * 3600, (hour + 1) * 3600, PART):
            rows = part(mechanism, first * RATE, PART * RATE)
            rows.write_csv(file, include_header=first == 0, float_precision=8)


def apart(found: Snapshot, fit: ident.Fit) -> tuple[float, str]:
    """Largest difference of a parameter in standard errors of the batch, and which it is."""
    off = {}
    for value in found.identified:
        batch = fit[value.name]
        if batch.identifiable and batch.stderr:
            off[value.name] = abs(value.value - batch.value) / batch.stderr
    worst = max(off, key=lambda name: off[name])
    return off[worst], worst


def resident() -> float:
    """Memory of this process now [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def table(hours: int = 2) -> list[dict[str, float | str]]:
    """A row an hour."""
    mechanism, rows = machine(), []
    with tempfile.TemporaryDirectory() as folder, open(os.devnull, "w") as nowhere:
        path = Path(folder) / "log.csv"
        online, spent, size = Online(mechanism), 0.0, 0
        session, output = Session(online, None, None, every=1.0), sys.stdout
        for hour in range(hours):
            extend(path, mechanism, hour)
            sys.stdout, start = nowhere, time.process_time()
            head = path.open("rb").readline()
            command = ["sh", "-c", 'printf "%s" "$1"; tail -c +"$2" "$3"', "sh",
                       head.decode() if hour else "", str(size + 1), str(path)]  # fmt: skip
            with subprocess.Popen(command, stdout=subprocess.PIPE) as pipe:
                assert pipe.stdout is not None
                os.dup2(pipe.stdout.fileno(), 0)
                for lines in follow(None):
                    session.take(lines)
            found, size = online.snapshot(), path.stat().st_size
            spent += time.process_time() - start
            sys.stdout = output
            memory = resident()
            fit = ident.gather(mechanism, path).fit
            off, worst = apart(found, fit)
            rows.append(
                {
                    "hour": str(hour + 1),
                    "samples": f"{online.samples:,}",
                    "CPU µs a sample": 1e6 * spent / online.samples,
                    "times faster than real time": online.samples / RATE / spent,
                    "MB": memory,
                    "furthest from the batch [standard errors]": off,
                    "of": worst,
                    "Fc of yaw (1)": f"{found['coulomb.yaw.Fc'].value:.5f}",
                    "of the batch": f"{fit['coulomb.yaw.Fc'].value:.5f}",
                    "± ": f"{fit['coulomb.yaw.Fc'].stderr:.5f}",
                }
            )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description="a long run of monitor beside a batch")
    parser.add_argument("--hours", type=int, default=2)
    for row in table(parser.parse_args().hours):
        print(
            "; ".join(
                f"{k}: {v:.3g}" if isinstance(v, float) else f"{k}: {v}" for k, v in row.items()
            )
        )


if __name__ == "__main__":
    main()
