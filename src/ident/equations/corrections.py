"""States and mechanisms with the corrections of effects: positions, torques, gravity, lengths.

    y → y + δy     τ(t) → τ(t + d)     g → Rᵀ g     placements + Δ     q → q + K⁺ [C λ; 0]

A corrected state is one like any other; no equation needs to know of it. The columns of a
correction's shapes are S = −∂r/∂s, r = b − A x, by differences over corrections at s and s + h.
"""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass, replace

import numpy as np

from ident.effects import Correction, Effect
from ident.equations.filter import Decimator
from ident.equations.terms import Samples, Terms, effect_terms, unbalanced, with_bodies
from ident.equations.unknowns import Columns, Point
from ident.errors import MotionError
from ident.mechanism.mechanism import Mechanism
from ident.motion.closures import integrate
from ident.motion.state import State

WIDER = 3.0  # times the rows' cut-off: a filter that passes all that the rows' filter passes
STEP = 1e-5  # of the range of a shape parameter: corrections are smooth in their shapes
CHUNK = 4096  # samples whose residual is made at once


def corrected(base: Samples, cutoff: float | None, only: Effect | None = None) -> Samples:
    """A whole state as correcting effects (or `only` one) make it at the point of `base`."""
    mechanism, e = base.mechanism, base.e
    for effect in mechanism.effects:
        if not effect.corrects or (only and effect.label != only.label):
            continue
        _, shape = base.point.of(effect)
        if len(shape) < len(effect.shapes):
            continue
        if not any(shape.values()) and not effect.margin:
            continue
        what = effect.correction(replace(base.signals(effect.joints), shape=shape))
        mechanism, e = _corrected(mechanism, e, what, base, cutoff, effect.margin)
    same = e is base.e and mechanism is base.mechanism
    return base if same else Samples(mechanism, e, slice(None), base.point)


def beside(
    base: Samples, effect: Effect, name: str, cutoff: float | None, only: Effect | None = None
) -> tuple[float, Samples]:
    """h [the shape's unit] and the state corrected with one shape of an effect at s + h."""
    _, shape = base.point.of(effect)
    low, high = effect.bounds(replace(base.signals(effect.joints), shape=shape))[name]
    full = effect.names[[each.name for each in effect.parameters].index(name)]
    h = STEP * (high - low)
    point = base.point.with_values({full: shape.get(name, 0.0) + h})
    return h, corrected(replace(base, point=point), cutoff, only)


def residual(at: Samples) -> np.ndarray:
    """r = b − A x (n, d) of a whole state, in the independent coordinates."""
    key = ("residual",)
    if key not in at.memo:
        parts = (slice(start, start + CHUNK) for start in range(0, len(at.e), CHUNK))
        at.memo[key] = np.concatenate([unbalanced(at.reduced(part)) for part in parts])
    return at.memo[key]


def _corrected(
    mechanism: Mechanism,
    e: State,
    what: Correction,
    whole: Samples,
    cutoff: float | None,
    margin: float,
) -> tuple[Mechanism, State]:
    mechanism = mechanism.corrected(what)
    if what.moved:
        e = e.at(mechanism, e.known(mechanism))
    for name, d in what.delay.items():
        tau, channel = e.tau.copy(), mechanism.driven.index(name)
        tau[:, channel] = late(e.t, e.tau[:, channel], -d)  # read at t + d, without the ends
        inside = (e.t >= e.t[0] + margin) & (e.t <= e.t[-1] - margin)
        e = replace(e, tau=tau, usable=e.usable & inside)
    if what.dq:
        known = e.known(mechanism)
        for name, dq in what.dq.items():
            if name in e.logged:  # the closures place the others
                known[:, :, e.logged.index(name)] += _rates(e, dq, cutoff)
        e = e.at(mechanism, known)
    for name, C in what.gap.items():
        e = _opened(mechanism, e, name, C, whole, cutoff)
    return mechanism, e


def late(t: np.ndarray, x: np.ndarray, d: float) -> np.ndarray:
    """x(t − d) of a series x (n,) at the times t (n,) [s]; the ends stand still."""
    if not d:
        return x
    from scipy.interpolate import CubicSpline  # takes 0.2 s to import

    return CubicSpline(t, x)(np.clip(t - d, t[0], t[-1]))


def _rates(e: State, dq: np.ndarray | float, cutoff: float | None) -> np.ndarray:
    """δy, δẏ, δÿ (3, n) of a correction, without what is far above the rows' cut-off."""
    n = len(e)
    if np.ndim(dq) == 0:
        return np.stack([np.full(n, float(dq)), np.zeros(n), np.zeros(n)])
    wide = WIDER * cutoff if cutoff and WIDER * cutoff < 0.5 * e.rate else None
    decimator, x = Decimator.of(wide, e.rate), np.asarray(dq, dtype=float)
    if decimator.taps is not None:
        x = np.convolve(np.pad(x, decimator.half, mode="edge"), decimator.taps, mode="valid")
    rate = np.gradient(x, 1 / e.rate)
    return np.stack([x, rate, np.gradient(rate, 1 / e.rate)])


def _opened(
    mechanism: Mechanism, e: State, name: str, C: float, whole: Samples, cutoff: float | None
) -> State:
    """q + K⁺ [C λ; 0], with the rates that come with it; exact to first order in C."""
    known = zip(mechanism.kinematics.multipliers, mechanism.kinematics.units, strict=True)
    forces = [each if unit == "N" else "" for each, unit in known]
    mine = [i for i, each in enumerate(forces) if each.startswith(f"{name}.")]
    gap = C * whole.multipliers()[:, mine]
    step = np.einsum("nij,nj->ni", e.pinv[:, :, mine], gap)
    rates = np.stack([_rates(e, x, cutoff) for x in step.T], axis=2)
    q = integrate(mechanism.model, e.q, rates[0])
    return e.at(mechanism, motion=(q, e.v + rates[1], e.a + rates[2]))


@dataclass(frozen=True, eq=False)
class Scene:
    """One state with its corrections at the working point."""

    whole: Samples  # corrected mechanism and state, and values of all parameters
    columns: Columns  # the unknowns
    # for every unknown shape of a correcting effect: its place in x, its value s, h, and the
    # state at s + h
    beside: tuple[tuple[int, float, float, Samples], ...] = ()

    @classmethod
    def of(
        cls,
        mechanism: Mechanism,
        columns: Columns,
        e: State,
        point: Point | None = None,
        cutoff: float | None = None,
    ) -> Scene:
        """The scene of a state; `cutoff` [Hz] is that of the rows' filter."""
        check_needs(mechanism, e.name, e.extra)
        bare = Samples(mechanism, e, slice(None), point or Point.prior(mechanism))
        found = [
            (int(place), bare.point.of(effect)[1].get(each.name, 0.0),
             *beside(bare, effect, each.name, cutoff))
            for effect, places in columns.effects if effect.corrects
            for each, place in zip(effect.shapes, places, strict=True) if place >= 0
        ]  # fmt: skip
        return cls(corrected(bare, cutoff), columns, tuple(found))

    @property
    def mechanism(self) -> Mechanism:
        """Corrected."""
        return self.whole.mechanism

    @property
    def e(self) -> State:
        """Corrected."""
        return self.whole.e

    @property
    def point(self) -> Point:
        """The working point."""
        return self.whole.point

    def samples(self, part: slice | np.ndarray) -> Samples:
        """Some samples in the independent coordinates."""
        return self.whole.reduced(part)

    def generalised(self, part: slice | np.ndarray) -> Samples:
        """The same in generalised coordinates."""
        return self.whole.generalised(part)

    def effects(self, s: Samples) -> Terms:
        """The equations of some samples without Γ, with the sensitivities S of corrections."""
        found = []
        r = unbalanced(s) if self.beside else np.empty(0)
        for place, value, h, moved in self.beside:
            there = replace(s, mechanism=moved.mechanism, e=moved.e, memo=moved.memo)
            found.append((place, value, (r - unbalanced(there)) / h))
        return effect_terms(s, self.columns, found)

    def terms(self, part: slice | np.ndarray, *, full: bool = False) -> Terms:
        """A x = b of some samples, in the independent coordinates or, `full`, in all."""
        s = self.generalised(part) if full else self.samples(part)
        found = self.effects(s)
        gamma = [s.gamma[:, row] for row in range(s.shape[1])]
        A, b = with_bodies(self.columns, self.point, gamma, found.A, found.b)
        return replace(found, A=A, b=b)


def check_needs(mechanism: Mechanism, log: str, columns: Container[str]) -> None:
    """Refuse an effect without the other effect, or the column of the log, that it needs."""
    present = {effect.label for effect in mechanism.effects}
    for effect in mechanism.effects:
        for other in effect.required:
            if other not in present:
                raise MotionError(
                    f"{mechanism.name}: effect '{effect.label}' changes '{other}', which is not "
                    f"there; add it (--with {other}), or leave out {effect.label}"
                )
        for name in effect.reads():
            if name not in columns:
                raise MotionError(
                    f"{log}: has no column '{name}', which effect '{effect.label}' needs; log "
                    f"it, map it in [log], or leave out {effect.label}"
                )
