"""Saturation: a torque that stays at its extreme while the model asks for more."""

from __future__ import annotations

import numpy as np

from ident.fit import Fit
from ident.health.channels import Channel, Channels
from ident.health.check import Check
from ident.motion.clock import runs

LONG = 3  # consecutive samples at the very extreme
TWICE = 2  # such runs: a single one may be a peak
SHARE = 0.005  # of all samples in such runs
BEYOND = 1.01  # times the extreme that the model asks for, in the middle of the runs


def clipped(fit: Fit, data: Channels) -> list[Check]:
    """Torque channels at their limit."""
    wanted: dict[tuple[str, str], tuple[np.ndarray, np.ndarray]] = {}
    found = []
    for channel in data.of("tau"):
        found += [
            (channel, side, at)
            for side in (1.0, -1.0)
            if (at := _at_extreme(side * channel.x)).any()
        ]
    if not found:
        return []
    for p in fit.predict():
        for u, joint in enumerate(p.joints):
            wanted[p.name, f"tau.{joint}"] = p.t, p.predicted[:, u]
    shares: dict[tuple[str, str], float] = {}
    for channel, side, at in found:
        key = channel.log, channel.name
        if key in wanted:
            asked = side * np.interp(channel.t[at], *wanted[key])
            limit = float((side * channel.x).max())
            if limit > 0 and np.median(asked) < BEYOND * limit:
                continue
        elif side * float(channel.x[at][0]) <= 0:
            continue
        shares[key] = shares.get(key, 0.0) + float(at.mean())
    return [_said(channel, shares.pop((channel.log, channel.name)))
            for channel in data.of("tau") if (channel.log, channel.name) in shares]  # fmt: skip


def _at_extreme(x: np.ndarray) -> np.ndarray:
    """(n,) true in runs of LONG and more samples at the maximum of x, if there are enough."""
    top = x == x.max()
    at = np.zeros(len(x), dtype=bool)
    if top.all():
        return at
    long = [run for run in runs(top) if run.stop - run.start >= LONG]
    for run in long:
        at[run] = True
    enough = len(long) >= TWICE or at.mean() > SHARE
    return at if enough else np.zeros(len(x), dtype=bool)


def _said(channel: Channel, share: float) -> Check:
    limit = float(np.abs(channel.x).max())
    return Check(
        "saturation", (channel.name,), share, SHARE, share > SHARE,
        f"{channel.log}: {100 * share:.2g} % of the samples stay at the extreme ({limit:.4g}) "
        "while the model asks for more: flat tops in the plot",
        "leave these stretches out, or move within the drive's or the sensor's range",
        "of the samples",
    )  # fmt: skip
