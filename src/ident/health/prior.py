"""Torques of another magnitude than the URDF's bodies need: a hint, for a URDF may be wrong."""

from __future__ import annotations

import numpy as np

from ident.fit import Fit
from ident.health.bounded import least
from ident.health.check import Check
from ident.health.evidence import USUAL
from ident.health.remainder import shares
from ident.health.trial import Trial

TIMES = 8.0  # masses in a URDF are rarely five times off, units and gear ratios are
CANCEL = 0.2  # of the URDF's terms: a smaller torque is a remainder, and tells no factor
LEFT = 0.2  # of the torque, that is neither friction, spring nor rotor inertia
LIKE = 0.9  # correlation from which the URDF's prediction is like the torque at all


def magnitudes(fit: Fit, trial: Trial) -> list[Check]:
    """The gain of each torque against the URDF's prediction, with the usual effects left free."""
    found = []
    remainder = shares(fit, fit.columns.prior)
    k, J = len(fit.columns), len(trial.driven)
    for T, own in zip(trial.triangles, trial.own, strict=True):
        if own < 0:
            continue
        predicted = T[:, :k] @ fit.columns.prior - T[:, trial.width]
        torque = T[:, trial.width :] @ trial.as_logged - T[:, trial.width]
        usual = T[:, k : k + USUAL * J]  # friction, offset, spring, rotor inertia
        y, p = (x - usual @ least(usual, x) for x in (torque, predicted))
        sizes = float(np.linalg.norm(y)), float(np.linalg.norm(p))
        if not all(sizes) or sizes[0] < LEFT * np.linalg.norm(torque):
            continue
        like, gain = float(y @ p) / sizes[0] / sizes[1], sizes[0] / sizes[1]
        part = remainder.get(trial.driven[own], 0.0)
        told = part / gain > CANCEL  # the URDF's own torque among its terms
        bad = like > LIKE and told and max(gain, 1 / gain) > TIMES
        if bad:
            name = trial.driven[own]
            text = (
                f"{gain:.3g} times what the URDF's bodies need, and of the same shape: a unit, a "
                "gear ratio or a torque constant, unless the URDF's masses are no real ones"
            )
            found.append(
                Check("magnitude", (f"tau.{name}",), gain, TIMES, True, text,
                      f'[log] "tau.{name}" = {{ column = …, scale = {1 / gain:.2g} }}',
                      "times the URDF's")
            )  # fmt: skip
    return found
