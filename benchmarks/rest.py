"""What rest tells: gravity from a table of poses, and a payload that only held axes lift.

    python benchmarks/rest.py [--seeds 20] [--poses 30] [poses] [payload]

Both on the arm of robots/ and on a UR5 (package example-robot-data). Truth is Pinocchio's regressor
with planted bodies; a joint at rest holds a part of its dry friction that is drawn within ± F.

`poses`: 30 poses drawn within the joints' ranges, one row a pose, all bodies unknown and up to 30 %
from the URDF's; F is 5 % of the rms torque of gravity at a joint. Reference: plain least squares of
the same base parameters with weights 1/F, as who knows the band would solve it. Errors are of the
torque of gravity at 500 other poses, each joint in its F; intervals are of all base parameters.

`payload`: bodies and friction are known, as after an earlier fit; the wrist (the arm's one, the
UR5's three joints) moves for 8 s at 100 Hz under a load of 1 to 3 kg, up to 10 cm from the flange;
all other axes are held in a pose that is drawn, with friction at rest within ± 1 N m. Noise: 1 % of
the torques in motion, 10 µrad. Intervals are of the mass of `identify --with payload`, beside the
unloaded log's friction; named: what `diagnose` says first, without that.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from robots import urdfs

import ident
from ident.log import Log

ROOT = Path(__file__).resolve().parents[1]
BAND = 0.05  # F over the rms torque of gravity
HELD = 1.0  # F of a held joint [N m]
RATE, SECONDS = 100.0, 8.0  # Hz, s
NOISE, POSITIONS = 0.01, 1e-5  # of a torque's rms; rad


@dataclass(frozen=True)
class Machine:
    """A serial arm: its URDF, the joints that move with the wrist, and the link of the load."""

    name: str
    urdf: Path
    wrist: tuple[str, ...]
    link: str
    viscous: float  # N m s/rad, of the wrist
    coulomb: float  # N m, of the wrist


def machines() -> Iterator[Machine]:
    """Return the arm, and the UR5 where it is installed."""
    yield Machine("arm", ROOT / "robots" / "arm" / "arm.urdf", ("wrist",), "hand", 0.02, 0.1)
    for path in urdfs():
        if path.name == "ur5_robot.urdf":
            joints = tuple(f"wrist_{k}_joint" for k in (1, 2, 3))
            yield Machine("ur5", path, joints, "wrist_3_link", 0.2, 0.5)


def gammas(mechanism: ident.Mechanism, *motion: np.ndarray) -> np.ndarray:
    """Return Γ (n, nv, 10 bodies) at q, v, a by Pinocchio."""
    model, data = mechanism.model, mechanism.model.createData()
    rows = zip(*motion, strict=True)
    return np.stack([pin.computeJointTorqueRegressor(model, data, *row) for row in rows])


def drawn_poses(mechanism: ident.Mechanism, random: np.random.Generator, count: int) -> np.ndarray:
    """Return poses (count, joints) within the ranges, half a turn to each side at most."""
    low = np.array([max(joint.lower, -np.pi) for joint in mechanism.joints])
    high = np.array([min(joint.upper, np.pi) for joint in mechanism.joints])
    return random.uniform(low, high, (count, len(low)))


def planted(mechanism: ident.Mechanism, random: np.random.Generator) -> np.ndarray:
    """Return bodies that can exist, up to 30 % from the URDF's in mass, centre and inertia."""
    found = []
    for ten in mechanism.prior.reshape(-1, 10):
        body = pin.Inertia.FromDynamicParameters(ten)
        factor, turn = random.uniform(0.7, 1.3), random.uniform(0.7, 1.3, 3)
        found.append(pin.Inertia(body.mass * factor, body.lever * turn, factor * body.inertia))
    return np.concatenate([body.toDynamicParameters() for body in found])


def poses(machine: Machine, seeds: int, count: int) -> str:
    """Return the row of gravity from poses."""
    mechanism = ident.load(machine.urdf).with_calibration("exact")
    names = [joint.name for joint in mechanism.joints]
    inside, errors, references, spent = list[bool](), list[float](), list[float](), 0.0
    for seed in range(seeds):
        random = np.random.default_rng([seed, 1])
        pi, zero = planted(mechanism, random), np.zeros((count, len(names)))
        q = drawn_poses(mechanism, random, count)
        gamma = gammas(mechanism, q, zero, zero)
        other = drawn_poses(mechanism, random, 500)
        at_others = gammas(mechanism, other, np.zeros_like(other), np.zeros_like(other))
        size = np.sqrt(np.mean((at_others @ pi) ** 2, axis=0))
        F = BAND * np.where(size > 1e-6, size, size.max())
        tau = gamma @ pi + F * random.uniform(-1, 1, q.shape)
        columns = {f"q.{name}": q[:, i] for i, name in enumerate(names)}
        columns |= {f"tau.{name}": tau[:, i] for i, name in enumerate(names)}
        begin = time.process_time()
        log = Log.from_arrays("poses", np.arange(float(count)), columns)
        fit = ident.identify(mechanism, ident.complete(mechanism, log))
        spent += time.process_time() - begin
        base, rigid = fit.estimate.base, fit.columns.rigid
        truth, beta = base.combined(pi[rigid]), fit.estimate.solution.beta
        inside += [*(np.abs(beta - truth) < 1.96 * np.sqrt(np.diag(fit.scatter)))]
        A = (gamma / F[:, None]).reshape(-1, len(pi))[:, rigid][:, base.independent]
        known = np.linalg.lstsq(A, (tau / F).ravel())[0]
        B = (at_others / F[:, None])[:, :, rigid][:, :, base.independent]
        errors.append(float(np.mean((B @ (beta - truth)) ** 2)))
        references.append(float(np.mean((B @ (known - truth)) ** 2)))
    rms, reference = (float(np.sqrt(np.mean(x))) for x in (errors, references))
    return (
        f"{machine.name}: gravity off by {rms:.3f} F, plain least squares {reference:.3f} F "
        f"(ratio {rms / reference:.3f}); {100 * np.mean(inside):.1f} % of {len(inside)} intervals "
        f"hold; {spent / seeds:.1f} s a fit"
    )


def loaded_log(
    mechanism: ident.Mechanism, machine: Machine, random: np.random.Generator
) -> tuple[Log, float]:
    """Return a log of the wrist's motion with a load, and its mass [kg]."""
    names, t = [joint.name for joint in mechanism.joints], np.arange(0, SECONDS, 1 / RATE)
    mass = random.uniform(1, 3)
    lever = random.uniform(-0.1, 0.1, 3)
    load = pin.Inertia(mass, lever, mass * 0.03**2 * np.eye(3))
    pi = mechanism.prior.copy().reshape(-1, 10)
    pi[mechanism.bodies.links.index(machine.link)] += load.toDynamicParameters()
    pose = drawn_poses(mechanism, random, 1)[0]
    q = np.tile(pose, (len(t), 1))
    v, a = np.zeros_like(q), np.zeros_like(q)
    for name in machine.wrist:
        i = names.index(name)
        for k in (1, 2, 3):
            w, phase = 2 * np.pi * 0.25 * k, random.uniform(0, 2 * np.pi)
            size = random.uniform(0.2, 0.6) / k
            q[:, i] += size * np.sin(w * t + phase)
            v[:, i] += size * w * np.cos(w * t + phase)
            a[:, i] -= size * w**2 * np.sin(w * t + phase)
    tau = gammas(mechanism, q, v, a) @ pi.ravel()
    columns = dict[str, np.ndarray]()
    for i, name in enumerate(names):
        noise = random.standard_normal(len(t))
        if name in machine.wrist:
            tau[:, i] += machine.viscous * v[:, i] + machine.coulomb * np.sign(v[:, i])
            tau[:, i] += NOISE * tau[:, i].std() * noise
        else:
            tau[:, i] += random.uniform(-HELD, HELD) + NOISE * HELD * noise
        columns[f"q.{name}"] = q[:, i] + POSITIONS * random.standard_normal(len(t))
        columns[f"tau.{name}"] = tau[:, i]
    return Log.from_arrays("wrist", t, columns), float(mass)


def known_machine(machine: Machine, folder: Path) -> ident.Mechanism:
    """Return the machine with its bodies and friction known."""
    names = [joint.name for joint in ident.load(machine.urdf).joints]
    lines = [f'urdf = "{machine.urdf}"', "parameters = { unknown = [] }"]
    exact = (f'{each} = "exact"' for each in ("clock", "tau", "q", "length", "lateness"))
    lines += [f"calibration = {{ {', '.join(exact)} }}"]
    for name in names:
        moves = name in machine.wrist
        lines += ["[[effect]]", 'kind = "coulomb"', f'joint = "{name}"',
                  f"Fc = {machine.coulomb if moves else HELD}",
                  "[[effect]]", 'kind = "viscous"', f'joint = "{name}"',
                  f"Fv = {machine.viscous}"]  # fmt: skip
    (folder / "mechanism.toml").write_text("\n".join(lines) + "\n")
    return ident.load(folder)


def payload(machine: Machine, seeds: int) -> str:
    """Return the row of the load."""
    inside, widths, named, words, spent = 0, list[float](), 0, list[str](), 0.0
    with tempfile.TemporaryDirectory() as folder:
        mechanism = known_machine(machine, Path(folder))
    with_load = mechanism.with_effect(f"payload:{machine.link}")
    for seed in range(seeds):
        log, mass = loaded_log(mechanism, machine, np.random.default_rng([seed, 2]))
        begin = time.process_time()
        fit = ident.identify(with_load, ident.complete(with_load, log))
        value = fit[f"payload.{machine.link}.m"]
        if value.identifiable and value.stderr:
            inside += abs(value.value - mass) < 1.96 * value.stderr
            widths.append(value.stderr)
        diagnosis = ident.diagnose(ident.identify(mechanism, ident.complete(mechanism, log)))
        spent += time.process_time() - begin
        best = diagnosis.best
        good = best is not None and best.kind == "payload"
        named += good
        if not good:
            words.append(f"{seed}: {diagnosis.verdict} {best.label if best else ''}".strip())
    said = f"; not named: {'; '.join(words)}" if words else ""
    return (
        f"{machine.name}: mass in {inside} of {seeds} intervals (± {np.median(widths):.2f} kg, one "
        f"standard error), payload named in {named} of {seeds}; {spent / seeds:.1f} s a log{said}"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("rows", nargs="*", help="poses, payload; default: both")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--poses", type=int, default=30)
    parser.add_argument("--only", help="arm or ur5")
    given = parser.parse_args(arguments)
    rows = given.rows or ["poses", "payload"]
    for machine in machines():
        if given.only in (None, machine.name):
            if "poses" in rows:
                print("poses  ", poses(machine, given.seeds, given.poses), flush=True)
            if "payload" in rows:
                print("payload", payload(machine, given.seeds), flush=True)


if __name__ == "__main__":
    main()
