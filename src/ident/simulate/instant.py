"""One instant's equations of motion, solved with some joints sliding and some stuck.

    M v̇ + h + Σ Wᵀ E c + Σ wᵀ f + Jᵀ λ = Wᵀ τ + f_e
    sliding  f = s F, s = ±1          stuck  w v̇ + ẇ v = 0, |f| ≤ F

In the coordinates α of v̇ = a₀ + Z α that the closures leave: A α + Bᵀ f = b, u̇ = B α + δ.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
import pinocchio as pin
from scipy.linalg import lapack

from ident.errors import MechanismError
from ident.mechanism.parameters import COUNT, pseudo_inertia
from ident.simulate.dry import box_programme
from ident.simulate.laws import Extra, Seen
from ident.simulate.plant import Moment, Plant
from ident.simulate.presence import Presence

STICK = 0  # a mode; −1 and +1 are sliding, by the sign of the rate
MARGIN = 1e-9  # of F, by which a stuck joint's friction may be exceeded before it breaks away
SURE = 1e-14  # of the largest term, above which an acceleration has a sign


class Actuator(Protocol):
    """What turns the driven joints."""

    def torque(self, m: Moment, plant: Plant, against: np.ndarray) -> np.ndarray:
        """τ (driven,) [N m | N]; `against` (nv,): smooth effects, less external forces."""
        ...


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What time brings.

    Attributes:
        since: the log's first sample [s].
        extra: other columns as functions of time.
        wrenches: (frame, wrench (6,) in its axes as a function of time).
    """

    since: float = 0.0
    extra: Extra = field(default_factory=dict)
    wrenches: tuple[tuple[int, Callable[[float], np.ndarray]], ...] = ()


@dataclass(frozen=True, eq=False)
class Balance:
    """The equations solved at one instant.

    Attributes:
        a: (nv,) v̇; tau: (driven,); multipliers: (m,) the smallest λ that fit.
        friction: (dry,) torques of dry friction; limits: (dry,) F.
        rates: (dry,) their joints' accelerations.
        unsure: whether the friction of stuck joints is not determined one by one.
    """

    a: np.ndarray
    tau: np.ndarray
    multipliers: np.ndarray
    friction: np.ndarray
    limits: np.ndarray
    rates: np.ndarray
    sides: np.ndarray
    holding: bool = True


class Instant:
    """One instant's equations, to be solved for several x of what effects ask for."""

    def __init__(
        self,
        presence: Presence,
        actuator: Actuator,
        around: Surroundings,
        m: Moment,
        modes: np.ndarray,
        resting: np.ndarray | None,
    ) -> None:
        self.presence, self.around, self.m, self.modes = presence, around, m, modes
        self.open = resting
        self.held = modes == STICK if resting is None else resting
        self.plant = plant = presence.plant
        laws = plant.laws
        self.w = plant.dry @ m.W
        J = len(m.y)
        zero = np.zeros(J)
        self.seen = Seen(m.t, around.since, m.y, m.yd, around.extra, zero, zero, zero)
        self.external = self._external()
        line = laws.line  # effects that ask for nothing:
        self.plain = m.W.T @ (line.T0 + line.Tq @ m.y + line.Tv @ m.yd)
        self.aside = np.zeros(len(m.v))  # of these, what the prediction leaves out
        for law in laws.smooth:
            if not law.asks:
                force = m.W[list(law.at)].T @ law.torque(self.seen)
                self.plain += force
                self.aside += force if law.effect.implicit else 0.0
        for each, z in zip(laws.presliding, m.z, strict=True):
            self.plain += each.sigma * z * m.W[each.at]
        self.tau = actuator.torque(m, plant, self.plain - self.external)
        self.applied = m.W[plant.driven].T @ self.tau + self.external
        self.A = m.Z.T @ m.M @ m.Z
        self.Ma0 = m.M @ m.a0
        self.delta = self.w @ m.a0 + plant.dry @ m.drift
        self.B = self.w @ m.Z

    def _external(self) -> np.ndarray:
        model, m = self.plant.mechanism.model, self.m
        total = np.zeros(len(m.v))
        for frame, wrench in self.around.wrenches:
            J = pin.computeFrameJacobian(model, model.createData(), m.q, frame, pin.LOCAL)
            total += J.T @ wrench(m.t)
        return total

    def _with(self, x: np.ndarray) -> Seen:
        if not len(x):
            return self.seen
        told = {word: np.zeros(len(self.m.y)) for word in ("torque", "load", "ydd")}
        for (word, i), value in zip(self.presence.asking, x, strict=True):
            told[word][i] = value
        return replace(self.seen, torque=told["torque"], load=told["load"], ydd=told["ydd"])

    def _respond(self, x: np.ndarray) -> tuple[np.ndarray, ...]:
        """(v̇, friction, limits, sides, forces without friction, whether friction suffices)."""
        m, seen, laws = self.m, self._with(x), self.plant.laws
        r = self.applied - m.h - self.plain
        for law in laws.smooth:
            if law.asks:
                r = r - m.W[list(law.at)].T @ law.torque(seen)
        F = np.array([each.limit(seen) for each in laws.dry])
        f = np.where(self.held, 0.0, self.modes * F)
        b = m.Z.T @ (r - self.w.T @ f - self.Ma0)
        sides, held = np.zeros(len(F), dtype=int), np.flatnonzero(self.held)
        holding = np.array(True)
        if len(held) and F[held].min() < 0:
            self._refuse_negative(held[int(F[held].argmin())], F)
        if not len(held):
            alpha = self._least(self.A, b)
        elif self.open is not None:
            alpha, f[held], sides[held] = self._settle(b, held, F[held])
        else:
            alpha, f[held], holding = self._hold(b, held, F[held])
        return m.a0 + m.Z @ alpha, f, F, sides, r, holding

    def _settle(
        self, b: np.ndarray, held: np.ndarray, F: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        B = self.B[held]
        back = self._least(self.A, np.column_stack([b, B.T]))
        f, sides = box_programme(B @ back[:, 1:], B @ back[:, 0] + self.delta[held], F)
        return back[:, 0] - back[:, 1:] @ f, f, sides

    def _hold(
        self, b: np.ndarray, held: np.ndarray, F: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """α with B α = −δ; the friction that this takes, and whether it is within F."""
        B, A = self.B[held], self.A
        U, sizes, Vt = np.linalg.svd(B)
        least = 1e-9 * max(1.0, float(sizes.max(initial=0.0)))
        r = int((sizes > least).sum())
        Bp = (Vt[:r].T / sizes[:r]) @ U[:, :r].T
        alpha, N = -Bp @ self.delta[held], Vt[r:].T
        if N.shape[1]:
            alpha = alpha + N @ self._least(N.T @ A @ N, N.T @ (b - A @ alpha))
        needed = b - A @ alpha  # = Bᵀ f
        f = Bp.T @ needed
        limit = F * (1 + MARGIN)
        if r == len(held):
            return alpha, f, np.array((np.abs(f) <= limit).all())
        if (np.abs(f) <= limit).all():
            return alpha, f, np.array(True)
        f, _ = box_programme(B @ B.T, B @ needed, limit)  # several share one load
        left = np.abs(B.T @ f - needed).max()
        return alpha, f, np.array(left <= MARGIN * np.abs(B.T).max() * F.max(initial=0.0))

    def asked(self, x: np.ndarray) -> np.ndarray:
        """g(x): what the model predicts where effects believe x."""
        m, laws = self.m, self.plant.laws
        a, f, F, *_ = self._respond(x)
        rigid = self.plant.bare.torque(m.q, m.v, a)
        others = m.M @ a + m.h - rigid + self.plain - self.aside
        for law in laws.smooth:
            if law.asks and not law.effect.implicit:
                others = others + m.W[list(law.at)].T @ law.torque(self._with(x))
        for k, each in enumerate(laws.dry):
            share = each.plain(self.seen) / F[k] if F[k] else 0.0
            others = others + share * f[k] * self.w[k]
        return self.presence.of(m, a, rigid - self.external, others, self.tau)

    def balance(self, x: np.ndarray) -> Balance:
        """All of it."""
        m = self.m
        a, f, F, sides, r, holding = self._respond(x)
        multipliers = m.Jp.T @ (r - self.w.T @ f - m.M @ a)
        rates = self.B @ (m.Z.T @ (a - m.a0)) + self.delta
        return Balance(a, self.tau, multipliers, f, F, rates, sides, bool(holding))

    def _least(self, A: np.ndarray, b: np.ndarray) -> np.ndarray:
        """A⁻¹ b of a positive definite A.

        Raises:
            MechanismError: where it is not, naming the bodies that cannot exist.
        """
        if not len(A):
            return np.zeros_like(b)
        _, x, info = lapack.dposv(A, b)
        if info == 0:
            return x.reshape(b.shape)
        mechanism = self.plant.mechanism
        bodies = zip(mechanism.bodies.links, self.plant.laws.pi.reshape(-1, COUNT), strict=True)
        bad = [
            link
            for link, pi in bodies
            if np.linalg.eigvalsh(pseudo_inertia(pi)).min() < -1e-9 * np.abs(pi).max()
        ]
        why = (
            f"no real body has the parameters of {', '.join(bad)}"
            if bad
            else "something that moves has no inertia"
        )
        raise MechanismError(
            f"{mechanism.name}: at t = {self.m.t:.4g} s the mass matrix is not positive definite, "
            f"so forces do not determine the motion: {why}; identify with --consistent, or give "
            "other parameters"
        )

    def _refuse_negative(self, k: int, F: np.ndarray) -> None:
        names = self.plant.laws.dry[k].effects
        raise MechanismError(
            f"{self.plant.mechanism.name}: dry friction of {' and '.join(names)} is "
            f"{F[k]:.4g} at rest, which would drive the joint; give values of 0 or more, or leave "
            "the effect out"
        )
