"""Positions only, from an encoder of 14 bits at 200 Hz, with 2 % of noise on the torques.

Base parameters against the planted ones, in shares of their scale (m, m l, m l² of the body that
carries them, l: how far its mass reaches; friction: its own value), and how often the 95 %
intervals cover the truth: a five-bar and a three-joint arm, by plain least squares, by the
default and by the refined fit.

    python benchmarks/encoder.py [--runs 40]
"""

from __future__ import annotations

import argparse
import re
import tempfile
from pathlib import Path

import numpy as np

import ident
from ident.equations.problem import body_scales

ROBOTS = Path(__file__).resolve().parents[1] / "robots"
STEP = 2 * np.pi / 2**14  # rad, of the encoder
RATE, SECONDS = 200.0, 10.0  # Hz, s
TORQUE = 0.02  # of each torque's own standard deviation
MOTIONS = {  # rad: centre and amplitude of each driven joint
    "five_bar": {"left": (2.25, 0.45), "right": (0.9, 0.45)},
    "arm3": {"yaw": (0.0, 1.2), "shoulder": (0.4, 0.8), "elbow": (0.6, 0.9)},
}
FRICTION = {  # N m s/rad, N m
    "five_bar": {"viscous": 0.05, "coulomb": 0.1},
    "arm3": {"viscous": 0.5, "coulomb": 1.0},
}


def mechanism(name: str, folder: Path) -> ident.Mechanism:
    """The five-bar, or the arm with its wrist locked; with friction in the drives."""
    if name == "five_bar":
        model = ident.load(ROBOTS / "five_bar")
    else:
        text = (ROBOTS / "arm" / "arm.urdf").read_text(encoding="utf-8")
        locked = re.sub(r'(<joint name="wrist" type=)"\w+"', r'\1"fixed"', text)
        path = folder / "arm3.urdf"
        path.write_text(locked, encoding="utf-8")
        model = ident.load(path)
    for kind in FRICTION[name]:
        model = model.with_effect(kind)
    return model


def motion(name: str, seed: int) -> ident.Log:
    """Sums of five sines from 0.1 to 0.9 Hz about each joint's centre."""
    t = np.arange(0.0, SECONDS, 1 / RATE)
    random = np.random.default_rng(seed)
    columns = {}
    for joint, (centre, amplitude) in MOTIONS[name].items():
        f = 0.1 * np.array([1, 3, 5, 7, 9])[:, None]
        size = random.uniform(0.5, 1.0, (5, 1))
        phase = random.uniform(0, 2 * np.pi, (5, 1))
        w = 2 * np.pi * f
        size *= amplitude / size.sum()
        columns[f"q.{joint}"] = centre + (size * np.sin(w * t + phase)).sum(axis=0)
        columns[f"v.{joint}"] = (size * w * np.cos(w * t + phase)).sum(axis=0)
        columns[f"a.{joint}"] = -(size * w**2 * np.sin(w * t + phase)).sum(axis=0)
    return ident.Log.from_arrays(f"{name}.csv", t, columns)


def logged(model: ident.Mechanism, exact: ident.Log, seed: int) -> ident.Log:
    """Positions as the encoder counts them, and noisy torques."""
    random = np.random.default_rng(seed)
    columns = {}
    for name, x in exact.columns.items():
        if name.startswith("q."):
            columns[name] = STEP * np.round((x + random.uniform(0, STEP)) / STEP)
        elif name.startswith("tau."):
            columns[name] = x + TORQUE * np.std(x) * random.standard_normal(len(x))
    return ident.Log.from_arrays(exact.name, exact.t, columns)


def truth(fit: ident.Fit, values: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """True base parameters (n_ind,) in the fit's own combinations, and their scale."""
    columns, base = fit.columns, fit.estimate.base
    m, length = body_scales(fit.mechanism)
    size = np.stack([m, *[m * length] * 3, *[m * length**2] * 6], axis=1).ravel()[columns.rigid]
    size = np.append(size, [abs(values[name]) for name in columns.names[len(size) :]])
    x = columns.prior.copy()
    for i, name in enumerate(columns.names):
        x[i] = values.get(name, x[i])
    beta = x[base.independent] + base.K @ x[base.dependent]
    return beta, size[base.independent]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=40)
    runs = parser.parse_args().runs
    print(f"{runs} runs each; error over scale [%]: worst bias, worst std, worst rms; coverage [%]")
    with tempfile.TemporaryDirectory() as folder:
        for name in MOTIONS:
            model = mechanism(name, Path(folder))
            planted = {n: FRICTION[name][e.kind] for e in model.effects for n in e.names}
            exact, _ = ident.simulate(model, motion(name, 1), values=planted)
            for estimator in ("least-squares", "auto", "likelihood"):
                off, covered = [], []
                for run in range(runs):
                    done = ident.complete(model, logged(model, exact, run))
                    fit = ident.identify(model, done, estimator=estimator)
                    beta, scale = truth(fit, planted)
                    error = fit.estimate.solution.beta - beta
                    off.append(100 * error / scale)
                    covered.append(np.abs(error) <= 1.96 * np.sqrt(np.diag(fit.covariance)))
                ranks = {len(each) for each in off}
                if len(ranks) > 1:
                    print(f"{name:10} {estimator:14} ranks differ: {sorted(ranks)}")
                    continue
                bias, std = np.mean(off, axis=0), np.std(off, axis=0)
                rms = np.sqrt(np.mean(np.square(off), axis=0))
                share = 100 * np.mean(covered, axis=0)
                print(
                    f"{name:10} {estimator:14} {len(bias)} base parameters: "
                    f"{np.abs(bias).max():6.2f} {std.max():6.2f} {rms.max():6.2f}; "
                    f"{share.mean():5.1f} (lowest {share.min():.1f})"
                )


if __name__ == "__main__":
    main()
