"""Γ(q, v, a), the regressor of a tree of rigid bodies, for many samples at once.

    torque of joint j:   S_jᵀ Σ_{i moved by j} Y_i π_i   ⟹   Γ_ji = S_jᵀ Y_i

Y_i (6, 10) maps the parameters of body i, (m, m c, inertia about the origin of the body's frame),
to the wrench (f, n) that its motion needs, in the body's frame, with α and a the angular and the
classical linear acceleration of the frame (gravity enters as −g at the root):

    f = m a + α × mc + ω × (ω × mc)          n = I α + ω × I ω + mc × a

Pinocchio has the same matrix for one sample a call; this recursion goes over many samples,
and its matrices stand as the filter wants them. Vectors are (3, …, n): samples
stand last, where NumPy's loops are long.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ident.mechanism.parameters import COUNT

CHUNK = 1024  # samples that are worked at once; their vectors fit into the processor's cache
FEW = 64  # samples below which single calls of Pinocchio cost less; free bodies have them always


def regressor(model: pin.Model, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Γ (n, nv, 10 · bodies) of q (n, nq), v (n, nv), a (n, nv).

    Γ π are the joint torques of rigid bodies with gravity. Samples are contiguous in memory: a
    column of one row is one stretch.
    """
    n, nv = len(q), model.nv
    gamma = np.zeros((nv, COUNT * (model.njoints - 1), n))
    if n < FEW or model.nq != model.nv:
        data = model.createData()
        for i in range(n):
            gamma[:, :, i] = pin.computeJointTorqueRegressor(model, data, q[i], v[i], a[i])
        return gamma.transpose(2, 0, 1)
    for part, joints, bodies, _ in _motions(model, q, v, a, axes=True):
        for body, joint in enumerate(joints):
            columns, rows = slice(COUNT * body, COUNT * (body + 1)), joint.rows
            if len(rows) == rows[-1] - rows[0] + 1:  # neighbours: filled in place
                _project(gamma[rows[0] : rows[-1] + 1, columns, part], bodies[body + 1])
                continue
            block = np.empty((len(rows), COUNT, part.stop - part.start))
            _project(block, bodies[body + 1])
            gamma[rows, columns, part] = block
    return gamma.transpose(2, 0, 1)


def rigid_forces(
    model: pin.Model, q: np.ndarray, v: np.ndarray, a: np.ndarray, pi: np.ndarray
) -> np.ndarray:
    """Γ π (n, nv) of π (10 · bodies,) by the recursion of Newton and Euler, which needs no Γ."""
    if len(q) < FEW or model.nq != model.nv:
        return np.asarray(regressor(model, q, v, a) @ pi)
    torque, rigid = np.empty((model.nv, len(q))), pi.reshape(-1, COUNT)
    for part, joints, bodies, poses in _motions(model, q, v, a, axes=False):
        forces = [np.zeros((2, 3, part.stop - part.start))]
        for each, motion in zip(rigid, bodies[1:], strict=True):
            m, mc, inertia = each[0], each[1:4], each[[[4, 5, 7], [5, 6, 8], [7, 8, 9]]]
            omega, alpha, acc = motion.transpose(1, 0, 2)
            force = m * acc + np.einsum("ijn,j->in", _about_centre(motion), mc)
            spin = np.einsum("ijn,jn->in", _skew(omega), inertia @ omega)
            forces.append(np.stack([force, inertia @ alpha + spin + pin.skew(mc) @ acc]))
        for joint, (R, p) in reversed([*zip(joints, poses, strict=True)]):
            f, moment = forces.pop()
            torque[joint.row, part] = joint.S[:3] @ f + joint.S[3:] @ moment
            moment = moment + np.einsum("ijn,jn->in", _skew(p), f)
            forces[joint.parent] += np.einsum("ijn,kjn->kin", R, np.stack([f, moment]))
    return torque.T


def supports(model: pin.Model) -> list[np.ndarray]:
    """For every row of Γ the columns that can differ from zero: the bodies the joint moves."""
    moved: list[list[int]] = [[] for _ in range(model.nv)]
    for body in range(1, model.njoints):
        joint = body
        while joint > 0:
            for row in range(model.idx_vs[joint], model.idx_vs[joint] + model.nvs[joint]):
                moved[row].extend(range(COUNT * (body - 1), COUNT * body))
            joint = model.parents[joint]
    return [np.array(columns, dtype=int) for columns in moved]


@dataclass(frozen=True, eq=False)
class _Joint:
    """One joint of the model: revolute or prismatic about any axis.

    Attributes:
        parent: number of the parent's joint, 0 for the world.
        rows: of all coordinates that move its body, its own last.
        S: (6,) its axis in the frame of its body, linear part first.
        place, turn: (3,), (3, 3, 3) position at q = 0, and rotation A₀ + A₁ sin q + A₂ (1 − cos q).
    """

    parent: int
    rows: np.ndarray
    S: np.ndarray
    place: np.ndarray
    turn: np.ndarray

    @classmethod
    def of(cls, model: pin.Model, body: int, before: list[_Joint]) -> _Joint:
        """The joint that moves a body, after those that stand before it in the model."""
        joint, placement = model.joints[body], model.jointPlacements[body]
        data = joint.createData()
        joint.calc(data, np.zeros(1))
        R, S = placement.rotation, np.asarray(data.S).reshape(6)
        U, parent = pin.skew(S[3:]), model.parents[body]
        rows = before[parent - 1].rows if parent else np.zeros(0, dtype=int)
        rows = np.append(rows, model.idx_vs[body])
        turn = np.stack([R, R @ U, R @ U @ U])
        return cls(parent, rows, S, np.asarray(placement.translation), turn)

    @property
    def row(self) -> int:
        """Of its coordinate in q and v."""
        return int(self.rows[-1])

    def pose(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """R (3, 3, n), body to parent, and p (3, n), the body's origin in the parent's frame."""
        x = q[self.row]
        if not self.S[3:].any():  # prismatic
            away = self.place[:, None] + np.outer(self.turn[0] @ self.S[:3], x)
            return np.broadcast_to(self.turn[0][:, :, None], (3, 3, len(x))), away
        A = self.turn[:, :, :, None]
        return A[0] + A[1] * np.sin(x) + A[2] * (1.0 - np.cos(x)), self.place[:, None]


def _motions(
    model: pin.Model, q: np.ndarray, v: np.ndarray, a: np.ndarray, axes: bool
) -> Iterator[tuple[slice, list[_Joint], list[np.ndarray], list[tuple[np.ndarray, np.ndarray]]]]:
    """Samples, joints, motion of the world and all bodies (with axes or without), and R and p of
    all bodies, parents before children; arrays are used again for the next samples.
    """
    joints: list[_Joint] = []
    for body in range(1, model.njoints):
        joints.append(_Joint.of(model, body, joints))
    widths = [3, *(3 + 2 * len(joint.rows) * axes for joint in joints)]
    work = [np.empty((3, width, min(len(q), CHUNK))) for width in widths]
    for start in range(0, len(q), CHUNK):
        part = slice(start, min(start + CHUNK, len(q)))
        state = [x[part].T for x in (q, v, a)]
        bodies = [x[:, :, : part.stop - part.start] for x in work]
        bodies[0][:] = 0.0  # all that stands still is accelerated against gravity
        bodies[0][:, 2] = -np.asarray(model.gravity.linear)[:, None]
        poses = [
            _move(joint, bodies[joint.parent], body, *state)
            for joint, body in zip(joints, bodies[1:], strict=True)
        ]
        yield part, joints, bodies, poses


def _move(
    joint: _Joint, before: np.ndarray, body: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Set the motion of a body from its parent's; returns R (3, 3, n) and p (3, n) of its origin.

    Both are (3, 3 + 2 rows, n): ω, α, a of the body in its frame, then the linear and the angular
    part of every axis that moves it, in turn; p is in its frame too. Axes may be left out. q, v, a
    are (nq, n), (nv, n), (nv, n).
    """
    R, p = joint.pose(q)
    old = min(before.shape[1], body.shape[1])
    moved = np.einsum("jin,jmn->imn", R, before[:, :old], out=body[:, :old])
    p = np.einsum("jin,jn->in", R, p)
    # the same at the body's own origin
    moved[:, 2] += np.einsum("ijn,jn->in", _about_centre(moved), p)
    if old > 3:
        moved[:, 3::2] -= np.einsum("ijn,jmn->imn", _skew(p), moved[:, 4::2])
    S, row = joint.S, joint.row
    rate, rise = np.outer(S, v[row]), np.outer(S, a[row])
    spin = _skew(moved[:, 0])
    if S[:3].any():  # 2 ω × v + ω_J × v + its own, ω of the parent
        moved[:, 2] += rise[:3]
        moved[:, 2] += np.einsum("ijn,jn->in", 2 * spin + _skew(rate[3:]), rate[:3])
    if S[3:].any():
        moved[:, 1] += rise[3:]
        moved[:, 1] += np.einsum("ijn,jn->in", spin, rate[3:])
        moved[:, 0] += rate[3:]
    if body.shape[1] > old:
        body[:, old], body[:, old + 1] = S[:3, None], S[3:, None]
    return R, p


def _project(out: np.ndarray, body: np.ndarray) -> None:
    """Γ_ji = S_jᵀ Y_i (rows, 10, n) of one body and all joints that move it."""
    linear, angular, acc, B = body[:, 3::2], body[:, 4::2], body[:, 2], _about_centre(body)
    np.einsum("rmn,rn->mn", linear, acc, out=out[:, 0])
    np.einsum("rmn,rkn->mkn", linear, B, out=out[:, 1:4])
    out[:, 1:4] += np.einsum("rmn,rkn->mkn", angular, _skew(-acc))
    np.einsum("rmn,rkn->mkn", angular, _about_inertia(body, B), out=out[:, 4:])


def _about_centre(state: np.ndarray) -> np.ndarray:
    """B = [α]× + [ω]×² = [α]× + ω ωᵀ − |ω|² 1 (3, 3, n)."""
    omega = state[:, 0]
    B = _skew(state[:, 1])
    B += omega[:, None] * omega[None]
    size = np.einsum("in,in->n", omega, omega)
    for i in range(3):
        B[i, i] -= size
    return B


def _about_inertia(state: np.ndarray, B: np.ndarray) -> np.ndarray:
    """L (3, 6, n) with L (Ixx, Ixy, Iyy, Ixz, Iyz, Izz) = I α + ω × I ω.

    I x = P(x) inertia with P(x) = [x₁ x₂ 0 x₃ 0 0; 0 x₁ x₂ 0 x₃ 0; 0 0 0 x₁ x₂ x₃], so
    L = P(α) + ω × P(ω)
    """
    omega, alpha = state[:, 0], state[:, 1]
    L = np.empty((3, 6, omega.shape[1]))
    # the terms of α alone, those of α and ω (entries of B), those of ω alone
    L[0, 0], L[1, 2], L[2, 5] = alpha
    L[0, 3], L[1, 1], L[2, 4] = B[1, 0], B[2, 1], B[0, 2]
    np.negative(B[2, 0], out=L[0, 1])
    np.negative(B[0, 1], out=L[1, 4])
    np.negative(B[1, 2], out=L[2, 3])
    x, y, z = omega
    np.multiply(y, z, out=L[0, 5])
    np.multiply(x, z, out=L[1, 0])
    np.multiply(x, y, out=L[2, 2])
    np.negative(L[0, 5], out=L[0, 2])
    np.negative(L[1, 0], out=L[1, 5])
    np.negative(L[2, 2], out=L[2, 0])
    np.subtract(B[1, 1], B[2, 2], out=L[0, 4])  # y² − z²
    np.subtract(B[2, 2], B[0, 0], out=L[1, 3])
    np.subtract(B[0, 0], B[1, 1], out=L[2, 1])
    return L


def _skew(x: np.ndarray) -> np.ndarray:
    """[x]× (3, 3, n) of x (3, n)."""
    out = np.zeros((3, *x.shape))
    out[2, 1], out[0, 2], out[1, 0] = x
    out[1, 2], out[2, 0], out[0, 1] = -x
    return out
