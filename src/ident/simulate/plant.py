"""Bodies, closures and joints of a mechanism, evaluated at one instant.

    M v̇ + h + Jᵀλ = f,   J v̇ + J̇v = 0       v̇ = a₀ + Z α,   J Z = 0,   a₀ = −J⁺ J̇v

Z and J⁺ come from one singular value decomposition of J, so that closures may repeat each other.

Its effects are forward laws, sorted by `Unknown.acts`:

torque   E c, any smooth function of the state: ripple, an end stop, a torque's gain, …
linear   E c, linear in q and v: viscous friction, springs, …; all of them are one matrix
inertia  c times the acceleration, which joins M: rotor inertia, a coupling's inertia
dry      a largest friction torque F ≥ 0 at a joint, or at the sum of two: Stribeck, …
level    a part of F that no state changes: Coulomb
state    c z with a state z of its own, ż = `Effect.state_rate` (Dahl)
body     ten more dynamic parameters of a link

All come from the effects' own columns, so that a simulated log and the equations that identify from
it cannot disagree.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np
import pinocchio as pin

from ident.effects import Correction, Effect, Signals
from ident.equations.unknowns import Point
from ident.errors import MechanismError, MotionError
from ident.information import linear
from ident.mechanism.closures import rates
from ident.mechanism.kinematics import Mapped
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import Rigid

SMOOTH = 1e-3  # range: [rad/s | m/s] below which the sign of a law, no dry friction, is smooth
SIGN_ONLY = 1e-200  # numerics: [rad/s | m/s] a speed that has a sign and no size
Extra = Mapping[str, Callable[[float], float]]


def signals_at(
    since: float, t: float, y: np.ndarray, yd: np.ndarray, extra: Mapping[str, float]
) -> Signals:
    """Return the signals of all J joints at one instant, y and ẏ (J,), as two samples.

    The first is the log's, at the time `since`: some effects count time from there.
    """
    zero = np.zeros((2, len(y)))
    others = {name: np.full(2, x) for name, x in extra.items()}
    return Signals(np.array([since, t]), zero + y, zero + yd, zero, zero[0], others)


@dataclass(frozen=True, eq=False)
class EffectLaw:
    """The unknowns of one effect that act alike, with their values."""

    effect: Effect
    c: np.ndarray  # (unknowns,) values, zero for those that act otherwise
    # shape, present: values of its shapes, and of all effects' parameters
    shape: Mapping[str, float]
    present: Mapping[str, float]
    at: tuple[int, ...]  # indices of its joints among the mechanism's

    def torque(self, s: Signals, yd: np.ndarray | None = None) -> np.ndarray:
        """Return E c (arity,) [N m | N] of its joints from signals of all joints.

        At other rates (arity,) if they are given.
        """
        at = list(self.at)
        state = replace(
            s,
            q=s.q[:, at],
            v=s.v[:, at] if yd is None else np.stack([yd, yd]),
            a=s.a[:, at],
            still=np.full(len(at), SMOOTH if yd is None else SIGN_ONLY),
            shape=self.shape,
            present=self.present,
            predicted=lambda: (s.torque[:, at], s.load[:, at]),
        )
        return self.effect.columns(state)[-1] @ self.c

    def limit(self, s: Signals) -> float:
        """Return the friction F [N m | N] of a dry law at the present speed, whatever its sign."""
        u = np.zeros(len(self.at))
        u[0] = max(abs(float(s.v[-1, list(self.at)].sum())), SIGN_ONLY)
        return float(self.torque(s, u)[0])


@dataclass(eq=False)
class DryJoint:
    """Dry friction at one joint, or at the sum of two joints' rates."""

    name: str  # of the joint, or of both with a comma
    at: tuple[int, ...]  # their indices
    effects: list[str] = field(default_factory=list)  # labels
    level: float = 0.0  # the part of F that does not depend on the state
    parts: list[EffectLaw] = field(default_factory=list)  # the laws of the rest

    def limit(self, s: Signals, *, explicit: bool = False) -> float:
        """Return F [N m | N], or the part that needs no prediction of the model."""
        if not self.parts:
            return self.level
        parts = (part for part in self.parts if not (explicit and part.effect.asks))
        return self.level + sum(part.limit(s) for part in parts)


class ForwardLaws:
    """All effects of a mechanism, which all have values and laws, sorted by how they act."""

    def __init__(self, mechanism: Mechanism, point: Point) -> None:
        J = len(mechanism.joints)
        zero = np.zeros(J)
        # T0, Tq, Tv: (J,), (J, J), (J, J): the linear laws, T = T0 + Tq y + Tv ẏ
        self.T0, self.Tq, self.Tv = zero.copy(), np.zeros((J, J)), np.zeros((J, J))
        self.pi = point.pi.copy()  # (10 · bodies,) dynamic parameters with payloads
        self.smooth: list[EffectLaw] = []  # other torques
        self.states: list[EffectLaw] = []  # laws with a state
        self.inertial: list[tuple[tuple[int, ...], float]] = []  # joints, coefficient [kg m² | kg]
        self.joints: set[int] = set()  # indices of those on which some law acts
        dry: dict[tuple[str, ...], DryJoint] = {}
        rest = signals_at(0.0, 0.0, zero, zero, {})
        for effect in mechanism.effects:
            if why := effect.not_integrable:
                raise MechanismError(
                    f"effect '{effect.label}': cannot be integrated: {why}; or leave it out, or "
                    "simulate a given motion (without --forward)"
                )
            c, shape = point.of(effect)
            if effect.corrects or effect.in_rows_alone or not c.any():
                continue  # of the measurement or the geometry; or of no size
            if effect.loaded_link:
                self.pi[mechanism.bodies.columns(effect.loaded_link)] += c
                continue
            at = tuple(mechanism.joint_index[name] for name in effect.acting)
            self.joints.update(at)
            for acts in dict.fromkeys(unknown.acts for unknown in effect.unknowns):
                part = np.where([unknown.acts == acts for unknown in effect.unknowns], c, 0.0)
                law = EffectLaw(effect, part, shape, point.values, at)
                if not part.any():
                    continue
                if acts == "inertia":
                    self.inertial.append((at, float(part.sum())))
                elif acts == "state":
                    self.states.append(law)
                elif acts == "linear":
                    self.T0[list(at)] += (offset := law.torque(rest))
                    for i in at:  # known from the columns at rest and at unit states
                        unit = np.tile(np.eye(J)[i], (2, 1))
                        self.Tq[list(at), i] += law.torque(replace(rest, q=unit)) - offset
                        self.Tv[list(at), i] += law.torque(replace(rest, v=unit)) - offset
                elif acts in ("dry", "level"):
                    joint = dry.setdefault(effect.joints, DryJoint(",".join(effect.joints), at))
                    joint.effects.append(effect.label)
                    joint.level += law.limit(rest) if acts == "level" else 0.0
                    joint.parts += [law] if acts == "dry" else []
                else:
                    self.smooth.append(law)
        self.dry = [*dry.values()]
        laws = [*self.smooth, *(part for joint in self.dry for part in joint.parts)]
        # (signal, joint) of the predictions that some law asks for
        asking = ((word, i) for law in laws for word in law.effect.asks for i in law.at)
        self.asking = tuple(dict.fromkeys(asking))
        self.reads = {name for law in laws for name in law.effect.reads()}  # columns of a log


SINGULAR = 1e-7  # numerics: of J's largest singular value: below, the closures lose a direction
Rows = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class InstantTerms:
    """State and terms of the equations at one instant."""

    t: float
    # q, v: (nq,), (nv,)
    q: np.ndarray
    v: np.ndarray
    z: np.ndarray  # (states,) of effects that have one
    # y, yd: (J,) of the mechanism's joints; W (J, nv), drift (J,): ÿ = W v̇ + drift
    y: np.ndarray
    yd: np.ndarray
    W: np.ndarray
    drift: np.ndarray
    # M, h: with the inertias that effects add
    M: np.ndarray
    h: np.ndarray
    J: np.ndarray  # (m, nv)
    Jp: np.ndarray  # (nv, m) its pseudo-inverse
    Z: np.ndarray  # (nv, d)
    a0: np.ndarray  # (nv,)


class Plant:
    """A mechanism ready to be integrated."""

    def __init__(self, mechanism: Mechanism, point: Point, observed: tuple[int, ...] = ()) -> None:
        """Prepare a mechanism that its effects have corrected (gravity, lengths).

        All values are in `point`; coordinates of the joints `observed` are wanted, whatever acts
        on them.
        """
        model, joints = mechanism.model, mechanism.joints
        self.mechanism = mechanism
        self.laws = laws = ForwardLaws(mechanism, point)
        self.rigid = Rigid.of(model, laws.pi)
        self.driven = [mechanism.joint_index[name] for name in mechanism.driven]
        self.dry = np.zeros((len(laws.dry), len(joints)))  # joints whose rates add up in friction
        for row, joint in zip(self.dry, laws.dry, strict=True):
            row[list(joint.at)] = 1.0
        self._tree = [i for i, joint in enumerate(joints) if joint.in_tree]
        self._index = [joints[i].index for i in self._tree]
        self._W = np.zeros((len(joints), model.nv))
        self._W[self._tree, self._index] = 1.0
        self._free = np.eye(model.nv), np.zeros((model.nv, 0))  # Z and J⁺ without closures
        self.qdot = lambda q, v: v  # q̇ (nq,); v itself where every joint has one coordinate
        if model.nq != model.nv:
            symbols = ca.SX.sym("q", model.nq), ca.SX.sym("v", model.nv)
            qdot = ca.Function("qdot", symbols, [rates(model, symbols[0]) @ symbols[1]])
            self.qdot = lambda q, v: qdot(q, v).full().ravel()
        kinematics, wanted = mechanism.kinematics, {*laws.joints, *self.driven, *observed}
        self._closure = Mapped(kinematics.closure_function, 1) if mechanism.closures else None
        closure_joints = wanted - {*self._tree}  # closures' own joints
        self._closure_state = Mapped(kinematics.own_function, 1) if closure_joints else None
        self._inertia = np.zeros((model.nv, model.nv))  # of effects, where W does not change
        for at, Ia in laws.inertial:
            w = self._W[list(at)].sum(axis=0)
            self._inertia += Ia * np.outer(w, w)

    def closures(self, q: np.ndarray, v: np.ndarray) -> Rows:
        """Return Φ (m,), J (m, nv), J̇v (m,)."""
        if self._closure is None:
            return np.zeros(0), np.zeros((0, len(v))), np.zeros(0)
        value, rate, drift = self._closure(q, v)
        return value[0, :, 0], rate[0], drift[0, :, 0]

    def joints(self, q: np.ndarray, v: np.ndarray, near: np.ndarray | None = None) -> Rows:
        """Return y (J,), W (J, nv), Ẇv (J,) of all joints; of closures' own only where needed.

        Whole turns of closures' own joints are counted from coordinates `near` (J,).
        """
        y, drift = np.zeros((2, len(self._W)))
        y[self._tree] = q[self._index]
        if self._closure_state is None:
            return y, self._W, drift
        W = self._W.copy()
        closure_state = self._closure_state(q, v)
        for i, joint in enumerate(self.mechanism.joints):
            if not joint.in_tree:
                value, W[i], closure_drift = (x[0, joint.index] for x in closure_state)
                y[i], drift[i] = value[0], closure_drift[0]
                if joint.rotational and near is not None:
                    y[i] += 2 * np.pi * np.round((near[i] - y[i]) / (2 * np.pi))
        return y, W, drift

    def terms(
        self, t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray, near: np.ndarray | None = None
    ) -> InstantTerms:
        """Return the terms of the equations at one instant; refuse a singular position."""
        _, J, gamma = self.closures(q, v)
        y, W, drift = self.joints(q, v, near)
        M, h = self.rigid(pin.crba, q), self.rigid(pin.nonLinearEffects, q, v)
        if self._closure_state is None:
            M = M + self._inertia
        else:
            for at, Ia in self.laws.inertial:
                w = W[list(at)].sum(axis=0)
                M = M + Ia * np.outer(w, w)
                h = h + Ia * drift[list(at)].sum() * w
        Z, Jp = self.split(J, t)
        return InstantTerms(t, q, v, z, y, W @ v, W, drift, M, h, J, Jp, Z, -Jp @ gamma)

    def split(self, J: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Return Z (nv, d) with J Z = 0, and J⁺ (nv, m); refuse J that has lost rank."""
        if not len(J):
            return self._free
        r = self.mechanism.rank
        U, S, Vt = linear.svd(J)
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
        """Return the nearest q with Φ(q) = 0 and v with J v = 0 and w v = 0, w (k, nv) of `stuck`.

        Coordinate projection: Eich, SIAM J. Numer. Anal. 30(5), 1993; Hairer, Wanner, Solving
        Ordinary Differential Equations II, VII.2.
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
            constraints = np.vstack([J, stuck])
            v = v - linear.pinv(constraints, 1e-9) @ (constraints @ v)
        return q, v


def constant_correction(effect: Effect, point: Point) -> Correction:
    """Return the correction of an effect; none for one that depends on what the model predicts."""
    if not effect.corrects or effect.implicit:
        return Correction()
    none = np.zeros((1, len(effect.joints)))
    signals = Signals(np.zeros(1), none, none, none, none[0], shape=point.of(effect)[1])
    return effect.correction(signals)
