"""Machines with something hidden, made from a seed, for `ident demo`.

The machines are simulated. What identification is given is what a user would have: a mechanism
folder, and noisy logs: of a five-bar whose URDF is some percent off the torques of its drives, of
an arm of position servos commands and positions only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ident.errors import IdentError
from ident.files import write_all
from ident.text import listed

if TYPE_CHECKING:
    from ident.effects import Effect
    from ident.log import Log
    from ident.mechanism import Mechanism

MACHINE, SERVOS = "picker", "servo_arm"
SECONDS, STEP = 15.0, 0.004
SERVO_STEP, COMPARED = 0.005, 4.0  # s; the last seconds of a log of servos are one of their own
NOISE = {"q": (2e-5, False), "tau": (0.01, True)}  # rad; share of the torque's rms
ENCODER = 1.1e-4  # rad, noise of one of 14 bit
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
DRIVES = {  # usual values of the servos: kp, kd with viscous friction, dry friction, rotor inertia
    "yaw": (20.0, 0.5, 0.12, 0.012),
    "shoulder": (25.0, 0.6, 0.15, 0.014),
    "elbow": (14.0, 0.3, 0.08, 0.008),
}
MIDDLES = {"yaw": 0.0, "shoulder": -0.6, "elbow": 1.0}  # rad, of the commands
DELAY = (0.004, 0.012)  # s
SPREAD = (0.8, 1.25)  # of values about the usual ones
SERVO_SECRETS: tuple[tuple[str, dict[str, tuple[float, float]]], ...] = (
    ("spring:yaw", {"k": (0.3, 0.6), "b": (-0.2, 0.2)}),
    ("spring:elbow", {"k": (0.3, 0.6), "b": (-0.6, -0.3)}),
    ("load_friction:elbow", {"mu": (0.08, 0.15)}),
    ("position_friction:yaw", {"F1": (0.05, 0.1), "F2": (0.1, 0.2)}),
    ("ripple:shoulder", {"A": (0.05, 0.1), "B": (-0.05, 0.05), "N": (12.0, 20.0)}),
    ("ripple:elbow", {"A": (0.03, 0.06), "B": (-0.05, 0.05), "N": (12.0, 20.0)}),
    ("end_stop:elbow", {"k": (4.0, 8.0), "q1": (1.08, 1.16), "side": (1.0, 1.0)}),
)


@dataclass(frozen=True, eq=False)
class Puzzle:
    """A mechanism folder with a log, and what the folder does not say. Made by `make_puzzle` or
    `make_servo_puzzle`.

    Attributes:
        folder: holds mechanism.toml, the URDF and the log.
        log: path of the log.
        answer: the hidden effect, with its values.
        drives: values of what the folder leaves unknown beside, by full name.
    """

    folder: Path
    log: Path
    answer: Effect
    drives: Mapping[str, float] = field(default_factory=dict)

    @property
    def mechanism(self) -> Mechanism:
        """As its maker believes it to be."""
        from ident.mechanism import load

        return load(self.folder)

    @property
    def truth(self) -> dict[str, float]:
        """The answer's parameters by full name."""
        return {full: self.answer.values[full.rpartition(".")[2]] for full in self.answer.names}

    @property
    def hidden(self) -> str:
        """The answer in one line."""
        pairs = zip(self.truth.items(), self.answer.units, strict=True)
        values = (f"{name} = {x:.4g} {unit}".removesuffix(" 1") for (name, x), unit in pairs)
        return f"{self.answer.label} ({self.answer.summary()}): {listed(values)}"


def make_puzzle(folder: str | Path, *, seed: int) -> Puzzle:
    """Make a machine's folder with a log, where there is neither; the seed chooses the hidden
    effect, its size, the true inertias, the motion and the noise.
    """
    from ident.mechanism import load
    from ident.simulate import Noise, simulate

    folder = _begun(folder, MACHINE, "run.csv")
    mechanism = load(folder)
    rng = np.random.default_rng(seed)
    label, truth = _secret(rng, SECRETS)
    true = mechanism.with_effect(label, truth)
    pi = mechanism.prior * np.repeat(rng.uniform(0.85, 1.2, len(mechanism.prior) // 10), 10)
    noise = [Noise(name, size, relative=relative) for name, (size, relative) in NOISE.items()]
    log, _ = simulate(
        true, _motion(rng), values=KNOWN, pi=pi, noise=noise, seed=seed, columns=("q", "tau")
    )
    write_all(folder, {"run.csv": log.polars().write_csv().encode()})
    return Puzzle(folder, folder / "run.csv", true.effects[-1])


def _motion(rng: np.random.Generator) -> Log:
    """Motion of both drives: four sines each, with a common period, to both ends of a range, where
    an end stop is touched.
    """
    from ident.log import Log

    t = np.arange(0.0, SECONDS, STEP)
    w = 2 * np.pi * np.array([0.2, 0.4, 0.6, 1.0])[:, None]
    q = {}
    for joint, (middle, half) in {"left": (1.96, 0.45), "right": (1.05, 0.4)}.items():
        phase = rng.uniform(0, 2 * np.pi, (4, 1))
        x = np.array([1.0, 0.8, 0.5, 0.35]) @ np.sin(w * t + phase)
        q[f"q.{joint}"] = middle + half * (2 * (x - x.min()) / np.ptp(x) - 1)
    return Log.from_arrays("run.csv", t, q)


def make_servo_puzzle(folder: str | Path, *, seed: int) -> Puzzle:
    """Make an arm of position servos with two logs, of commands and positions, where there is none;
    the seed chooses the hidden effect, gains, friction, delay, commands and noise.

    `run.csv` is to be identified, `other.csv`, the seconds after it, to be compared.
    """
    from ident.mechanism import load
    from ident.simulate import Noise, Torques, integrate

    folder = _begun(folder, SERVOS, "run.csv", "other.csv")
    mechanism = load(folder)
    rng = np.random.default_rng(seed)
    label, truth = _secret(rng, SERVO_SECRETS)
    drives = {f"command_delay.{','.join(DRIVES)}.d": float(rng.uniform(*DELAY))}
    for joint, usual in DRIVES.items():
        names = "servo.{}.kp", "servo.{}.kd", "coulomb.{}.Fc", "rotor_inertia.{}.Ia"
        values = (np.array(usual) * rng.uniform(*SPREAD, len(usual))).tolist()
        drives |= dict(zip((name.format(joint) for name in names), values, strict=True))
    true = mechanism.with_effect(label, truth)
    run = integrate(
        true, Torques(_commands(rng)), values=drives, columns=("q",), tolerance=1e-5,
        noise=[Noise("q", ENCODER)], seed=seed,
    )  # fmt: skip
    columns = [f"{kind}.{joint}" for joint in DRIVES for kind in ("ref", "q")]
    rows = run.log.polars().select("t", *columns)
    count = len(rows) - round(COMPARED / SERVO_STEP)
    logs = {"run.csv": rows.head(count), "other.csv": rows.tail(len(rows) - count)}
    write_all(folder, {name: log.write_csv().encode() for name, log in logs.items()})
    return Puzzle(folder, folder / "run.csv", true.effects[-1], drives)


def _commands(rng: np.random.Generator) -> Log:
    """Commands of all servos: four sines each; the arm is taken to begin where it is told to be."""
    from ident.log import Log

    t = np.arange(0.0, SECONDS, SERVO_STEP)
    columns = dict[str, np.ndarray]()
    for joint, middle in MIDDLES.items():
        f, phase = rng.uniform(0.15, 1.6, (4, 1)), rng.uniform(0, 2 * np.pi, (4, 1))  # Hz, rad
        size = rng.uniform(0.1, 0.3, 4) / np.sqrt(1 + f[:, 0])
        x = middle + size @ np.sin(2 * np.pi * f * t + phase)
        columns |= {f"q.{joint}": x, f"ref.{joint}": x}
    return Log.from_arrays("run.csv", t, columns)


def _secret(
    rng: np.random.Generator, secrets: tuple[tuple[str, dict[str, tuple[float, float]]], ...]
) -> tuple[str, dict[str, float]]:
    """Draw an effect and its values."""
    label, sizes = secrets[rng.integers(len(secrets))]
    return label, {name: float(rng.uniform(low, high)) for name, (low, high) in sizes.items()}


def _begun(folder: str | Path, machine: str, *logs: str) -> Path:
    """Write the files of a machine into a folder that has neither them nor the logs to come."""
    folder = Path(folder)
    files = {
        name: (resources.files("ident.show") / machine / name).read_bytes()
        for name in (f"{machine}.urdf", "mechanism.toml")
    }
    for name in (*files, *logs):
        if (folder / name).exists():
            raise IdentError(f"{folder}: has a {name} already; name a new folder")
    write_all(folder, files)
    return folder
