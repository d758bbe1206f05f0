"""Twelve robots, each with a hidden effect: what does `ident diagnose` say? Makes docs/gallery.md.

    python benchmarks/gallery.py [--only NAME] [--out FOLDER] [--write]

Robots are URDFs of the package example-robot-data, as they ship. Motion and torques are those of
robots.py: random sums of sines, Pinocchio's RNEA, 0.5 % noise; the effect is added by its formula,
written here, in one joint. Each log is kept in FOLDER, with the command that finds the effect in
it. `--write` writes the page and its pictures.
"""

from __future__ import annotations

import argparse
import io
import re
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from robots import Simulated, by_pinocchio, log_of, urdfs

import ident
from ident.fit.identify import Comparison
from ident.show.residual import plot_joint

DOCS = Path(__file__).resolve().parents[1] / "docs"
INCHES, DOTS = 7.5, 60  # width of a picture, dots an inch
Torque = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Hidden:
    """An effect in one joint: its name in the library, words, and torque from q, v, a (n,)."""

    robot: str
    file: str
    joint: int
    kind: str
    words: str
    torque: Torque


def presliding(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Return 0.05 N m of friction that is reached after some 0.1 rad (Dahl)."""
    z = np.zeros(len(q))
    for k, dq in enumerate(np.diff(q), start=1):
        z[k] = (z[k - 1] + 0.5 * dq * (2 - np.sign(dq) * z[k - 1] / 0.1)) / (1 + abs(dq) / 0.2)
    return 0.05 * z / 0.1


HIDDEN = (
    Hidden("UR5", "ur5_robot.urdf", 1, "spring", "a spring of 12 N m/rad", lambda q, v, a: 12 * q),
    Hidden("UR10", "ur10_robot.urdf", 2, "coulomb", "dry friction of 4 N m",
           lambda q, v, a: 4 * np.sign(v)),
    Hidden("UR3", "ur3_robot.urdf", 4, "rotor_inertia", "a rotor of 0.05 kg m²",
           lambda q, v, a: 0.05 * a),
    Hidden("Panda", "panda.urdf", 3, "viscous", "viscous friction of 2 N m s/rad",
           lambda q, v, a: 2 * v),
    Hidden("xArm7", "xarm7.urdf", 2, "drag", "drag of 1.5 N m s²/rad²",
           lambda q, v, a: 1.5 * v * np.abs(v)),
    Hidden("Z1", "z1.urdf", 1, "stribeck", "2 N m more friction at low speed",
           lambda q, v, a: np.sign(v) * (1 + 2 * np.exp(-((v / 0.3) ** 2)))),
    Hidden("Go2, a leg", "go2.urdf", 2, "torque_offset", "an offset of 0.8 N m",
           lambda q, v, a: 0.8 + 0 * q),
    Hidden("ANYmal C", "anymal.urdf", 1, "rotor_inertia", "a rotor of 0.3 kg m²",
           lambda q, v, a: 0.3 * a),
    Hidden("Solo 12", "solo12.urdf", 1, "coulomb", "dry friction of 0.05 N m",
           lambda q, v, a: 0.05 * np.sign(v)),
    Hidden("Bolt", "bolt.urdf", 2, "viscous", "viscous friction of 0.05 N m s/rad",
           lambda q, v, a: 0.05 * v),
    Hidden("SO-101", "so101.urdf", 1, "ripple", "a ripple of 12 waves a turn",
           lambda q, v, a: 0.06 * np.sin(12 * q)),
    Hidden("Finger", "finger_edu.urdf", 1, "hysteresis", "dry friction with presliding",
           presliding),
)  # fmt: skip


def with_hidden(robot: Simulated, hidden: Hidden) -> Simulated:
    """Return a robot with the effect in its joint."""
    inner, j = robot.torque, hidden.joint

    def torque(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        tau = inner(q, v, a)
        tau[:, j] += hidden.torque(q[:, j], v[:, j], a[:, j])
        return tau

    return replace(robot, torque=torque)


def shown(hidden: Hidden, folder: Path) -> tuple[str, bytes]:
    """Diagnose a robot; return its section of the page, and its picture."""
    path = next(p for p in urdfs() if p.name == hidden.file)
    robot = by_pinocchio(path)
    log = with_hidden(robot, hidden)
    name = f"{path.stem}.csv"
    log_of(log, 3).write(folder / name)
    mechanism = ident.load(path)
    motion = ident.complete(mechanism, folder / name)
    d = ident.diagnose(ident.identify(mechanism, motion, estimator="least-squares"))
    short = d.short.replace(str(path), path.name)
    planted = f"{hidden.words} in {robot.joints[hidden.joint]} (`{hidden.kind}`)"
    above = re.split(r"\n\n(?:  ident[ .]|Next|--verbose)", short)[0]
    lines = [f"## {hidden.robot}", "", f"Hidden: {planted}.", "", "```", above]
    lines += ["```", "", "```sh", f"ident diagnose {path.name} {name}", "```", ""]
    first = next((x for x in d.candidates if d.best is not None and x.fit is not None), None)
    joint, models = robot.joints[hidden.joint], {"as it is": d.fit.residual}
    if first is not None:
        joint = first.joint
        models[f"with {first.effect.label}"] = ident.residual_of(first.fit)
    chart = replace(plot_joint(Comparison(models, {}), joint), width=INCHES)
    picture = io.BytesIO()
    chart.savefig(picture, format="png", dpi=DOTS)
    lines += [f"![{chart.words}](pictures/gallery_{path.stem}.png)", ""]
    return "\n".join(lines), picture.getvalue()


def largest_fall(section: str) -> float:
    """Return by how many times the error of a joint falls at most in a section of the page."""
    ends = re.findall(r"([\d.]+) % → ([\d.]+) %", section)
    return max((float(before) / float(now) for before, now in ends), default=0.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", default="", metavar="NAME")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="keep the logs here")
    parser.add_argument("--write", action="store_true")
    given = parser.parse_args()
    head = (DOCS / "gallery.md").read_text().partition("\n## ")[0].rstrip()
    sections, pictures = [], {}
    with tempfile.TemporaryDirectory() as scratch:
        folder = given.out or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        for hidden in HIDDEN:
            if given.only.lower() not in hidden.robot.lower():
                continue
            section, picture = shown(hidden, folder)
            print(section, flush=True)
            sections.append(section)
            pictures[f"gallery_{Path(hidden.file).stem}.png"] = picture
    if given.write and not given.only:
        sections.sort(key=largest_fall, reverse=True)
        (DOCS / "gallery.md").write_text("\n".join([head, "", *sections]))
        for name, picture in pictures.items():
            (DOCS / "pictures" / name).write_bytes(picture)


if __name__ == "__main__":
    main()
