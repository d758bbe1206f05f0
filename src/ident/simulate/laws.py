"""A mechanism's effects as laws for one instant, sorted by what they do to the motion.

smooth    torque E c of what the joints do now: viscous, springs, ripple, …
inertial  a coefficient of acceleration, which joins M: rotor inertia, a coupling's inertia
dry       a largest friction torque F ≥ 0 at a joint, or at the sum of two: Coulomb, Stribeck, …
presliding  a state z with ż = v − |v| z/z0 and the torque σ z (Dahl)
payload   ten more dynamic parameters of a link

All but the presliding's rate come from the effects' own columns, so that a simulated log and the
equations that identify from it cannot disagree.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from ident.effects import Correcting, Effect, Signals
from ident.effects.coupling import Coupling
from ident.effects.drive import Drift, RotorInertia, TorqueOffset
from ident.effects.elastic import Spring
from ident.effects.friction import (
    Coulomb,
    Dry,
    Hysteresis,
    LoadFriction,
    TemperatureFriction,
    Viscous,
)
from ident.effects.measured import ClosureCompliance
from ident.effects.payload import Payload
from ident.effects.user import UserEffect, compiled_of
from ident.equations.point import Point
from ident.errors import MechanismError
from ident.mechanism.mechanism import Mechanism

LEAST = 1e-200  # [rad/s | m/s] a speed that has a sign and no size
LINEAR = (Viscous, Spring, TorqueOffset, Coupling)  # in q and v
LEVEL = (Coulomb, Coupling)  # whose friction torque does not depend on the state
Extra = Mapping[str, Callable[[float], float]]


@dataclass(frozen=True, eq=False)
class Seen:
    """What effects see at one instant.

    Attributes:
        t: [s]; since: the log's first sample [s].
        y, yd: (J,) of all joints.
        extra: other columns of the log, as functions of time.
        torque, load, ydd: (J,) of the present model, for effects that ask for them.
    """

    t: float
    since: float
    y: np.ndarray
    yd: np.ndarray
    extra: Extra
    torque: np.ndarray
    load: np.ndarray
    ydd: np.ndarray


@dataclass(frozen=True, eq=False)
class Law:
    """One effect, or a part of it, with its values.

    Attributes:
        c: (unknowns,) values, zero for what is not of this part.
        at: where its joints stand among the mechanism's.
        asks: which of `torque`, `load` and `ydd` its columns depend on.
    """

    effect: Effect
    c: np.ndarray
    shape: Mapping[str, float]
    present: Mapping[str, float]
    at: tuple[int, ...]
    asks: tuple[str, ...] = ()

    def torque(self, seen: Seen) -> np.ndarray:
        """E c (arity,) [N m | N] that the joints must supply."""
        at = list(self.at)
        return self._of(seen, seen.yd[at], LEAST)

    def limit(self, seen: Seen) -> float:
        """The friction torque F [N m | N] of a dry law at the present speed, whichever its sign."""
        u = np.zeros(len(self.at))
        u[0] = max(abs(float(seen.yd[list(self.at)].sum())), LEAST)
        return float(self._of(seen, u, LEAST)[0])

    def _of(self, seen: Seen, yd: np.ndarray, still: float) -> np.ndarray:
        at = list(self.at)
        # two samples, the first being the log's: some effects count time from there
        s = Signals(
            t=np.array([seen.since, seen.t]),
            q=seen.y[[at, at]],
            v=np.stack([yd, yd]),
            a=seen.ydd[[at, at]],
            still=np.full(len(at), still),
            extra={name: np.full(2, seen.extra[name](seen.t)) for name in self.effect.reads()},
            shape=self.shape,
            present=self.present,
            predicted=lambda: (seen.torque[[at, at]], seen.load[[at, at]]),
        )
        return self.effect.columns(s)[-1] @ self.c


@dataclass(frozen=True, eq=False)
class DryJoint:
    """Where dry friction acts: on one joint, or on the sum of two joints' rates.

    Attributes:
        name: of the joint, or of both with a comma.
        effects: their labels.
        level: of F, what does not depend on the state.
        parts: the laws of the rest.
    """

    name: str
    at: tuple[int, ...]
    effects: tuple[str, ...]
    level: float
    parts: tuple[Law, ...]

    @classmethod
    def of(cls, names: tuple[str, ...], laws: list[Law], count: int) -> DryJoint:
        """Of the laws at these joints, of `count` in all."""
        rest = nothing_seen(count)
        level = sum(law.limit(rest) for law in laws if isinstance(law.effect, LEVEL))
        parts = tuple(law for law in laws if not isinstance(law.effect, LEVEL))
        labels = tuple(law.effect.label for law in laws)
        return cls(",".join(names), laws[0].at, labels, level, parts)

    def limit(self, seen: Seen) -> float:
        """F [N m | N]."""
        return self.level + sum(part.limit(seen) for part in self.parts)

    def plain(self, seen: Seen) -> float:
        """Of F, what asks for no prediction."""
        return self.level + sum(part.limit(seen) for part in self.parts if not part.asks)


@dataclass(frozen=True, eq=False)
class Line:
    """Torques of all joints that are linear in their state: T = T0 + Tq y + Tv ẏ.

    Attributes:
        T0: (J,); Tq, Tv: (J, J).
    """

    T0: np.ndarray
    Tq: np.ndarray
    Tv: np.ndarray

    @classmethod
    def of(cls, laws: list[Law], count: int) -> Line:
        """The sum of linear laws, read off their columns at rest and at unit states."""
        T0, Tq, Tv = np.zeros(count), np.zeros((count, count)), np.zeros((count, count))
        rest = nothing_seen(count)
        for law in laws:
            at = list(law.at)
            zero = law.torque(rest)
            T0[at] += zero
            for i, unit in ((i, np.eye(count)[i]) for i in at):
                Tq[at, i] += law.torque(replace(rest, y=unit)) - zero
                Tv[at, i] += law.torque(replace(rest, yd=unit)) - zero
        return cls(T0, Tq, Tv)


def nothing_seen(count: int) -> Seen:
    """All joints at zero and at rest."""
    none = np.zeros(count)
    return Seen(0.0, 0.0, none, none, {}, none, none, none)


@dataclass(frozen=True, eq=False)
class Presliding:
    """A Dahl spring at a joint: torque σ z, ż = v − |v| z/z0."""

    name: str
    at: int
    sigma: float
    z0: float


@dataclass(frozen=True, eq=False)
class Laws:
    """All effects of a mechanism at a working point, sorted.

    Attributes:
        line: smooth laws that are linear, as one; smooth: the others.
        dry, presliding: as above.
        inertial: (joints, coefficient [kg m² | kg]).
        pi: (10 · bodies,) dynamic parameters with payloads.
    """

    line: Line
    smooth: tuple[Law, ...]
    dry: tuple[DryJoint, ...]
    presliding: tuple[Presliding, ...]
    inertial: tuple[tuple[tuple[int, ...], float], ...]
    pi: np.ndarray

    @property
    def asking(self) -> tuple[tuple[str, int], ...]:
        """(what, joint) of the prediction that some law asks for."""
        laws = [*self.smooth, *(part for joint in self.dry for part in joint.parts)]
        return tuple(dict.fromkeys((word, i) for law in laws for word in law.asks for i in law.at))

    @classmethod
    def of(cls, mechanism: Mechanism, point: Point) -> Laws:
        """The laws of a mechanism whose effects all have values.

        Raises:
            MechanismError: for an effect that cannot be integrated, with the reason.
        """
        smooth: list[Law] = []
        linear: list[Law] = []
        dry: dict[tuple[str, ...], list[Law]] = {}
        presliding: list[Presliding] = []
        inertial: list[tuple[tuple[int, ...], float]] = []
        pi = point.pi.copy()
        for effect in mechanism.effects:
            _check(effect)
            c, shape = point.of(effect)
            if isinstance(effect, Correcting) or not c.any():
                continue  # of the measurement or the geometry; or of no size
            if isinstance(effect, Payload):
                pi[mechanism.bodies.columns(effect.joints[0])] += c
                continue
            at = tuple(mechanism.joint_index[name] for name in effect.joints)
            law = Law(effect, c, shape, point.values, at, _asks(effect))
            if isinstance(effect, RotorInertia):
                inertial.append((at, float(c[0])))
            elif isinstance(effect, Coupling):
                inertial.append((at, float(c[0])))
                linear.append(Law(effect, c * (0, 1, 0), shape, point.values, at))
                if c[2]:
                    friction = Law(effect, c * (0, 0, 1), shape, point.values, at)
                    dry.setdefault(effect.joints, []).append(friction)
            elif isinstance(effect, Hysteresis):
                presliding.append(Presliding(effect.joints[0], at[0], float(c[0]), shape["z0"]))
            elif isinstance(effect, Dry):
                dry.setdefault(effect.joints, []).append(law)
            else:
                (linear if isinstance(effect, LINEAR) else smooth).append(law)
        count = len(mechanism.joints)
        joints = (DryJoint.of(names, laws, count) for names, laws in dry.items())
        return cls(
            Line.of(linear, count), tuple(smooth), tuple(joints), tuple(presliding),
            tuple(inertial), pi,
        )  # fmt: skip


def _asks(effect: Effect) -> tuple[str, ...]:
    if isinstance(effect, TemperatureFriction):
        return ()  # only for another effect's parameter
    if isinstance(effect, LoadFriction):
        return ("load",)
    if isinstance(effect, UserEffect):
        compiled = compiled_of(type(effect), len(effect.joints))
        given = {"ydd": 2, "torque": 3, "load": 4}
        return tuple(word for word, i in given.items() if compiled.jac_sparsity(0, i).nnz())
    return ("torque",) if effect.implicit else ()


def _check(effect: Effect) -> None:
    """Refuse what has no place in an integration.

    Raises:
        MechanismError: naming the effect, the reason and what to do.
    """
    why = ""
    if isinstance(effect, ClosureCompliance):
        why = "a closure that yields would vibrate, and this effect has no inertia to do it with"
    elif isinstance(effect, UserEffect):
        compiled = compiled_of(type(effect), len(effect.joints))
        used = {compiled.instruction_id(i) for i in range(compiled.n_instructions())}
        if ca.OP_SIGN in used:
            why = "its function has sign(), which jumps; write ca.tanh(s.v / 1e-3), or use coulomb"
    elif effect.memory and not isinstance(effect, Hysteresis | Drift):
        why = "it depends on the past, and nothing here says how its state goes on"
    if why:
        raise MechanismError(
            f"effect '{effect.label}': cannot be integrated: {why}; or leave it out, or simulate a "
            "given motion (without --forward)"
        )
