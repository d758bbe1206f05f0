"""Simulation-based calibration: do 95 % intervals hold where sensors and drawing are off?

    python benchmarks/priors.py [--draws 300] [--machines arm five_bar slider_crank ur5] [--exact]

Each draw is a machine with other inertias, whose clock, torque gains, zeros, lengths and latenesses
are drawn from their priors, all at once, and a log of 8 s at 200 Hz with 1 % noise of the torques.
If intervals are right, the rank of the truth in the posterior is uniform (Talts, Betancourt,
Simpson, Vehtari, Gelman, arXiv:1804.06788, 2018). Parameters of one log are not independent, so the
test takes one of each draw, at random. `--exact`: of a machine on which nothing is off.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import chisquare, norm

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "tests" / "mistakes")]

import subjects  # noqa: E402

from ident import Log, Mechanism  # noqa: E402
from ident.mechanism.calibration import Calibration  # noqa: E402
from identification import motion_log, robot  # noqa: E402
from miscalibrated import misread  # noqa: E402

MACHINES = ("arm", "five_bar", "slider_crank", "ur5")
RATE, SECONDS, BINS = 200.0, 8.0, 10


def machine(name: str) -> tuple[Mechanism, Log]:
    """A mechanism with friction, and how its joints move."""
    if name != "ur5":
        mechanism = replace(robot(name), calibration=Calibration())
        mechanism = mechanism.with_effect("viscous").with_effect("coulomb")
        return mechanism, motion_log(name, RATE, SECONDS)
    subject = next(x for x in subjects.subjects() if x.name == name)
    columns = subject.moving(lambda joint: 1.0)
    motion = Log.from_arrays("motion.csv", columns.pop("t"), columns)
    return subject.load(Path(tempfile.mkdtemp())), motion


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=300, help="of all machines together")
    parser.add_argument("--machines", nargs="+", default=MACHINES, choices=MACHINES)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--exact", action="store_true")
    given = parser.parse_args()
    ranks, chooser = [], np.random.default_rng(given.seed)
    print("machine       draws  intervals  hold  z rms  max |z|  ± all / ± noise  error / LS  s")
    for name in given.machines:
        mechanism, motion = machine(name)
        started = time.process_time()
        z, wider, better = [], [], []
        for draw in range(given.draws // len(given.machines)):
            none = {"size": lambda cause, random: 0.0} if given.exact else {}
            case = misread(mechanism, motion, given.seed + draw, **none)
            fit = case.fit()
            z.append(case.off(fit))
            least = replace(mechanism.with_calibration("exact"))
            alone = replace(case, mechanism=least).fit()
            off = case.off(alone) * [v.stderr for v in alone.base_parameters]
            mine = z[-1] * [v.stderr for v in fit.base_parameters]
            better.append(np.log(np.abs(mine) / np.abs(off)).mean())
            noise = [v.stderr for v in alone.base_parameters]
            wider.append(np.median([v.stderr for v in fit.base_parameters] / np.array(noise)))
            ranks.append(norm.cdf(chooser.choice(z[-1])))
        every = np.concatenate(z)
        print(
            f"{name:13} {len(z):5} {len(every):10} {np.mean(np.abs(every) < norm.ppf(0.975)):5.1%}"
            f" {np.sqrt(np.mean(every**2)):6.2f} {np.abs(every).max():8.1f}"
            f" {np.median(wider):16.2f} {np.exp(np.mean(better)):11.2f}"
            f" {(time.process_time() - started) / len(z):4.2f}",
            flush=True,
        )
    counts = np.histogram(ranks, bins=BINS, range=(0, 1))[0]
    print(f"ranks of one parameter a draw: {counts.tolist()}, p = {chisquare(counts).pvalue:.3f}")


if __name__ == "__main__":
    main()
