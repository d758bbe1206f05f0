"""Machines on which mistakes are made, each with a clean log of known truth."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import loops

import ident
from helpers import MOTIONS, ROBOTS
from ident import Log, Mechanism, Noise

RATE, SECONDS = 200.0, 5.0
TORQUE_NOISE, ENCODER = 0.01, 2e-5  # share of a torque's rms; rad or m
FOREIGN = {"ur5": "ur5_robot.urdf", "panda": "panda.urdf"}  # of the package example-robot-data
Columns = dict[str, np.ndarray]
Terms = Mapping[str, tuple[float, list[tuple[int, float, float]]]]


@dataclass(frozen=True)
class Subject:
    """A machine: its files, the joints on which mistakes are made, and its usual motion.

    Attributes:
        urdf, toml: texts of its files.
        one, other: a joint in the middle of it, and another one; link: moved by `one`.
        terms: of the motion, by joint: offset and Fourier terms (harmonic, sin, cos).
    """

    name: str
    urdf: str
    toml: str
    one: str
    other: str
    link: str
    terms: Terms

    def load(self, folder: Path) -> Mechanism:
        """The mechanism of the texts, written into a folder."""
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "robot.urdf").write_text(self.urdf)
        (folder / "mechanism.toml").write_text(self.toml)
        return ident.load(folder).with_effect("viscous").with_effect("coulomb")

    @property
    def driven(self) -> list[str]:
        """Joints with a motor of which positions are logged."""
        return list(self.terms)

    def moving(self, scale: Callable[[str], float], slower: float = 1.0) -> Columns:
        """t, q, v, a of the driven joints, amplitudes scaled by joint."""
        t = np.arange(round(SECONDS * RATE)) / RATE
        w = 2 * np.pi / (SECONDS * slower)
        found: Columns = {"t": t}
        for joint, (offset, terms) in self.terms.items():
            q, v, a = np.full_like(t, offset), np.zeros_like(t), np.zeros_like(t)
            for k, s, c in terms:
                sin, cos = np.sin(k * w * t), np.cos(k * w * t)
                q += scale(joint) * (s * sin + c * cos)
                v += scale(joint) * k * w * (s * cos - c * sin)
                a -= scale(joint) * (k * w) ** 2 * (s * sin + c * cos)
            found |= {f"q.{joint}": q, f"v.{joint}": v, f"a.{joint}": a}
        return found


@dataclass(frozen=True, eq=False)
class Case:
    """A subject, a log of it, the values behind the log, and the mechanism that made it."""

    subject: Subject
    columns: Columns
    values: Mapping[str, float]
    truth: Mechanism

    def logged(self, **columns: np.ndarray) -> Case:
        """The same with other columns; `q__elbow` is q.elbow."""
        new = {name.replace("__", "."): x for name, x in columns.items()}
        return replace(self, columns={**self.columns, **new})

    def each(self, prefix: str, change: Callable[[np.ndarray], np.ndarray]) -> Case:
        """The same with all columns that begin so changed."""
        new = {n: change(x) if n.startswith(prefix) else x for n, x in self.columns.items()}
        return replace(self, columns=new)

    def rows(self, index: np.ndarray) -> Case:
        """The same with other rows."""
        return replace(self, columns={name: x[index] for name, x in self.columns.items()})

    def described(self, urdf: str | None = None, toml: str | None = None) -> Case:
        """The same log with other files."""
        own = self.subject
        return replace(self, subject=replace(own, urdf=urdf or own.urdf, toml=toml or own.toml))


def recorded(
    subject: Subject, mechanism: Mechanism, motion: Columns | None = None, seed: int = 1
) -> Case:
    """A log of the machine, its bodies heavier or lighter than the URDF's by up to 30 %."""
    random = np.random.default_rng(7)  # the machine is the same, whatever the log's noise
    values = dict(zip(mechanism.bodies.names, mechanism.prior, strict=True))
    factor = {link: 1 + 0.3 * random.uniform(-1, 1) for link in mechanism.bodies.links}
    for name in mechanism.unknown:
        values[name] *= factor[name.rpartition(".")[0]]
    for effect in mechanism.effects:
        for name in effect.names:
            values[name] = random.uniform(0.1, 0.3)
    usual = subject.moving(lambda joint: 1.0)

    def of(columns: Columns) -> Log:
        motion = {name: x for name, x in columns.items() if name != "t"}
        made, _ = ident.simulate(
            mechanism, Log.from_arrays("run.csv", columns["t"], motion), values=values
        )
        return made

    made = of(usual if motion is None else motion)
    reference = made if motion is None else of(usual)  # noise is that of the usual torques
    noise = np.random.default_rng(seed)
    found: Columns = {"t": made.t}
    for name, x in made.columns.items():
        sigma = ENCODER if name.startswith("q.") else 0.0
        if name.startswith("tau."):
            sigma = TORQUE_NOISE * float(np.sqrt(np.mean(reference.columns[name] ** 2)))
        if name.startswith(("v.", "a.")):
            sigma = 1e-3 * float(np.std(x))
        if name.partition(".")[2] in subject.driven or name.startswith(("tau.", "wrench.")):
            found[name] = x + sigma * noise.normal(size=len(x))
    return Case(subject, found, values, mechanism)


def positions_only(case: Case) -> Case:
    """The log without velocities and accelerations."""
    kept = {n: x for n, x in case.columns.items() if not n.startswith(("v.", "a."))}
    return replace(case, columns=kept)


# --- the machines ------------------------------------------------------------------------------


def shipped(name: str, one: str, other: str, link: str) -> Subject:
    """A robot of robots/."""
    folder = ROBOTS / name
    toml = re.sub(r'urdf = ".*"', 'urdf = "robot.urdf"', (folder / "mechanism.toml").read_text())
    terms = {joint: (offset, waves) for joint, (offset, _, waves) in MOTIONS[name].items()}
    return Subject(name, (folder / f"{name}.urdf").read_text(), toml, one, other, link, terms)


def foreign(name: str, one: str, other: str, link: str, centre: tuple[float, ...]) -> Subject:
    """A robot of the package example-robot-data, with its hand held."""
    files = distribution("example-robot-data").files or []
    (file,) = (each for each in files if each.name == FOREIGN[name])
    urdf = re.sub(r"<mimic[^>]*/>", "", Path(str(file.locate())).read_text())
    joints = re.findall(r'<joint name="([^"]+)" type="(?:revolute|continuous|prismatic)"', urdf)
    fingers = [joint for joint in joints if "finger" in joint]
    joints = [joint for joint in joints if joint not in fingers]
    held = ", ".join(f"{joint} = 0.0" for joint in fingers)
    toml = f'urdf = "robot.urdf"\ngravity = [0.0, 0.0, -9.81]\n\n[joints]\nlocked = {{ {held} }}\n'
    random, terms = np.random.default_rng(3), {}
    for joint, offset in zip(joints, centre, strict=True):
        waves = [(k, *(0.55 / k**0.7 * random.normal(size=2))) for k in (1, 2, 3)]
        terms[joint] = (offset, waves)
    return Subject(name, urdf, toml, one, other, link, terms)


def looped(name: str, one: str, other: str, link: str, terms: Terms) -> Subject:
    """A closed loop of `loops`."""
    urdf, toml = getattr(loops, name)()
    return Subject(name, urdf, toml, one, other, link, terms)


def subjects() -> Iterator[Subject]:
    """All machines that are at hand; what is not is said on standard error."""
    yield shipped("arm", "elbow", "shoulder", "forearm")
    yield shipped("five_bar", "left", "right", "left_distal")
    yield shipped("slider_crank", "theta", "s", "rod")
    try:
        yield foreign("ur5", "elbow_joint", "shoulder_lift_joint", "forearm_link",
                      (0.2, -1.0, 1.2, 0.3, 0.8, 0.1))  # fmt: skip
        yield foreign("panda", "panda_joint4", "panda_joint2", "panda_link4",
                      (0.1, 0.2, -0.3, -1.6, 0.4, 1.7, 0.2))  # fmt: skip
    except PackageNotFoundError:
        sys.stderr.write("ur5 and panda are left out: pip install example-robot-data\n")
    swing = [(1, 0.5, 0.2), (2, -0.15, 0.1)]
    yield looped("parallelogram", "crank", "rocker", "coupler_link", {"crank": (1.5, swing)})
    swing = [(1, 0.8, 0.3), (2, -0.3, 0.4)]
    yield looped("crank_slider", "crank", "slide", "rod", {"crank": (0.4, swing)})
    random, legs = np.random.default_rng(5), {}
    for number in range(6):
        waves = [(k, *(0.02 / k * random.normal(size=2))) for k in (1, 2, 3)]
        legs[f"leg{number}"] = (0.66, waves)
    yield looped("hexapod", "leg2", "leg0", "platform", legs)


def clean(subject: Subject, folder: Path) -> Case:
    """Its clean log with velocities and accelerations."""
    return recorded(subject, subject.load(folder))


__all__ = ["Case", "Noise", "Subject", "clean", "positions_only", "recorded", "subjects"]
