"""q, v and a of the joints that determine the motion, from whatever was logged of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ident.motion.channels import Channel, Smoothed, channels_of
from ident.motion.clock import runs
from ident.motion.decided import Decided
from ident.motion.measure import Signals
from ident.motion.motion import Band
from ident.motion.resolution import finest, resolution
from ident.motion.smooth import Smooth, filled, fitted, interpolate, residuals, weighted
from ident.motion.spline import basis_over

ENDS = 2.0  # knots at either end of a run between which a spline is not to be trusted
MOST = 0.08  # share of the shortest run that an end may lose
WHOLE = 1e-4  # share of noise up to which q, v and a are taken as logged, where all three are
ALONE = 1e-6  # the same for positions alone, which are differentiated
AUTO = "auto"
AS_LOGGED = "as logged"


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
    signals: Signals,
    names: Sequence[str],
    band: Band,
    spacing: float | str | None = AUTO,
    decided: Decided | None = None,
) -> Derived:
    """Coordinates, rates and accelerations of logged joints.

    Clean channels, as simulations have them, are taken as they are; what is missing beside them is
    interpolated. The others are smoothed. Every run between gaps has splines of its own; inside
    gaps a coordinate goes straight from one side to the other, for the closures to be followed.

    Args:
        signals: the log; names: the joints.
        band: what the spectra say.
        spacing: of the knots [s]; "auto": from the data; None: as logged, nothing is smoothed.
        decided: of a part of a log: what the whole log has decided.
    """
    channels = channels_of(signals, names)
    noisy = [
        name
        for name in names
        if spacing is not None and not _as_logged(channels, name, band, signals.exact)
    ]
    noisy = list(decided.noisy) if decided else noisy
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
        smooth, said = smoothed(signals, mine, tuple(noisy), band, spacing, decided)
        at = [list(names).index(name) for name in noisy]
        for run, spline in smooth.runs:
            known[:, run, at] = spline.at(signals.t[run])
        table |= {each.column: each for each in said}
        accelerations = {channel.joint for channel in mine if channel.order == 2}
        shortest = min(float(t[-1] - t[0]) for t in (signals.t[run] for run, _ in smooth.runs))
        lost = min(ENDS * smooth.spacing, MOST * shortest)
        ends = max(ends, 0.0 if accelerations >= set(noisy) else lost)
    ends = decided.ends if decided else ends
    t, gap = signals.t, ~signals.usable
    for i in range(len(names)):
        known[0, gap, i] = np.interp(t[gap], t[~gap], known[0, ~gap, i])
    return Derived(known, ends, smooth, [table[channel.column] for channel in channels])


def smoothed(
    signals: Signals,
    channels: Sequence[Channel],
    names: tuple[str, ...],
    band: Band,
    spacing: float | str | None,
    decided: Decided | None = None,
) -> tuple[Smooth, list[Smoothed]]:
    """One spline a run through all channels of the joints, and what it left of each."""
    t, found = signals.t, runs(signals.usable)
    h, noise = _weighed(signals, channels, names, band, spacing, decided)
    white = [channel.sigma for channel in channels]
    channels = [channel.with_noise(noise[channel.column]) for channel in channels]
    origin = decided.clock.t0 if decided else None
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
    signals: Signals,
    channels: Sequence[Channel],
    names: tuple[str, ...],
    band: Band,
    spacing: float | str | None,
    decided: Decided | None,
) -> tuple[float, Mapping[str, float]]:
    """The distance of the knots [s], and the noise by which each channel is weighed, by column."""
    if decided:
        own = {channel.column: channel.sigma for channel in channels}
        return decided.knots, own | dict(decided.noise)
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
    signals: Signals, channels: Sequence[Channel], band: Band
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
