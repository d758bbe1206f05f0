"""States near a state: a joint's coordinate, rate or acceleration a little larger, to first order.

    z = K⁺ e_i       all rates at unit rate of joint i               K = [J; W_u]
    coordinate       q' = q ⊕ h z    v' = v − K⁺ δK v    a' = a − K⁺ (δK a + δdrift)
    rate             v' = v + h z    a' = a − K⁺ δdrift
    acceleration     a' = a + h z
    δK⁺ = −K⁺ δK K⁺ + K⁺K⁺ᵀ δKᵀ (1 − K K⁺)      the second term where equations are redundant

δK and δdrift (of J̇v, Ẇv) are differences between both states; K⁺ is that of the state itself, so
nothing is solved or factored anew: two evaluations of the closures a joint.

Source of δK⁺: G. Golub, V. Pereyra, SIAM J. Numer. Anal. 10, 1973.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ident.mechanism.mechanism import Mechanism
from ident.motion.closures import LoopSolver, integrate, pseudo_inverse
from ident.motion.state import State, joint_coordinates


@dataclass(frozen=True, eq=False)
class Neighbours:
    """States near that of a mechanism with closures, whose joints `names` determine its motion."""

    mechanism: Mechanism
    e: State
    names: Sequence[str]

    @cached_property
    def _solver(self) -> LoopSolver:
        return LoopSolver(self.mechanism, self.names)

    def _rate(self, solver: LoopSolver, q: np.ndarray) -> np.ndarray:
        """Return K (n, m + d, nv) at q."""
        closure, joints = self.mechanism.kinematics.closure_rows(q), solver.coordinates(q)
        return np.concatenate([closure.rate, joints.rate], axis=1)

    def _drift(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return J̇v and Ẇv (n, m + d) at q and v."""
        closure = self.mechanism.kinematics.closure_drift(q, v)
        return np.concatenate([closure, self._solver.coordinates(q, v).drift], axis=1)

    @cached_property
    def _state(self) -> tuple[np.ndarray, np.ndarray]:
        """K and its drift of the state itself."""
        return self._rate(self._solver, self.e.q), self._drift(self.e.q, self.e.v)

    @cached_property
    def _inverse(self) -> np.ndarray:
        """K⁺ (n, nv, m + d) of the joints that are shifted."""
        same = tuple(self.names) == self.e.independent
        return self.e.pinv if same else pseudo_inverse(self._state[0])

    def shifted(self, name: str, order: int, step: float) -> State:
        """Return the state in which a joint's coordinate (order 0), rate (1) or acceleration (2) is
        larger by `step`; the others of `names` are as they were.
        """
        e, K_inverse = self.e, self._inverse
        z = step * K_inverse[:, :, self.names.index(name) - len(self.names)]
        q, v, a, loop = e.q, e.v, e.a, e.loop
        if order == 2:
            a = a + z
        elif order == 1:
            v = v + z
            a = a - _times(K_inverse, self._change_of_drift(name, v, step))
        else:
            q = integrate(self.mechanism.model, q, z)
            change = self._rate(self._solver, q) - self._state[0]
            self._changes[name] = _times(change, e.v) / step
            v = v - _times(K_inverse, _times(change, v))
            drift = self._drift(q, v) - self._state[1]
            a = a - _times(K_inverse, _times(change, a) + drift)
            loop = self._loop(q, change)
        turns = {joint.name: e.y[:, i] for i, joint in enumerate(self.mechanism.joints)}
        y, yd, ydd = joint_coordinates(self.mechanism, q, v, a, turns)
        return replace(e, q=q, v=v, a=a, y=y, yd=yd, ydd=ydd, loop=loop)

    @cached_property
    def _changes(self) -> dict[str, np.ndarray]:
        """∂K/∂y v (n, m + d) by joint, as far as it has been shifted."""
        return {}

    def _change_of_drift(self, name: str, v: np.ndarray, step: float) -> np.ndarray:
        """Return δdrift (n, m + d) at the rates v, which differ by `step` in a joint's rate.

        Of scalar joints the drift is vᵀ ∂²Φ v, whose derivative along z is twice ∂K/∂y v.
        """
        model = self.mechanism.model
        if model.nq == model.nv and name in self._changes:
            return 2.0 * step * self._changes[name]
        return self._drift(self.e.q, v) - self._state[1]

    def _loop(self, q: np.ndarray, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return K⁺ and the velocity transmission of the independent joints at q, where K of the
        shifted ones has changed by `change`.
        """
        mechanism, e = self.mechanism, self.e
        m, d = len(mechanism.kinematics.multipliers), len(e.independent)
        joints, every = mechanism.joints, None
        if not all(joint.in_tree for joint in joints):
            every = LoopSolver(mechanism, (joint.name for joint in joints)).coordinates(q).rate
        change_of_K = np.zeros((len(q), m + d, change.shape[2]))
        change_of_K[:, :m] = change[:, :m]
        if every is not None:
            now = LoopSolver(mechanism, e.independent).coordinates(e.q).rate
            change_of_K[:, m:] = every[:, [mechanism.joint_index[x] for x in e.independent]] - now
        pinv = e.pinv - e.pinv[:, :, : m + d] @ (change_of_K @ e.pinv)
        if m + d > pinv.shape[1]:
            before = self._independent_rows
            rest = np.eye(m + d) - before @ e.pinv
            pinv += e.pinv @ (e.pinv.transpose(0, 2, 1) @ (change_of_K.transpose(0, 2, 1) @ rest))
        Z = pinv[:, :, m:]
        if every is not None:
            return pinv, every @ Z
        return pinv, Z[:, [joint.index for joint in joints]]

    @cached_property
    def _independent_rows(self) -> np.ndarray:
        return self._rate(LoopSolver(self.mechanism, self.e.independent), self.e.q)


def _times(M: np.ndarray, x: np.ndarray) -> np.ndarray:
    """M x (n, i) of stacked M (n, i, j) and x (n, j)."""
    return np.asarray(np.einsum("nij,nj->ni", M, x))
