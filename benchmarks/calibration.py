"""Names given where nothing is missing: clean logs with coloured noise and jittering stamps.

    python benchmarks/calibration.py [--logs 200] [--hidden 40] [--write FILE]

Logs of the arm and of the five-bar, 6 s at 100 Hz, whose viscous and dry friction the model has.
Noise of the torques: 3 % of each, of a correlation of 0.95 from sample to sample; rows are taken
1 ms rms away from their stamps; positions have 0.1 mrad. A false name: a verdict `missing`. In the
`hidden` logs one effect more is at work, of 30 % of its joint's torque.
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
SHARE = 0.3  # of the standard deviation of the joint's torque, that a hidden effect has
SHAPES = ("vs", "N")
HIDDEN = {  # effects of the arm with values [N m/rad, N m, kg m², s]
    "spring:elbow": {"k": 3.0, "b": 0.5}, "torque_offset:shoulder": {"c": 3.0},
    "rotor_inertia:elbow": {"Ia": 0.4}, "cable:yaw": {"k0": 0.5, "k1": 2.0, "k2": 1.5, "k3": 2.0},
    "stribeck:yaw": {"Fs": 1.5, "vs": 0.3}, "drag:yaw": {"Fd": 1.0},
    "ripple:shoulder": {"A": 2.0, "B": 2.0, "N": 12.0}, "delay:yaw": {"d": 0.04},
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--logs", type=int, default=200)
    parser.add_argument("--hidden", type=int, default=40)
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
        *hidden(options.hidden),
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
        for alpha in ALPHAS:  # the larger first: what it does not name the smaller does not
            if alpha < ALPHAS[0] and verdicts[ALPHAS[0]][-1] != "missing":
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


def hidden(count: int) -> Iterator[str]:
    """How many effects are named with the same noise, and those that are not."""
    right, wrong = 0, []
    for seed in range(count):
        label = list(HIDDEN)[seed % len(HIDDEN)]
        d = ident.diagnose(fitted("arm", 1000 + seed, label))
        group = [each.label for each in d.group]
        rivals = [each.label for c in d.candidates[:1] for each in c.rivals]
        if label in group or (d.verdict == "missing" and label in rivals):
            right += 1
        else:
            wrong.append(f"{label}: {d.verdict} {', '.join(group)}".strip())
    yield shown(f"Hidden effects named: {right} of {count}. Not: {'; '.join(wrong) or 'none'}.")


def fitted(name: str, seed: int, label: str | None = None) -> Any:
    """A fit of the model with friction to a log, with the effect `label` at work or not."""
    robot = ident.load(ROBOTS / name).with_effect("viscous").with_effect("coulomb")
    true = robot.with_effect(label) if label else robot
    values = {f: VALUES[f.rpartition(".")[2]] for e in robot.effects for f in e.names}
    friction = dict(values)
    values |= (
        {f"{label.replace(':', '.')}.{n}": x for n, x in HIDDEN[label].items()} if label else {}
    )
    random = np.random.default_rng(seed)
    motion = waves(name, random)
    joints = [c[2:] for c in motion.columns if c.startswith("q.")]

    def simulated(model: Any, some: dict[str, float]) -> ident.Log:
        return ident.simulate(model, motion, values=some, columns=["q", "tau"], joints=joints)[0]

    log = simulated(true, values)
    if label and not label.startswith("delay"):
        joint, bare = label.partition(":")[2], simulated(robot, friction).columns
        tau = bare[f"tau.{joint}"]
        share = rms(log.columns[f"tau.{joint}"] - tau) / np.std(tau)
        prefix = label.replace(":", ".")
        values |= {f"{prefix}.{n}": x if n in SHAPES else x * SHARE / share
                   for n, x in HIDDEN[label].items()}  # fmt: skip
        log = simulated(true, values)
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


def waves(name: str, random: np.random.Generator) -> ident.Log:
    """A periodic motion about where the shipped log begins, within its range."""
    shipped = ident.read_log(ROBOTS / name / "run.csv")
    robot = ident.load(ROBOTS / name)
    joints = [j for j in robot.driven if f"q.{j}" in shipped.columns]
    t = np.arange(0, SECONDS, 1 / RATE)
    columns = {}
    for joint in joints:
        x = shipped.columns[f"q.{joint}"]
        f = (1 + np.arange(WAVES)) / SECONDS
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
