"""The noun: a motion to be run, what it uses of the limits and what a log of it would tell."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ident.excite.criterion import Separation
from ident.excite.plots import plot_excitation
from ident.excite.words import said
from ident.log import Log
from ident.show.charts import Chart
from ident.show.html import Shown


@dataclass(frozen=True)
class Use:
    """What a motion makes of one limit.

    Attributes:
        joint: empty for `singularity`; kind: position, speed, acceleration, torque or singularity.
        low, high: the extremes reached; lower, upper: the limits, of torque less the reserve.
        unit: of these four; of a singularity ‖K⁺‖.
        share: of the range that is covered, or of the limit that is reached; 0 where there is none.
    """

    joint: str
    kind: str
    low: float
    high: float
    lower: float
    upper: float
    unit: str
    share: float


@dataclass(frozen=True)
class Expected:
    """A base parameter with its prior and the standard error that is to be expected.

    The standard error is for torques with white noise of `Excitation.noise`, a value a sample.
    """

    name: str
    prior: float
    stderr: float
    unit: str


@dataclass(frozen=True, eq=False)
class Excitation(Shown):
    """A periodic motion of the drives.

    Attributes:
        name: of the mechanism.
        log: t, and q, v, a and the predicted tau of every drive; friction of unknown size is not in
            the torques.
        period: [s]; periods: how many; harmonics: of the series.
        series: by joint (2 H + 1,): c, a_1 … a_H, b_1 … b_H of
            y(t) = c + Σ a_k sin(kωt) + b_k cos(kωt), ω = 2π/period.
        uses: of all limits; home: multiple of ‖K⁺‖ at home that is reached (0 in a tree).
        unknowns: how many; base: the combinations that are identified.
        condition_number: of the rows divided by the noise, columns of unit norm.
        log_det: of the information of the base parameters in SI units, of the whole log.
        noise: expected of the torques, by drive [N m | N].
        separation: of two effects, if that was asked for.
        seed: that it came from; notes: what was assumed.
    """

    name: str
    log: Log
    period: float
    periods: int
    harmonics: int
    series: Mapping[str, np.ndarray]
    uses: tuple[Use, ...]
    home: float
    unknowns: int
    base: tuple[Expected, ...]
    condition_number: float
    log_det: float
    noise: Mapping[str, float]
    separation: Separation | None
    seed: int
    notes: tuple[str, ...] = ()

    def use(self, joint: str, kind: str) -> Use:
        """What the motion makes of one limit: of `joint`, its `kind` (range, speed …)."""
        return next(each for each in self.uses if (each.joint, each.kind) == (joint, kind))

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the log to `path`, a .csv, .parquet or .npz, whole or not at all."""
        self.log.write(path)

    def plot(self) -> Chart:
        """Position, speed, acceleration and torque of every drive in one period, with limits."""
        return plot_excitation(self)

    def __str__(self) -> str:
        return said(self)

    __repr__ = __str__
