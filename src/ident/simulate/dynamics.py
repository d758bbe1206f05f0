"""The equations of motion with joints that slide or are stuck, at one instant.

    M v̇ + h + Σ Wᵀ E c + Σ wᵀ f + Jᵀ λ = Wᵀ τ + f_e
    sliding  f = s F, s = ±1          stuck  w v̇ + ẇ v = 0, |f| ≤ F

In the coordinates α of v̇ = a₀ + Z α that the closures leave: A α + Bᵀ f = b, u̇ = B α + δ. No
library has this together with closures that may repeat each other and friction that depends on the
load; it is what distinguishes a stuck joint from a slow one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from scipy.linalg import lapack

from ident.effects import Signals
from ident.equations.terms import joint_loads
from ident.errors import MechanismError, MotionError
from ident.information import linear
from ident.mechanism.parameters import COUNT, pseudo_inertia
from ident.motion.closures import pseudo_inverse
from ident.motion.state import wrenches
from ident.simulate.plant import Extra, InstantTerms, Plant, signals_at

STICK = 0  # range: a mode; −1 and +1 are sliding, by the sign of the rate
MARGIN = 1e-9  # numerics: of F, by which a stuck joint's friction may be exceeded
SMALL = 1e-12  # numerics: of the largest term of the box programme: zero
CONVERGED, ITERATIONS = 1e-12, 60  # numerics: relative error of x = g(x); evaluations of g
# τ (driven,) [N m | N] from the terms and (nv,): smooth effects, less external forces
Actuator = Callable[[InstantTerms, np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Balance:
    """The equations solved at one instant."""

    a: np.ndarray  # (nv,) v̇
    tau: np.ndarray  # (driven,)
    multipliers: np.ndarray  # (m,) the smallest λ that fit
    friction: np.ndarray  # (dry,) torques of dry friction
    limits: np.ndarray  # (dry,) F, their largest sizes
    rates: np.ndarray  # (dry,) their joints' accelerations
    # (dry,) of joints at rest with open modes, the limit (−1, +1) that friction reaches
    sides: np.ndarray
    holding: bool  # whether the friction of stuck joints suffices


@dataclass(eq=False)
class Dynamics:
    """The right side of the equations of motion."""

    plant: Plant
    actuator: Actuator
    independent: tuple[str, ...]  # joints in which drives are predicted
    extra: Extra  # other columns of a log
    since: float  # its first sample [s]

    def __post_init__(self) -> None:
        self.wrenches = {n: x for n, x in self.extra.items() if n.startswith("wrench.")}
        self.asking = self.plant.laws.asking
        self._x, self._slope = np.zeros(len(self.asking)), np.zeros((len(self.asking),) * 2)

    def balance(
        self, m: InstantTerms, modes: np.ndarray, resting: np.ndarray | None = None
    ) -> Balance:
        """Return accelerations and forces in the modes (dry,) −1, 0, +1.

        Joints at rest in `resting` (dry,) stick or slide according to the forces at this instant.
        """
        instant = _Instant(self, m, modes, resting)
        if not len(self._x):
            return instant.balance(self._x)
        # x = g(x) of what effects ask for, by Newton's method with a slope that is reused
        x = self._x
        for k in range(ITERATIONS):
            off = instant.predicted(x) - x
            if np.abs(off).max() <= CONVERGED * (1.0 + np.abs(x).max()):
                self._x = x
                return instant.balance(x)
            if k % 8 == 2:  # g is linear but for signs: forward differences
                h = np.diag(1e-4 * (1.0 + np.abs(x)))
                g = off + x
                self._slope = np.stack(
                    [(instant.predicted(x + e) - g) / e.sum() for e in h], axis=1
                )
            step = linear.lstsq(np.eye(len(x)) - self._slope, off, rcond=1e-12)[0]
            x = x + (step if k < ITERATIONS // 2 else 0.5 * step)
        mechanism = self.plant.mechanism
        labels = ", ".join(effect.label for effect in mechanism.effects if effect.implicit)
        raise MotionError(
            f"{mechanism.name}: at t = {m.t:.6g} s no torque satisfies the effects that depend on "
            f"the load ({labels}): a coefficient is too large for this motion"
        )


class _Instant:
    """One instant's equations, to be solved for several x of what effects ask for."""

    def __init__(
        self, dynamics: Dynamics, m: InstantTerms, modes: np.ndarray, resting: np.ndarray | None
    ) -> None:
        self.dynamics, self.m, self.modes, self.open = dynamics, m, modes, resting is not None
        self.stuck = modes == STICK if resting is None else resting
        self.plant = plant = dynamics.plant
        laws, extra = plant.laws, dynamics.extra
        self.w = plant.dry @ m.W
        read = {name: extra[name](m.t) for name in laws.reads}
        self.signals = signals_at(dynamics.since, m.t, m.y, m.yd, read)
        self.external = np.zeros(len(m.v))
        if dynamics.wrenches:
            now = {name: np.array([x(m.t)]) for name, x in dynamics.wrenches.items()}
            f_e = wrenches(plant.mechanism, "", now, m.q[None])
            assert f_e is not None
            self.external = f_e[0]
        self.explicit = m.W.T @ (laws.T0 + laws.Tq @ m.y + laws.Tv @ m.yd)
        self.aside = np.zeros(len(m.v))  # of these, the part that the prediction leaves out
        for law in laws.smooth:
            if not law.effect.asks:
                force = m.W[list(law.at)].T @ law.torque(self.signals)
                self.explicit += force
                self.aside += force if law.effect.implicit else 0.0
        for law, z in zip(laws.states, m.z, strict=True):
            self.explicit += law.c.sum() * z * m.W[law.at[0]]
        self.tau = dynamics.actuator(m, self.explicit - self.external)
        self.applied = m.W[plant.driven].T @ self.tau + self.external
        if len(m.J):
            self.A = m.Z.T @ m.M @ m.Z
            self.delta = self.w @ m.a0 + plant.dry @ m.drift
            self.B = self.w @ m.Z
        else:  # Z is 1, a₀ is 0
            self.A, self.B, self.delta = m.M, self.w, plant.dry @ m.drift

    def _with(self, x: np.ndarray) -> Signals:
        if not len(x):
            return self.signals
        given = {word: np.zeros_like(self.signals.q) for word in ("a", "torque", "load")}
        for (word, i), value in zip(self.dynamics.asking, x, strict=True):
            given[word][:, i] = value
        return replace(
            self.signals, a=given["a"], predicted=lambda: (given["torque"], given["load"])
        )

    def balance(self, x: np.ndarray) -> Balance:
        """Return accelerations and forces where effects take x for what they ask for."""
        m, s, laws = self.m, self._with(x), self.plant.laws
        r = self.applied - m.h - self.explicit
        for law in laws.smooth:
            if law.effect.asks:
                r = r - m.W[list(law.at)].T @ law.torque(s)
        if not laws.dry:
            return self._smooth(r)
        F = np.array([joint.limit(s) for joint in laws.dry])
        f = np.where(self.stuck, 0.0, self.modes * F)
        loops = bool(len(m.J))
        b = r - self.w.T @ f
        b = m.Z.T @ (b - m.M @ m.a0) if loops else b
        sides, stuck, holding = np.zeros(len(F), dtype=int), np.flatnonzero(self.stuck), True
        if len(stuck) and F[stuck].min() < 0:
            k = stuck[int(F[stuck].argmin())]
            raise MechanismError(
                f"{self.plant.mechanism.name}: dry friction of "
                f"{' and '.join(laws.dry[k].effects)} is {F[k]:.4g} at rest, which would drive the "
                "joint; give values of 0 or more, or leave the effect out"
            )
        B = self.B[stuck]
        back = self._least(self.A, np.concatenate([b[None], B]).T)
        H, g = B @ back[:, 1:], B @ back[:, 0] + self.delta[stuck]
        if self.open:
            f[stuck], sides[stuck] = box_programme(H, g, F[stuck])
        elif len(stuck):
            f[stuck], holding = holding_friction(H, g, F[stuck] * (1 + MARGIN))
        alpha = back[:, 0] - back[:, 1:] @ f[stuck]
        a, rates = m.a0 + m.Z @ alpha if loops else alpha, self.B @ alpha + self.delta
        multipliers = m.Jp.T @ (r - self.w.T @ f - m.M @ a) if loops else np.zeros(0)
        return Balance(a, self.tau, multipliers, f, F, rates, sides, holding)

    def _smooth(self, r: np.ndarray) -> Balance:
        """Return accelerations and forces by forces r (nv,) where no joint has dry friction."""
        m, none = self.m, np.zeros(0)
        if len(m.J):
            alpha = self._least(self.A, (m.Z.T @ (r - m.M @ m.a0))[:, None])[:, 0]
            a = m.a0 + m.Z @ alpha
        else:
            a = self._least(self.A, r[:, None])[:, 0]
        multipliers = m.Jp.T @ (r - m.M @ a)
        return Balance(a, self.tau, multipliers, none, none, none, none.astype(int), True)

    def predicted(self, x: np.ndarray) -> np.ndarray:
        """Return g(x): the model's predictions where effects take x for them."""
        m, laws = self.m, self.plant.laws
        now = self.balance(x)
        a, f, F = now.a, now.friction, now.limits
        rigid = self.plant.rigid(pin.rnea, m.q, m.v, a)
        others = m.M @ a + m.h - rigid + self.explicit - self.aside
        for law in laws.smooth:
            if law.effect.asks and not law.effect.implicit:
                others = others + m.W[list(law.at)].T @ law.torque(self._with(x))
        for k, joint in enumerate(laws.dry):
            share = joint.limit(self.signals, explicit=True) / F[k] if F[k] else 0.0
            others = others + share * f[k] * self.w[k]
        mechanism, independent = self.plant.mechanism, self.dynamics.independent
        words, places = zip(*self.dynamics.asking, strict=True)
        joints = [mechanism.joints[i].name for i in places]
        Kp, known = None, np.zeros(len(rigid))
        if mechanism.closures:
            at = [mechanism.joint_index[name] for name in independent]
            Kp = pseudo_inverse(np.concatenate([m.J, m.W[at]])[None])
            for i, tau in zip(self.plant.driven, self.tau, strict=True):
                if i not in at:
                    known += m.W[i] * tau
        rigid = rigid - self.external
        torque, load = joint_loads(
            mechanism, joints, independent, Kp, rigid[None], others[None], known, self.tau[None]
        )
        acceleration = (m.W @ a + m.drift)[list(places)]
        by_word = {"a": acceleration, "torque": torque[0], "load": load[0]}
        return np.array([by_word[word][k] for k, word in enumerate(words)])

    def _least(self, A: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return A⁻¹ b of a positive definite A."""
        if not len(A):
            return np.zeros_like(b)
        _, x, info = lapack.dposv(A, b)
        if info == 0:
            return x.reshape(b.shape)
        mechanism = self.plant.mechanism
        bodies = zip(mechanism.bodies.links, self.plant.laws.pi.reshape(-1, COUNT), strict=True)
        why = "something that moves has no inertia"
        least = (
            (x, np.linalg.eigvalsh(pseudo_inertia(pi)).min(), abs(pi).max()) for x, pi in bodies
        )
        if bad := [link for link, value, size in least if value < -1e-9 * size]:
            why = f"no real body has the parameters of {', '.join(bad)}"
        raise MechanismError(
            f"{mechanism.name}: at t = {self.m.t:.4g} s the mass matrix is not positive definite, "
            f"so forces do not determine the motion: {why}; identify with --consistent, or give "
            "other parameters"
        )


def holding_friction(H: np.ndarray, g: np.ndarray, F: np.ndarray) -> tuple[np.ndarray, bool]:
    """Return f (k,) with H f = g, so that no joint at rest moves, and whether |f| ≤ F is possible.

    f is the smallest where several joints of a loop hold the same motion and can share its load.
    """
    if len(g) == 1:
        f = np.divide(g, H[0], out=np.zeros(1), where=H[0] != 0)
        return f, bool(abs(f[0]) <= F[0])
    f, rank = linear.lstsq(H, g, rcond=SMALL)
    holds = bool((np.abs(f) <= F).all())
    if holds or rank == len(g):
        return f, holds
    boxed, _ = box_programme(H, g, F)
    holds = np.abs(g - H @ boxed).max() <= MARGIN * np.abs(H).max() * F.max(initial=0.0)
    return (boxed, True) if holds else (f, False)


def box_programme(H: np.ndarray, g: np.ndarray, F: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return f (k,) and the bound of each, −1, 0 (inside) or +1 (k,), by active sets.

        A α = b − Bᵀ f,   u̇ = B α + δ,   f_k ∈ F_k Sgn(u̇_k)
        min_f  ½ fᵀ H f − gᵀ f,   |f_k| ≤ F_k,      H = B A⁻¹ Bᵀ,   g = B A⁻¹ b + δ      u̇ = g − H f

    The accelerations α and the friction torques f of the joints at rest solve a strictly convex
    problem in α (Moreau, C. R. Acad. Sci. 262A, 1966; Glocker, Set-Valued Force Laws, 2001), whose
    dual this is. u̇ is unique; f is not where several joints of a loop hold the same motion.
    """
    from scipy.optimize import lsq_linear  # takes 0.2 s to import

    open_ = np.flatnonzero(F > 0)
    f, side = np.zeros(len(g)), np.zeros(len(g), dtype=int)
    if len(open_):
        h, V = np.linalg.eigh(H[np.ix_(open_, open_)])
        known = h > SMALL * max(float(h[-1]), 0.0)
        root = np.sqrt(h[known])
        A, b = (V[:, known] * root).T, V[:, known].T @ g[open_] / root
        unit = F[open_]
        solution = lsq_linear(A * unit, b, (-1.0, 1.0), method="bvls", tol=1e-15, max_iter=1000)
        side[open_] = solution.active_mask
        f[open_] = np.where(solution.active_mask, solution.active_mask * unit, unit * solution.x)
    return f, np.where(F > 0, side, np.sign(g - H @ f).astype(int))
