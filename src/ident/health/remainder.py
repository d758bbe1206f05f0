"""Torques that are the small remainder of large terms that cancel: a joint that swings freely."""

from __future__ import annotations

import numpy as np

from ident.fit import Fit
from ident.fit.estimate import sizes, totals
from ident.health.check import Check

FREE = 0.1  # of the terms: 5 % of error in one of them is then half the torque or more


def shares(fit: Fit, x: np.ndarray) -> dict[str, float]:
    """By independent joint: rms torque over the root sum of squares of all terms at x (k,)."""
    d = len(fit.motion.independent)
    terms = sizes(totals(fit.cells, len(fit.columns), d), x)
    found = {}
    for (joint, error), size in zip(fit.train.items(), terms, strict=True):
        if error.relative and size > 0:
            found[joint] = error.rms / error.relative / float(size)
    return found


def free(fit: Fit) -> list[Check]:
    """Driven joints that swing freely, so that their relative error says little."""
    found = []
    for joint, share in shares(fit, fit.estimate.solution.x).items():
        if share >= FREE or joint not in fit.mechanism.driven:
            continue
        text = (
            f"{100 * share:.2g} % of the inertia, gravity and coupling terms that cancel in it: "
            "the motor does next to nothing, and a relative error of this joint says little"
        )
        remedy = (
            f"put '{joint}' among the passive joints for this log, its friction kept as an effect, "
            "or judge it by its rms error"
        )
        found.append(
            Check(
                "swings freely", (f"tau.{joint}",), share, FREE, True, text, remedy, "of its terms"
            )
        )
    return found
