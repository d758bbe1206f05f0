"""Forward laws of a mechanism's effects at one instant, sorted by `Unknown.acts`.

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

import numpy as np

from ident.effects import Effect, Signals
from ident.equations.unknowns import Point
from ident.errors import MechanismError
from ident.mechanism.mechanism import Mechanism

SMOOTH = 1e-3  # [rad/s | m/s] speed below which the sign of a law that is no dry friction is smooth
SIGN_ONLY = 1e-200  # [rad/s | m/s] a speed that has a sign and no size
Extra = Mapping[str, Callable[[float], float]]


@dataclass(frozen=True, eq=False)
class InstantSignals:
    """Signals of all J joints at one instant."""

    t: float  # [s]
    since: float  # the log's first sample [s]
    # y, yd: (J,)
    y: np.ndarray
    yd: np.ndarray
    extra: Extra  # other columns of the log, as functions of time
    # a, torque, load: (J,) predictions of the present model, for effects that ask for them
    a: np.ndarray
    torque: np.ndarray
    load: np.ndarray


@dataclass(frozen=True, eq=False)
class EffectLaw:
    """The unknowns of one effect that act alike, with their values."""

    effect: Effect
    c: np.ndarray  # (unknowns,) values, zero for those that act otherwise
    # shape, present: values of its shapes, and of all effects' parameters
    shape: Mapping[str, float]
    present: Mapping[str, float]
    at: tuple[int, ...]  # indices of its joints among the mechanism's

    def torque(self, s: InstantSignals, yd: np.ndarray | None = None) -> np.ndarray:
        """Return E c (arity,) [N m | N] that the joints must supply, at other rates if given."""
        at, given = list(self.at), yd
        yd = s.yd[at] if given is None else given
        # two samples, the first being the log's: some effects count time from there
        signals = Signals(
            t=np.array([s.since, s.t]),
            q=s.y[[at, at]],
            v=np.stack([yd, yd]),
            a=s.a[[at, at]],
            still=np.full(len(at), SMOOTH if given is None else SIGN_ONLY),
            extra={name: np.full(2, s.extra[name](s.t)) for name in self.effect.reads()},
            shape=self.shape,
            present=self.present,
            predicted=lambda: (s.torque[[at, at]], s.load[[at, at]]),
        )
        return self.effect.columns(signals)[-1] @ self.c

    def limit(self, s: InstantSignals) -> float:
        """Return the friction F [N m | N] of a dry law at the present speed, whatever its sign."""
        u = np.zeros(len(self.at))
        u[0] = max(abs(float(s.yd[list(self.at)].sum())), SIGN_ONLY)
        return float(self.torque(s, u)[0])

    def state_rate(self, z: float, v: float) -> float:
        """Return ż of its state at the joint's rate v."""
        return float(self.effect.state_rate(np.array([z]), np.array([v]), self.shape)[0])


@dataclass(eq=False)
class DryJoint:
    """Dry friction at one joint, or at the sum of two joints' rates."""

    name: str  # of the joint, or of both with a comma
    at: tuple[int, ...]  # their indices
    effects: list[str] = field(default_factory=list)  # labels
    level: float = 0.0  # the part of F that does not depend on the state
    parts: list[EffectLaw] = field(default_factory=list)  # the laws of the rest

    def limit(self, s: InstantSignals, *, explicit: bool = False) -> float:
        """Return F [N m | N], or the part that needs no prediction of the model."""
        parts = (each for each in self.parts if not (explicit and each.effect.asks))
        return self.level + sum(part.limit(s) for part in parts)


class ForwardLaws:
    """All effects of a mechanism whose effects all have values, sorted by how they act.

    Raises:
        MechanismError: for an effect without a law.
    """

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
        rest = InstantSignals(0.0, 0.0, zero, zero, {}, zero, zero, zero)
        for effect in mechanism.effects:
            if why := effect.not_integrable:
                raise MechanismError(
                    f"effect '{effect.label}': cannot be integrated: {why}; or leave it out, or "
                    "simulate a given motion (without --forward)"
                )
            c, shape = point.of(effect)
            if effect.corrects or not c.any():
                continue  # of the measurement or the geometry; or of no size
            if effect.loaded_link:
                self.pi[mechanism.bodies.columns(effect.loaded_link)] += c
                continue
            at = tuple(mechanism.joint_index[name] for name in effect.joints)
            self.joints.update(at)
            for acts in dict.fromkeys(each.acts for each in effect.unknowns):
                part = np.where([each.acts == acts for each in effect.unknowns], c, 0.0)
                law = EffectLaw(effect, part, shape, point.values, at)
                if not part.any():
                    continue
                if acts == "inertia":
                    self.inertial.append((at, float(part.sum())))
                elif acts == "state":
                    self.states.append(law)
                elif acts == "linear":
                    self._add_linear(law, rest)
                elif acts in ("dry", "level"):
                    joint = dry.setdefault(effect.joints, DryJoint(",".join(effect.joints), at))
                    joint.effects.append(effect.label)
                    if acts == "level":
                        joint.level += law.limit(rest)
                    else:
                        joint.parts.append(law)
                else:
                    self.smooth.append(law)
        self.dry = list(dry.values())
        laws = [*self.smooth, *(part for joint in self.dry for part in joint.parts)]
        # (signal, joint) of the predictions that some law asks for
        self.asking = tuple(
            dict.fromkeys((word, i) for law in laws for word in law.effect.asks for i in law.at)
        )

    def _add_linear(self, law: EffectLaw, rest: InstantSignals) -> None:
        """Add a linear law, known from its columns at rest and at unit states."""
        at, zero = list(law.at), law.torque(rest)
        self.T0[at] += zero
        for i, unit in zip(at, np.eye(len(self.T0))[at], strict=True):
            self.Tq[at, i] += law.torque(replace(rest, y=unit)) - zero
            self.Tv[at, i] += law.torque(replace(rest, yd=unit)) - zero
