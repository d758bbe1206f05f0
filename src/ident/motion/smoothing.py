"""q, v and a of the joints that determine the motion, smoothed if their channels are noisy.

Knots are as far apart as the data allow to distinguish motion from noise:

    AICc(h) = Σ_j [n_j log Σ_k RSS_jk / σ_jk² + 2 m n_j / (n_j − m − 1)]

over joints j and their channels k, m coefficients and n_j samples each; only the ratio of the
channels' noises need be known (C. Hurvich, C.-L. Tsai, Biometrika 76(2), 1989). The finest spacing
that is tried resolves ten times the motion's bandwidth: real noise (quantised, jittering, from a
controller's filter) is not white, and this criterion would follow it.

Where more joints are logged than needed, one smooth motion in the independent coordinates u is
fitted to the channels of all joints, by Gauss-Newton steps with the transmission L = ∂y/∂u:

    y_j^(k) − measured  =  d^k/dt^k [Σ_i L_ji δu_i]  =  Σ_r (k over r) Σ_i L_ji^(k−r) δu_i^(r)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import comb

import numpy as np

from ident.information.splines import Basis
from ident.mechanism.mechanism import Mechanism
from ident.motion.recipe import AUTO, CLEAN, Band, Recipe
from ident.motion.signals import Channel, LogSignals, Smoothed, channels_of, periods, runs
from ident.motion.spline import (
    INCONSISTENT,
    WIDTH,
    Observations,
    Smooth,
    Spline,
    basis_over,
    filled,
    fitted,
    interpolate,
    residuals,
    solved,
    weighted,
)
from ident.motion.state import State

SMOOTH_OVER_MOTION = 10.0  # resolution of smoothing over the motion's bandwidth
RATIO = 2**0.5  # of one spacing that is tried to the next
WORSE = 2  # spacings in a row that must be worse before coarser ones are given up
FEWEST = 6  # knot intervals of a run
LOOKED_AT = 20000  # samples of a channel that decide
ENDS = 2.0  # knots at either end of a run between which a spline is not to be trusted
MOST = 0.08  # share of the shortest run that an end may lose
WHOLE = 1e-4  # share of noise up to which q, v and a are taken as logged, where all three are
ALONE = 1e-6  # the same for positions alone, which are differentiated
AS_LOGGED = "as logged"
SAMPLES = 1.5  # from one knot to the next, at least
STEPS = 6
SETTLED = 1e-7  # of a joint's motion: a smaller step changes nothing


def finest(band: Band, channels: Sequence[Channel]) -> float:
    """Knots [s] that resolve ten times the bandwidth, and no finer than the samples allow."""
    several = any(channel.order > 0 for channel in channels)
    samples = (1.0 if several else 2.0) * periods(channels)
    if band.noise <= CLEAN or band.motion <= 0:
        return samples
    return max(1 / (2.0 * SMOOTH_OVER_MOTION * band.motion), samples)


def resolution(channels: Sequence[Channel], t: np.ndarray, band: Band) -> float:
    """The spacing of knots [s] for the channels of one run on the clock t (n,)."""
    t = t[:LOOKED_AT]
    mine = [channel.within(t) for channel in channels]
    names = tuple(dict.fromkeys(channel.joint for channel in mine))
    h = best = finest(band, channels)
    least, worse = np.inf, 0
    while worse < WORSE and (t[-1] - t[0]) / h >= FEWEST:
        value = sum(_criterion(basis_over(t[0], t[-1], h), mine, name) for name in names)
        worse = 0 if value < least else worse + 1
        if value < least:
            least, best = value, h
        h *= RATIO
    return best


def _criterion(basis: Basis, channels: Sequence[Channel], name: str) -> float:
    """AICc of one joint."""
    mine = [channel for channel in channels if channel.joint == name]
    n, m = sum(len(channel.x) for channel in mine), basis.count
    if n - m <= 1:
        return np.inf
    left = residuals(fitted(basis, mine, (name,)), mine, (name,))
    squares = [float(off @ off) / c.sigma**2 for off, c in zip(left, mine, strict=True)]
    return n * float(np.log(sum(squares) + 1e-300)) + 2 * m * n / (n - m - 1)


@dataclass(frozen=True, eq=False)
class Derived:
    """The motion of some joints on the clock of a log.

    Attributes:
        known: (3, n, d) coordinates, rates, accelerations of the joints, in their order.
        ends: time [s] at either end of a run where accelerations are poor: a fitted spline has
            data on one side only there.
        smooth: the splines of the joints whose channels are noisy; None where none is.
        table: what was done to each channel.
    """

    known: np.ndarray
    ends: float
    smooth: Smooth | None
    table: list[Smoothed] = field(default_factory=list)


def derive(
    signals: LogSignals,
    names: Sequence[str],
    band: Band,
    spacing: float | str | None = AUTO,
    recipe: Recipe | None = None,
) -> Derived:
    """Coordinates, rates and accelerations of logged joints.

    Clean channels, as simulations have them, are taken as they are; what is missing beside them is
    interpolated. The others are smoothed. Every run between gaps has splines of its own; inside
    gaps a coordinate goes straight from one side to the other, for the closures to be followed.

    Args:
        signals: the log; names: the joints.
        band: what the spectra say.
        spacing: of the knots [s]; "auto": from the data; None: as logged, nothing is smoothed.
        recipe: of a part of a log: recipe of the whole log.
    """
    channels = channels_of(signals, names)
    noisy = [
        name
        for name in names
        if spacing is not None and not _as_logged(channels, name, band, signals.exact)
    ]
    noisy = list(recipe.noisy) if recipe else noisy
    known, ends = np.zeros((3, len(signals.t), len(names))), 0.0
    table: dict[str, Smoothed] = {}
    for i, name in enumerate(names):
        if name not in noisy:
            mine = [channel for channel in channels if channel.joint == name]
            known[:, :, i], end, said = _taken(signals, mine, band)
            ends = max(ends, end)
            table |= {each.column: each for each in said}
    smooth = None
    if noisy:
        mine = [channel for channel in channels if channel.joint in noisy]
        smooth, said = smoothed(signals, mine, tuple(noisy), band, spacing, recipe)
        at = [list(names).index(name) for name in noisy]
        for run, spline in smooth.runs:
            known[:, run, at] = spline.at(signals.t[run])
        table |= {each.column: each for each in said}
        accelerations = {channel.joint for channel in mine if channel.order == 2}
        shortest = min(float(t[-1] - t[0]) for t in (signals.t[run] for run, _ in smooth.runs))
        lost = min(ENDS * smooth.spacing, MOST * shortest)
        ends = max(ends, 0.0 if accelerations >= set(noisy) else lost)
    ends = recipe.ends if recipe else ends
    t, gap = signals.t, ~signals.usable
    for i in range(len(names)):
        known[0, gap, i] = np.interp(t[gap], t[~gap], known[0, ~gap, i])
    return Derived(known, ends, smooth, [table[channel.column] for channel in channels])


def smoothed(
    signals: LogSignals,
    channels: Sequence[Channel],
    names: tuple[str, ...],
    band: Band,
    spacing: float | str | None,
    recipe: Recipe | None = None,
) -> tuple[Smooth, list[Smoothed]]:
    """One spline a run through all channels of the joints, and what it left of each."""
    t, found = signals.t, runs(signals.usable)
    h, noise = _weighed(signals, channels, names, band, spacing, recipe)
    white = [channel.sigma for channel in channels]
    channels = [channel.with_noise(noise[channel.column]) for channel in channels]
    origin = recipe.clock.t0 if recipe else None
    smooth = Smooth.of(channels, names, [(run, t[run]) for run in found], h, origin)
    squares, counts = np.zeros(len(channels)), np.zeros(len(channels))
    for run, spline in smooth.runs:
        inside = [channel.within(t[run]) for channel in channels]
        for k, off in enumerate(residuals(spline, inside, names)):
            squares[k] += off @ off
            counts[k] += len(off)
    rms = np.sqrt(squares / np.maximum(counts, 1))
    how = f"spline, knots {1e3 * h:.3g} ms"
    return smooth, [
        Smoothed(channel.column, how, sigma, float(off), h)
        for channel, sigma, off in zip(channels, white, rms, strict=True)
    ]


def _weighed(
    signals: LogSignals,
    channels: Sequence[Channel],
    names: tuple[str, ...],
    band: Band,
    spacing: float | str | None,
    recipe: Recipe | None,
) -> tuple[float, Mapping[str, float]]:
    """The distance of the knots [s], and the noise by which each channel is weighed, by column."""
    if recipe:
        own = {channel.column: channel.sigma for channel in channels}
        return recipe.knots, own | dict(recipe.noise)
    t = signals.t[max(runs(signals.usable), key=lambda run: run.stop - run.start)]
    automatic = spacing == AUTO or spacing is None
    h = resolution(channels, t, band) if automatic else float(spacing or 0.0)
    seen = [channel.within(t) for channel in channels]
    found = weighted(basis_over(t[0], t[-1], h), seen, names)
    return h, {channel.column: channel.sigma for channel in found}


def _as_logged(channels: Sequence[Channel], name: str, band: Band, exact: bool) -> bool:
    """Whether a joint's channels are clean, and enough to be taken as they are."""
    mine = [channel for channel in channels if channel.joint == name]
    worst = max(channel.noise for channel in mine)
    if all(channel.spread == 0 for channel in mine):  # it stands still
        return True
    if len(mine) == 3 and exact:
        return worst <= WHOLE
    return worst <= ALONE and len(mine) == 1 and band.cutoff is None


def _taken(
    signals: LogSignals, channels: Sequence[Channel], band: Band
) -> tuple[np.ndarray, float, list[Smoothed]]:
    """A joint's q, v and a (3, n) without smoothing, what its ends lose [s], and what was done."""
    found, t = np.zeros((3, len(signals.t))), signals.t
    has = [channel.order for channel in channels]
    ends = 0.0
    for run in runs(signals.usable):
        inside = [channel.within(t[run]) for channel in channels]
        if has == [0, 1, 2]:
            found[:, run] = [filled(channel.t, channel.x, t[run]) for channel in inside]
        elif all(channel.spread == 0 for channel in channels):
            for channel in channels:
                found[channel.order, run] = channel.x[0]
        elif has == [0]:
            found[:, run] = interpolate(inside[0].t, inside[0].x, t[run])
        else:
            h = finest(Band(0.0, 0.0, None), inside)
            basis = basis_over(t[run][0], t[run][-1], h)
            found[:, run] = fitted(basis, inside, (channels[0].joint,)).at(t[run])[:, :, 0]
            ends = 0.0 if 2 in has else ENDS * h
    missing = " and ".join("qva"[k] for k in range(3) if k not in has)
    had = " and ".join("qva"[k] for k in has)
    how = f"{missing} by quintic interpolation of {had}" if missing else AS_LOGGED
    return found, ends, [Smoothed(c.column, how, c.sigma, 0.0) for c in channels]


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


def finer(mechanism: Mechanism, e: State, times: int) -> Smooth:
    """The splines of an experiment with so many knots for one, of which its own motion is one.

    Fewer where samples are too far apart for that.
    """
    assert e.smooth is not None
    t = [e.t[run] for run, _ in e.smooth.runs]
    times = max(1, min(times, int(e.smooth.spacing * e.rate / SAMPLES)))
    if len(e.logged) == mechanism.degrees_of_freedom:
        return e.smooth.finer(t, times)
    through = replace(e.smooth, channels=tuple(through_motion(mechanism, e, e.smooth.names)))
    return fused(mechanism, along(mechanism, e, through.finer(t, times)), e.smooth.channels)


def through_motion(mechanism: Mechanism, e: State, names: tuple[str, ...]) -> list[Channel]:
    """The motion of some joints itself, as channels."""
    found = []
    for name in names:
        at = mechanism.joint_index[name]
        for order, y in enumerate((e.y, e.yd, e.ydd)):
            spread = float(np.std(y[:, at])) or 1.0
            found.append(Channel(name, order, e.t, y[:, at], spread, spread))
    return found


def fused(mechanism: Mechanism, e: State, channels: Sequence[Channel]) -> Smooth:
    """The splines of an experiment's independent joints, fitted to channels of all joints.

    Args:
        mechanism: with closures.
        e: on the splines from which the steps set out.
        channels: of any joints.
    """
    assert e.smooth is not None
    names = e.smooth.names
    for _ in range(STEPS):
        e = e.transmitted(mechanism, names)
        smooth = e.smooth
        assert smooth is not None
        L = e.leverage
        assert L is not None
        rates = [L, np.zeros_like(L), np.zeros_like(L)]
        found, step = [], 0.0
        for run, before in smooth.runs:
            for order in (1, 2):
                rates[order][run] = np.gradient(rates[order - 1][run], e.t[run], axis=0)
            rows = [
                _rows(
                    before, channel.within(e.t[run]), e, rates, mechanism.joint_index[channel.joint]
                )
                for channel in channels
            ]
            spline = solved(before.basis, rows, len(names))
            found.append((run, spline))
            now = spline.at(e.t[run])[0]
            moved = np.abs(now - before.at(e.t[run])[0]).max(axis=0)
            step = max(step, float((moved / (now.std(axis=0) + 1e-12)).max()))
        e = along(mechanism, e, replace(smooth, runs=tuple(found), channels=tuple(channels)))
        if step < SETTLED:
            break
    assert e.smooth is not None
    return e.smooth


def missed(mechanism: Mechanism, e: State, channels: Sequence[Channel]) -> list[np.ndarray]:
    """Measured minus smoothed (n_k,) of each channel in all runs of an experiment."""
    assert e.smooth is not None
    found = []
    for channel in channels:
        series = (e.y, e.yd, e.ydd)[channel.order][:, mechanism.joint_index[channel.joint]]
        parts = []
        for run, _ in e.smooth.runs:
            inside = channel.within(e.t[run])
            parts.append(inside.x - np.interp(inside.t, e.t[run], series[run]))
        found.append(np.concatenate(parts))
    return found


def reweighted(mechanism: Mechanism, e: State, channels: Sequence[Channel]) -> list[Channel]:
    """The channels with the noise that residuals show, where that is more than they had."""
    found = []
    for channel, off in zip(channels, missed(mechanism, e, channels), strict=True):
        rms = float(np.sqrt(np.mean(off**2)))
        found.append(channel.with_noise(rms) if rms > INCONSISTENT * channel.sigma else channel)
    return found


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
        own = rates[k - r][:, joint]
        L = (1 - share) * own[at - 1] + share * own[at]
        R += comb(k, r) * B[:, :, None] * L[:, None, :]
    series = (e.y, e.yd, e.ydd)[k][:, joint]
    now = np.interp(t, e.t, series)
    linear = np.einsum("nrd,nrd->n", R, spline.c[first[:, None] + np.arange(WIDTH)])
    return Observations(first, R / channel.sigma, (channel.x - now + linear) / channel.sigma)
