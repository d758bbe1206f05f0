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

    @classmethod
    def at_rest(cls, count: int) -> InstantSignals:
        """All joints at zero and at rest."""
        none = np.zeros(count)
        return cls(0.0, 0.0, none, none, {}, none, none, none)


@dataclass(frozen=True, eq=False)
class EffectLaw:
    """The unknowns of one effect that act alike, with their values."""

    effect: Effect
    c: np.ndarray  # (unknowns,) values, zero for those that act otherwise
    acts: str  # see above
    # shape, present: values of its shapes, and of all effects' parameters
    shape: Mapping[str, float]
    present: Mapping[str, float]
    at: tuple[int, ...]  # indices of its joints among the mechanism's

    def torque(self, s: InstantSignals) -> np.ndarray:
        """Return E c (arity,) [N m | N] that the joints must supply."""
        return self._at(s, s.yd[list(self.at)])

    def limit(self, s: InstantSignals) -> float:
        """Return the friction F [N m | N] of a dry law at the present speed, whatever its sign."""
        u = np.zeros(len(self.at))
        u[0] = max(abs(float(s.yd[list(self.at)].sum())), SIGN_ONLY)
        return float(self._at(s, u)[0])

    def _at(self, s: InstantSignals, yd: np.ndarray) -> np.ndarray:
        at = list(self.at)
        # two samples, the first being the log's: some effects count time from there
        signals = Signals(
            t=np.array([s.since, s.t]),
            q=s.y[[at, at]],
            v=np.stack([yd, yd]),
            a=s.a[[at, at]],
            still=np.full(len(at), SIGN_ONLY),
            extra={name: np.full(2, s.extra[name](s.t)) for name in self.effect.reads()},
            shape=self.shape,
            present=self.present,
            predicted=lambda: (s.torque[[at, at]], s.load[[at, at]]),
        )
        return self.effect.columns(signals)[-1] @ self.c

    def state_rate(self, z: float, v: float) -> float:
        """Return ż of its state at the joint's rate v."""
        return float(self.effect.state_rate(np.array([z]), np.array([v]), self.shape)[0])


@dataclass(frozen=True, eq=False)
class DryJoint:
    """Dry friction at one joint, or at the sum of two joints' rates."""

    name: str  # of the joint, or of both with a comma
    at: tuple[int, ...]  # their indices
    effects: tuple[str, ...]  # labels
    level: float  # the part of F that does not depend on the state
    parts: tuple[EffectLaw, ...]  # the laws of the rest

    def limit(self, s: InstantSignals) -> float:
        """Return F [N m | N]."""
        return self.level + sum(part.limit(s) for part in self.parts)

    def explicit(self, s: InstantSignals) -> float:
        """Return the part of F that needs no prediction of the model."""
        return self.level + sum(part.limit(s) for part in self.parts if not part.effect.asks)


@dataclass(frozen=True, eq=False)
class ForwardLaws:
    """All effects of a mechanism at a working point, sorted."""

    # T0, Tq, Tv: (J,), (J, J), (J, J): the linear laws, T = T0 + Tq y + Tv ẏ
    T0: np.ndarray
    Tq: np.ndarray
    Tv: np.ndarray
    pi: np.ndarray  # (10 · bodies,) dynamic parameters with payloads
    smooth: list[EffectLaw] = field(default_factory=list)  # other torques
    dry: list[DryJoint] = field(default_factory=list)  # joints with dry friction
    states: list[EffectLaw] = field(default_factory=list)  # laws with a state
    # (joints, coefficient [kg m² | kg])
    inertial: list[tuple[tuple[int, ...], float]] = field(default_factory=list)

    @property
    def asking(self) -> tuple[tuple[str, int], ...]:
        """(signal, joint) of the predictions that some law asks for."""
        laws = [*self.smooth, *(part for joint in self.dry for part in joint.parts)]
        return tuple(
            dict.fromkeys((word, i) for law in laws for word in law.effect.asks for i in law.at)
        )

    @property
    def joints(self) -> set[int]:
        """Indices of the joints on which some law acts."""
        groups = [law.at for law in (*self.smooth, *self.states)]
        groups += [joint.at for joint in self.dry] + [at for at, _ in self.inertial]
        linear = (self.T0 != 0) | self.Tq.any(axis=1) | self.Tv.any(axis=1)
        return {i for at in groups for i in at} | {int(i) for i in np.flatnonzero(linear)}

    @classmethod
    def of(cls, mechanism: Mechanism, point: Point) -> ForwardLaws:
        """Sort the laws of a mechanism whose effects all have values; refuse one without a law."""
        J = len(mechanism.joints)
        rest = InstantSignals.at_rest(J)
        laws = cls(np.zeros(J), np.zeros((J, J)), np.zeros((J, J)), point.pi.copy())
        dry: dict[tuple[str, ...], list[EffectLaw]] = {}
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
                laws.pi[mechanism.bodies.columns(effect.loaded_link)] += c
                continue
            at = tuple(mechanism.joint_index[name] for name in effect.joints)
            for acts in dict.fromkeys(each.acts for each in effect.unknowns):
                part = np.where([each.acts == acts for each in effect.unknowns], c, 0.0)
                law = EffectLaw(effect, part, acts, shape, point.values, at)
                if not part.any():
                    continue
                if acts == "inertia":
                    laws.inertial.append((at, float(part.sum())))
                elif acts == "state":
                    laws.states.append(law)
                elif acts in ("dry", "level"):
                    dry.setdefault(effect.joints, []).append(law)
                elif acts == "linear":
                    laws._add_linear(law, rest)
                else:
                    laws.smooth.append(law)
        for names, same in dry.items():
            level = sum(law.limit(rest) for law in same if law.acts == "level")
            parts = tuple(law for law in same if law.acts != "level")
            labels = tuple(law.effect.label for law in same)
            laws.dry.append(DryJoint(",".join(names), same[0].at, labels, level, parts))
        return laws

    def _add_linear(self, law: EffectLaw, rest: InstantSignals) -> None:
        """Add a linear law, known from its columns at rest and at unit states."""
        at, zero = list(law.at), law.torque(rest)
        self.T0[at] += zero
        for i in at:
            unit = np.eye(len(self.T0))[i]
            self.Tq[at, i] += law.torque(replace(rest, y=unit)) - zero
            self.Tv[at, i] += law.torque(replace(rest, yd=unit)) - zero
