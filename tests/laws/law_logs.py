"""Logs of a machine with a law: motion from a Fourier series, torques from inverse dynamics.

    τ = Zᵀ (ID(q, v, a) + friction + law)        Z: velocities of all joints by those of the drives

Rigid-body torques are MuJoCo's, the columns of the model Pinocchio's; nothing is the library's.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pinocchio as pin

sys.path.insert(0, str(Path(__file__).parents[1] / "battery"))

from calibrate import inverse
from law_cases import ENCODER, SHARE, Case, Law
from mechanisms import MACHINES
from reference import reference
from rigid import Machine, urdf, write_folder
from sensors import noisy, sizes
from simulate import BEFORE, Rig
from torques import STILL, temperature

Array = np.ndarray
RATE = 150.0  # of a log [Hz]
SECONDS = 20.0  # of a log
CLOSED = 1e-13  # gap of a closure [m]
INSIDE = 0.97  # range of the log that judges, as a share of that of the log to identify from
FRICTION = (0.03, 0.07)  # share of a drive's torque, of viscous and of Coulomb friction
FUNCTIONS = {
    "sin": np.sin, "cos": np.cos, "tan": np.tan, "exp": np.exp, "log": np.log, "sqrt": np.sqrt,
    "abs": np.abs, "tanh": np.tanh, "sign": lambda x: np.tanh(x / STILL),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Motion:
    """Of all joints at the samples, without noise.

    Attributes:
        q, v, a, load: (n, nv); load: rigid-body torques.
        Z: (n, nv, driven); rigid: (n, driven) what the drives supply to move rigid bodies.
    """

    machine: Machine
    t: Array
    q: Array
    v: Array
    a: Array
    load: Array
    Z: Array
    rigid: Array

    def signals(self, joint: str) -> dict[str, Array]:
        """What a formula at a joint is written in."""
        names = [each.name for each in self.machine.joints]
        k = names.index(joint)
        found = {"t": self.t, "temperature": np.vectorize(temperature)(self.t)}
        found |= {name: getattr(self, name)[:, k] for name in ("q", "v", "a", "load")}
        found |= {f"q_{name}": self.q[:, i] for i, name in enumerate(names)}
        return found | {f"v_{name}": self.v[:, i] for i, name in enumerate(names)}

    def felt(self, joint: str, torque: Array) -> Array:
        """(n, driven): a torque at a joint as the drives feel it."""
        k = [each.name for each in self.machine.joints].index(joint)
        return self.Z[:, k] * np.asarray(torque)[:, None]

    def torque(self, joint: str, formula: str, constants: Mapping[str, float]) -> Array:
        """(n, driven): a formula's torque as the drives feel it."""
        return self.felt(joint, value(formula, self.signals(joint), constants))


def value(formula: str, signals: Mapping[str, Array], constants: Mapping[str, float]) -> Array:
    """(n,) of a formula; sign(x) is steep, not a step, as everywhere in the battery."""
    names = {**FUNCTIONS, **signals, **constants}
    with np.errstate(all="ignore"):
        x = eval(formula, {"__builtins__": {}}, names)
    return np.broadcast_to(np.asarray(x, dtype=float), signals["t"].shape)


@dataclass(frozen=True, eq=False)
class Made:
    """A case's log, the log that judges, and what is true of them.

    Attributes:
        log: columns with noise; tau, judge_tau: (n, driven) without noise.
        known: friction of which the model knows, by (kind, joint); law: with its size, or None.
        beside: further columns of the model, as joint and formula.
    """

    case: Case
    motion: Motion
    judge: Motion
    log: dict[str, Array]
    tau: Array
    judge_tau: Array
    known: Mapping[tuple[str, str], float]
    law: Law | None
    beside: tuple[tuple[str, str], ...] = ()

    def folder(self, place: Path) -> Path:
        """The mechanism folder, with a wrong prior and without the law."""
        machine = MACHINES[self.case.machine]
        return write_folder(machine, place, {key: {} for key in self.known}, self.case.seed)

    def columns(self, motion: Motion) -> Array:
        """(n, driven, columns) of the model without the law: rigid bodies, friction, `beside`."""
        more = [friction(motion, key) for key in self.known]
        more += [motion.torque(joint, formula, {}) for joint, formula in self.beside]
        return np.concatenate([bodies(motion), *(x[:, :, None] for x in more)], axis=2)


@lru_cache(maxsize=8)
def motions(name: str, seed: int) -> tuple[Motion, Motion]:
    """To identify from, and to judge on: within the range and the speeds of the first."""
    machine = replace(MACHINES[name], step=1 / RATE)
    skip, first, found = round(BEFORE * RATE), None, []
    for number in range(2):
        r = reference(machine, seed, number, SECONDS)
        u, du, ddu = r.q[skip:], r.v[skip:], r.a[skip:]
        if first is None:
            first = (u.max(axis=0) + u.min(axis=0)) / 2, np.ptp(u, axis=0), np.abs(du).max(axis=0)
        else:
            middle, extent, speed = first
            own = (u.max(axis=0) + u.min(axis=0)) / 2
            scale = INSIDE * np.minimum(extent / np.ptp(u, axis=0), speed / np.abs(du).max(axis=0))
            u, du, ddu = middle + scale * (u - own), scale * du, scale * ddu
        found.append(moved(machine, u, du, ddu))
    return found[0], found[1]


def moved(machine: Machine, u: Array, du: Array, ddu: Array) -> Motion:
    """The motion of all joints from that of the drives, and the torques of rigid bodies."""
    rig = Rig(machine)
    n, nv = len(u), rig.model.nv
    Z = np.zeros((n, nv, len(rig.driven)))
    q, v, a = np.zeros((n, nv)), np.zeros((n, nv)), np.zeros((n, nv))
    q[:, rig.driven], v[:, rig.driven], a[:, rig.driven] = u, du, ddu
    if not rig.rest:
        Z[:] = np.eye(nv)[:, rig.driven]
    else:
        at, e = rig.assemble(u[0]), 1e-6
        for i in range(n):
            at[rig.driven] = u[i]
            for _ in range(6):
                rig.leverage(at)
                gap, J = rig.gap(), rig.jacobian()[:, rig.rest]
                if np.abs(gap).max() < CLOSED:
                    break
                at[rig.rest] -= np.linalg.lstsq(J, gap, rcond=1e-9)[0]
            Z[i], q[i] = rig.leverage(at), at
            v[i] = Z[i] @ du[i]
            rate = (rig.leverage(at + e * v[i]) - rig.leverage(at - e * v[i])) / (2 * e)
            a[i] = Z[i] @ ddu[i] + rate @ du[i]
    load = inverse(rig, q, v, a)
    rigid = np.einsum("nij,ni->nj", Z, load)
    return Motion(machine, np.arange(n) / RATE, q, v, a, load, Z, rigid)


def bodies(motion: Motion) -> Array:
    """(n, driven, 10 bodies): Γ of Pinocchio as the drives feel it."""
    model = pin.buildModelFromXML(urdf(motion.machine, None))
    data = model.createData()
    at = [model.joints[model.getJointId(j.name)].idx_v for j in motion.machine.joints]
    order = np.argsort(at)
    found = np.empty((len(motion.t), motion.Z.shape[2], 10 * (model.njoints - 1)))
    for i in range(len(motion.t)):
        G = pin.computeJointTorqueRegressor(
            model, data, motion.q[i, order], motion.v[i, order], motion.a[i, order]
        )
        found[i] = motion.Z[i].T @ G[at]
    return found


def friction(motion: Motion, key: tuple[str, str]) -> Array:
    """(n, driven) of a coefficient of 1."""
    kind, joint = key
    return motion.torque(joint, {"viscous": "v", "coulomb": "sign(v)"}[kind], {})


def rms(x: Array) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


@lru_cache(maxsize=4)
def make(case: Case) -> Made:
    """Everything of a case."""
    motion, judge = motions(case.machine, case.seed)
    rng = np.random.default_rng([19, case.seed])
    known: dict[tuple[str, str], float] = {}
    law = case.law
    for k, joint in enumerate(motion.machine.driven):
        for kind in ("viscous", "coulomb"):
            share = rng.uniform(*FRICTION)
            if law is None or (law.kind, law.joint) != (kind, joint):
                known[kind, joint] = (
                    share * rms(motion.rigid[:, k]) / rms(friction(motion, (kind, joint))[:, k])
                )
    if law is not None:
        one = motion.torque(law.joint, law.formula, {**law.constants, "k": 1.0})
        change = max(rms(one[:, k]) / rms(motion.rigid[:, k]) for k in range(one.shape[1]))
        size = float(f"{rng.uniform(*SHARE) / change:.3g}")
        law = replace(law, constants={**law.constants, "k": size})
    taus = []
    for each in (motion, judge):
        tau = each.rigid + sum(x * friction(each, key) for key, x in known.items())
        if law is not None:
            tau = tau + each.torque(law.joint, law.formula, law.constants)
        taus.append(tau)
    names = [joint.name for joint in motion.machine.joints]
    driven = motion.machine.driven
    log = {"t": motion.t} | {f"q.{j}": motion.q[:, names.index(j)] for j in driven}
    log |= {f"tau.{j}": taus[0][:, k] for k, j in enumerate(driven)}
    if law is not None and "temperature" in law.formula:
        log |= {f"temperature.{j}": np.vectorize(temperature)(motion.t) for j in driven}
    (log,) = noisy([log], sizes([log], case.noise, case.noise * ENCODER), case.seed)
    return Made(case, motion, judge, log, *taus, known, law)


class Complement:
    """What the model without the law cannot make of a torque, rows weighted by 1/rms(τ).

    A column's part in the span of the model's columns is removed by an orthogonal projection.
    """

    def __init__(self, made: Made, motion: Motion | None = None) -> None:
        self.weight = 1 / np.sqrt(np.mean(made.tau**2, axis=0))
        X = self.rows(made.columns(motion or made.motion))
        scale = np.linalg.norm(X, axis=0)
        U, s, _ = np.linalg.svd(X[:, scale > 0] / scale[scale > 0], full_matrices=False)
        self.basis = U[:, s > 1e-9 * s[0]]

    def rows(self, torque: Array) -> Array:
        """(n driven, …) of (n, driven, …)."""
        weight = self.weight.reshape(-1, *(1,) * (torque.ndim - 2))
        return (torque * weight).reshape(-1, *torque.shape[2:])

    def of(self, torque: Array) -> Array:
        """(n driven,): the part of (n, driven) that the model's columns leave."""
        x = self.rows(torque)
        return x - self.basis @ (self.basis.T @ x)
