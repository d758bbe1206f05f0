"""Completion of a closed mechanism and its constraint Jacobians: what a sample costs, by part.

python benchmarks/completion.py [slider_crank four_bar five_bar]

From q, v and a of the drives in the log that comes with each robot: `follow` is all positions by
continuation, `rates` all velocities and accelerations, `leverage` J of every sample, the inverse
K⁺ = [J; W_u]⁺ and the leverages of all joints. Together they are completion and J; `complete` is
all of `ident.complete`, which also looks at clocks, noise, bands and standstill.
Processor time of one thread, the best of REPEAT.
"""

import os

os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import ident
from ident.motion.closures import LoopSolver

ROBOTS = Path(__file__).resolve().parent.parent / "robots"
NAMES = ("slider_crank", "four_bar", "five_bar")
REPEAT = 15
PARTS = ("follow", "rates", "leverage", "completion and J", "J alone", "complete")


def table(names: tuple[str, ...] = NAMES) -> list[dict[str, object]]:
    """One row a robot: samples, µs a sample of each part, and how far the loops stay open."""
    return [_row(name) for name in names]


def _row(name: str) -> dict[str, object]:
    mechanism = ident.load(ROBOTS / name)
    log = ident.read_log(ROBOTS / name / "run.csv", mechanism.columns)
    motion = ident.complete(mechanism, log)
    (e,) = motion.experiments
    at = [mechanism.joint_index[joint] for joint in e.logged]
    known = np.stack([x[:, at] for x in (e.y, e.yd, e.ydd)])
    closer = LoopSolver(mechanism, e.logged)
    runs: dict[str, Callable[[], object]] = {
        "follow": lambda: closer.follow(known[0], e.t),
        "rates": lambda: closer.rates(e.q, known[1], known[2]),
        "leverage": lambda: e.transmitted(mechanism, motion.independent),
        "completion and J": lambda: e.at(mechanism, known, start="follow"),
        "J alone": lambda: mechanism.kinematics.closure_rows(e.q),
        "complete": lambda: ident.complete(mechanism, log),
    }
    us = {part: 1e6 * best(run) / len(e) for part, run in runs.items()}
    return {"robot": name, "samples": len(e), **us, "open": motion.closure_error}


def best(run: Callable[[], object]) -> float:
    """Seconds of processor time."""
    seconds = []
    for _ in range(REPEAT):
        start = time.process_time()
        run()
        seconds.append(time.process_time() - start)
    return min(seconds)


def main() -> None:
    print("µs a sample")
    print(("{:14}{:>8}" + "{:>18}" * len(PARTS) + "{:>10}").format("", "samples", *PARTS, "|Φ|"))
    for row in table(tuple(sys.argv[1:]) or NAMES):
        cost = "".join(f"{row[part]:18.2f}" for part in PARTS)
        print(f"{row['robot']:14}{row['samples']:8}{cost}{row['open']:10.1e}")


if __name__ == "__main__":
    main()
