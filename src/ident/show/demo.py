"""`ident demo`: a machine with a hidden effect, made from a seed, and how it is found.

The machine is simulated. What identification is given is what a user would have: a mechanism folder
whose URDF is some percent off, and a noisy log of the two drives.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from ident.effects import Effect
from ident.errors import IdentError
from ident.files import write_all
from ident.log import Log
from ident.mechanism import Mechanism, load
from ident.show.simulate import csv_text
from ident.simulate import Noise, simulate
from ident.text import listed, rounded

MACHINE = "picker"
SECONDS, STEP = 15.0, 0.004
NOISE = (Noise("q", 2e-5), Noise("tau", 0.01, relative=True))  # rad; share of the torque's rms
KNOWN = {
    "viscous.left.Fv": 0.03,
    "viscous.right.Fv": 0.025,
    "coulomb.left.Fc": 0.08,
    "coulomb.right.Fc": 0.06,
}
SECRETS: tuple[tuple[str, dict[str, tuple[float, float]]], ...] = (  # sizes from, to
    ("coulomb:left_elbow", {"Fc": (0.03, 0.07)}),
    ("coulomb:right_elbow", {"Fc": (0.03, 0.07)}),
    ("spring:right_elbow", {"k": (0.2, 0.4), "b": (-0.5, -0.2)}),
    ("ripple:left", {"A": (0.03, 0.07), "B": (-0.05, 0.05), "N": (12.0, 20.0)}),
    ("ripple:right", {"A": (0.03, 0.07), "B": (-0.05, 0.05), "N": (18.0, 28.0)}),
    ("end_stop:left", {"k": (2.0, 4.0), "q1": (2.2, 2.28), "side": (1.0, 1.0)}),
    ("end_stop:right", {"k": (2.0, 4.0), "q1": (0.72, 0.8), "side": (-1.0, -1.0)}),
    ("stribeck:left", {"Fs": (0.06, 0.14), "vs": (0.3, 0.5)}),
    ("load_friction:left", {"mu": (0.06, 0.1)}),
    ("load_friction:right", {"mu": (0.06, 0.1)}),
)


@dataclass(frozen=True, eq=False)
class Puzzle:
    """A mechanism folder with a log, and what the folder does not say. Made by `make_puzzle`.

    Attributes:
        seed: of everything that is random.
        folder: holds mechanism.toml, the URDF and the log.
        log: path of the log.
        answer: the hidden effect, with its values.
    """

    seed: int
    folder: Path
    log: Path
    answer: Effect

    @property
    def mechanism(self) -> Mechanism:
        """As its maker believes it to be."""
        return load(self.folder)

    @property
    def truth(self) -> dict[str, float]:
        """The answer's parameters by full name."""
        names = (each.name for each in self.answer.parameters)
        return {
            full: self.answer.values[name]
            for full, name in zip(self.answer.names, names, strict=True)
        }

    @property
    def hidden(self) -> str:
        """The answer in one line."""
        units = dict(zip(self.answer.names, self.answer.units, strict=True))
        values = (f"{n} = {v:.4g} {units[n]}".removesuffix(" 1") for n, v in self.truth.items())
        return f"{self.answer.label} ({self.answer.summary()}): {listed(values)}"


def make_puzzle(folder: str | Path, *, seed: int) -> Puzzle:
    """A machine's folder with a log, into a folder that has neither.

    Args:
        folder: made where there is none.
        seed: chooses the hidden effect, its size, the true inertias, the motion and the noise.

    Raises:
        IdentError: if the folder has a mechanism or a log already, or cannot be written.
    """
    folder = Path(folder)
    files = {
        name: (resources.files("ident.show") / MACHINE / name).read_bytes()
        for name in (f"{MACHINE}.urdf", "mechanism.toml")
    }
    for name in (*files, "run.csv"):
        if (folder / name).exists():
            raise IdentError(f"{folder}: has a {name} already; name a new folder")
    write_all(folder, files)
    mechanism = load(folder)
    rng = np.random.default_rng(seed)
    label, sizes = SECRETS[rng.integers(len(SECRETS))]
    truth = {name: float(rng.uniform(low, high)) for name, (low, high) in sizes.items()}
    true = mechanism.with_effect(label, truth)
    pi = mechanism.prior * np.repeat(rng.uniform(0.85, 1.2, len(mechanism.prior) // 10), 10)
    log, _ = simulate(
        true, _motion(rng), values=KNOWN, pi=pi, noise=NOISE, seed=seed, columns=("q", "tau")
    )
    write_all(folder, {"run.csv": csv_text(log).encode()})
    return Puzzle(seed, folder, folder / "run.csv", true.effects[-1])


def _motion(rng: np.random.Generator) -> Log:
    """Motion of both drives: four sines each, with a common period, inside the workspace."""
    t = np.arange(0.0, SECONDS, STEP)
    w = 2 * np.pi * np.array([0.2, 0.4, 0.6, 1.0])[:, None]
    q = {}
    for joint, (middle, half) in {"left": (1.96, 0.45), "right": (1.05, 0.4)}.items():
        phase = rng.uniform(0, 2 * np.pi, (4, 1))
        x = np.array([1.0, 0.8, 0.5, 0.35]) @ np.sin(w * t + phase)
        q[f"q.{joint}"] = middle + half * x / np.abs(x).max()
    return Log.from_arrays("run.csv", t, q)


def answered(made: Puzzle) -> str:
    """Return the truth beside what the diagnosis and the fit in the folder found."""
    content = (made.folder / "diagnosis" / "diagnosis.json").read_text(encoding="utf-8")
    found: dict[str, Any] = json.loads(content)
    if found["best"] is None:
        return f"The diagnosis gave no name: {found['verdict']}."
    first = found["candidates"][0]
    best, *rivals = (
        f"{each['effect']}:{','.join(each['joints'])}" for each in (first, *first["rivals"])
    )
    label, kind = made.answer.label, first["effect"]
    if best == label:
        fit = json.loads((made.folder / "after" / "fit.json").read_text(encoding="utf-8"))
        values = {v["name"]: v for each in fit["effects"] for v in each["parameters"]}
        texts = (f"{n} = {rounded(values[n]['value'], values[n]['stderr'])}" for n in made.truth)
        return f"Found{' among rivals that fit as well' if rivals else ''}: {listed(texts)}."
    if label in rivals:
        return (
            f"The diagnosis put {best} first and listed {label}, the true effect, as a rival that "
            "explains this log as well: the answer is the set, not its first name."
        )
    if kind in made.answer.nested_in and tuple(first["joints"]) == made.answer.joints:
        return (
            f"The diagnosis named {best}, which contains it: beside what they have in common its "
            "parameters should be zero within their errors."
        )
    return f"The diagnosis named {best}: wrong this time."
