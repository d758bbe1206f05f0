"""Γ(q, v, a) and Γ π of many samples at once, in NumPy alone; Pinocchio is read for its model.

A joint of one degree of freedom has an axis s = (s_v, s_w) of linear and angular velocity. In the
frame of body i, with its angular velocity w, ẇ and the acceleration of its origin less gravity g,
the force that the ten parameters of the body need at the joint j of an ancestor is

    m                 s_v · g
    first moments     s_v × ẇ + w (w · s_v) − |w|² s_v + g × s_w
    L (six)           sym(s_w ẇᵀ + (s_w × w) wᵀ)                       s_v = s_w × p + …

which are the columns of the joint's row of Γ. All ancestors of a body are one array, all samples
of a piece its last axis; nothing is compiled. Equal to Pinocchio's regressor and RNEA within
rounding (`tests/truth/test_regressor.py`). Source: C. Atkeson, C. An, J. Hollerbach, Int. J. Robot.
Res. 5(3), 1986, eq. 8–16, with barycentric parameters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

Array = np.ndarray
COUNT = 10  # range: dynamic parameters of a body
PIECE = 4096  # work: samples at once: fewer passes, arrays that the cache still holds
AXES = {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}
# range: places (row, column) of Lxx, Lxy, Lyy, Lxz, Lyz, Lzz
MOMENTS = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint of one degree of freedom: its axis, its placement on its parent, its coordinate."""

    parent: int  # number of the joint that carries it, −1 for the world
    turns: bool  # revolute, else prismatic
    on_circle: bool  # its configuration is (cos q, sin q)
    q: int  # first place in a configuration
    v: int  # place in a velocity
    axis: Array  # (3,) in its own frame
    # rotation from its frame to its parent's: R₀ + R_s sin q + R_c cos q, (3, 3) each
    rotations: tuple[Array, Array, Array]
    translation: Array  # (3,) [m]

    @classmethod
    def of(cls, model: pin.Model, index: int) -> Joint | None:
        """Return a joint of a model by its number; None for one of another kind."""
        joint = model.joints[index]
        kind = joint.shortname().removeprefix("JointModel")
        if kind[:-1] in ("R", "P", "RUB") and kind[-1] in AXES:
            axis = np.array(AXES[kind[-1]])
        elif kind in ("RevoluteUnaligned", "PrismaticUnaligned", "RevoluteUnboundedUnaligned"):
            data = joint.createData()
            joint.calc(data, np.zeros(1) if joint.nq == 1 else np.array([1.0, 0.0]))
            linear, angular = np.asarray(data.S).ravel().reshape(2, 3)
            axis = angular if kind.startswith("R") else linear
        else:
            return None
        R, p = (np.array(x) for x in (model.jointPlacements[index].rotation,
                                      model.jointPlacements[index].translation))  # fmt: skip
        x, y, z = axis
        K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        turns = kind.startswith("R")
        none = np.zeros((3, 3))
        rotations = (R @ (np.eye(3) + K @ K), R @ K, -R @ K @ K) if turns else (R, none, none)
        return cls(
            model.parents[index] - 1, turns, joint.nq == 2, joint.idx_q, joint.idx_v, axis,
            rotations, p,
        )  # fmt: skip

    def placement(self, q: Array) -> tuple[Array, Array]:
        """Return R (3, 3, n) and p (3, n) from its frame to its parent's; q (nq, n)."""
        n, (constant, of_sine, of_cosine) = q.shape[1], self.rotations
        if not self.turns:
            p = self.translation[:, None] + (constant @ self.axis)[:, None] * q[self.q]
            return np.broadcast_to(constant[:, :, None], (3, 3, n)), p
        if self.on_circle:
            sine, cosine = q[self.q + 1], q[self.q]
        else:
            sine, cosine = np.sin(q[self.q]), np.cos(q[self.q])
        R = np.empty((3, 3, n))
        for place in np.ndindex(3, 3):
            entry = R[place]
            np.multiply(sine, of_sine[place], out=entry)
            if of_cosine[place]:
                entry += cosine * of_cosine[place]
            if constant[place]:
                entry += constant[place]
        return R, self.translation[:, None]


def joints_of(model: pin.Model) -> list[Joint] | None:
    """Return all joints of a model; None if one has not one degree of freedom."""
    joints = [Joint.of(model, index) for index in range(1, model.njoints)]
    return None if None in joints else joints  # type: ignore[return-value]


def cross(a: Array, b: Array) -> Array:
    """a × b of arrays (3, …, n)."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.multiply(a[j], b[k], out=out[i])
        out[i] -= a[k] * b[j]
    return out


def dot(a: Array, b: Array) -> Array:
    """a · b of arrays (3, …, n)."""
    out = a[0] * b[0]
    out += a[1] * b[1]
    out += a[2] * b[2]
    return out


def rotated(R: Array, x: Array, *, back: bool) -> Array:
    """R x, or Rᵀ x (`back`), of x (3, …, n)."""
    R = R if back else R.transpose(1, 0, 2)
    R = R.reshape(3, 3, *(1,) * (x.ndim - 2), R.shape[2])
    out = np.empty(x.shape)
    for i in range(3):
        np.multiply(R[0, i], x[0], out=out[i])
        out[i] += R[1, i] * x[1]
        out[i] += R[2, i] * x[2]
    return out


@dataclass(eq=False)
class BodyState:
    """What a body's ten columns need, in its frame, of n samples."""

    w: Array  # (3, n) angular velocity
    dw: Array  # (3, n) its derivative
    g: Array  # (3, n) acceleration of its origin, less gravity
    # (3, ancestors, n) the axes of the joints that carry it, from the base on, its own the last
    sw: Array
    sv: Array


def states(
    model: pin.Model, joints: list[Joint], q: Array, v: Array, a: Array, *, axes: bool
) -> tuple[list[BodyState], list[tuple[Array, Array]]]:
    """Return the states of all bodies at q (nq, n), v, a (nv, n), and the joints' placements;
    `axes`: whether their ancestors' axes are wanted.
    """
    n, bodies = q.shape[1], list[BodyState]()
    still, gravity = np.zeros((3, n)), -np.array(model.gravity.linear)[:, None]
    placements = [joint.placement(q) for joint in joints]
    for joint, (R, p) in zip(joints, placements, strict=True):
        moves = joint.parent >= 0
        if moves:
            parent = bodies[joint.parent]
            w, dw, g, sw, sv = parent.w, parent.dw, parent.g, parent.sw, parent.sv
            g = g + cross(dw, p) + cross(w, cross(w, p))
            w, dw, g = (rotated(R, x, back=True) for x in (w, dw, g))
            if axes:
                sv = rotated(R, sv + cross(sw, p[:, None]), back=True)
                sw = rotated(R, sw, back=True)
        else:
            w = dw = still
            g = rotated(R, np.broadcast_to(gravity, (3, n)), back=True)
            sw = sv = np.zeros((3, 0, n))
        axis, rate, second = joint.axis[:, None], v[joint.v], a[joint.v]
        if joint.turns:
            dw = dw + (cross(w, axis * rate) if moves else 0.0) + axis * second
            w = w + axis * rate
        else:
            g = g + axis * second + (2 * cross(w, axis * rate) if moves else 0.0)
        if axes:
            own_axis = np.broadcast_to(axis[:, None], (3, 1, n))
            none = np.zeros((3, 1, n))
            sw = np.concatenate([sw, own_axis if joint.turns else none], axis=1)
            sv = np.concatenate([sv, none if joint.turns else own_axis], axis=1)
        bodies.append(BodyState(w, dw, g, sw, sv))
    return bodies, placements


def regressor(
    model: pin.Model, joints: list[Joint], q: Array, v: Array, a: Array, Z: Array | None = None
) -> Array:
    """Return Γ (nv, 10 · bodies, n) of q (n, nq), v (n, nv), a (n, nv), or ZᵀΓ (d, …) with Z
    (nv, d), of which no row of Γ is kept.
    """
    n = len(q)
    gamma = np.zeros((model.nv if Z is None else Z.shape[1], COUNT * len(joints), n))
    carriers: list[list[int]] = []  # of each body the rows of its ancestors, from the base on
    for joint in joints:
        carriers.append([*(carriers[joint.parent] if joint.parent >= 0 else []), joint.v])
    for start in range(0, n, PIECE):
        part = slice(start, min(start + PIECE, n))
        motion = (np.ascontiguousarray(x[part].T) for x in (q, v, a))
        bodies, _ = states(model, joints, *motion, axes=True)
        for i, (body, rows) in enumerate(zip(bodies, carriers, strict=True)):
            columns = _columns(body)
            if Z is not None:
                felt = np.flatnonzero(Z[rows].any(axis=0))
                rows, columns = felt.tolist(), np.tensordot(Z[rows][:, felt].T, columns, 1)
            for row, of_row in zip(rows, columns, strict=True):
                gamma[row, COUNT * i : COUNT * (i + 1), part] = of_row
    return gamma


def _columns(body: BodyState) -> Array:
    """Return the ten columns of a body in the rows of its ancestors, (ancestors, 10, n)."""
    sw, sv = body.sw, body.sv
    w, dw, g = body.w[:, None], body.dw[:, None], body.g[:, None]
    out = np.empty((sw.shape[1], COUNT, sw.shape[2]))
    out[:, 0] = dot(sv, g)
    along, square = dot(sv, w), dot(w, w)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        moment = out[:, 1 + i]
        np.multiply(sv[j], dw[k], out=moment)
        moment -= sv[k] * dw[j]
        moment += g[j] * sw[k]
        moment -= g[k] * sw[j]
        moment += w[i] * along
        moment -= sv[i] * square
    turned = cross(sw, w)
    for number, (i, j) in enumerate(MOMENTS):
        moment = out[:, 4 + number]
        np.multiply(sw[i], dw[j], out=moment)
        moment += turned[i] * w[j]
        if i != j:
            moment += sw[j] * dw[i]
            moment += turned[j] * w[i]
    return out


def rigid_forces(
    model: pin.Model, joints: list[Joint], q: Array, v: Array, a: Array, pi: Array
) -> Array:
    """Return Γ π (n, nv) of π (10 · bodies,), possible bodies or not: one pass out, one back."""
    forces = np.zeros((model.nv, len(q)))
    for start in range(0, len(q), PIECE):
        part = slice(start, min(start + PIECE, len(q)))
        dynamics = Dynamics.of(model, joints, q[part], v[part], a[part], pi)
        for joint, (f, moment) in zip(joints, dynamics.wrenches, strict=True):
            forces[joint.v, part] = joint.axis @ (moment if joint.turns else f)
    return forces.T


@dataclass(frozen=True, eq=False)
class Dynamics:
    """Bodies in motion at n samples, and what moves them."""

    joints: list[Joint]
    pi: Array  # (10 · bodies,)
    bodies: list[BodyState]
    placements: list[tuple[Array, Array]]  # of the joints, on their parents
    wrenches: list[tuple[Array, Array]]  # force, moment (3, n) through each joint, in its frame

    @classmethod
    def of(
        cls, model: pin.Model, joints: list[Joint], q: Array, v: Array, a: Array, pi: Array
    ) -> Dynamics:
        """Return those of q (n, nq), v, a (n, nv) and π, possible bodies or not."""
        motion = (np.ascontiguousarray(x.T) for x in (q, v, a))
        bodies, placements = states(model, joints, *motion, axes=False)
        wrenches = [_wrench(*x) for x in zip(bodies, pi.reshape(-1, COUNT), strict=True)]
        for i in reversed(range(len(joints))):
            if (below := joints[i].parent) >= 0:
                wrenches[below] = _added(wrenches[below], placements[i], wrenches[i])
        return cls(joints, pi, bodies, placements, wrenches)

    def slopes(self, k: int, along: Array) -> Array:
        """Return the change (nv, n) of Γ π as joint k is displaced on its parent by `along` (3,),
        to first order: all that it carries is accelerated by ẇ × d + w × (w × d) more, and its
        wrench has a longer arm.
        """
        n, below, d = self.bodies[k].w.shape[1], self.joints[k].parent, along[:, None]
        out = np.zeros((len(self.joints), n))
        if below < 0:  # the world does not move, and has no row
            return out
        w, dw = self.bodies[below].w, self.bodies[below].dw
        more = {below: cross(dw, d) + cross(w, cross(w, d))}
        change: dict[int, tuple[Array, Array]] = {}
        for i in range(k, len(self.joints)):
            joint, pi = self.joints[i], self.pi[COUNT * i : COUNT * (i + 1)]
            if i == k or (joint.parent in more and joint.parent != below):
                g = more[i] = rotated(self.placements[i][0], more[joint.parent], back=True)
                change[i] = pi[0] * g, cross(pi[1:4, None], g)
        none = np.zeros((3, n))
        for i in reversed(range(len(self.joints))):
            if i not in change:
                continue
            joint, (f, moment) = self.joints[i], change[i]
            out[joint.v] = joint.axis @ (moment if joint.turns else f)
            if joint.parent >= 0:
                before = change.get(joint.parent, (none, none))
                total = _added(before, self.placements[i], (f, moment))
                if i == k:
                    arm = cross(d, rotated(self.placements[k][0], self.wrenches[k][0], back=False))
                    total = total[0], total[1] + arm
                change[joint.parent] = total
        return out


def _added(
    below: tuple[Array, Array], placement: tuple[Array, Array], wrench: tuple[Array, Array]
) -> tuple[Array, Array]:
    """Return a body's wrench with that of a joint on it, which is in the joint's frame."""
    (R, p), (f, moment) = placement, wrench
    f, moment = rotated(R, f, back=False), rotated(R, moment, back=False)
    return below[0] + f, below[1] + moment + cross(p, f)


def _wrench(body: BodyState, pi: Array) -> tuple[Array, Array]:
    """Return force and moment (3, n) that a body's motion needs, about its frame's origin."""
    h, w, dw = pi[1:4, None], body.w, body.dw
    L = np.zeros((3, 3))
    for value, (i, j) in zip(pi[4:], MOMENTS, strict=True):
        L[i, j] = L[j, i] = value
    f = pi[0] * body.g + cross(dw, h) + cross(w, cross(w, h))
    return f, cross(h, body.g) + L @ dw + cross(w, L @ w)
