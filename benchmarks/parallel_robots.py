"""Machines with closed loops as others write them, identified from the logs of their motors alone.

    python benchmarks/parallel_robots.py FOLDER [--only NAME …]

FOLDER is a checkout of Gepetto/example-parallel-robots (git clone, 52e64b3), whose folders have a
URDF and a robot.yaml (Extended URDF). Nothing of a robot's files is changed. The log of each is
independent of ident's equations: the motors move by sums of sines (`AMPLITUDE`, reduced where a
loop leaves its singularity-free range), all other joints follow, and torques and multipliers come
from Pinocchio's RNEA and Jacobians of the closures' frames, by least squares of [−Jᵀ S]. The
motors' positions (noise 1e-6 rad) and torques (0.1 % of rms) are logged, nothing else; only of a
machine with more freedoms than motors (a foot that hangs) the position of the passive joint, too.

`rank` is how many parameters the log determines: columns of which more than `TOLERANCE` is new, of
unknowns whose plausible change moves torques by more than `NOTHING` of what the largest moves.
`SVD` is the number of singular values above `RANK` of ZᵀΓ by Pinocchio, its columns of length 1,
null ones (`NOTHING`) left out. `held` of these the noise leaves worse known than a prior is.
`torque` is ‖W (p − p₀)‖ / ‖W p₀‖ with W the rows of the SVD. `multipliers` is the largest error of
those that are determined: by the loops, and by the log within `DETERMINED`, standard error by the
fit's own account; `any` of all that the loops determine; both as a share of the norm of all.
Time is processor time of `identify` a sample, memory the most of the process.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import ident
from ident.errors import IdentError
from ident.information.estimate import rank_revealing
from ident.information.linear import Triangle
from ident.mechanism.mechanism import Mechanism
from ident.motion.closures import best_conditioned
from ident.motion.motion import prescribed

RATE, DURATION = 200.0, 5.0  # Hz, s
AMPLITUDE, REDUCED = 0.4, 0.7  # rad; factor where a loop cannot follow
SLIDES = 0.1  # m/rad: of slides beside angles
HARMONICS = (2, 3, 5, 8, 13)  # of 1 / DURATION
NOISE_Q, NOISE_TAU = 1e-6, 1e-3  # rad | m; share of the rms
EDGE = 0.5  # s at both ends of the log whose multipliers are not compared
RANK = 1e-6  # of the largest singular value
TOLERANCE = 1e-6  # share of a column that is new
NOTHING = 1e-6  # of the largest column times its unknown's plausible change
DETERMINED = 0.01  # standard error of a multiplier, of the norm of all
LIMIT = 600  # s for each robot
COLUMNS = (
    "robot", "joints", "equations", "rank J", "dof", "motors", "idle", "assembles", "rank", "SVD",
    "held", "torque", "multipliers", "of", "any", "µs a sample", "GB",
)  # fmt: skip


def robots(folder: Path) -> list[Path]:
    """Return the URDFs that have a robot.yaml beside them."""
    return sorted(next(x.parent.glob("*.urdf")) for x in (folder / "robots").rglob("robot.yaml"))


def jacobian(mechanism: Mechanism, data: pin.Data, q: np.ndarray) -> np.ndarray:
    """Return the Jacobian (m, nv) of all closures by Pinocchio; rows of any scale and order."""
    model = mechanism.model
    pin.computeJointJacobians(model, data, q)
    rows = []
    for closure in mechanism.closures:
        if not closure.frames:
            tie = mechanism.kinematics.closure_rows(q[None]).rate[0]  # ratios of joints, constant
            at = [x.name for x in mechanism.closures].index(closure.name)
            rows.append(tie[mechanism.kinematics.rows_of_closures[at]])
            continue
        first, second = closure.frames
        places = [data.oMi[f.joint] * f.placement for f in (first, second)]
        twists = [
            place.toActionMatrixInverse() @ pin.getJointJacobian(model, data, f.joint, pin.WORLD)
            for f, place in zip((first, second), places, strict=True)
        ]
        between = places[0].inverse() * places[1]
        relative = between.toActionMatrix() @ twists[1] - twists[0]
        if type(closure).__name__ == "PointClosure":
            apart = between.translation  # the velocity of the second point, seen from the first
            relative = relative[:3] - pin.skew(apart) @ relative[3:]
        rows.append(relative)
    return np.concatenate(rows)


def logged(mechanism: Mechanism) -> tuple[str, ...]:
    """Return the joints whose positions are logged: motors and what they leave free."""
    free = best_conditioned(mechanism, mechanism.general[None])
    return tuple(dict.fromkeys((*mechanism.driven, *free)))


def motors_motion(mechanism: Mechanism, seed: int) -> tuple[np.ndarray, Any]:
    """Return times and the state of a motion of the motors, with the largest amplitude that goes.

    Raises:
        IdentError: if the loops cannot follow even a tenth of a degree.
    """
    random, t = np.random.default_rng(seed), np.arange(int(RATE * DURATION)) / RATE
    names = logged(mechanism)
    places = [mechanism.joint(name).index for name in names]
    waves = 2 * np.pi * np.array(HARMONICS) / DURATION
    phases = random.uniform(0, 2 * np.pi, (len(names), len(waves)))
    shares = random.uniform(0.3, 1, phases.shape) / np.sqrt(HARMONICS)
    shares /= shares.sum(axis=1, keepdims=True)
    shares[[not mechanism.joint(name).rotational for name in names]] *= SLIDES
    amplitude = AMPLITUDE
    while True:
        known = np.zeros((3, len(t), len(names)))
        for i in range(len(names)):
            angle = np.outer(t, waves) + phases[i]
            known[0, :, i] = mechanism.assembled[places[i]]
            known[0, :, i] += amplitude * (np.sin(angle) - np.sin(phases[i])) @ shares[i]
            known[1, :, i] = amplitude * (np.cos(angle) * waves) @ shares[i]
            known[2, :, i] = -amplitude * (np.sin(angle) * waves**2) @ shares[i]
        try:
            return t, prescribed(mechanism, "run", t, names, known).experiments[0]
        except IdentError:
            amplitude *= REDUCED
            if amplitude < 2e-3:
                raise


def measure(path: Path) -> dict[str, Any]:
    """Return the row of one robot."""
    row: dict[str, Any] = {"robot": path.parent.name}
    if path.parent.parent.name != "robots":
        row["robot"] = f"{path.parent.parent.name}/{path.parent.name}"
    try:
        mechanism = ident.load(path).with_calibration("exact")  # noise is all that is wrong
    except IdentError as error:
        return row | {"error": str(error)}
    row |= {
        "joints": len(mechanism.joints), "equations": len(mechanism.kinematics.multipliers),
        "motors": len(mechanism.driven), "idle": len(mechanism.idle),
        "assembles": mechanism.assembly.closed,
    }  # fmt: skip
    try:
        mechanism.assembled  # noqa: B018
        row |= {"rank J": mechanism.rank, "dof": mechanism.degrees_of_freedom}
        t, e = motors_motion(mechanism, 0)
        row |= identified(mechanism, t, e)
    except IdentError as error:
        row["error"] = str(error)
    row["GB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    return row


def identified(mechanism: Mechanism, t: np.ndarray, e: Any) -> dict[str, Any]:
    """Return what the motors' log identifies, against the truth."""
    model, data = mechanism.model, mechanism.model.createData()
    random, n, m = np.random.default_rng(1), len(t), len(mechanism.kinematics.multipliers)
    places = [mechanism.joint(name).index for name in mechanism.driven]
    S = np.eye(model.nv)[:, places]
    torques, lam, W = np.zeros((n, len(places))), np.zeros((n, m)), []
    jacobians = mechanism.kinematics.closure_rows(e.q).rate
    for k in range(n):
        forces = pin.rnea(model, data, e.q[k], e.v[k], e.a[k])
        solved = np.linalg.lstsq(np.hstack([-jacobians[k].T, S]), forces, rcond=1e-9)[0]
        lam[k], torques[k] = solved[:m], solved[m:]
        if k % 10 == 0:
            K = jacobian(mechanism, data, e.q[k])
            sizes = np.linalg.svd(K, compute_uv=False)
            Z = np.linalg.svd(K)[2][int((sizes > 1e-9 * sizes[0]).sum()) :].T
            gamma = pin.computeJointTorqueRegressor(model, data, e.q[k], e.v[k], e.a[k])
            W.append(Z.T @ gamma)
    _, sizes, directions = np.linalg.svd(jacobians[n // 2].T)
    null = directions[int((sizes > 1e-9 * sizes[0]).sum()) :]
    determined = np.abs(null).max(axis=0, initial=0.0) < 1e-6
    columns = {}
    for i, name in enumerate(mechanism.driven):
        columns[f"q.{name}"] = e.q[:, places[i]] + NOISE_Q * random.normal(size=n)
        rms = np.sqrt(np.mean(torques[:, i] ** 2))
        columns[f"tau.{name}"] = torques[:, i] + NOISE_TAU * rms * random.normal(size=n)
    for name in logged(mechanism):
        noise = NOISE_Q * random.normal(size=n)
        columns.setdefault(f"q.{name}", e.q[:, mechanism.joint(name).index] + noise)
    rows = np.concatenate(W)
    motion = ident.complete(mechanism, ident.Log.from_arrays("run", t, columns))
    begin = time.process_time()
    fit = ident.identify(mechanism, motion)
    spent = time.process_time() - begin
    unknown = fit.problem.columns.rigid
    plausible = fit.problem.plausible[: len(unknown)]
    scaled = significant(rows[:, unknown], plausible)
    singular = np.linalg.svd(scaled, compute_uv=False)
    seen = significant(fit.estimate.triangle.R[:, : len(unknown)], plausible)
    rank = rank_revealing(Triangle.of(seen, np.zeros(len(seen))), TOLERANCE).rank
    difference = fit.point.pi - mechanism.prior
    own = motion.experiments[0]
    at = np.round((own.t - t[0]) * RATE).astype(int)
    inside = own.usable & (own.t > t[0] + EDGE) & (own.t < t[-1] - EDGE)
    errors = (fit.multipliers[0][1] - lam[at])[inside]
    size = np.sqrt(np.mean((lam[at][inside] ** 2).sum(axis=1)))
    determined &= np.isfinite(errors).all(axis=0)
    errors = np.sqrt(np.mean(errors**2, axis=0)) / size
    certain = determined & (fit.multiplier_errors.by_values < DETERMINED * size)
    return {
        "rank": rank, "SVD": int((singular > RANK * singular[0]).sum()),
        "held": rank - int(fit.rank), "any": float(errors[determined].max(initial=0.0)),
        "multipliers": float(errors[certain].max(initial=0.0)),
        "of": f"{certain.sum()} of {determined.sum()}",
        "torque": float(np.linalg.norm(rows @ difference) / np.linalg.norm(rows @ mechanism.prior)),
        "µs a sample": 1e6 * spent / n,
    }  # fmt: skip


def significant(rows: np.ndarray, plausible: np.ndarray) -> np.ndarray:
    """Return the columns whose unknowns move torques, each of length 1; others as zeros."""
    lengths = np.linalg.norm(rows, axis=0)
    moves = lengths * plausible > NOTHING * (lengths * plausible).max()
    return np.where(moves, rows / np.where(moves, lengths, 1.0), 0.0)


def main() -> None:
    """Print one row for each robot, each in a process of its own."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--one", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        print(json.dumps(measure(arguments.one)))
        return
    print("| " + " | ".join(COLUMNS) + " |\n" + "|---" * len(COLUMNS) + "|", flush=True)
    for path in robots(arguments.folder):
        if arguments.only and not any(name in str(path.parent) for name in arguments.only):
            continue
        command = [sys.executable, __file__, str(arguments.folder), "--one", str(path)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT)
            row = json.loads(done.stdout.splitlines()[-1]) if done.stdout else {}
            row = row or {"robot": path.parent.name, "error": done.stderr.strip()[-300:]}
        except subprocess.TimeoutExpired:
            row = {"robot": path.parent.name, "error": f"no answer in {LIMIT} s"}
        cells = (row.get(name, "–") for name in COLUMNS)
        words = (f"{x:.2g}" if isinstance(x, float) else str(x) for x in cells)
        print("| " + " | ".join(words) + " |", flush=True)
        if "error" in row:
            print(f"<!-- {row['robot']}: {row['error']} -->", flush=True)


if __name__ == "__main__":
    main()
