"""States and mechanisms with the corrections of effects: positions, torques, gravity, lengths.

    y → y + δy     τ(t) → τ(t + d)     g → Rᵀ g     placements + Δ     q → q + K⁺ [C λ; 0]

A corrected state is one like any other; no equation needs to know of it. The columns of a
correction's shapes are S = −∂(b − A x)/∂s, by central differences over corrections at s ± h.
"""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.interpolate import CubicSpline

from ident.effects import Correction, Effect
from ident.equations.filter import Decimator
from ident.equations.terms import (
    STEP,
    Samples,
    Terms,
    effect_terms,
    reduced,
    unbalanced,
    with_bodies,
)
from ident.equations.unknowns import Columns, Point
from ident.errors import MotionError
from ident.mechanism.mechanism import Mechanism
from ident.motion.closures import integrate
from ident.motion.state import State

WIDER = 3.0  # times the rows' cut-off: a filter that passes all that the rows' filter passes


@dataclass(frozen=True, eq=False)
class Corrected:
    """A mechanism and one of its states, corrected; `memo` keeps what is slow to make."""

    mechanism: Mechanism
    e: State
    memo: dict[object, np.ndarray] = field(default_factory=dict)


def corrected(
    base: Corrected, point: Point, cutoff: float | None, only: Effect | None = None
) -> Corrected:
    """The mechanism and state as correcting effects (or `only` one) make them at a point."""
    mechanism, e = base.mechanism, base.e
    whole = Samples(mechanism, e, slice(None), point, base.memo)
    for effect in mechanism.effects:
        if not effect.corrects or (only and effect.label != only.label):
            continue
        _, shape = point.of(effect)
        if len(shape) < len(effect.shapes):
            continue
        if not any(shape.values()) and not effect.margin:
            continue
        what = effect.correction(replace(whole.signals(effect.joints), shape=shape))
        mechanism, e = _corrected(mechanism, e, what, whole, cutoff, effect.margin)
    return base if e is base.e and mechanism is base.mechanism else Corrected(mechanism, e)


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
    return CubicSpline(t, x)(np.clip(t - d, t[0], t[-1])) if d else x


def _rates(e: State, dq: np.ndarray | float, cutoff: float | None) -> np.ndarray:
    """δy, δẏ, δÿ (3, n) of a correction, without what is far above the rows' cut-off."""
    n = len(e)
    if np.ndim(dq) == 0:
        return np.stack([np.full(n, float(dq)), np.zeros(n), np.zeros(n)])
    wide = WIDER * cutoff if cutoff and WIDER * cutoff < 0.5 * e.rate else None
    taps = Decimator.of(wide, e.rate).taps
    x = np.asarray(dq, dtype=float)
    if taps is not None:
        half = len(taps) // 2
        from scipy.signal import oaconvolve  # takes half a second to import

        x = oaconvolve(np.pad(x, half, mode="edge"), taps, mode="valid")
    rate = np.gradient(x, 1 / e.rate)
    return np.stack([x, rate, np.gradient(rate, 1 / e.rate)])


def _opened(
    mechanism: Mechanism, e: State, name: str, C: float, whole: Samples, cutoff: float | None
) -> State:
    """q + K⁺ [C λ; 0], with the rates that come with it; exact to first order in C."""
    assert e.pinv is not None
    known = zip(mechanism.kinematics.multipliers, mechanism.kinematics.units, strict=True)
    forces = [each if unit == "N" else "" for each, unit in known]
    mine = [i for i, each in enumerate(forces) if each.startswith(f"{name}.")]
    gap = C * whole.multipliers()[:, mine]
    step = np.einsum("nij,nj->ni", e.pinv[:, :, mine], gap)
    rates = np.stack([_rates(e, x, cutoff) for x in step.T], axis=2)
    q = integrate(mechanism.model, e.q, rates[0])
    return e.at(mechanism, motion=(q, e.v + rates[1], e.a + rates[2]))


# the place in x of an unknown shape, its value s, h, and the scenes at s + h and s − h
Beside = tuple[int, float, float, Corrected, Corrected]


@dataclass(frozen=True, eq=False)
class Scene:
    """One state with its corrections."""

    corrected: Corrected  # mechanism and state at the working point
    columns: Columns  # the unknowns
    point: Point  # values of all parameters
    beside: tuple[Beside, ...] = ()  # for every unknown shape of a correcting effect

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
        point = point or Point.prior(mechanism)
        bare = Corrected(mechanism, e)
        beside = []
        for effect, places in columns.effects:
            if not effect.corrects:
                continue
            _, shape = point.of(effect)
            for each, full, place in zip(effect.shapes, effect.names, places, strict=True):
                if place < 0:
                    continue
                value, h = shape.get(each.name, 0.0), step_of(effect, bare, point, each.name)
                above, below = (
                    corrected(bare, point.with_values({full: value + sign * h}), cutoff)
                    for sign in (1, -1)
                )
                beside.append((int(place), value, h, above, below))
        return cls(corrected(bare, point, cutoff), columns, point, tuple(beside))

    @property
    def mechanism(self) -> Mechanism:
        """Corrected."""
        return self.corrected.mechanism

    @property
    def e(self) -> State:
        """Corrected."""
        return self.corrected.e

    def samples(self, part: slice | np.ndarray) -> Samples:
        """Some samples in the independent coordinates."""
        return reduced(self.mechanism, self.e, part, self.point, self.corrected.memo)

    def generalised(self, part: slice | np.ndarray) -> Samples:
        """The same in generalised coordinates."""
        return Samples(self.mechanism, self.e, part, self.point, self.corrected.memo)

    def effects(self, s: Samples) -> Terms:
        """The equations of some samples without Γ, with the sensitivities S of corrections."""
        found = []
        for place, value, h, *sides in self.beside:
            above, below = (
                unbalanced(replace(s, mechanism=x.mechanism, e=x.e, memo=x.memo), self.point)
                for x in sides
            )
            found.append((place, value, -(above - below) / (2 * h)))
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
        for kind in effect.needs:
            other = f"{kind}:{','.join(effect.joints)}"
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


def step_of(effect: Effect, base: Corrected, point: Point, name: str) -> float:
    """h [the shape's unit], a thousandth of what these data could tell."""
    whole = Samples(base.mechanism, base.e, slice(None), point, base.memo)
    _, shape = point.of(effect)
    low, high = effect.bounds(replace(whole.signals(effect.joints), shape=shape))[name]
    return STEP * (high - low)
