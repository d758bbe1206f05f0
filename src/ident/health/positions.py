"""Swapped, mis-signed and scaled position channels, tried only where the fit is poor.

Each trial completes the motion anew, which is cheap in a tree alone; through closures a wrong
position channel does not close, and `complete` says so.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ident.fit import Fit
from ident.health.check import Check
from ident.health.possible import at_samples
from ident.health.torques import column_of, entry
from ident.health.trial import Trial
from ident.motion import Experiment
from ident.motion.place import in_tree

DOUBTFUL = 0.08  # error of the worst joint, above which positions are doubted
CLEAR = 0.3  # of the error may be left; stricter than for torques, for more is tried
DEGREES = 10.0  # smallest range of a channel that may be in degrees
FEW = 700  # samples that tell a right motion from a wrong one
Map = tuple[str, tuple[int, ...], np.ndarray, np.ndarray]  # kind, joints, taken from, times


def moved(fit: Fit, trial: Trial) -> list[Check]:
    """The one change of position channels that explains the log clearly better, if there is one."""
    mechanism, motion = fit.mechanism, fit.motion
    if mechanism.closures or max(trial.now.relative) < DOUBTFUL or not trial.square:
        return []
    thin = [_thinned(e, FEW // len(motion.experiments)) for e in motion.experiments]
    plain = replace(fit, motion=replace(motion, band=replace(motion.band, cutoff=None)))
    before = Trial.of(plain, thin).now
    names = [joint.name for joint in mechanism.joints]
    tried = []
    span = [max(float(np.ptp(e.y[:, j])) for e in thin) for j in range(len(names))]
    for kind, joints, take, times in _maps(len(names)):
        if kind == "scale" and span[joints[0]] < DEGREES:
            continue
        known = [[x[:, take] * times for x in (e.y, e.yd, e.ydd)] for e in thin]
        other = [
            in_tree(mechanism, e, tuple(names), np.array(x))
            for e, x in zip(thin, known, strict=True)
        ]
        tried.append((Trial.of(plain, other).now.score, kind, joints, float(times[joints[0]])))
    score, kind, joints, factor = min(tried)
    if score > CLEAR * before.score:
        return []
    channels = tuple(f"q.{names[j]}" for j in joints)
    fall = (
        f"the error of the predicted torques falls from {100 * before.score:.3g} % to "
        f"{100 * score:.3g} %"
    )
    if kind == "swapped":
        a, b = (column_of(mechanism, c)[0] for c in channels)
        remedy = (
            f'write [log] "{channels[0]}" = {{ column = "{b}" }} and '
            f'"{channels[1]}" = {{ column = "{a}" }}, velocities alike'
        )
        text = (
            f"{channels[0]} and {channels[1]} look exchanged: with one in the other's place {fall}"
        )
    else:
        remedy = f"write {entry(mechanism, channels[0], factor)}, velocity alike"
        what = "the sign is wrong" if factor == -1.0 else "in degrees, not in radians"
        text = f"{what}: corrected, {fall}"
    return [
        Check(f"position {kind}", channels, score / before.score, CLEAR, True, text, remedy,
              "of the error left")
    ]  # fmt: skip


def _maps(count: int) -> Iterator[Map]:
    every, ones = np.arange(count), np.ones(count)
    for j in range(count):
        for kind, factor in (("sign", -1.0), ("scale", np.pi / 180)):
            times = ones.copy()
            times[j] = factor
            yield kind, (j,), every, times
        for i in range(j):
            take = every.copy()
            take[i], take[j] = j, i
            yield "swapped", (i, j), take, ones


def _thinned(e: Experiment, most: int) -> Experiment:
    index = np.flatnonzero(e.usable)
    return at_samples(e, index[:: max(1, len(index) // most)])
