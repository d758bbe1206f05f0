"""Logs of the arm that change while they run, by the project's own simulation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

import ident
from helpers import ROBOTS
from ident import Log, Mechanism, Motion

RATE, CUTOFF, KNOTS = 100.0, 6.0, 0.12
FRICTION = {"yaw": (0.5, 1.0), "shoulder": (0.8, 1.5), "elbow": (0.4, 0.8), "wrist": (0.05, 0.1)}
RANGE = {"yaw": (0.0, 1.3), "shoulder": (-0.55, 0.5), "elbow": (0.9, 0.7), "wrist": (0.2, 1.4)}
SIGMA = {"yaw": 0.06, "shoulder": 0.06, "elbow": 0.03, "wrist": 0.006}  # N m
Columns = dict[str, np.ndarray]


def arm() -> tuple[Mechanism, dict[str, float]]:
    """With friction in all joints, and its true values."""
    mechanism = ident.load(ROBOTS / "arm").with_effect("viscous").with_effect("coulomb")
    values = {}
    for joint, (Fv, Fc) in FRICTION.items():
        values |= {f"viscous.{joint}.Fv": Fv, f"coulomb.{joint}.Fc": Fc}
    return mechanism, values


def known(mechanism: Mechanism, values: Mapping[str, float]) -> Mechanism:
    """With nothing unknown."""
    effects = tuple(
        replace(e, values={e.parameters[0].name: values[e.names[0]]}) for e in mechanism.effects
    )
    return replace(mechanism, effects=effects, unknown=())


def motion_log(rng: np.random.Generator, seconds: float) -> Log:
    """Three sines a joint."""
    t = np.arange(round(seconds * RATE)) / RATE
    columns = {}
    for joint, (centre, half) in RANGE.items():
        share = rng.uniform(0.5, 1.0, 3)
        x = np.full(len(t), centre)
        for a, f in zip(half * share / share.sum(), (0.3, 0.62, 1.06), strict=True):
            x = x + a * np.sin(2 * np.pi * (f * rng.uniform(0.85, 1.15) * t + rng.uniform()))
        columns[f"q.{joint}"] = x
    return Log.from_arrays("arm.csv", t, columns)


def run(
    seed: int,
    seconds: float,
    changes: Mapping[float, tuple[str, Mapping[str, float]]] | None = None,
    louder: float = 1.0,
) -> Motion:
    """Completed; from each time [s] on with the torques of another model, all noisy.

    Args:
        seed: of motion and noise.
        seconds: of the log.
        changes: by time, an effect that there is then (or none) and values beyond the usual ones.
        louder: factor of the wrist's noise from the first of them on.
    """
    rng = np.random.default_rng(seed)
    mechanism, values = arm()
    motion = motion_log(rng, seconds)
    log, _ = ident.simulate(mechanism, motion, values=values, columns=("q", "tau"))
    columns: Columns = dict(log.columns)
    for begins, (label, given) in (changes or {}).items():
        other = mechanism.with_effect(label) if label else mechanism
        made, _ = ident.simulate(other, motion, values={**values, **given}, columns=("q", "tau"))
        for name, x in columns.items():
            columns[name] = np.where(log.t < begins, x, made.columns[name])
    for name in columns:
        sigma = SIGMA[name[4:]] if name.startswith("tau.") else 2e-5
        more = np.where(
            log.t < min(changes or [np.inf]), 1.0, louder if name == "tau.wrist" else 1.0
        )
        columns[name] = columns[name] + sigma * more * rng.standard_normal(len(log.t))
    noisy = Log.from_arrays("arm.csv", log.t, columns)
    return ident.complete(mechanism, noisy, cutoff=CUTOFF, smoothing=KNOTS)


def joined(*motions: Motion) -> Motion:
    """Several logs as one motion."""
    return replace(motions[0], experiments=tuple(e for m in motions for e in m.experiments))
