"""The smooth motion of a mechanism: splines in its independent coordinates, fitted to all joints.

    y_j^(k) − measured  =  d^k/dt^k [Σ_i L_ji δu_i]  =  Σ_r (k over r) Σ_i L_ji^(k−r) δu_i^(r)

L = ∂y/∂u is the leverage of the closures: Gauss-Newton steps with it, from the splines of the
independent joints' own channels, make all channels count while the closures hold exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import comb

import numpy as np

from ident.mechanism.mechanism import Mechanism
from ident.motion.channels import Channel
from ident.motion.motion import Experiment
from ident.motion.place import at_coordinates, reduced
from ident.motion.smooth import INCONSISTENT, Smooth
from ident.motion.spline import WIDTH, Rows, Spline, solved

SAMPLES = 1.5  # from one knot to the next, at least
STEPS = 6
SETTLED = 1e-7  # of a joint's motion: a smaller step changes nothing


def along(mechanism: Mechanism, e: Experiment, smooth: Smooth) -> Experiment:
    """The experiment on another smooth motion near its own; inside gaps it stays as it is."""
    surplus = len(e.logged) > mechanism.degrees_of_freedom
    names = smooth.names if surplus else e.logged
    index = [mechanism.joint_index[name] for name in names]
    known = np.stack([y[:, index] for y in (e.y, e.yd, e.ydd)])
    at = [names.index(name) for name in smooth.names]
    for run, spline in smooth.runs:
        known[:, run, at] = spline.at(e.t[run])
    there = replace(at_coordinates(mechanism, e, names, known), smooth=smooth)
    return there if e.pinv is None else reduced(mechanism, there, e.independent)[0]


def finer(mechanism: Mechanism, e: Experiment, times: int) -> Smooth:
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


def through_motion(mechanism: Mechanism, e: Experiment, names: tuple[str, ...]) -> list[Channel]:
    """The motion of some joints itself, as channels."""
    found = []
    for name in names:
        at = mechanism.joint_index[name]
        for order, y in enumerate((e.y, e.yd, e.ydd)):
            spread = float(np.std(y[:, at])) or 1.0
            found.append(Channel(name, order, e.t, y[:, at], spread, spread))
    return found


def fused(mechanism: Mechanism, e: Experiment, channels: Sequence[Channel]) -> Smooth:
    """The splines of an experiment's independent joints, fitted to channels of all joints.

    Args:
        mechanism: with closures.
        e: on the splines from which the steps set out.
        channels: of any joints.
    """
    assert e.smooth is not None
    names = e.smooth.names
    for _ in range(STEPS):
        e = reduced(mechanism, e, names)[0]
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


def missed(mechanism: Mechanism, e: Experiment, channels: Sequence[Channel]) -> list[np.ndarray]:
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


def reweighted(mechanism: Mechanism, e: Experiment, channels: Sequence[Channel]) -> list[Channel]:
    """The channels with the noise that residuals show, where that is more than they had."""
    found = []
    for channel, off in zip(channels, missed(mechanism, e, channels), strict=True):
        rms = float(np.sqrt(np.mean(off**2)))
        found.append(channel.with_noise(rms) if rms > INCONSISTENT * channel.sigma else channel)
    return found


def _rows(
    spline: Spline, channel: Channel, e: Experiment, rates: list[np.ndarray], joint: int
) -> Rows:
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
    return Rows(first, R / channel.sigma, (channel.x - now + linear) / channel.sigma)
