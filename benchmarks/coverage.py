"""Do 95 % intervals hold the truth in 92 to 98 % of logs? With noise and robots of many kinds.

    python benchmarks/coverage.py [runs] [case …]

A case is named <robot>/<noise>; without names all are run. The truth is planted, a log made and
identified as by default, `runs` times. Printed: the share of intervals (value ± 1.96 standard
errors) that hold the truth, for effects and bodies, and of the worst parameter; the bias in
standard deviations of the estimates, median and worst over parameters; and the standard errors that
were said over the standard deviation that was seen, median.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

import ident  # noqa: E402
from identification import motion_log, plant, robot  # noqa: E402

RATE, SECONDS, BURN = 250.0, 12.0, 4000
Columns = dict[str, np.ndarray]
Noise = Callable[[np.random.Generator, Columns], Columns]


def correlated(rng: np.random.Generator, n: int, rho: float) -> np.ndarray:
    """(n,) a first-order autoregression of unit variance."""
    white = rng.standard_normal(BURN + n)
    return lfilter([np.sqrt(1 - rho**2)], [1, -rho], white)[BURN:]


def on_torques(rho: float, level: float = 0.01, positions: float = 0.0) -> Noise:
    """Torques with a share of noise of autoregression `rho` a sample; q with white noise [rad]."""

    def noisy(rng: np.random.Generator, clean: Columns) -> Columns:
        found = {}
        for name, x in clean.items():
            if name.startswith("tau."):
                x = x + level * x.std() * correlated(rng, len(x), rho)
            elif positions and name.startswith("q."):
                x = x + positions * rng.standard_normal(len(x))
            found[name] = x
        return found

    return noisy


def encoder(bits: int, level: float) -> Noise:
    """Positions as an encoder counts them, torques with white noise."""
    step = 2 * np.pi / 2**bits

    def noisy(rng: np.random.Generator, clean: Columns) -> Columns:
        found = {}
        for name, x in clean.items():
            if name.startswith("q."):
                x = step * np.round(x / step + rng.uniform())  # the zero is anywhere in a step
                x = x - step * 0.5
            else:
                x = x + level * x.std() * rng.standard_normal(len(x))
            found[name] = x
        return found

    return noisy


NOISES: dict[str, Noise] = {
    "white torque 1 %": on_torques(0.0),
    "torque 1 %, 0.04 s": on_torques(0.9),
    "torque 1 %, 0.4 s": on_torques(0.99),
    "torque 1 %, 2 s": on_torques(0.998),
    "positions 1e-5 rad": on_torques(0.0, 0.01, 1e-5),
    "positions 1e-4 rad": on_torques(0.0, 0.01, 1e-4),
    "positions 1e-3 rad": on_torques(0.0, 0.01, 1e-3),
    "encoder 14 bit": encoder(14, 0.02),
}
ROBOTS = ("arm", "five_bar", "four_bar")


def case(name: str, noise: Noise, runs: int, seed: int = 0) -> list[str]:
    """One row of the table."""
    mechanism = robot(name).with_effect("viscous").with_effect("coulomb")
    planted = plant(mechanism, motion_log(name, RATE, SECONDS), seed=seed)
    clean = {c: x for c, x in planted.log.columns.items() if c.startswith(("q.", "tau."))}
    rng = np.random.default_rng(seed)
    cutoff: float | str | None = "auto"
    by_name: dict[str, list[tuple[float, float]]] = {}
    for _ in range(runs):
        log = ident.Log.from_arrays("log", planted.log.t, noise(rng, clean))
        motion = ident.complete(mechanism, log, cutoff=cutoff)
        cutoff = motion.band.cutoff  # chosen from the first log, then kept
        fit = ident.identify(mechanism, motion)
        off = fit.estimate.solution.beta - planted.base(fit)
        for value, error in zip(fit.base_parameters, off, strict=True):
            by_name.setdefault(value.name, []).append((error, value.stderr))
    some = {n: np.array(x) for n, x in by_name.items() if len(x) > runs / 2}
    inside = {n: np.mean(np.abs(x[:, 0]) < 1.96 * x[:, 1]) for n, x in some.items()}
    effects = [s for n, s in inside.items() if n.split(".")[0] in ("viscous", "coulomb")]
    bodies = [s for n, s in inside.items() if n.split(".")[0] not in ("viscous", "coulomb")]
    bias = np.array([abs(x[:, 0].mean()) / x[:, 0].std() for x in some.values()])
    said = np.array([np.median(x[:, 1]) / x[:, 0].std() for x in some.values()])
    return [
        f"{100 * np.mean(effects):.1f} %",
        f"{100 * np.mean(bodies):.1f} %" if bodies else "–",
        f"{100 * min(inside.values()):.0f} %",
        f"{np.median(bias):.2f}",
        f"{bias.max():.2f}",
        f"{np.median(said):.2f}",
    ]


def main() -> None:
    words = sys.argv[1:]
    runs = int(words.pop(0)) if words and words[0].isdigit() else 100
    names = [f"{r}/{n}" for r in ROBOTS for n in NOISES]
    print(f"{runs} logs a case")
    print(f"{'':32s} effects  bodies   worst  bias (median, worst)  said / seen")
    for each in words or names:
        name, _, noise = each.partition("/")
        start = time.perf_counter()
        row = case(name, NOISES[noise], runs)
        seconds = time.perf_counter() - start
        print(f"{each:32s} {'   '.join(row)}   ({seconds:.0f} s)", flush=True)


if __name__ == "__main__":
    main()
