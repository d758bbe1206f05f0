"""The equations of motion at one instant.

    M v̇ + h + Jᵀλ = f,   J v̇ + J̇v = 0       v̇ = a₀ + Z α,   J Z = 0,   a₀ = −J⁺ J̇v

Z and J⁺ come from one singular value decomposition of J, so that closures may repeat each other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np
import pinocchio as pin

from ident.effects import Signals
from ident.equations.point import Point
from ident.errors import MotionError
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.tree import rates
from ident.simulate.laws import Laws
from ident.simulate.rigid import Rigid

SINGULAR = 1e-7  # of the largest singular value of J: below, the closures lose a direction


class OneSample:
    """A CasADi function (q, v) → (value, rate, drift), called for one sample without overhead."""

    def __init__(self, function: ca.Function) -> None:
        m, nv = function.size1_out(0), function.size1_in(1)
        self._q, self._v = np.zeros(function.size1_in(0)), np.zeros(nv)
        self._found = np.zeros(m), np.zeros((nv, m)), np.zeros(m)
        self._buffer, self._call = function.buffer()
        for i, x in enumerate((self._q, self._v)):
            self._buffer.set_arg(i, memoryview(x))  # type: ignore[call-arg, arg-type]
        for i, found in enumerate(self._found):
            self._buffer.set_res(i, memoryview(found))  # type: ignore[call-arg, arg-type]

    def __call__(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """value (m,), rate (m, nv), drift (m,)."""
        self._q[:], self._v[:] = q, v
        self._call()
        value, rate, drift = self._found
        return value.copy(), rate.T.copy(), drift.copy()


@dataclass(frozen=True, eq=False)
class Moment:
    """State and terms of the equations at one instant.

    Attributes:
        q, v: (nq,), (nv,); z: (presliding,) states of the friction springs.
        y, yd: (J,) of the mechanism's joints; W (J, nv), drift (J,): ÿ = W v̇ + drift.
        M, h: with the inertias that effects add.
        J: (m, nv); Jp: (nv, m) its pseudo-inverse; Z: (nv, d); a0: (nv,).
    """

    t: float
    q: np.ndarray
    v: np.ndarray
    z: np.ndarray
    y: np.ndarray
    yd: np.ndarray
    W: np.ndarray
    drift: np.ndarray
    M: np.ndarray
    h: np.ndarray
    J: np.ndarray
    Jp: np.ndarray
    Z: np.ndarray
    a0: np.ndarray


@dataclass(frozen=True, eq=False)
class Plant:
    """A mechanism ready to be integrated.

    Attributes:
        mechanism: as its effects correct it (gravity, lengths).
        laws: of its effects.
        rigid: its bodies with payloads; bare: without.
    """

    mechanism: Mechanism
    laws: Laws
    rigid: Rigid
    bare: Rigid

    @classmethod
    def of(cls, mechanism: Mechanism, point: Point) -> Plant:
        """Of a mechanism that is corrected already, with all values in `point`."""
        laws = Laws.of(mechanism, point)
        bare = Rigid.of(mechanism.model, point.pi)
        loaded = bool((laws.pi != point.pi).any())
        rigid = Rigid.of(mechanism.model, laws.pi) if loaded else bare
        return cls(mechanism, laws, rigid, bare)

    @cached_property
    def _closure(self) -> OneSample:
        return OneSample(self.mechanism.kinematics.closure_function)

    @cached_property
    def _own(self) -> OneSample:
        return OneSample(self.mechanism.kinematics.own_function)

    @cached_property
    def _uses_own(self) -> bool:
        laws = self.laws
        used = {i for law in laws.smooth for i in law.at} | {i for k in laws.dry for i in k.at}
        used |= set(np.flatnonzero(laws.line.T0))
        used |= set(np.flatnonzero(laws.line.Tq.any(axis=1) | laws.line.Tv.any(axis=1)))
        used |= {k.at for k in laws.presliding} | {i for at, _ in laws.inertial for i in at}
        used |= {self.mechanism.joint_index[name] for name in self.mechanism.driven}
        return any(not self.mechanism.joints[i].in_tree for i in used)

    @cached_property
    def dry(self) -> np.ndarray:
        """(dry, J): which joints' rates add up where dry friction acts."""
        found = np.zeros((len(self.laws.dry), len(self.mechanism.joints)))
        for row, each in zip(found, self.laws.dry, strict=True):
            row[list(each.at)] = 1.0
        return found

    @cached_property
    def driven(self) -> list[int]:
        """Where the drives stand among the joints."""
        return [self.mechanism.joint_index[name] for name in self.mechanism.driven]

    @cached_property
    def _tree(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Places of tree joints among all joints, their places in v, and W (J, nv) of them."""
        joints = self.mechanism.joints
        at = np.array([i for i, joint in enumerate(joints) if joint.in_tree], dtype=int)
        index = np.array([joints[i].index for i in at], dtype=int)
        W = np.zeros((len(joints), self.mechanism.model.nv))
        W[at, index] = 1.0
        return at, index, W

    @cached_property
    def _qdot(self) -> ca.Function | None:
        model = self.mechanism.model
        if model.nq == model.nv:
            return None
        q, v = ca.SX.sym("q", model.nq), ca.SX.sym("v", model.nv)
        return ca.Function("qdot", [q, v], [rates(model, q) @ v])

    def qdot(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """q̇ (nq,): v itself where every joint has one coordinate."""
        return v if self._qdot is None else self._qdot(q, v).full().ravel()

    def closures(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Φ (m,), J (m, nv), J̇v (m,)."""
        if not self.mechanism.closures:
            nv = self.mechanism.model.nv
            return np.zeros(0), np.zeros((0, nv)), np.zeros(0)
        return self._closure(q, v)

    def joints(
        self, q: np.ndarray, v: np.ndarray, near: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """y (J,), W (J, nv), Ẇv (J,) of all joints; of closures' own only where something needs it.

        Args:
            near: (J,) coordinates from which whole turns of closures' own joints are counted.
        """
        at, index, W = self._tree
        y, drift = np.zeros(len(W)), np.zeros(len(W))
        y[at] = q[index]
        if not self._uses_own:
            return y, W, drift
        W = W.copy()
        value, rate, own_drift = self._own(q, v)
        for i, joint in enumerate(self.mechanism.joints):
            if not joint.in_tree:
                y[i], W[i], drift[i] = value[joint.index], rate[joint.index], own_drift[joint.index]
                if joint.rotational and near is not None:
                    y[i] += 2 * np.pi * np.round((near[i] - y[i]) / (2 * np.pi))
        return y, W, drift

    def moment(
        self, t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray, near: np.ndarray | None = None
    ) -> Moment:
        """The terms of the equations at one instant.

        Raises:
            MotionError: at a singular position of the closures.
        """
        _, J, gamma = self.closures(q, v)
        y, W, drift = self.joints(q, v, near)
        M, h = self.rigid.mass(q), self.rigid.bias(q, v)
        for at, Ia in self.laws.inertial:
            w = W[list(at)].sum(axis=0)
            M = M + Ia * np.outer(w, w)
            h = h + Ia * drift[list(at)].sum() * w
        Z, Jp = self.split(J, t)
        return Moment(t, q, v, z, y, W @ v, W, drift, M, h, J, Jp, Z, -Jp @ gamma)

    def inverse(self, m: Moment, at: list[int], ydd: np.ndarray, against: np.ndarray) -> np.ndarray:
        """Torques of the joints `at` for their accelerations ydd, against further forces (nv,).

        Zᵀ Wᵀ τ = Zᵀ (M v̇ + h + against),  W v̇ + drift = ÿ; least squares and the smallest τ where
        there are not as many drives as degrees of freedom.
        """
        reach = m.W[at] @ m.Z
        back = np.linalg.pinv(reach, 1e-9)
        a = m.a0 + m.Z @ (back @ (ydd - m.drift[at] - m.W[at] @ m.a0))
        return back.T @ (m.Z.T @ (m.M @ a + m.h + against))

    def split(self, J: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Z (nv, d) with J Z = 0, and J⁺ (nv, m).

        Raises:
            MotionError: where J has lost rank.
        """
        nv = self.mechanism.model.nv
        if not len(J):
            return np.eye(nv), np.zeros((nv, 0))
        r = self.mechanism.rank
        U, S, Vt = np.linalg.svd(J)
        if r and S[r - 1] < SINGULAR * S[0]:
            raise MotionError(
                f"{self.mechanism.name}: at t = {t:.4g} s the simulated motion comes to a singular "
                "position, where its closures leave more than one way to go on; start elsewhere, "
                "or simulate less time"
            )
        return Vt[r:].T, (Vt[:r].T / S[:r]) @ U[:, :r].T

    def closed(
        self, t: float, q: np.ndarray, v: np.ndarray, stuck: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The nearest q with Φ(q) = 0 and v with J v = 0, at which stuck joints stand.

        Coordinate projection: Eich, SIAM J. Numer. Anal. 30(5), 1993; Hairer, Wanner, Solving
        Ordinary Differential Equations II, VII.2.

        Args:
            stuck: (k, nv) rows w of joints that stick, w v = 0.
        """
        model = self.mechanism.model
        if model.nq != model.nv:
            q = pin.normalize(model, q)
        Jp = np.zeros((model.nv, 0))
        for _ in range(4 if self.mechanism.closures else 0):
            phi, J, _ = self.closures(q, v)
            _, Jp = self.split(J, t)
            if np.abs(phi).max() < 1e-14:
                break
            q = pin.integrate(model, q, -Jp @ phi)
        _, J, _ = self.closures(q, v)
        v = v - Jp @ (J @ v)
        if len(stuck):
            held = np.vstack([J, stuck])
            v = v - np.linalg.pinv(held, 1e-9) @ (held @ v)
        return q, v


def corrected_mechanism(mechanism: Mechanism, point: Point) -> Mechanism:
    """The mechanism with the gravity and the lengths that its effects say."""
    for effect in mechanism.effects:
        if not effect.corrects or effect.implicit:
            continue
        none = np.zeros((1, len(effect.joints)))
        signals = Signals(np.zeros(1), none, none, none, none[0])
        mechanism = mechanism.corrected(
            effect.correction(replace(signals, shape=point.of(effect)[1]))
        )
    return mechanism
