"""Results of `excite`: a motion, its use of the limits, and what a log of it would determine."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ident.display import Plotted
from ident.log import Log


@dataclass(frozen=True)
class LimitUse:
    """The share of one limit that a motion uses.

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
class ExpectedValue:
    """A base parameter with its prior and its expected standard error.

    The standard error is for torques with white noise of `Excitation.noise`, a value a sample.
    """

    name: str
    prior: float
    stderr: float
    unit: str


@dataclass(frozen=True)
class Separation:
    """How well a motion distinguishes two effects.

    Attributes:
        first, second: their labels.
        cosine: the largest between what both predict, all else projected out; 1: no difference.
        share: of each one's torque, the part that nothing else explains, the other included.
        stderr: of each one's first unknown when everything is refitted; units: theirs.
    """

    first: str
    second: str
    cosine: float
    share: tuple[float, float]
    stderr: tuple[float, float]
    units: tuple[str, str]

    def __str__(self) -> str:
        (a, b), (ea, eb), (ua, ub) = self.share, self.stderr, self.units
        return (
            f"{self.first} and {self.second}: cosine {self.cosine:.4g} beside all else; of their "
            f"torque {100 * a:.3g} % and {100 * b:.3g} % is explained by nothing else; expected "
            f"standard errors {ea:.2g} {ua} and {eb:.2g} {ub}"
        )


@dataclass(frozen=True, eq=False, repr=False)
class Excitation(Plotted):
    """A periodic motion of the drives. Made by `ident.excite`.

    Attributes:
        name: of the mechanism.
        log: t, and q, v, a and the predicted tau of every drive; friction of unknown size is not in
            the torques.
        period: [s]; periods: their number; harmonics: of the series.
        series: by joint (2 H + 1,): c, a_1 … a_H, b_1 … b_H of
            y(t) = c + Σ a_k sin(kωt) + b_k cos(kωt), ω = 2π/period.
        uses: of all limits; home: multiple of ‖K⁺‖ at home that is reached (0 in a tree).
        unknowns: their number; base: the combinations that are identified.
        condition_number: of the rows divided by the noise, columns of unit norm.
        log_det: of the information of the base parameters in SI units, of the whole log.
        noise: expected of the torques, by drive [N m | N].
        separation: of two effects, if that was requested.
        seed: of the random motions from which the search started; notes: assumptions.
    """

    name: str
    log: Log
    period: float
    periods: int
    harmonics: int
    series: Mapping[str, np.ndarray]
    uses: tuple[LimitUse, ...]
    home: float
    unknowns: int
    base: tuple[ExpectedValue, ...]
    condition_number: float
    log_det: float
    noise: Mapping[str, float]
    separation: Separation | None
    seed: int
    notes: tuple[str, ...] = ()

    def use(self, joint: str, kind: str) -> LimitUse:
        """Return the use of one limit: of `joint`, its `kind` (position, speed, …)."""
        return next(each for each in self.uses if (each.joint, each.kind) == (joint, kind))

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the log to `path`, a .csv, .parquet or .npz, whole or not at all."""
        self.log.write(path)
