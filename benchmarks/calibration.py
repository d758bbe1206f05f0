"""Names given where nothing is missing: clean logs with coloured noise and jittering stamps.

    python benchmarks/calibration.py [--logs 200] [--write FILE]

Logs of the arm and of the five-bar, 6 s at 100 Hz, whose viscous and dry friction the model has.
Noise of the torques: 3 % of each, of a correlation of 0.95 from sample to sample; rows are taken
1 ms rms away from their stamps; positions have 0.1 mrad. A false name: a verdict `missing`.
Names in the same noise: `python tests/battery/score.py --coloured`.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from scipy.signal import lfilter

import ident

ROBOTS = Path(__file__).resolve().parents[1] / "robots"
ALPHAS = (0.05, 0.01)
CORRELATION, SIZE = 0.95, 0.03  # of the torques' noise: from sample to sample, share of the rms
JITTER, POSITIONS = 1e-3, 1e-4  # s, rad
RATE, SECONDS, WAVES = 100.0, 6.0, 5  # Hz, s, waves a joint
VALUES = {"Fv": 0.3, "Fc": 0.3}  # N m s/rad, N m


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--logs", type=int, default=200)
    parser.add_argument("--write", type=Path)
    options = parser.parse_args()
    begin = time.process_time()
    lines = [
        shown(
            "| α | logs | `missing` | share | at most | `nothing` | `undecided` | "
            "`unexplained` | names |\n|---|---|---|---|---|---|---|---|---|"
        ),
        *clean(options.logs),
        "",
        f"{time.process_time() - begin:.0f} s of processor time.",
    ]
    if options.write:
        options.write.write_text("\n".join(lines) + "\n", encoding="utf-8")


def shown(line: str) -> str:
    print(line, flush=True)
    return line


def clean(count: int) -> Iterator[str]:
    """A row of verdicts for each α."""
    verdicts: dict[float, list[str]] = {alpha: [] for alpha in ALPHAS}
    names: dict[float, Counter[str]] = {alpha: Counter() for alpha in ALPHAS}
    for seed in range(count):
        fit = fitted(("arm", "arm", "five_bar")[seed % 3], seed)
        for alpha in ALPHAS:  # the larger first: where it finds nothing, the smaller does not
            if alpha < ALPHAS[0] and verdicts[ALPHAS[0]][-1] in ("nothing", "undecided"):
                verdicts[alpha].append(verdicts[ALPHAS[0]][-1])
                continue
            d = ident.diagnose(fit, alpha=alpha)
            verdicts[alpha].append(d.verdict)
            names[alpha].update(effect.label for effect in d.group)
    for alpha, found in verdicts.items():
        each = Counter(found)
        others = " | ".join(str(each[v]) for v in ("nothing", "undecided", "unexplained"))
        yield shown(
            f"| {alpha} | {count} | {each['missing']} | {100 * each['missing'] / count:.1f} % | "
            f"{200 * alpha:g} % | {others} | {', '.join(names[alpha]) or '–'} |"
        )


def fitted(name: str, seed: int) -> Any:
    """A fit of the model with friction to a log in which nothing is missing."""
    robot = ident.load(ROBOTS / name).with_effect("viscous").with_effect("coulomb")
    values = {f: VALUES[f.rpartition(".")[2]] for e in robot.effects for f in e.names}
    random = np.random.default_rng(seed)
    motion = waves(name, random)
    joints = [c[2:] for c in motion.columns if c.startswith("q.")]
    log = ident.simulate(robot, motion, values=values, columns=["q", "tau"], joints=joints)[0]
    late = log.t + JITTER * random.standard_normal(len(log.t))
    columns = {}
    for column, x in log.columns.items():
        columns[column] = np.interp(late, log.t, x)
        noise = random.standard_normal(len(x))
        if column.startswith("tau."):
            noise = lfilter([np.sqrt(1 - CORRELATION**2)], [1, -CORRELATION], noise)
            columns[column] += SIZE * rms(x) * noise
        elif column.startswith("q."):
            columns[column] += POSITIONS * noise
    return ident.identify(robot, ident.complete(robot, pl.DataFrame({"t": log.t, **columns})))


def rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def waves(
    name: str, random: np.random.Generator, rate: float = RATE, seconds: float = SECONDS
) -> ident.Log:
    """A periodic motion about where the shipped log begins, within its range."""
    shipped = ident.read_log(ROBOTS / name / "run.csv")
    robot = ident.load(ROBOTS / name)
    joints = [j for j in robot.driven if f"q.{j}" in shipped.columns]
    t = np.arange(0, seconds, 1 / rate)
    columns = {}
    for joint in joints:
        x = shipped.columns[f"q.{joint}"]
        f = (1 + np.arange(WAVES)) / seconds
        phase = 2 * np.pi * (f[:, None] * t + random.random((WAVES, 1)))
        size = random.standard_normal((WAVES, 1)) / np.sqrt(1 + np.arange(WAVES))[:, None]
        w = 2 * np.pi * f[:, None]
        q, v, a = ((size * y).sum(axis=0) for y in
                   (np.sin(phase), w * np.cos(phase), -(w**2) * np.sin(phase)))  # fmt: skip
        scale = 0.45 * np.ptp(x) / np.abs(q).max()
        columns |= {f"q.{joint}": 0.5 * (x.min() + x.max()) + scale * q,
                    f"v.{joint}": scale * v, f"a.{joint}": scale * a}  # fmt: skip
    return ident.Log.from_arrays("waves", t, columns)


if __name__ == "__main__":
    main()
