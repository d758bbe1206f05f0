"""How large a hidden effect is: values such that it changes a joint's torque by a given share."""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np
from rigid import Machine
from sensors import late
from simulate import Known, Rig, Run, tilted
from torques import SENSORS, TORQUES

# the unknown that is scaled, of the kinds that are one column (or one shape) times it
SCALED = {
    "viscous": ("Fv",), "coulomb": ("Fc",), "stribeck": ("Fs",), "load_friction": ("mu",),
    "hysteresis": ("sigma",), "drag": ("Fd",), "spring": ("k", "b"), "cable": ("k1", "k3"),
    "end_stop": ("k",), "rotor_inertia": ("Ia",), "coupling": ("Im", "Fvm", "Fcm"),
    "ripple": ("A", "B"), "temperature_friction": ("kappa",),
}  # fmt: skip


def resolve(
    machine: Machine, runs: Sequence[Run], kind: str, joints: tuple[str, ...], share: float,
    seed: int, known: Sequence[Known] = (),
) -> Known:  # fmt: skip
    """The effect with values of three digits, from the same motion without it."""
    rng = np.random.default_rng([5, seed, *map(ord, kind)])
    if kind in SENSORS:
        return sensor(machine, runs, kind, joints, share)
    if kind == "gravity_tilt":
        return tilt(machine, runs, share, rng)
    if kind == "payload":
        return Known(kind, joints, {"m": round(5 * share, 3)})
    unit = shape(machine, runs, kind, joints, rng, known)
    if kind == "coupling":  # each of the three parts by itself
        for name in unit:
            alone = {**dict.fromkeys(unit, 0.0), name: 1.0}
            unit[name] = 1 / change(machine, runs, Known(kind, joints, alone))
    scale = share / change(machine, runs, Known(kind, joints, unit))
    scaled = SCALED.get(kind, tuple(name for name in unit if name in ("F", "k", "J", "A")))
    values = {name: float(f"{x * scale:.3g}") if name in scaled else x for name, x in unit.items()}
    return Known(kind, joints, values)


def shape(
    machine: Machine, runs: Sequence[Run], kind: str, joints: tuple[str, ...],
    rng: np.random.Generator, known: Sequence[Known],
) -> dict[str, float]:  # fmt: skip
    """Values of size one: what does not scale is drawn to suit the motion."""
    row = Rig(machine).row(joints[:1] if kind == "cross_spring" else joints)
    q = np.concatenate([run.q @ row for run in runs])
    speed = float(np.std(np.concatenate([run.v @ row for run in runs])))
    half = float(np.ptp(q)) / 2
    if kind == "stribeck":
        return {"Fs": 1.0, "vs": round(speed * rng.uniform(0.35, 0.6), 3)}
    if kind == "hysteresis":
        return {"sigma": 1.0, "z0": round(half * rng.uniform(0.12, 0.2), 3)}
    if kind == "spring":
        return {"k": 1.0, "b": -float(np.mean(q)) + 0.3 * half * rng.uniform(-1, 1)}
    if kind == "cable":
        return {"k1": 0.4, "k3": round(1 / max(np.abs(q).max(), 0.1) ** 2, 3)}
    if kind == "end_stop":
        return {"k": 1.0, "q1": round(float(np.quantile(q, rng.uniform(0.65, 0.75))), 3)}
    if kind == "ripple":
        angle, order = rng.uniform(0, 2 * np.pi), rng.choice([5, 6, 8])
        return {"A": math.cos(angle), "B": math.sin(angle), "N": float(order)}
    if kind == "bump":
        return {"F": 1.0, "q1": round(float(np.quantile(q, rng.uniform(0.3, 0.7))), 3)}
    if kind == "temperature_friction":
        base = next(e for e in known if e.kind == "viscous" and e.joints == joints)
        return {"kappa": 1.0, "Fv": base.values["Fv"]}
    names = SCALED.get(kind) or {
        "cross_spring": ("k",), "slosh": ("J",), "disturbance": ("A",),
    }.get(kind, ("F",))  # fmt: skip
    return dict.fromkeys(names, 1.0)


def change(machine: Machine, runs: Sequence[Run], effect: Known) -> float:
    """Largest rms change of a drive's torque, as a share of that torque."""
    rig = Rig(machine)
    row = rig.row(effect.joints[:1] if effect.kind == "cross_spring" else effect.joints)
    other = rig.index[effect.joints[1]] if effect.kind == "cross_spring" else 0
    squares, total = np.zeros(len(rig.driven)), np.zeros(len(rig.driven))
    for run in runs:
        torque = TORQUES[effect.kind](effect.values, float(run.t[1]))
        state = (run.t, run.q @ row, run.v @ row, run.a @ row, run.load @ row, run.q[:, other])
        f = np.array([torque(*map(float, each)) for each in zip(*state, strict=True)])
        some = slice(None, None, 10 if rig.rest else 1)
        lever = (
            np.stack([row @ rig.leverage(q) for q in run.q[some]])
            if rig.rest
            else np.broadcast_to(row[rig.driven], (len(f), len(rig.driven)))
        )
        squares += ((lever * f[some, None]) ** 2).mean(axis=0)
        total += (run.tau**2).mean(axis=0)
    return float(np.sqrt(squares / total).max())


def sensor(
    machine: Machine, runs: Sequence[Run], kind: str, joints: tuple[str, ...], share: float
) -> Known:
    """A channel's error of the given share of its torque."""
    k = machine.driven.index(joints[0])
    tau = np.concatenate([run.tau[:, k] for run in runs])
    rms = float(np.sqrt((tau**2).mean()))
    name, value = "c", share * rms
    if kind == "torque_gain":
        name, value = "g", share
    elif kind == "drift":
        value = share * rms / float(np.sqrt((runs[0].t ** 2).mean()))
    elif kind == "saturation":
        name, value = "limit", bisect(lambda x: clipped(tau, x) / rms, 0.0, float(abs(tau).max()),
                                      share)  # fmt: skip
    elif kind == "delay":
        off = lambda d: np.sqrt(  # noqa: E731
            np.mean([np.mean((late(machine, run, k, d) - run.tau[:, k]) ** 2) for run in runs])
        )
        name, value = "d", bisect(lambda d: off(d) / rms, 0.0, 0.05, share)
    elif kind in ("encoder_offset", "elasticity"):
        name = "delta" if kind == "encoder_offset" else "compliance"
        value = min(share / max(shifted(machine, runs, k, kind), 1e-9), 0.1)
    return Known(kind, joints, {name: float(f"{value:.3g}")})


def clipped(tau: np.ndarray, limit: float) -> float:
    return float(np.sqrt(((tau - np.clip(tau, -limit, limit)) ** 2).mean()))


def bisect(f: object, low: float, high: float, goal: float) -> float:
    """Where f meets the goal between low and high, or the nearer end."""
    rising = f(high) > f(low)  # type: ignore[operator]
    for _ in range(40):
        middle = (low + high) / 2
        if (f(middle) < goal) == rising:  # type: ignore[operator]
            low = middle
        else:
            high = middle
    return (low + high) / 2


def shifted(machine: Machine, runs: Sequence[Run], k: int, kind: str) -> float:
    """Share by which a serial arm's torques change per unit of an angle's error."""
    rig, e = Rig(machine), 1e-3
    squares = total = np.zeros(rig.model.nv)
    for run in runs:
        wrong = run.q[::5].copy()
        wrong[:, k] += e if kind == "encoder_offset" else e * run.tau[::5, k]
        off = inverse(rig, wrong, run.v[::5], run.a[::5]) - inverse(
            rig, run.q[::5], run.v[::5], run.a[::5]
        )
        squares, total = squares + (off**2).mean(axis=0), total + (run.tau**2).mean(axis=0)
    return float(np.sqrt(squares / total).max()) / e


def tilt(machine: Machine, runs: Sequence[Run], share: float, rng: np.random.Generator) -> Known:
    """A base turned about x and y such that the joint that feels it most changes by the share."""
    angle = rng.uniform(0, 2 * np.pi)
    rig, e, squares = Rig(machine), 1e-3, 0.0
    squares = total = np.zeros(rig.model.nv)
    for run in runs:
        part = run.q[::5], run.v[::5], run.a[::5]
        level = inverse(rig, *part)
        rig.model.opt.gravity[:] = tilted({"x": e * math.cos(angle), "y": e * math.sin(angle)})
        off = inverse(rig, *part) - level
        rig.model.opt.gravity[:] = (0.0, 0.0, -9.81)
        squares, total = squares + (off**2).mean(axis=0), total + (run.tau**2).mean(axis=0)
    size = share * e / float(np.sqrt(squares / total).max())
    size = min(size, 0.12)
    values = {"x": round(size * math.cos(angle), 5), "y": round(size * math.sin(angle), 5)}
    return Known("gravity_tilt", (), values)


def inverse(rig: Rig, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    rig.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    tau = np.empty_like(q)
    for i in range(len(q)):
        rig.data.qpos[:], rig.data.qvel[:], rig.data.qacc[:] = q[i], v[i], a[i]
        mujoco.mj_inverse(rig.model, rig.data)
        tau[i] = rig.data.qfrc_inverse
    return tau
