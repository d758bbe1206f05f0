"""q, v and a of the joints that determine the motion, smoothed if their channels are noisy.

Knots are as far apart as the data allow to distinguish motion from noise:

    AICc(h) = Σ_j [n_j log Σ_k RSS_jk / σ_jk² + 2 m n_j / (n_j − m − 1)]

over joints j and their channels k, m coefficients and n_j samples each; only the ratio of the
channels' noises need be known (C. Hurvich, C.-L. Tsai, Biometrika 76(2), 1989). The finest spacing
that is tried resolves ten times the motion's bandwidth: real noise (quantised, jittering, from a
controller's filter) is not white, and this criterion would follow it. Noise that is alike over one
sample and over several is white, and nothing else than this criterion bounds the spacing.

Where more joints are logged than needed, one smooth motion in the independent coordinates u is
fitted to the channels of all joints, by Gauss-Newton steps with the transmission L = ∂y/∂u:

    y_j^(k) − measured  =  d^k/dt^k [Σ_i L_ji δu_i]  =  Σ_r (k over r) Σ_i L_ji^(k−r) δu_i^(r)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import comb

import numpy as np

from ident.information.time_bases import Basis
from ident.mechanism.mechanism import Mechanism
from ident.motion.closures import best_conditioned
from ident.motion.recipe import AUTO, CLEAN, Band, Recipe
from ident.motion.signals import LogSignals, channels_of, runs
from ident.motion.spline import (
    DEGREE,
    WIDTH,
    Channel,
    Observations,
    Smooth,
    Smoothed,
    Spline,
    Windows,
    basis_over,
    fitted,
    interpolate,
    residuals,
    reweighted,
    rms,
    solved,
    weighted,
)
from ident.motion.state import State

RATIO = 2**0.5  # work: of one spacing that is tried to the next
WORSE = 2  # work: spacings in a row that must be worse before coarser ones are given up
MIN_INTERVALS = 6  # work: knot intervals of a run
LOOKED_AT = 20000  # work: samples of a channel that decide
ENDS = 2.0  # numerics: knots at either end of a run between which a spline is not to be trusted
END_SHARE = 0.08  # tuned: share of the shortest run that an end may lose
EXACT_SHARE = 1e-4  # numerics: share of noise up to which q, v and a are exact but for rounding
ALONE = 1e-6  # numerics: the same for positions alone, which are differentiated
AS_LOGGED = "as logged"
SAMPLES = 1.5  # numerics: from one knot to the next, at least
STEPS = 6  # work
CONVERGED = 1e-7  # numerics: of a joint's motion: a smaller step changes nothing


def finest(band: Band, channels: Sequence[Channel]) -> float:
    """Knots [s] that resolve ten times the bandwidth, and no finer than the samples allow."""
    several = any(channel.order > 0 for channel in channels)
    period = min(float(np.median(np.diff(channel.t))) for channel in channels)
    samples = (1.0 if several else 2.0) * period
    if band.noise <= CLEAN or band.white:
        return samples
    return max(band.resolved, samples)


def resolution(channels: Sequence[Channel], t: np.ndarray, band: Band) -> float:
    """The spacing of knots [s] for the channels of one run on the clock t (n,)."""
    t = t[:LOOKED_AT]
    inside = [channel.within(t) for channel in channels]
    joints = [
        [channel for channel in inside if channel.joint == name]
        for name in dict.fromkeys(channel.joint for channel in inside)
    ]
    # what is exact but for rounding, as a turn that is prescribed, asks for no knots beside noise
    noisy = [x for x in joints if any(c.sigma > ALONE * np.std(c.x) for c in x)]
    joints = noisy or joints
    coarsest = min(band.knots[1], (t[-1] - t[0]) / MIN_INTERVALS)
    h = best = float(np.clip(finest(band, channels), *band.knots))
    least, worse = np.inf, 0
    while worse < WORSE and h <= coarsest:
        value = sum(_criterion(basis_over(t[0], t[-1], h), of_joint) for of_joint in joints)
        worse = 0 if value < least else worse + 1
        if value < least:
            least, best = value, h
        h *= RATIO
    return best


def _criterion(basis: Basis, channels: Sequence[Channel]) -> float:
    n, m, names = sum(len(channel.x) for channel in channels), basis.count, (channels[0].joint,)
    if n - m <= 1:
        return np.inf
    known = Windows(basis)
    off = residuals(fitted(basis, channels, names, known), channels, names, known)
    squares = sum(float(x @ x) / c.sigma**2 for x, c in zip(off, channels, strict=True))
    return n * float(np.log(squares + 1e-300)) + 2 * m * n / (n - m - 1)


@dataclass(frozen=True, eq=False)
class Derived:
    """The motion of some joints on the clock of a log."""

    names: tuple[str, ...]  # of the joints
    known: np.ndarray  # (3, n, d) their coordinates, rates, accelerations
    ends: float  # time [s] at the ends of a run where a spline has data on one side only
    smooth: Smooth | None  # of the joints with noisy channels; None where there is none
    table: list[Smoothed]  # one a channel


def derive(
    signals: LogSignals,
    names: tuple[str, ...],
    band: Band,
    spacing: float | str | None = AUTO,
    recipe: Recipe | None = None,
) -> Derived:
    """Coordinates, rates, accelerations of logged joints; `recipe`: of the whole log, for a part.

    Clean channels, as simulations have them, are taken as they are; what is missing beside them is
    interpolated. The others are smoothed, by splines with knots every `spacing` [s] in every run
    between gaps; inside gaps a coordinate goes straight, for the closures to be followed.
    """
    channels, t = channels_of(signals, names), signals.t
    joints = {name: [channel for channel in channels if channel.joint == name] for name in names}
    known, ends, smooth = np.zeros((3, len(t), len(names))), 0.0, None
    noisy: list[str] = []
    table: list[Smoothed] = []
    for i, (name, of_joint) in enumerate(joints.items()):
        still, worst = all(c.spread == 0 for c in of_joint), max(c.noise for c in of_joint)
        exact = worst <= EXACT_SHARE and len(of_joint) == 3 and signals.exact
        alone = worst <= ALONE and len(of_joint) == 1 and band.cutoff is None
        as_logged = spacing is None or still or exact or alone
        if name in recipe.noisy if recipe else not as_logged:
            noisy.append(name)
            continue
        known[:, :, i], lost, done = _unsmoothed(signals, of_joint)
        ends = max(ends, lost)
        table += done
    if noisy:
        of_joint = [channel for channel in channels if channel.joint in noisy]
        h = recipe.knots if recipe else spacing
        if isinstance(h, str) or h is None:
            h = resolution(of_joint, max((t[run] for run in runs(signals.usable)), key=len), band)
        smooth, done = smoothed(signals, of_joint, tuple(noisy), h, recipe)
        at = [names.index(name) for name in noisy]
        for run, spline in smooth.runs:
            known[:, run, at] = spline.at(t[run])
        table += done
        if {channel.joint for channel in of_joint if channel.order == 2} < set(noisy):
            shortest = min(float(np.ptp(t[run])) for run, _ in smooth.runs)
            ends = max(ends, min(ENDS * smooth.spacing, END_SHARE * shortest))
    gap = ~signals.usable
    for i in range(len(names)):
        known[0, gap, i] = np.interp(t[gap], t[~gap], known[0, ~gap, i])
    order = [channel.column for channel in channels]
    table.sort(key=lambda channel: order.index(channel.column))
    return Derived(names, known, recipe.ends if recipe else ends, smooth, table)


def smoothed(
    signals: LogSignals,
    channels: Sequence[Channel],
    names: tuple[str, ...],
    h: float,
    recipe: Recipe | None = None,
) -> tuple[Smooth, list[Smoothed]]:
    """One spline a run, with knots every h [s], through all channels; what it leaves of each."""
    spans = [(run, signals.t[run]) for run in runs(signals.usable)]
    if recipe:
        origin = recipe.clock.t0
        noise = {channel.column: channel.sigma for channel in channels} | dict(recipe.noise)
    else:
        t, origin = max((t for _, t in spans), key=len), None
        inside = [channel.within(t) for channel in channels]
        agreeing = weighted(basis_over(t[0], t[-1], h), inside, names)
        noise = {channel.column: channel.sigma for channel in agreeing}
    pieces = [(run, t, basis_over(t[0], t[-1], h, origin)) for run, t in spans]
    weighed = [replace(channel, sigma=noise[channel.column]) for channel in channels]
    smooth = Smooth.of(weighed, names, h, pieces)
    missed = [
        residuals(spline, [channel.within(signals.t[run]) for channel in weighed], names)
        for run, spline in smooth.runs
    ]
    how = f"spline, knots {1e3 * h:.3g} ms"
    return smooth, [
        Smoothed(channel.column, how, channel.sigma, rms(off), h)
        for channel, off in zip(channels, zip(*missed, strict=True), strict=True)
    ]


def _unsmoothed(
    signals: LogSignals, channels: Sequence[Channel]
) -> tuple[np.ndarray, float, list[Smoothed]]:
    """A joint's q, v and a (3, n) without smoothing, what its ends lose [s], and what was done."""
    known, ends = np.zeros((3, len(signals.t))), 0.0
    orders = [channel.order for channel in channels]
    for run in runs(signals.usable):
        t = signals.t[run]
        inside = [channel.within(t) for channel in channels]
        if orders == [0, 1, 2]:
            known[:, run] = [
                channel.x if len(channel.t) == len(t) else interpolate(channel.t, channel.x, t)[0]
                for channel in inside
            ]
        elif all(channel.spread == 0 for channel in channels):
            for channel in channels:
                known[channel.order, run] = channel.x[0]
        elif orders == [0]:
            known[:, run] = interpolate(inside[0].t, inside[0].x, t)
        else:
            h = finest(Band(0.0, 0.0, None), inside)
            spline = fitted(basis_over(t[0], t[-1], h), inside, (channels[0].joint,))
            known[:, run] = spline.at(t)[:, :, 0]
            ends = 0.0 if 2 in orders else ENDS * h
    missing = " and ".join("qva"[k] for k in range(3) if k not in orders)
    logged = " and ".join("qva"[k] for k in orders)
    how = f"{missing} by quintic interpolation of {logged}" if missing else AS_LOGGED
    return known, ends, [Smoothed(channel.column, how, channel.sigma, 0.0) for channel in channels]


# --- more joints logged than needed --------------------------------------------------------------


def along(mechanism: Mechanism, e: State, smooth: Smooth) -> State:
    """The experiment on another smooth motion near its own; inside gaps it stays as it is."""
    surplus = len(e.logged) > mechanism.degrees_of_freedom
    names = smooth.names if surplus else e.logged
    known = e.known(mechanism, names)
    at = [names.index(name) for name in smooth.names]
    for run, spline in smooth.runs:
        known[:, run, at] = spline.at(e.t[run])
    return replace(e.at(mechanism, known, names), smooth=smooth)


def together(mechanism: Mechanism, signals: LogSignals, e: State, recipe: Recipe | None) -> State:
    """One smooth motion of a smoothed state, with its knots, made by the channels of all joints."""
    assert e.smooth is not None
    names = best_conditioned(mechanism, e.q) if recipe is None else recipe.carriers
    channels = channels_of(signals, e.logged)
    through = through_motion(mechanism, e, names)
    without_noise = recipe and replace(recipe, noise={})
    e = along(mechanism, e, smoothed(signals, through, names, e.smooth.spacing, without_noise)[0])
    white = [channel.sigma for channel in channels]
    if recipe is not None:
        channels = [
            replace(channel, sigma=recipe.noise.get(channel.column, channel.sigma))
            for channel in channels
        ]
    else:
        e = along(mechanism, e, fused(mechanism, e, channels))
        channels = reweighted(channels, missed(mechanism, e, channels))
    smooth = fused(mechanism, e, channels)
    e = along(mechanism, e, smooth)
    how = f"spline in {', '.join(names)}, knots {1e3 * smooth.spacing:.3g} ms"
    table = [
        Smoothed(channel.column, how, sigma, off, smooth.spacing)
        for channel, sigma, off in zip(channels, white, missed(mechanism, e, channels), strict=True)
    ]
    return replace(e, channels=tuple(table))


def finer(mechanism: Mechanism, e: State, times: int) -> Smooth:
    """The splines of an experiment with `times` as many knots, fewer if samples are too few."""
    smooth, surplus = e.smooth, len(e.logged) > mechanism.degrees_of_freedom
    assert smooth is not None
    times, runs = max(1, min(times, int(smooth.spacing * e.rate / SAMPLES))), []
    for run, spline in smooth.runs:
        b = spline.basis
        count = times * (b.count - DEGREE) + DEGREE
        runs.append((run, e.t[run], Basis.with_count(b.t0, b.t_end, count, DEGREE)))
    channels = through_motion(mechanism, e, smooth.names) if surplus else smooth.channels
    fine = Smooth.of(channels, smooth.names, smooth.spacing / times, runs)
    return fused(mechanism, along(mechanism, e, fine), smooth.channels) if surplus else fine


def through_motion(mechanism: Mechanism, e: State, names: tuple[str, ...]) -> list[Channel]:
    """The motion of some joints itself, as channels."""
    channels = []
    for name in names:
        for order, y in enumerate(e.known(mechanism, (name,))[:, :, 0]):
            spread = float(np.std(y)) or 1.0
            channels.append(Channel(name, order, e.t, y, spread, spread))
    return channels


def fused(mechanism: Mechanism, e: State, channels: Sequence[Channel]) -> Smooth:
    """The splines of independent joints, from the experiment's own, fitted to all channels."""
    assert e.smooth is not None
    smooth = e.smooth
    for _ in range(STEPS):
        e = e.transmitted(mechanism, smooth.names)
        L = e.leverage
        rates = [L, np.zeros_like(L), np.zeros_like(L)]
        splines, step = [], 0.0
        for run, before in smooth.runs:
            t = e.t[run]
            for order in (1, 2):
                rates[order][run] = np.gradient(rates[order - 1][run], t, axis=0)
            rows = [
                _rows(before, channel.within(t), e, rates, mechanism.joint_index[channel.joint])
                for channel in channels
            ]
            spline = solved(before.basis, rows, len(smooth.names))
            splines.append((run, spline))
            now = spline.at(t)[0]
            change = np.abs(now - before.at(t)[0]).max(axis=0)
            step = max(step, float((change / (now.std(axis=0) + 1e-12)).max()))
        smooth = replace(smooth, runs=tuple(splines), channels=tuple(channels))
        e = along(mechanism, e, smooth)
        if step < CONVERGED:
            break
    return smooth


def missed(mechanism: Mechanism, e: State, channels: Sequence[Channel]) -> list[float]:
    """rms of measured minus smoothed of each channel, in all runs of an experiment."""
    assert e.smooth is not None
    errors = []
    for channel in channels:
        series = e.known(mechanism, (channel.joint,))[channel.order, :, 0]
        parts = []
        for run, _ in e.smooth.runs:
            inside = channel.within(e.t[run])
            parts.append(inside.x - np.interp(inside.t, e.t[run], series[run]))
        errors.append(rms(parts))
    return errors


def _rows(
    spline: Spline, channel: Channel, e: State, rates: list[np.ndarray], joint: int
) -> Observations:
    """A channel's equations in the coefficients c, linear about the experiment's motion."""
    t = np.clip(channel.t, spline.basis.t0, spline.basis.t_end)
    at = np.clip(np.searchsorted(e.t, t), 1, len(e.t) - 1)
    share = ((t - e.t[at - 1]) / (e.t[at] - e.t[at - 1]))[:, None]
    k, d = channel.order, spline.c.shape[1]
    R, first = np.zeros((len(t), WIDTH, d)), np.zeros(len(t), dtype=np.intp)
    for r in range(k + 1):
        first, B = spline.basis.window(t, r)
        rates_of_joint = rates[k - r][:, joint]
        L = (1 - share) * rates_of_joint[at - 1] + share * rates_of_joint[at]
        R += comb(k, r) * B[:, :, None] * L[:, None, :]
    now = np.interp(t, e.t, (e.y, e.yd, e.ydd)[k][:, joint])
    linear = np.einsum("nrd,nrd->n", R, spline.c[first[:, None] + np.arange(WIDTH)])
    return Observations(first, R / channel.sigma, (channel.x - now + linear) / channel.sigma)
