"""Robots as they ship: each loads, is checked, and identifies a simulated log of itself.

    python benchmarks/robots.py [--robosuite FILE_OR_FOLDER] [--only NAME] [--write]

Takes all URDFs of the package example-robot-data (`pip install example-robot-data`) and all robots
of robosuite (`pip download --no-deps robosuite`: the wheel, or the folder it is unpacked to).
Nothing of a robot's files is changed. The simulation is independent of ident: Pinocchio's RNEA on
the URDF as `pinocchio.buildModelFromUrdf` reads it, with torques of joints that mimic projected
onto those they follow, or MuJoCo's inverse dynamics on the MJCF, damping, dry friction and armature
included. The base is fixed, and a body that is free in
MJCF is locked. Motion: random sums of sines within the limits of position and speed,
100 Hz, 20 s, only positions and torques logged, torque noise of 0.5 % of each joint's rms.

A robot passes if its base parameters agree with the truth within their intervals (no more |z| above
1.96, and no larger one, than chance brings in one of a thousand robots of as many parameters) and
the torques of a second motion are predicted within 1 % of each joint's rms. Errors of one fit are
correlated, so chance brings more than that: of a robot that fails, ten further logs are
identified, and it passes if their intervals contain the truth in at least nine of ten cases. Each
robot runs in a process of its own; time is that of the processor for loading, both logs, the fit
and its summary, memory the most of the whole process, simulation included. `--write` puts the table
into docs/robots.md; rows of robots that are not of `--only` stay as they are.
"""

from __future__ import annotations

import argparse
import json
import re
import resource
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from scipy.stats import binom
from scipy.stats import t as student

import ident

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "robots.md"
RATE, PERIOD, CYCLES, HARMONICS = 100.0, 10.0, 2, 6  # Hz, s
NOISE = 0.005  # of the rms of a joint's torque
SHARE = 0.8  # of the range between the limits that is used
HALF = {True: 1.5, False: 0.3}  # range of a joint without limits: rotational [rad], sliding [m]
FASTEST = {True: 3.0, False: 0.5}  # [rad/s], [m/s]
RESOLVED = 1e-6  # of the largest torque of the robot, below which a joint has none
CHANCE, ERROR = 1e-3, 0.01
LOGS, SHARE_WITHIN = 10, 0.9  # after a failure: further logs; intervals of 95 % in these contain it
SQUARES = 15  # from which standard errors are estimated: about 20 blocks of time, windowed
COLUMNS = ("robot", "joints", "parameters", "within", "largest z", "χ²", "error", "time", "memory")
MARKS = ("<!-- robots -->", "<!-- /robots -->")


# --- files ---------------------------------------------------------------------------------------


def urdfs() -> list[Path]:
    """Return all URDFs of example-robot-data, none if it is not installed."""
    folders = [Path(p) / "cmeel.prefix/share/example-robot-data/robots" for p in sys.path]
    return next((sorted(f.rglob("*.urdf")) for f in folders if f.is_dir()), [])


def mjcfs(folder: Path) -> list[Path]:
    """Return all robots of robosuite below its folder."""
    return sorted(p for p in folder.rglob("robot.xml") if p.parent.parent.name == "robots")


def title(path: Path) -> str:
    """Return the name of a robot in the table: its folder's and its file's."""
    if path.suffix == ".xml":
        return f"robosuite/{path.parent.name}"
    own = next(p.name for p in path.parents if p.parent.name == "robots" and p.name != "robots")
    return f"{own.removesuffix('_description').removesuffix('_data')}/{path.stem}"


# --- simulation ----------------------------------------------------------------------------------

Series = tuple[np.ndarray, np.ndarray, np.ndarray]  # q, v, a: (n, joints)


@dataclass(frozen=True)
class Simulated:
    """A robot as a simulator has it.

    Attributes:
        joints: names; lower, upper, speed: their limits; rotational: by joint.
        tied: by joint that follows another: the other, ratio and offset.
        bodies: ten dynamic parameters of the body of each joint, where the simulator has the frame
            that ident has.
        torque: from q, v, a (n, joints) to torques (n, joints), those of followers included.
        effects: to be identified, with their values by joint.
        locked: joints of several coordinates, such as a free base, that are held.
    """

    joints: tuple[str, ...]
    lower: np.ndarray
    upper: np.ndarray
    speed: np.ndarray
    rotational: tuple[bool, ...]
    tied: Mapping[str, tuple[str, float, float]]
    bodies: Mapping[str, np.ndarray]
    torque: Any
    effects: Mapping[str, Mapping[str, float]]
    locked: tuple[str, ...] = ()


def by_pinocchio(path: Path) -> Simulated:
    """Read a URDF by Pinocchio alone."""
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    indices = range(1, model.njoints)
    names = tuple(model.names[i] for i in indices)
    lower, upper, rotational = [], [], []
    for i in indices:
        joint = model.joints[i]
        if joint.nv != 1:
            raise ValueError(f"joint {model.names[i]} has {joint.nv} velocities")
        scalar = joint.nq == 1
        lower.append(model.lowerPositionLimit[joint.idx_q] if scalar else -np.inf)
        upper.append(model.upperPositionLimit[joint.idx_q] if scalar else np.inf)
        rotational.append(joint.shortname().startswith("JointModelR"))

    def torque(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        out, full = np.empty_like(q), np.empty(model.nq)
        for k in range(len(q)):
            for i in indices:
                joint, x = model.joints[i], q[k, i - 1]
                full[joint.idx_q : joint.idx_q + joint.nq] = (
                    [x] if joint.nq == 1 else [np.cos(x), np.sin(x)]
                )
            out[k] = pin.rnea(model, data, full, v[k], a[k])
        return out

    tied = {}
    for joint in ElementTree.parse(path).getroot().findall("joint"):
        mimic = joint.find("mimic")
        if mimic is not None and joint.get("name") in names:
            tied[joint.get("name")] = (
                mimic.get("joint"),
                float(mimic.get("multiplier", "1")),
                float(mimic.get("offset", "0")),
            )
    bodies = {model.names[i]: model.inertias[i].toDynamicParameters() for i in indices}
    return Simulated(
        names, np.array(lower), np.array(upper), model.velocityLimit.copy(), tuple(rotational),
        tied, bodies, torque, {},
    )  # fmt: skip


def by_mujoco(path: Path) -> Simulated:
    """Read an MJCF by MuJoCo alone, free bodies welded; contacts and limits exert no force."""
    import mujoco

    spec = mujoco.MjSpec.from_file(str(path))
    free = [j for j in spec.joints if j.type == mujoco.mjtJoint.mjJNT_FREE]
    locked = tuple(j.name or f"{j.parent.name}_joint" for j in free)
    for joint in free:
        spec.delete(joint)
    model = spec.compile()
    off = mujoco.mjtDisableBit
    model.opt.disableflags |= off.mjDSBL_CONTACT | off.mjDSBL_LIMIT
    model.opt.disableflags |= off.mjDSBL_FRICTIONLOSS  # added below, without a solver's smoothing
    data = mujoco.MjData(model)
    names = tuple(model.joint(j).name for j in range(model.njnt))
    limited = model.jnt_limited.astype(bool)
    loss = model.dof_frictionloss.copy()

    def torque(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        out = np.empty_like(q)
        for k in range(len(q)):
            data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
            mujoco.mj_inverse(model, data)
            out[k] = data.qfrc_inverse + loss * np.sign(v[k])
        return out

    values = {"viscous": model.dof_damping, "coulomb": loss, "rotor_inertia": model.dof_armature}
    return Simulated(
        names,
        np.where(limited, model.jnt_range[:, 0], -np.inf),
        np.where(limited, model.jnt_range[:, 1], np.inf),
        np.full(len(names), np.inf),
        tuple(int(kind) == int(mujoco.mjtJoint.mjJNT_HINGE) for kind in model.jnt_type),
        {}, {}, torque,
        {kind: {n: float(x) for n, x in zip(names, of, strict=True) if x}
         for kind, of in values.items()},
        locked,
    )  # fmt: skip


def motion(robot: Simulated, seed: int) -> Series:
    """Return a periodic motion within the limits, joints that follow others included."""
    random = np.random.default_rng([seed, len(robot.joints)])
    t = np.arange(round(CYCLES * PERIOD * RATE)) / RATE
    w = 2 * np.pi / PERIOD * np.arange(1, HARMONICS + 1)[:, None]
    place = {name: j for j, name in enumerate(robot.joints)}
    x = np.zeros((3, len(t), len(place)))
    for j, name in enumerate(robot.joints):
        if name in robot.tied:
            continue
        turns = robot.rotational[j]
        low, high = robot.lower[j], robot.upper[j]
        for follower, (leader, ratio, offset) in robot.tied.items():
            if leader == name and ratio:
                k = place[follower]
                ends = sorted(
                    ((robot.lower[k] - offset) / ratio, (robot.upper[k] - offset) / ratio)
                )
                low, high = max(low, ends[0]), min(high, ends[1])
        if not high - low < 4 * HALF[turns]:
            middle = float(np.clip(0.0, low + HALF[turns], high - HALF[turns]))
            low, high = middle - HALF[turns], middle + HALF[turns]
        a = random.uniform(0.3, 1.0, HARMONICS) * random.choice([-1, 1], HARMONICS)
        phase = random.uniform(0, 2 * np.pi, HARMONICS)
        z = w * t + phase[:, None]
        shape = a @ np.sin(z)
        size = 0.5 * SHARE * max(high - low, 0.0) / np.abs(shape).max()
        limit = robot.speed[j] if robot.speed[j] > 0 else np.inf
        fastest = size * np.abs((a * w[:, 0]) @ np.cos(z)).max()
        size *= min(1.0, SHARE * min(limit, FASTEST[turns]) / max(fastest, 1e-9))
        x[0, :, j] = 0.5 * (low + high) + size * shape
        x[1, :, j] = size * ((a * w[:, 0]) @ np.cos(z))
        x[2, :, j] = -size * ((a * w[:, 0] ** 2) @ np.sin(z))
    for _ in robot.tied:  # one may follow another that follows
        for name, (leader, ratio, offset) in robot.tied.items():
            x[:, :, place[name]] = ratio * x[:, :, place[leader]]
            x[0, :, place[name]] += offset
    return x[0], x[1], x[2]


def log_of(robot: Simulated, seed: int) -> ident.Log:
    """Return a log of the joints that are driven: positions and noisy torques."""
    q, v, a = motion(robot, seed)
    tau, place = robot.torque(q, v, a), {name: j for j, name in enumerate(robot.joints)}
    for name, (leader, ratio, _) in reversed(robot.tied.items()):
        while leader in robot.tied:  # what the drive of the first leader feels
            leader, more, _ = robot.tied[leader]
            ratio *= more
        tau[:, place[leader]] += ratio * tau[:, place[name]]
    own = [j for j, name in enumerate(robot.joints) if name not in robot.tied]
    rms = np.sqrt((tau[:, own] ** 2).mean(axis=0))
    random = np.random.default_rng([seed, 7])
    sigma = NOISE * np.maximum(rms, RESOLVED * rms.max())
    noisy = tau[:, own] + sigma * random.standard_normal((len(tau), len(own)))
    columns = {f"q.{robot.joints[j]}": q[:, j] for j in own}
    columns |= {f"tau.{robot.joints[j]}": noisy[:, k] for k, j in enumerate(own)}
    return ident.Log.from_arrays(f"{seed}", np.arange(len(q)) / RATE, columns)


# --- one robot -----------------------------------------------------------------------------------


def distances(mechanism: ident.Mechanism, robot: Simulated, fit: ident.Fit) -> np.ndarray:
    """Return how far each base parameter is from the truth, in standard errors."""
    truth = dict(zip(mechanism.bodies.names, mechanism.prior, strict=True))
    if robot.bodies:
        for joint, link in zip(mechanism.joints, mechanism.bodies.links, strict=True):
            names = np.array(mechanism.bodies.names)[mechanism.bodies.columns(link)]
            truth |= dict(zip(names, robot.bodies[joint.name], strict=True))
    for effect in mechanism.effects:
        truth[effect.names[0]] = robot.effects[effect.kind][effect.joints[0]]
    x = np.array([truth[name] for name in fit.columns.names])
    base = fit.estimate.base
    off = fit.estimate.solution.beta - x[base.independent] - base.K @ x[base.dependent]
    return np.abs(off) / np.sqrt(np.diag(fit.covariance))


def measured(path: Path, seed: int = 1) -> dict[str, Any]:
    """Return what a robot's own log says about its identification."""
    robot = by_mujoco(path) if path.suffix == ".xml" else None
    locked = dict.fromkeys(robot.locked if robot else ())
    ident.load(path, locked=locked)  # first: what is no robot is refused in words
    robot = robot or by_pinocchio(path)
    logs = [log_of(robot, seed), log_of(robot, seed + 1)]
    begun = time.process_time()
    mechanism = ident.load(path, locked=locked)
    for kind, values in robot.effects.items():
        for joint in values:
            mechanism = mechanism.with_effect(f"{kind}:{joint}")
    train, other = (ident.complete(mechanism, log) for log in logs)
    fit = ident.identify(mechanism, train, validate=other)
    words = str(fit)
    seconds = time.process_time() - begun
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    z = distances(mechanism, robot, fit)
    (validation,) = fit.validation.values()
    torque = max(e.rms / e.relative for e in validation.values() if e.relative)
    error = max(
        (e.relative for e in validation.values() if e.relative and e.rms / e.relative
         > RESOLVED * torque), default=np.inf,
    )  # fmt: skip
    within = f"{100 * (z < 1.96).mean():.0f} %"
    outside = binom.sf((z >= 1.96).sum() - 1, len(z), 0.05)
    good = outside > CHANCE and z.max() < student.isf(0.5 * CHANCE / len(z), SQUARES)
    if not good:
        further = (log_of(robot, seed + 2 + k) for k in range(LOGS))
        fits = (ident.identify(mechanism, ident.complete(mechanism, log)) for log in further)
        each = np.concatenate([distances(mechanism, robot, x) for x in fits])
        good = (each < 1.96).mean() >= SHARE_WITHIN
        within += f"; {LOGS} further logs: {100 * (each < 1.96).mean():.0f} %"
    return {
        "passed": bool(good and error < ERROR),
        "joints": " ".join((str(len(mechanism.joints)), *(f"`--lock {n}`" for n in locked))),
        "parameters": len(z),
        "within": within,
        "largest z": f"{z.max():.1f}",
        "χ²": f"{(z**2).mean():.2f}",
        "error": f"{100 * error:.2g} %",
        "time": f"{seconds:.1f} s",
        "memory": f"{memory:.2f} GB",
        "words": words,
    }


# --- all of them ---------------------------------------------------------------------------------


def rows(paths: list[Path]) -> Iterator[str]:
    """Yield the table row of each robot."""
    for path in paths:
        command = [sys.executable, __file__, "--one", str(path)]
        run = subprocess.run(command, capture_output=True, text=True, check=False)
        if run.returncode:
            why = (run.stderr.strip().splitlines() or ["no reason"])[-1].replace(str(path), "")
            why = re.sub(r"^[\w.]*Error: *[:\d]*\s*", "", why)
            yield f"| {title(path)} | – {why} |{' |' * (len(COLUMNS) - 2)}"
            continue
        row = json.loads(run.stdout.splitlines()[-1])
        mark = "" if row["passed"] else " ✗"
        cells = (title(path) + mark, *(str(row[key]) for key in COLUMNS[1:]))
        yield f"| {' | '.join(cells)} |"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--only", metavar="NAME", help="robots whose name contains it")
    parser.add_argument("--robosuite", type=Path, metavar="FILE_OR_FOLDER")
    parser.add_argument("--write", action="store_true", help="put the table into docs/robots.md")
    parser.add_argument("--one", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.one:
        print(json.dumps(measured(given.one)))
        return
    with tempfile.TemporaryDirectory() as scratch:
        paths = urdfs()
        if not paths:
            print("no example-robot-data: pip install example-robot-data", file=sys.stderr)
        folder = given.robosuite
        if folder is not None and folder.suffix == ".whl":
            with zipfile.ZipFile(folder) as wheel:
                wheel.extractall(scratch)
            folder = Path(scratch)
        paths += mjcfs(folder) if folder is not None else []
        paths = [p for p in paths if not given.only or given.only in title(p)]
        lines = [f"| {' | '.join(COLUMNS)} |", f"|{'---|' * len(COLUMNS)}"]
        print(*lines, sep="\n")
        for line in rows(paths):
            lines.append(line)
            print(line, flush=True)
    print(f"\n{summary(lines[2:])}")
    if given.write:
        before, _, rest = PAGE.read_text().partition(MARKS[0])
        table, _, after = rest.partition(MARKS[1])
        every = {name_of(row): row for row in table.splitlines() if row.startswith("| ")}
        every |= {name_of(row): row for row in lines[2:]}
        head, *others = every.values()
        content = [MARKS[0], summary(others), "", head, lines[1], *sorted(others, key=name_of)]
        content.append(MARKS[1])
        PAGE.write_text(before + "\n".join(content) + after)


def name_of(row: str) -> str:
    """Return the robot of a row of the table."""
    return row.split("|")[1].strip().removesuffix(" ✗")


def summary(rows: Sequence[str]) -> str:
    """Return how many of each collection identify, of those that have a joint that moves."""
    counts = []
    for what, own in (("URDFs", False), ("robots of robosuite", True)):
        verdicts = [verdict(x) for x in rows if name_of(x).startswith("robosuite/") == own]
        counts.append(f"{verdicts.count(True)} of {len(verdicts) - verdicts.count(None)} {what}")
    return f"{' and '.join(counts)} identify."


def verdict(row: str) -> bool | None:
    """Return whether a row says that its robot passes; None: it has no joint that moves."""
    if "no joint that moves" in row or "has no <link>" in row:
        return None
    return "✗" not in row and "| –" not in row


if __name__ == "__main__":
    main()
