"""Forward simulation by MuJoCo: a controller follows a reference, logged before every step.

Before a step, M q̈ + bias = applied + passive + constraint holds to rounding, so that the torque is
exact for the state it is logged with, however soft the constraints are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from rigid import Machine, mjcf
from torques import NATIVE, TORQUES, Values

RATE = 500.0  # of the log [Hz]
BEFORE = 1.0  # simulated before the log begins, so that it begins in motion [s]


@dataclass(frozen=True)
class Known:
    """An effect with its values at joints (or one closure's joint, or none)."""

    kind: str
    joints: tuple[str, ...]
    values: Values


@dataclass(frozen=True, eq=False)
class Reference:
    """Of the driven joints at every step from −BEFORE on: q, v, a (steps, driven)."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray


@dataclass(frozen=True, eq=False)
class Run:
    """One simulated experiment at RATE from t = 0 on.

    Attributes:
        q, v, a: (n, nv) of all joints; load: (n, nv) rigid-body torques.
        tau: (n, driven); early: (m, driven) at every step, from −BEFORE on.
        gap: largest opening of a closure [m].
    """

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    load: np.ndarray
    tau: np.ndarray
    early: np.ndarray
    gap: float


class Rig:
    """A machine in MuJoCo."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        self.model = mujoco.MjModel.from_xml_string(mjcf(machine))
        self.data = mujoco.MjData(self.model)
        names = [joint.name for joint in machine.joints]
        self.index = {name: k for k, name in enumerate(names)}
        self.driven = [self.index[name] for name in machine.driven]
        self.sites = [
            (self.model.site(f"{c.name}.a").id, self.model.site(f"{c.name}.b").id)
            for c in machine.closures
        ]
        self.rest = [k for k in range(len(names)) if k not in self.driven]
        self.rows = dict(zip(names, np.eye(len(names)), strict=True))
        for c in machine.closures:
            if c.turn:
                row = sum(x * self.rows[j] for j, x in c.turn.items())
                self.rows[f"closure.{c.name}"] = row
        for pair in machine.pairs:
            self.rows[",".join(pair)] = self.rows[pair[0]] + self.rows[pair[1]]

    def row(self, joints: Sequence[str]) -> np.ndarray:
        """(nv,): the effect's own rate is row · v, and its torque acts along it."""
        return self.rows[",".join(joints)]

    def gap(self) -> np.ndarray:
        """Φ (m,) at the data's present positions."""
        site = self.data.site_xpos
        return np.array([site[b] - site[a] for a, b in self.sites]).ravel()

    def jacobian(self) -> np.ndarray:
        """∂Φ/∂q (m, nv)."""
        nv, parts = self.model.nv, []
        for a, b in self.sites:
            Ja, Jb = np.zeros((3, nv)), np.zeros((3, nv))
            mujoco.mj_jacSite(self.model, self.data, Ja, None, a)
            mujoco.mj_jacSite(self.model, self.data, Jb, None, b)
            parts.append(Jb - Ja)
        return np.vstack(parts) if parts else np.zeros((0, nv))

    def leverage(self, q: np.ndarray) -> np.ndarray:
        """Z (nv, driven): how all joints move with the driven ones at q."""
        Z = np.zeros((self.model.nv, len(self.driven)))
        Z[self.driven] = np.eye(len(self.driven))
        if self.rest:
            self.data.qpos[:] = q
            mujoco.mj_kinematics(self.model, self.data)
            mujoco.mj_comPos(self.model, self.data)
            J = self.jacobian()
            Z[self.rest] = -np.linalg.lstsq(J[:, self.rest], J[:, self.driven], rcond=1e-9)[0]
        return Z

    def assemble(self, goal: np.ndarray) -> np.ndarray:
        """q with the driven joints at `goal`, reached from the start in small steps."""
        q = np.array([self.machine.start.get(name, 0.0) for name in self.index])
        begin = q[self.driven].copy()
        for share in np.linspace(0, 1, 200):
            q[self.driven] = begin + share * (goal - begin)
            for _ in range(8 if self.rest else 0):
                self.leverage(q)
                J = self.jacobian()[:, self.rest]
                q[self.rest] -= np.linalg.lstsq(J, self.gap(), rcond=1e-9)[0]
        return q

    def build_in(self, effect: Known) -> None:
        """What MuJoCo has itself, at a joint or along a sum of joints."""
        m, p = self.model, effect.values
        row = self.row(effect.joints)
        pair = np.count_nonzero(row) > 1
        k = self.model.tendon(",".join(effect.joints)).id if pair else int(np.argmax(row))
        if effect.kind in ("viscous", "coupling"):
            (m.tendon_damping if pair else m.dof_damping)[k] += p.get("Fv", p.get("Fvm", 0.0))
        if effect.kind in ("coulomb", "coupling"):
            loss = m.tendon_frictionloss if pair else m.dof_frictionloss
            loss[k] += p.get("Fc", p.get("Fcm", 0.0))
        if effect.kind in ("rotor_inertia", "coupling"):
            (m.tendon_armature if pair else m.dof_armature)[k] += p.get("Ia", p.get("Im", 0.0))
        if effect.kind == "spring":
            ref = -p["b"] / p["k"]
            if pair:
                m.tendon_stiffness[k], m.tendon_lengthspring[k] = p["k"], ref
            else:
                m.jnt_stiffness[k], m.qpos_spring[k] = p["k"], ref


def simulate(machine: Machine, reference: Reference, effects: Sequence[Known]) -> Run:
    """The controlled motion with these effects in the truth."""
    rig = Rig(machine)
    model, data, h = rig.model, rig.data, machine.step
    applied = []
    for effect in effects:
        if effect.kind == "gravity_tilt":
            model.opt.gravity[:] = tilted(effect.values)
        elif effect.kind == "payload":
            add_mass(model, effect)
        elif effect.kind in NATIVE:
            rig.build_in(effect)
        elif effect.kind in TORQUES:
            torque = TORQUES[effect.kind](effect.values, h)
            row = rig.row(effect.joints[:1] if effect.kind == "cross_spring" else effect.joints)
            other = rig.index[effect.joints[1]] if effect.kind == "cross_spring" else 0
            applied.append((row, torque, other))
    mujoco.mj_setConst(model, data)
    data.qpos[:] = rig.assemble(reference.q[0])
    data.qvel[:] = rig.leverage(data.qpos.copy()) @ reference.v[0]
    every, skip = round(1 / (RATE * h)), round(BEFORE / h)
    steps, nv, d = len(reference.q), model.nv, len(rig.driven)
    n = (steps - skip) // every
    kept = {name: np.empty((n, nv)) for name in ("q", "v", "a", "load")}
    early, gap = np.empty((steps, d)), 0.0
    stiffness, damping = (30.0**2, 2 * 30.0) if not rig.rest else (60.0**2, 2 * 60.0)
    load, command, inertia = np.zeros(nv), np.zeros(nv), nominal(rig, data.qpos.copy())
    for i in range(skip + n * every):
        mujoco.mj_step1(model, data)
        q, v = data.qpos, data.qvel
        wish = (
            reference.a[i]
            + damping * (reference.v[i] - v[rig.driven])
            + stiffness * (reference.q[i] - q[rig.driven])
        )
        if rig.rest:
            early[i] = inertia @ wish  # a loop's drive: plain PD and inertia feed-forward
        else:
            command[rig.driven] = wish
            mujoco.mj_mulM(model, data, early[i], command)
            early[i] += data.qfrc_bias
        data.qfrc_applied[:] = 0.0
        data.qfrc_applied[rig.driven] = early[i]
        for row, torque, other in applied:
            state = row @ q, row @ v, row @ data.qacc, row @ load, q[other]
            data.qfrc_applied -= row * torque((i - skip) * h, *map(float, state))
        mujoco.mj_step2(model, data)
        mujoco.mj_mulM(model, data, load, data.qacc)
        load += data.qfrc_bias
        if i >= skip and (i - skip) % every == 0:
            at = (i - skip) // every
            # the step has moved q and v on: log what they were
            kept["v"][at] = data.qvel - h * data.qacc
            kept["q"][at] = data.qpos - h * data.qvel
            kept["a"][at], kept["load"][at] = data.qacc, load
            gap = max(gap, float(np.abs(rig.gap()).max(initial=0.0)))
    if any(warning.number for warning in data.warning):
        raise RuntimeError(f"{machine.name}: the simulation is unstable")
    t = np.arange(n) / RATE
    return Run(t, **kept, tau=early[skip::every][:n].copy(), early=early, gap=gap)


def nominal(rig: Rig, q: np.ndarray) -> np.ndarray:
    """Inertia felt by the drives (driven, driven) at q, for gains and feed-forward."""
    Z = rig.leverage(q)
    mujoco.mj_forward(rig.model, rig.data)
    M = np.zeros((rig.model.nv, rig.model.nv))
    mujoco.mj_fullM(rig.model, rig.data, M)
    return np.diag(np.diag(Z.T @ M @ Z))


def tilted(values: Values) -> np.ndarray:
    """Gravity as the tilted base feels it: turned back about x, then y."""
    (cx, cy), (sx, sy) = (np.cos([values["x"], values["y"]]), np.sin([values["x"], values["y"]]))
    X = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    Y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    return (X @ Y).T @ np.array([0.0, 0.0, -9.81])


def add_mass(model: mujoco.MjModel, effect: Known) -> None:
    """A point mass at the last link's own centre of mass, with some inertia."""
    k = model.nbody - 1
    model.body_mass[k] += effect.values["m"]
    model.body_inertia[k] *= 1 + effect.values["m"]
