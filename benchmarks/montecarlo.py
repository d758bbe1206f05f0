"""The paper's method beside the project's default under white noise on every channel.

python benchmarks/montecarlo.py [--slider 100] [--pendulum 1000] [--jobs N] [--out DIR]

Slider-crank of sect. 3.2 at 60 to 20 dB, pendulum of sect. 3.1 at 30 and 15 dB; multipliers against
the exact reactions that come with the logs. Prints both tables, the figures that matter most, and
times; --out writes the pictures and all runs.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import polars as pl

import ident
from ident import MonteCarlo
from ident.show.simulate import multiplier_rows, parameter_rows

ROBOTS = Path(__file__).resolve().parent.parent / "robots"
RATIOS = {"slider_crank": (60, 50, 40, 30, 20), "pendulum": (30, 15)}
TRUTH = {
    "slider_crank": {"rod.Ixx": 4e-3, "rod.Iyy": 4e-4, "rod.Izz": 4e-3},
    "pendulum": {"rod.Izz": 0.2},
}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--slider", type=int, default=100)
    parser.add_argument("--pendulum", type=int, default=1000)
    parser.add_argument("--jobs", type=int)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    began = time.perf_counter()
    for name, runs in (("slider_crank", given.slider), ("pendulum", given.pendulum)):
        if runs:
            found = compared(name, runs, given.jobs)
            if given.out:
                found.write(given.out / name)
    print(f"\nin all {time.perf_counter() - began:.0f} s")


def compared(name: str, runs: int, jobs: int | None) -> MonteCarlo:
    mechanism = ident.load(ROBOTS / name)
    began = time.perf_counter()
    found = ident.monte_carlo(
        mechanism,
        ROBOTS / name / "run.csv",
        snr=RATIOS[name],
        runs=runs,
        estimators=("paper", "default"),
        truth=TRUTH[name],
        reactions=ROBOTS / name / "reactions.csv",
        jobs=jobs,
    )
    seconds = time.perf_counter() - began
    print(f"\n{name}: {runs} runs at each SNR in {seconds:.0f} s\n")
    printed(parameter_rows(found))
    printed(multiplier_rows(found))
    summed(found)
    for note in found.notes:
        print(f"note: {note}")
    return found


def printed(rows: list[list[str]]) -> None:
    """As a Markdown table."""
    print("| " + " | ".join(rows[0]) + " |\n" + "|---" * len(rows[0]) + "|")
    for row in rows[1:]:
        print("| " + " | ".join(row) + " |")
    print()


def summed(found: MonteCarlo) -> None:
    """Standard errors of the biases, of the default, and the multipliers' ratio to the paper's."""
    for r in found.table.filter(pl.col("estimator") == "default").iter_rows(named=True):
        if r["runs"] > 1:
            bias, error = (100 * r[each] / r["truth"] for each in ("bias", "bias_stderr"))
            print(
                f"default, {r['snr']:g} dB, {r['parameter']}: bias {bias:+.2f} ± {error:.2f} %, "
                f"mean stderr over std {r['stderr'] / r['std']:.2f}"
            )
    force = found.multipliers.filter(pl.col("multiplier") == "force")
    mean = {(r["estimator"], r["snr"]): r["mean"] for r in force.iter_rows(named=True)}
    for snr in found.snr:
        if ("paper", snr) in mean and ("default", snr) in mean:
            ratio = mean["default", snr] / mean["paper", snr]
            print(f"multipliers at {snr:g} dB: default over paper {ratio:.2f}")


if __name__ == "__main__":
    main()
