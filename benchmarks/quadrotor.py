"""A quadrotor from its flight: pose and rotors, upright and tumbling.

    python benchmarks/quadrotor.py [--seeds N] [--rows upright tumbling factors]

The flight is integrated by Pinocchio (free flyer, midpoint rule, 0.5 ms), the rotors follow a
controller with a lag of 30 ms. Logged at 500 Hz for 20 s: the pose with noise of 0.5 mm and 1 mrad,
and the wrench of the rotors (rows `upright`, `tumbling`) or their speeds with 0.2 % of noise, a
known mass and a drag of unknown size (row `factors`). Largest error, mean error, rms of the errors
over their standard errors, and how many intervals of 95 % hold the truth.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin

import ident

MASS, CENTRE = 1.37, np.array([0.006, -0.004, 0.010])  # kg, m
INERTIA = np.array(
    [[0.0115, 0.0002, -0.0003], [0.0002, 0.0128, 0.0004], [-0.0003, 0.0004, 0.0211]]
)  # kg m², about the centre of mass
ROTORS = np.array(
    [[0.17, 0.17, 0.02], [-0.17, 0.17, 0.02], [-0.17, -0.17, 0.02], [0.17, -0.17, 0.02]]
)
TURNS = np.array([1.0, -1.0, 1.0, -1.0])
K, RATIO, DRAG = 1.1e-5, 0.016, np.array([0.25, 0.25, 0.1])  # N s²/rad², m, N s/m
STEP, RATE, DURATION, LAG = 5e-4, 500.0, 20.0, 0.03  # s, Hz, s, s
POSITION, ANGLE, SPEED = 5e-4, 1e-3, 2e-3  # m, rad, share
MOST = 12.0  # N of one rotor


def effort(forces: np.ndarray) -> np.ndarray:
    """Return the wrench (…, 6) of the rotors' forces (…, 4) about the body's origin."""
    total = np.zeros((*forces.shape[:-1], 6))
    total[..., 2] = forces.sum(axis=-1)
    total[..., 3], total[..., 4] = forces @ ROTORS[:, 1], -forces @ ROTORS[:, 0]
    total[..., 5] = forces @ (RATIO * TURNS)
    return total


def flight(tumbling: bool, drag: bool) -> dict[str, np.ndarray]:
    """Return t (n,), q (n, 7), v (n, 6) and rotors' forces (n, 4)."""
    model = pin.Model()
    at = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(at, pin.Inertia(MASS, CENTRE, INERTIA), pin.SE3.Identity())
    data, mixer = model.createData(), np.linalg.pinv(effort(np.eye(4)).T[2:])
    q, v, forces = pin.neutral(model), np.zeros(6), np.full(4, MASS * 9.81 / 4)
    rows, every = [], round(1 / RATE / STEP)

    def wanted(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return forces (4,): of a path and, tumbling, of rates that turn the body over."""
        R = pin.Quaternion(q[3:]).toRotationMatrix()
        phase = 2 * np.pi * np.array([0.11, 0.17, 0.23]) * t
        goal = np.array([1.5, 1.2, 0.6]) * np.sin(phase)
        pull = 9.81 * np.array([0, 0, 1.0]) + 4 * (goal - q[:3]) - 3 * (R @ v[:3])
        wiggle = np.array([1.1 * np.sin(9 * t), 1.3 * np.sin(7 * t + 1), 1.5 * np.sin(4 * t)])
        if tumbling:
            rates = np.array([2.5 * np.sin(0.9 * t), 3.5, 1.2 * np.sin(0.6 * t)]) + wiggle
            lift = MASS * 9.81 * (1.3 + 0.9 * R[2, 2])
        else:
            up = pull / np.linalg.norm(pull)
            tilt = R.T @ np.cross(R[:, 2], up)
            rates = 8 * tilt + wiggle
            rates[2] = wiggle[2]
            lift = MASS * pull @ R[:, 2]
        moment = np.diag(INERTIA) * 10 * (rates - v[3:])
        return np.clip(mixer @ np.append(lift, moment), 0.05, MOST)

    def acceleration(q: np.ndarray, v: np.ndarray, forces: np.ndarray) -> np.ndarray:
        wrench = effort(forces)
        if drag:
            wrench[:3] -= DRAG * v[:3]
        return pin.aba(model, data, q, v, wrench)

    for k in range(round(DURATION / STEP)):
        if k % every == 0:
            rows.append(np.concatenate([[k * STEP], q, v, forces]))
        rate = (wanted(k * STEP, q, v) - forces) / LAG
        a = acceleration(q, v, forces)
        middle = pin.integrate(model, q, STEP / 2 * v), v + STEP / 2 * a
        a = acceleration(*middle, forces + STEP / 2 * rate)
        q, v = pin.integrate(model, q, STEP * middle[1]), v + STEP * a
        forces = forces + STEP * rate
    table = np.array(rows)
    return {"t": table[:, 0], "q": table[:, 1:8], "v": table[:, 8:14], "forces": table[:, 14:]}


def log(made: dict[str, np.ndarray], seed: int, factors: bool) -> ident.Log:
    """Return the log of a flight with noise."""
    random, n = np.random.default_rng(seed), len(made["t"])
    p = made["q"][:, :3] + POSITION * random.normal(size=(n, 3))
    turns = ANGLE * random.normal(size=(n, 3))
    poses = [
        (pin.Quaternion(x[3:]) * pin.Quaternion(pin.exp3(w))).coeffs()
        for x, w in zip(made["q"], turns, strict=True)
    ]
    columns = {f"base.{x}": p[:, i] for i, x in enumerate("xyz")}
    columns |= {f"base.q{x}": np.array(poses)[:, i] for i, x in enumerate("xyzw")}
    if factors:
        speeds = np.sqrt(made["forces"] / K) * (1 + SPEED * random.normal(size=(n, 4)))
        columns |= {f"input.rotor{i}": speeds[:, i] for i in range(4)}
    else:
        wrench = effort(made["forces"])
        columns |= {f"wrench.body.{x}": wrench[:, i] for i, x in enumerate(PARTS)}
    return ident.Log.from_arrays("flight", made["t"], columns)


PARTS = ("fx", "fy", "fz", "mx", "my", "mz")


def machine(folder: Path, tumbling: bool, factors: bool) -> ident.Mechanism:
    """Return the mechanism, its masses and inertias a tenth off."""
    d = 1.1 * np.diag(INERTIA)
    hubs = "".join(
        f'<link name="rotor{i}"/><joint name="hub{i}" type="fixed"><parent link="body"/>'
        f'<child link="rotor{i}"/><origin xyz="{x} {y} {z}"/></joint>'
        for i, (x, y, z) in enumerate(ROTORS)
    )
    mass = MASS if factors else 1.1 * MASS
    (folder / "quadrotor.urdf").write_text(
        f'<robot name="quadrotor"><link name="body"><inertial><mass value="{mass}"/><inertia '
        f'ixx="{d[0]}" ixy="0" ixz="0" iyy="{d[1]}" iyz="0" izz="{d[2]}"/></inertial></link>{hubs}'
        "</robot>"
    )
    order = ', order = "xzyx"' * tumbling
    text = f'urdf = "quadrotor.urdf"\nbase = {{ kind = "floating"{order} }}\n'
    if factors:
        text += '[parameters]\nunknown = ["body"]\nknown = ["body.m"]\n'
        text += "".join(f'[[effect]]\nkind = "thrust"\nframe = "rotor{i}"\n' for i in range(4))
        text += '[[effect]]\nkind = "body_drag"\nframe = "body"\n'
    (folder / "mechanism.toml").write_text(text)
    return ident.load(folder).with_calibration("exact")


def truth(factors: bool) -> dict[str, float]:
    """Return true values by name."""
    if factors:
        values = {f"thrust.rotor{i}.k": K for i in range(4)}
        values |= {f"thrust.rotor{i}.d": RATIO * TURNS[i] * K for i in range(4)}
        return values | {f"body_drag.body.D{x}": DRAG[i] for i, x in enumerate("xyz")}
    values = {"body.m": MASS}
    values |= {f"body.m{x}": MASS * CENTRE[i] for i, x in enumerate("xyz")}
    axes = [(i, j) for i in range(3) for j in range(i, 3)]
    return values | {f"body.I{'xyz'[i]}{'xyz'[j]}": float(INERTIA[i, j]) for i, j in axes}


def errors_of(fit: ident.Fit, true: dict[str, float]) -> dict[str, tuple[float, float]]:
    """Return error and standard error of each value."""
    found = {x.name: (x.value, x.stderr) for e in fit.effects for x in e.parameters}
    found |= {x.name: (x.value, x.stderr) for x in fit.parameters}
    return {name: (found[name][0] - x, found[name][1] or np.nan) for name, x in true.items()}


def run(row: str, seeds: int, show: Callable[[str], None] = print) -> None:
    """Print the figures of a row."""
    tumbling, factors = row == "tumbling", row == "factors"
    made, true = flight(tumbling, factors), truth(factors)
    tilt = np.degrees(np.arccos(1 - 2 * (made["q"][:, 3:5] ** 2).sum(axis=1)))
    fastest = np.abs(made["v"][:, 3:]).max()
    show(f"{row}: tilt up to {tilt.max():.0f}°, rates up to {fastest:.1f} rad/s")
    every: dict[str, list[tuple[float, float]]] = {name: [] for name in true}
    with tempfile.TemporaryDirectory() as folder:
        mechanism = machine(Path(folder), tumbling, factors)
        for seed in range(seeds):
            motion = ident.complete(mechanism, log(made, seed, factors))
            for name, pair in errors_of(ident.identify(mechanism, motion), true).items():
                every[name].append(pair)
    inside = total = 0
    for name, pairs in every.items():
        e, s = np.array(pairs).T
        held = int((np.abs(e) <= 1.96 * s).sum())
        inside, total = inside + held, total + len(e)
        show(
            f"  {name:22} true {true[name]:9.4g}  mean error {e.mean():+.2g}  largest "
            f"{np.abs(e).max():.2g} ({100 * np.abs(e).max() / abs(true[name]):.2g} %)  rms z "
            f"{np.sqrt(np.mean((e / s) ** 2)):.2f}  {held}/{len(e)}"
        )
    show(f"  intervals of 95 % that hold: {inside} of {total}, {100 * inside / total:.0f} %")


def main() -> None:
    """Print all rows."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--rows", nargs="*", default=["upright", "tumbling", "factors"])
    arguments = parser.parse_args()
    for row in arguments.rows:
        run(row, arguments.seeds)


if __name__ == "__main__":
    main()
