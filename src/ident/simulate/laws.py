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

import numpy as np

from ident.effects import Effect, Signals
from ident.equations.point import Point
from ident.errors import MechanismError
from ident.mechanism.mechanism import Mechanism

LEAST = 1e-200  # [rad/s | m/s] a speed that has a sign and no size
ASKED = {"a": "ydd"}  # where this module has another name than `Effect.asks`
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
        acts: as `Unknown.acts` of this part.
    """

    effect: Effect
    c: np.ndarray
    shape: Mapping[str, float]
    present: Mapping[str, float]
    at: tuple[int, ...]
    asks: tuple[str, ...] = ()
    acts: str = "torque"

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
        level = sum(law.limit(rest) for law in laws if law.acts == "level")
        parts = tuple(law for law in laws if law.acts != "level")
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
            if effect.corrects or not c.any():
                continue  # of the measurement or the geometry; or of no size
            if effect.loaded_link:
                pi[mechanism.bodies.columns(effect.loaded_link)] += c
                continue
            at = tuple(mechanism.joint_index[name] for name in effect.joints)
            asks = tuple(ASKED.get(word, word) for word in effect.asks)
            for acts in dict.fromkeys(each.acts for each in effect.unknowns):
                part = np.where([each.acts == acts for each in effect.unknowns], c, 0.0)
                law = Law(effect, part, shape, point.values, at, asks, acts)
                if not part.any():
                    continue
                if acts == "inertia":
                    inertial.append((at, float(part.sum())))
                elif acts == "state":
                    presliding.append(
                        Presliding(effect.joints[0], at[0], float(part.sum()), shape["z0"])
                    )
                elif acts in ("dry", "level"):
                    dry.setdefault(effect.joints, []).append(law)
                else:
                    (linear if acts == "linear" else smooth).append(law)
        count = len(mechanism.joints)
        joints = (DryJoint.of(names, laws, count) for names, laws in dry.items())
        return cls(
            Line.of(linear, count), tuple(smooth), tuple(joints), tuple(presliding),
            tuple(inertial), pi,
        )  # fmt: skip


def _check(effect: Effect) -> None:
    """Refuse what has no place in an integration.

    Raises:
        MechanismError: naming the effect, the reason and what to do.
    """
    why = effect.not_integrable
    if why:
        raise MechanismError(
            f"effect '{effect.label}': cannot be integrated: {why}; or leave it out, or simulate a "
            "given motion (without --forward)"
        )
