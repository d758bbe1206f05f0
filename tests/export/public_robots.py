"""Robots of the package example-robot-data, with logs of known truth."""

from __future__ import annotations

import re
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import numpy as np
import pytest

import ident
from ident import Log, Mechanism

PUBLIC = {"ur5": "ur5_robot.urdf", "panda": "panda.urdf"}
CENTRE = {"ur5": (0.2, -1.0, 1.2, 0.3, 0.8, 0.1), "panda": (0.1, 0.2, -0.3, -1.6, 0.4, 1.7, 0.2)}


def public_robot(name: str, folder: Path) -> Path:
    """Write a robot's folder with its hand held, without its meshes; skip where it is missing."""
    try:
        files = distribution("example-robot-data").files or []
    except PackageNotFoundError:
        pytest.skip("needs the robots' files: pip install example-robot-data")
    (file,) = (each for each in files if each.name == PUBLIC[name])
    text = Path(str(file.locate())).read_text()
    text = re.sub(r"<mimic[^>]*/>|<(visual|collision)\b.*?</\1>", "", text, flags=re.DOTALL)
    fingers = re.findall(r'<joint name="([^"]*finger[^"]*)" type="prismatic"', text)
    held = ", ".join(f"{joint} = 0.0" for joint in fingers)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.urdf").write_text(text)
    (folder / "mechanism.toml").write_text(
        f'urdf = "{name}.urdf"\n[joints]\nlocked = {{ {held} }}\n'
    )
    return folder


def wave(n: int, centre: np.ndarray, seed: int, seconds: float, size: float = 0.5) -> tuple:
    """Return t (m,), q, v, a (m, n): two harmonics a joint about a centre, from rest at it."""
    random, t = np.random.default_rng(seed), np.arange(0.0, seconds, 0.004)
    w = 2 * np.pi / seconds * np.array([[2.0], [5.0]])
    a, b = size * random.normal(size=(2, 2, n))
    s, c = np.sin(w * t)[:, :, None], np.cos(w * t)[:, :, None]
    w = w[:, :, None]
    a, b = a[:, None], b[:, None]
    q = centre + (a * s + b * (1 - c)).sum(axis=0) * 0.5
    v = ((a * c + b * s) * w).sum(axis=0) * 0.5
    return t, q, v, ((b * c - a * s) * w**2).sum(axis=0) * 0.5


def noisy_log(mechanism: Mechanism, name: str, values: dict[str, float], seed: int = 0) -> Log:
    """Return a log of the robot with sensors' noise on positions and torques."""
    joints = mechanism.driven
    t, *states = wave(len(joints), np.array(CENTRE[name]), seed, 6.0)
    columns = {f"{c}.{j}": x[:, i] for c, x in zip("qva", states, strict=True)
               for i, j in enumerate(joints)}  # fmt: skip
    log, _ = ident.simulate(
        mechanism, Log.from_arrays(name, t, columns), values=values, seed=seed,
        noise=[ident.Noise("q", 2e-5), ident.Noise("tau", 0.03, relative=True)],
        columns=("q", "tau"),
    )  # fmt: skip
    return log
