"""Errors that a repeated motion repeats, so that its periods are not independent.

What the model lacks and the steps of an encoder are the same in each of K periods: the variance
of a parameter is then 1 + (K − 1) ρ times as large (Kish, Survey Sampling, 1965, 5.4: the design
effect of clusters), ρ the residual's correlation between periods.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ident.fit.findings import Finding
from ident.fit.residual import Residual
from ident.information.blocks import Error
from ident.motion import Motion
from ident.motion.repetition import period_of

ROUNDING = 1e-6  # relative error below which a residual is that of rounding and interpolation


@dataclass(frozen=True)
class RepeatedErrors:
    """Period of the motion [s], correlation `rho` of the residual between periods, its mean over
    joints, and the `largest` one, which is more than `chance`.
    """

    period: float
    rho: float
    largest: float
    chance: float

    def variance(self, seconds: float) -> float:
        """Return by how much variances over so many seconds are larger than of white residuals."""
        return 1 + max(seconds / self.period - 1, 0.0) * self.rho

    def finding(self, seconds: float) -> Finding:
        """Return what a person should know of logs of so many seconds."""
        text = (
            f"the motion is repeated every {self.period:.4g} s and {100 * self.rho:.0f} % of the "
            f"residual with it: {seconds / self.period:.3g} periods are not independent, so "
            f"standard errors are {np.sqrt(self.variance(seconds)):.3g} times as wide"
        )
        return Finding("repeated errors", text, "", (), self.largest, self.chance)


def repeated_errors(
    motion: Motion, errors: Mapping[str, Error], residual: Callable[[], Residual]
) -> RepeatedErrors | None:
    """Return what a motion repeats of a model's relative `errors`; None where that is nothing.

    `residual` makes the residual, which is asked for only where the motion is repeated.
    """
    assert motion.mechanism is not None
    joints = np.array([motion.mechanism.joint_index[name] for name in motion.independent])
    if all((each.relative or 0.0) < ROUNDING for each in errors.values()) or not any(
        period_of(e, joints, motion.band.motion) for e in motion.experiments
    ):
        return None
    again = residual().periods
    if again is None or (largest := max(again.rho.values())) < again.chance:
        return None
    rho = float(np.mean([max(0.0, each) for each in again.rho.values()]))
    return RepeatedErrors(min(again.period.values()), rho, largest, again.chance)


def mean_duration(motion: Motion) -> float:
    """Return the mean duration of a motion's logs [s]; of an excerpt, of whole logs."""
    rate = float(np.mean([e.rate for e in motion.experiments]))
    return motion.samples / rate / len(motion.names)
