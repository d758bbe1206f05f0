"""Verdicts where nothing is missing, in noise that is not white: four kinds, ten logs each.

    python benchmarks/clean_logs.py [--seeds 10] [--kind KIND …]

Logs of the arm, of the five-bar and of the four-bar, 8 s at 200 Hz, whose viscous and dry
friction the model has; positions have 0.1 mrad. Noise of the torques, of 1 to 4 % of each:

    coloured          correlated from sample to sample, 0.8 to 0.98
    heavy_tailed      Student's t of 2.2 to 4 degrees of freedom
    stepped           rounded to steps of 4 to 15 % of the torque's rms, beside 0.3 % white noise
    multiplicative    white, as large as the torque is at the moment

A wrong name is a verdict `missing`; `far` are logs of which some joint's error is three times what
ident takes for the noise of the sensors.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from typing import Any

import numpy as np
import polars as pl
from calibration import POSITIONS, ROBOTS, VALUES, rms, waves
from scipy.signal import lfilter

import ident

KINDS = ("coloured", "heavy_tailed", "stepped", "multiplicative")
MACHINES = ("arm", "five_bar", "arm", "four_bar", "five_bar")
FAR = 3.0  # times the noise of the sensors


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="seed of the first log")
    parser.add_argument("--kind", action="append", choices=KINDS)
    options = parser.parse_args()
    print(
        "| noise | nothing | undecided | unexplained | missing | far | names |\n" + "|---" * 7 + "|"
    )
    begin, total = time.process_time(), Counter[str]()
    for kind in options.kind or KINDS:
        each, names = Counter[str](), Counter[str]()
        for seed in range(options.first, options.first + options.seeds):
            fit = fitted(kind, seed)
            diagnosis = ident.diagnose(fit)
            each[diagnosis.verdict] += 1
            names.update(effect.label for effect in diagnosis.group)
            each["far"] += bool(times_noise(fit) > FAR)
        total += each
        print(row(kind, each, names), flush=True)
    print(row("all", total, Counter()))
    print(f"\n{time.process_time() - begin:.0f} s of processor time.")


def row(title: str, each: Counter[str], names: Counter[str]) -> str:
    """One row of the table."""
    counts = ("nothing", "undecided", "unexplained", "missing", "far")
    cells = (title, *(str(each[name]) for name in counts), ", ".join(names) or "–")
    return f"| {' | '.join(cells)} |"


def times_noise(fit: Any) -> float:
    """The largest error of a joint over what noise of the sensors would leave."""
    return max(error.rms / fit.noise[joint] for joint, error in fit.held_out.items())


def fitted(kind: str, seed: int) -> Any:
    """A fit of the model with friction to a log in which nothing is missing."""
    name = MACHINES[seed % len(MACHINES)]
    robot = ident.load(ROBOTS / name).with_effect("viscous").with_effect("coulomb")
    values = {f: VALUES[f.rpartition(".")[2]] for e in robot.effects for f in e.names}
    random = np.random.default_rng([KINDS.index(kind), seed])
    motion = waves(name, random, rate=200.0, seconds=8.0)
    joints = [c[2:] for c in motion.columns if c.startswith("q.")]
    log = ident.simulate(robot, motion, values=values, columns=["q", "tau"], joints=joints)[0]
    columns = {
        column: x + POSITIONS * random.standard_normal(len(x))
        if column.startswith("q.")
        else spoilt(kind, x, random)
        for column, x in log.columns.items()
    }
    return ident.identify(robot, ident.complete(robot, pl.DataFrame({"t": log.t, **columns})))


def spoilt(kind: str, x: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """A torque channel with noise of a kind."""
    size = random.uniform(0.01, 0.04) * rms(x)
    white = random.standard_normal(len(x))
    if kind == "coloured":
        r = random.uniform(0.8, 0.98)
        return x + size * lfilter([np.sqrt(1 - r**2)], [1, -r], white)
    if kind == "heavy_tailed":
        tails = random.standard_t(random.uniform(2.2, 4.0), len(x))
        return x + size * tails / rms(tails)
    if kind == "stepped":
        step = random.uniform(0.04, 0.15) * rms(x)
        return step * np.round((x + 0.003 * rms(x) * white) / step)
    return x + size / rms(x) * np.abs(x) * white


if __name__ == "__main__":
    main()
