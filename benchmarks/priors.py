"""Simulation-based calibration: do 95 % intervals hold where sensors and drawing are off?

    python benchmarks/priors.py [--draws 300] [--machines arm five_bar slider_crank ur5] [--exact]
                                [--positions] [--first SEED] [--out FILE] [--read FILE …]

Each draw is a machine with other inertias, whose clock, torque gains, zeros, lengths and latenesses
are drawn from their priors, all at once, and a log of 8 s at 200 Hz with 1 % noise of the torques.
If intervals are right, the rank of the truth in the posterior is uniform (Talts, Betancourt,
Simpson, Vehtari, Gelman, arXiv:1804.06788, 2018). Parameters of one log are not independent, so the
test takes one of each draw, at random. One fit a draw: its values as they are logged are those of
least squares. `--exact`: of a machine on which nothing is off; `--positions`: without logged rates.
A draw is a line of the file `--out`, as soon as it is made; `--read`: the table of such files.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.stats import chisquare, norm

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "tests" / "mistakes")]

import subjects  # noqa: E402
from rows import kept, rows_of  # noqa: E402

from ident import Log, Mechanism  # noqa: E402
from ident.mechanism.calibration import Calibration  # noqa: E402
from identification import motion_log, robot  # noqa: E402
from miscalibrated import Misread, misread  # noqa: E402

MACHINES = ("arm", "five_bar", "slider_crank", "ur5")
RATE, SECONDS, BINS = 200.0, 8.0, 10
NAMES = (
    "machine",
    "draws",
    "intervals",
    "hold",
    "z rms",
    "largest",
    "± all / ± noise",
    "error / LS",
)


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


@dataclass(frozen=True)
class Draw:
    """Errors of the base parameters of one draw.

    Attributes:
        z: of each, in its standard error; wider: median of standard errors over those of noise
            alone; better: mean logarithm of errors over those of least squares.
    """

    machine: str
    seed: int
    names: tuple[str, ...]
    z: tuple[float, ...]
    wider: float
    better: float
    seconds: float

    @classmethod
    def of(cls, machine: str, seed: int, case: Misread) -> Draw:
        """Fit a log and compare with the truth."""
        started, fit = time.process_time(), case.fit()
        values, truth = fit.base_parameters, case.base(fit)
        found, logged, errors = (
            np.array([getattr(value, name) for value in values])
            for name in ("value", "as_logged", "stderr")
        )
        return cls(
            machine,
            seed,
            tuple(value.name for value in values),
            tuple(((found - truth) / errors).tolist()),
            float(np.median(errors / np.sqrt(np.diag(fit.scatter)))),
            float(np.log(np.abs(found - truth) / np.abs(logged - truth)).mean()),
            time.process_time() - started,
        )


def drawn(names: Sequence[str], seeds: range, exact: bool, positions: bool) -> Iterator[Draw]:
    """Draws of machines, one of each in turn."""
    machines = {name: machine(name) for name in names}
    none = {"size": lambda cause, random: 0.0} if exact else {}
    for seed in seeds:
        for name, (mechanism, motion) in machines.items():
            case = misread(mechanism, motion, seed, **none)
            yield Draw.of(name, seed, case.without_rates() if positions else case)


def table(draws: Sequence[Draw]) -> list[str]:
    """Lines of the table, and of the ranks of one parameter of each draw."""
    lines = [f"| {' | '.join(NAMES)} |", "|---" * len(NAMES) + "|"]
    machines = [*dict.fromkeys(draw.machine for draw in draws)]
    for name in [*machines, "all"] if len(machines) > 1 else machines:
        some = [draw for draw in draws if name in (draw.machine, "all")]
        z = np.concatenate([draw.z for draw in some])
        hold, wider = np.mean(np.abs(z) < norm.ppf(0.975)), np.median([d.wider for d in some])
        better = np.exp(np.mean([draw.better for draw in some]))
        cells = f"{100 * hold:.1f} %", f"{np.sqrt(np.mean(z**2)):.2f}", f"{np.abs(z).max():.1f}"
        lines.append(
            f"| {' | '.join([name, str(len(some)), str(len(z)), *cells])} | {wider:.1f} | "
            f"{better:.2f} |"
        )
    ranks = [norm.cdf(np.random.default_rng(draw.seed).choice(draw.z)) for draw in draws]
    counts = np.histogram(ranks, bins=BINS, range=(0, 1))[0]
    seconds = np.mean([draw.seconds for draw in draws])
    p = chisquare(counts).pvalue
    return [
        *lines, "",
        f"ranks of one parameter a draw: {counts.tolist()}, p = {p:.3f}; {seconds:.1f} s a draw",
    ]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=300, help="of all machines together")
    parser.add_argument("--machines", nargs="+", default=MACHINES, choices=MACHINES)
    parser.add_argument("--first", type=int, default=0, help="seed")
    parser.add_argument("--exact", action="store_true")
    parser.add_argument("--positions", action="store_true")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--read", type=Path, nargs="+")
    given = parser.parse_args()
    each = given.draws // len(given.machines)
    seeds = range(given.first, given.first + each)
    made = drawn(given.machines, seeds, given.exact, given.positions)
    rows = rows_of(given.read, Draw) if given.read else [*kept(made, given.out)]
    print("\n".join(table(rows)))


if __name__ == "__main__":
    main()
