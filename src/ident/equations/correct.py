"""Data and mechanism as correcting effects make them: positions, torques, gravity, lengths.

    y → y + δy     τ(t) → τ(t + d)     g → Rᵀ g     placements + Δ     q → q + K⁺ [C λ; 0]

A corrected experiment is one like any other; everything downstream reads it and knows no better.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import oaconvolve

from ident.effects import Correction, Effect
from ident.equations.filter import Decimator
from ident.equations.point import Point
from ident.equations.samples import Samples
from ident.mechanism.mechanism import Mechanism
from ident.motion import Experiment
from ident.motion.place import again, displaced

WIDER = 3.0  # times the rows' cut-off: a filter that passes all that the rows' filter passes
CALM = 0.4  # of the rows' cut-off, for corrections that vary
Rates = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class Seen:
    """A mechanism and one of its experiments, corrected; `memo` keeps what is slow to make."""

    mechanism: Mechanism
    e: Experiment
    memo: dict[object, np.ndarray] = field(default_factory=dict)


def corrected(seen: Seen, point: Point, cutoff: float | None, only: Effect | None = None) -> Seen:
    """The mechanism and experiment as correcting effects (or `only` one) make them at a point."""
    mechanism, e = seen.mechanism, seen.e
    whole = Samples(mechanism, e, slice(None), point, seen.memo)
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
    return seen if e is seen.e and mechanism is seen.mechanism else Seen(mechanism, e)


def _corrected(
    mechanism: Mechanism,
    e: Experiment,
    what: Correction,
    whole: Samples,
    cutoff: float | None,
    margin: float,
) -> tuple[Mechanism, Experiment]:
    mechanism = mechanism.corrected(what)
    if what.moved:
        e = again(mechanism, e, {})
    for name, d in what.delay.items():
        e = _early(e, mechanism.driven.index(name), d, margin)
    if what.dq:
        e = again(mechanism, e, {name: _rates(e, dq, cutoff) for name, dq in what.dq.items()})
    for name, C in what.gap.items():
        e = _opened(mechanism, e, name, C, whole, cutoff)
    return mechanism, e


def _early(e: Experiment, channel: int, d: float, margin: float) -> Experiment:
    """The experiment with one torque channel read at t + d, without its ends, where none is."""
    tau = e.tau.copy()
    tau[:, channel] = late(e.t, e.tau[:, channel], -d)
    inside = (e.t >= e.t[0] + margin) & (e.t <= e.t[-1] - margin)
    return replace(e, tau=tau, usable=e.usable & inside)


def late(t: np.ndarray, x: np.ndarray, d: float) -> np.ndarray:
    """x(t − d) of a series x (n,) at the times t (n,) [s]; the ends stand still."""
    return CubicSpline(t, x)(np.clip(t - d, t[0], t[-1])) if d else x


def _rates(e: Experiment, dq: np.ndarray | float, cutoff: float | None) -> Rates:
    """δy, δẏ, δÿ (n,) of a correction, without what is far above the rows' cut-off."""
    n = len(e)
    if np.ndim(dq) == 0:
        return np.full(n, float(dq)), np.zeros(n), np.zeros(n)
    wide = WIDER * cutoff if cutoff and WIDER * cutoff < 0.5 * e.rate else None
    taps = Decimator.of(wide, e.rate).taps
    x = np.asarray(dq, dtype=float)
    if taps is not None:
        half = len(taps) // 2
        x = oaconvolve(np.pad(x, half, mode="edge"), taps, mode="valid")
    rate = np.gradient(x, 1 / e.rate)
    return x, rate, np.gradient(rate, 1 / e.rate)


def _opened(
    mechanism: Mechanism, e: Experiment, name: str, C: float, whole: Samples, cutoff: float | None
) -> Experiment:
    """q + K⁺ [C λ; 0], with the rates that come with it; exact to first order in C."""
    assert e.pinv is not None
    known = zip(mechanism.kinematics.multipliers, mechanism.kinematics.units, strict=True)
    forces = [each if unit == "N" else "" for each, unit in known]
    mine = [i for i, each in enumerate(forces) if each.startswith(f"{name}.")]
    gap = C * whole.multipliers()[:, mine]
    step = np.einsum("nij,nj->ni", e.pinv[:, :, mine], gap)
    rates = [_rates(e, step[:, i], cutoff) for i in range(step.shape[1])]
    dq, dv, da = (np.stack(each, axis=1) for each in zip(*rates, strict=True))
    return displaced(mechanism, e, (dq, dv, da))


def shapes_of(effect: Effect, point: Point) -> Mapping[str, float]:
    """The shapes of a correcting effect, 0 where there is no value yet."""
    _, shape = point.of(effect)
    return {each.name: shape.get(each.name, 0.0) for each in effect.shapes}
