"""Forward kinematics of Pinocchio's model as CasADi expressions.

PyPI's `pin` has no CasADi binding, so placements are written here from the model's own data:
a joint's placement in its parent, then the joint's motion. Tested against Pinocchio.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import pinocchio as pin

from ident.errors import MechanismError


@dataclass(frozen=True)
class Placement:
    """Of a frame in the world: rotation R (3, 3) and origin p (3,) [m], CasADi or NumPy."""

    R: ca.SX
    p: ca.SX

    def __mul__(self, other: Placement) -> Placement:
        return Placement(self.R @ other.R, self.R @ other.p + self.p)

    @staticmethod
    def of(M: pin.SE3) -> Placement:
        """Pinocchio's constant placement, rounded where it is 0 or 1 but for rounding."""
        return Placement(ca.SX(_tidy(M.rotation)), ca.SX(_tidy(M.translation)))


def _tidy(values: np.ndarray) -> np.ndarray:
    nearest = np.round(values)
    return np.where(np.abs(values - nearest) < 1e-12, nearest, values)


def joint_axis(model: pin.Model, index: int) -> np.ndarray:
    """The unit axis (3,) of a joint with one coordinate, in the joint's frame.

    It is read off Pinocchio's own kinematics, so that no joint type needs a case of its own.
    """
    joint = model.joints[index]
    data = joint.createData()
    joint.calc(data, np.zeros(model.nq))
    S = np.asarray(data.S).reshape(6, -1)  # linear, then angular
    if S.shape[1] != 1:
        raise MechanismError(f"joint '{model.names[index]}' has {S.shape[1]} coordinates, not one")
    return _tidy(S[:3, 0] + S[3:, 0])


def is_rotational(model: pin.Model, index: int) -> bool:
    """Whether the joint's coordinate is an angle."""
    data = model.joints[index].createData()
    model.joints[index].calc(data, np.zeros(model.nq))
    return bool(np.abs(np.asarray(data.S).reshape(6, -1)[3:]).max() > 0.5)


def placements(model: pin.Model, q: ca.SX) -> list[Placement]:
    """World placements of all joints' frames, index 0 being the world.

    Args:
        model: Pinocchio's model.
        q: (nq,) in Pinocchio's order [rad | m | unit quaternion].
    """
    found = [Placement(ca.SX.eye(3), ca.SX.zeros(3))]
    for index in range(1, model.njoints):
        fixed = found[model.parents[index]] * Placement.of(model.jointPlacements[index])
        found.append(fixed * _motion(model, index, q))
    return found


def _motion(model: pin.Model, index: int, q: ca.SX) -> Placement:
    joint, at = model.joints[index], model.idx_qs[index]
    if joint.nq == 7:
        return Placement(_rotation_of_quaternion(q[at + 3 : at + 7]), q[at : at + 3])
    axis = joint_axis(model, index)
    if is_rotational(model, index):
        return Placement(_rotation_about(axis, q[at]), ca.SX.zeros(3))
    return Placement(ca.SX.eye(3), ca.SX(axis) * q[at])


def _rotation_about(axis: np.ndarray, angle: ca.SX) -> ca.SX:
    # Rodrigues: R = I + sin(q) [a]× + (1 − cos(q)) [a]×²
    cross = ca.skew(ca.SX(axis))
    return ca.SX.eye(3) + ca.sin(angle) * cross + (1 - ca.cos(angle)) * (cross @ cross)


def _rotation_of_quaternion(xyzw: ca.SX) -> ca.SX:
    cross = ca.skew(xyzw[:3])
    return ca.SX.eye(3) + 2 * xyzw[3] * cross + 2 * (cross @ cross)


def rates(model: pin.Model, q: ca.SX) -> ca.SX:
    """N(q) (nq, nv) of q̇ = N(q) v: unit for scalar joints, the quaternion's for a free body."""
    N = ca.SX(model.nq, model.nv)
    for index in range(1, model.njoints):
        joint, iq, iv = model.joints[index], model.idx_qs[index], model.idx_vs[index]
        if joint.nq == 1:
            N[iq, iv] = 1
            continue
        xyzw = q[iq + 3 : iq + 7]
        # ṗ = R v_lin ; quaternion rate = ½ quaternion ∘ (ω, 0), ω in the body's axes
        N[iq : iq + 3, iv : iv + 3] = _rotation_of_quaternion(xyzw)
        N[iq + 3 : iq + 6, iv + 3 : iv + 6] = 0.5 * (xyzw[3] * ca.SX.eye(3) + ca.skew(xyzw[:3]))
        N[iq + 6, iv + 3 : iv + 6] = -0.5 * xyzw[:3].T
    return N
