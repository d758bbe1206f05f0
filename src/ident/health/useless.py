"""Predictions that are no better than zero torque."""

from __future__ import annotations

from ident.fit import Fit
from ident.health.check import Check
from ident.health.trial import Trial

USELESS = 1.0  # relative error of zero torque itself
EXPLAINED = (
    0.7  # error with plain friction, offset, spring and rotor, below which data are not at fault
)


def useless(fit: Fit, trial: Trial) -> list[Check]:
    """Joints whose torque neither the model nor plain effects at each joint explain."""
    found = []
    for u, (joint, error) in enumerate(fit.train.items()):
        if error.relative is None:
            continue
        plain = float(trial.now.relative[u])
        bad = error.relative >= USELESS and plain >= EXPLAINED
        text = f"relative error {100 * error.relative:.3g} %" + (
            f", and {100 * plain:.3g} % with friction, offset, spring and rotor inertia at every "
            "joint: the prediction is no better than zero torque"
            if bad
            else ""
        )
        remedy = (
            "check sign, unit and column of its torque and position, and that the torque is a "
            "measurement"
        )
        channels = (f"tau.{joint}", f"q.{joint}")
        found.append(Check("error", channels, error.relative, USELESS, bad, text, remedy, "of rms"))
    return found
