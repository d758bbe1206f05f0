"""Folders of logs of the arm: its own motions, friction and noise, and what differs in some."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import polars as pl

import ident
from helpers import ROBOTS
from ident import Log, Mechanism, Noise

FRICTION = {
    "coulomb.yaw.Fc": 0.8,
    "coulomb.shoulder.Fc": 1.0,
    "coulomb.elbow.Fc": 0.5,
    "coulomb.wrist.Fc": 0.2,
}
JOINTS = ("yaw", "shoulder", "elbow", "wrist")


def arm() -> Mechanism:
    """With dry friction in every joint."""
    return ident.load(ROBOTS / "arm").with_effect("coulomb")


def log_of(
    mechanism: Mechanism,
    seed: int,
    values: Mapping[str, float] | None = None,
    *,
    noise: float = 0.02,
    seconds: float = 5.0,
) -> Log:
    """A log of its own motion; `values` are what differs from the URDF and from `FRICTION`."""
    random = np.random.default_rng(seed)
    t = np.arange(0, seconds, 0.01)
    columns = {}
    for joint in JOINTS:
        w = 2 * np.pi * random.uniform(0.15, 1.0, 4)
        size, phase = random.uniform(0.15, 0.5, 4) / (0.5 + w), random.uniform(0, 6.28, 4)
        angle = np.outer(t, w) + phase
        columns[f"q.{joint}"] = np.sin(angle) @ size
        columns[f"v.{joint}"] = np.cos(angle) @ (size * w)
        columns[f"a.{joint}"] = -np.sin(angle) @ (size * w**2)
    motion = Log.from_arrays(f"run_{seed}.csv", t, columns)
    told = FRICTION | dict(values or {})
    made, _ = ident.simulate(
        mechanism, motion, values=told, noise=[Noise("tau", noise, relative=True)], seed=seed
    )
    return made


def written(folder: Path, logs: Mapping[str, Log]) -> Path:
    """Logs as CSV files of a folder, by name."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, log in logs.items():
        pl.DataFrame({"t": log.t, **log.columns}).write_csv(folder / name)
    return folder
