"""Real logs made worse on purpose: errors beside those of the untouched log, and what is said.

    python benchmarks/spoilt.py [--data DIR]… [NAME …]

Each log of the machine (see `machines.py`) is spoilt in one way before it is read; viscous and
Coulomb friction, everything else by default. Errors in % of each joint, held out in time; `largest
rise` is that of one joint's rms [N m] over the untouched log's; `named`: by the diagnosis.
"""

from __future__ import annotations

import importlib
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
from machines import arguments, located
from scipy.signal import lfilter

import ident

ROOT = Path(__file__).resolve().parents[1]
NAMES = {"tx40": ("coupling:joint_5,joint_6",), "ur10e": (), "panda": ()}  # with further effects
Columns = dict[str, np.ndarray]
SAID = ("time stamps", "steps", "repeated", "resolution", "late", "filter", "rounded", "jitter")


def jittered(size: float) -> Callable[[Columns, np.random.Generator], Columns]:
    """Rows taken at other times than their stamps say, by `size` [s] rms, all columns alike."""

    def spoil(log: Columns, random: np.random.Generator) -> Columns:
        late = log["t"] + size * random.standard_normal(len(log["t"]))
        return {n: x if n == "t" else np.interp(late, log["t"], x) for n, x in log.items()}

    return spoil


def repeating(log: Columns, random: np.random.Generator) -> Columns:
    """One row in seven is the one before, with a stamp of its own."""
    rows = np.arange(len(log["t"]))
    rows[1:] -= random.random(len(rows) - 1) < 1 / 7
    return {n: x if n == "t" else x[rows] for n, x in log.items()}


def rounded(log: Columns, _: np.random.Generator) -> Columns:
    """Positions of 12 bit a turn."""
    step = 2 * np.pi / 4096
    return {n: step * np.round(x / step) if n[:2] == "q." else x for n, x in log.items()}


def lagging(log: Columns, _: np.random.Generator) -> Columns:
    """Torques through a first-order filter of 5 ms, of straight lines from sample to sample."""
    step = float(np.median(np.diff(log["t"]))) / 5e-3
    keep, rise = np.exp(-step), (1 - np.exp(-step)) / step
    return {
        n: lfilter([1 - rise, rise - keep], [1, -keep], x - x[0]) + x[0] if n[:4] == "tau." else x
        for n, x in log.items()
    }


WAYS: dict[str, Callable[[Columns, np.random.Generator], Columns]] = {
    "untouched": lambda log, _: log, "jitter 0.5 ms": jittered(0.5e-3),
    "jitter 2.7 ms": jittered(2.7e-3), "one row in seven repeated": repeating,
    "12 bit": rounded, "torques filtered, 5 ms": lagging,
}  # fmt: skip


def main() -> None:
    names, places = arguments(__doc__, NAMES)
    print("| machine | log | error | largest rise | said | named |\n|---|---|---|---|---|---|")
    for name in names:
        module = importlib.import_module(f"machines.{name}")
        source = located(module.SOURCE, places)
        if source is None:
            print(f"| {name} | no {module.SOURCE} | | | |", flush=True)
            continue
        with tempfile.TemporaryDirectory() as folder:
            machine = module.convert(source, Path(folder))
            robot = ident.load(machine.mechanism)
            for effect in (*machine.effects, *NAMES[name], "viscous", "coulomb"):
                robot = robot.with_effect(effect)
            table = pl.read_csv(machine.train[0], infer_schema_length=None)
        log = {n: table[n].to_numpy().astype(float) for n in table.columns}
        untouched: dict[str, float] = {}
        for way, spoil in WAYS.items():
            spoilt = pl.DataFrame(spoil(log, np.random.default_rng(1)))
            motion = ident.complete(robot, spoilt)
            fit = ident.identify(robot, motion)
            rms = {joint: error.rms for joint, error in fit.held_out.items()}
            untouched = untouched or rms
            rise = max(rms[joint] / untouched[joint] - 1 for joint in rms)
            shares = " ".join(f"{100 * (e.relative or 0):.3g}" for e in fit.held_out.values())
            sentences = [*motion.notes, *fit.warnings]
            said = [s for s in sentences if any(word in s for word in SAID)]
            short = "; ".join(dict.fromkeys(s.partition(": ")[2][:70] for s in said)) or "–"
            names = ", ".join(each.label for each in ident.diagnose(fit).group) or "–"
            cells = (name, way, shares, f"{100 * rise:+.0f} %", short, names)
            print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
