"""Where the motion itself is noisy: torques and motion weighed together (`ident.likelihood`).

Least squares takes the smooth motion as it is. Its noise is in all columns alike, so parameters are
shrunk (bias), and instants at which accelerations matter most get too much weight (scatter).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ident.fit.banded import cells_of
from ident.fit.estimate import Estimate, estimate, totals
from ident.fit.regression import Regression
from ident.likelihood.noise import motion_noise, torque_noise
from ident.likelihood.step import Linear, Run, linear, rows_cutoff
from ident.motion import Experiment, Motion
from ident.motion.fuse import along, finer
from ident.motion.smooth import Smooth
from ident.progress import Told

MATTERS = 0.05  # share of a coordinate's squared residual that is the motion's noise
FINER = 2  # knots of the likelihood for one of smoothing: torques tell more of the motion
AGREED = 1.2  # squared residual over squared noise at which noise explains the residual
EXPLAINED = 1.5  # the same, from noise that was estimated channel by channel
TRIALS = 6  # of the torques' noise
STEPS = 12
HALVES = 5  # of a step that does not lower the loss
ROUNDING = 1e-6
SETTLED = 0.05  # of a standard error: a smaller step is the last


@dataclass(frozen=True, eq=False)
class Likelihood:
    """How torques and motion were weighed together.

    Attributes:
        share: (d,) of each coordinate's squared residual in least squares, what noise of the motion
            can make.
        sigma: (d,) noise of the torque rows [N m | N].
        steps: Gauss-Newton steps that were made; settled: whether the last one changed nothing.
        made: how the motion follows that torques and measured channels agree on best.
    """

    share: np.ndarray
    sigma: np.ndarray
    steps: int
    settled: bool
    made: Callable[[], Motion]

    @cached_property
    def motion(self) -> Motion:
        """The motion on which torques and measured channels agree best."""
        return self.made()

    def described(self) -> dict[str, Any]:
        """For fit.json."""
        return {
            "share": [float(x) for x in self.share],
            "torque_noise": [float(x) for x in self.sigma],
            "steps": self.steps,
            "settled": self.settled,
        }

    def __str__(self) -> str:
        share = 100 * min(float(self.share.max(initial=0.0)), 1.0)
        done = f"{self.steps} step" + ("s" if self.steps > 1 else "")
        if self.steps > 1:
            done += ", converged" if self.settled else ", not converged"
        return (
            f"noise of the motion makes up to {share:.3g} % of the residual: torques and motion "
            f"were weighed together (maximum likelihood, {done})"
        )


def can_move(motion: Motion) -> bool:
    """Whether all experiments' motions are splines; those of clean logs are as logged."""
    return all(e.smooth is not None for e in motion.experiments)


def share_of_motion(r: Regression, found: Estimate) -> np.ndarray:
    """(d,) the part of each coordinate's squared residual that noise of the motion can make."""
    if not can_move(r.motion):
        return np.zeros(r.d)
    point = r.point.at(r.mechanism, r.columns, found.solution.x)
    cutoff = r.motion.band.cutoff
    made = [motion_noise(r.mechanism, e, point, cutoff) for e in r.motion.experiments]
    squares = r.squares(found.solution.x)
    left = squares.error / np.maximum(squares.rows, 1)
    return np.asarray(np.mean(made, axis=0) / np.where(left > 0, left, np.inf))


Weighed = tuple[Regression, Estimate, Likelihood]


def one_step(
    r: Regression, found: Estimate, share: np.ndarray, progress: Told | None = None
) -> Weighed | None:
    """One step of the likelihood, with the noise that the channels show; None where that noise
    does not explain the residual.

    Then the model lacks something, and a motion bent until torques fit would hide it.

    Args and returns are those of `refined`.
    """
    fine = tuple(finer(r.mechanism, e, FINER) for e in r.motion.experiments)
    here = _Place.at(r, found.solution.x, r.motion.experiments, fine, progress)
    sigma = here.noise()[0]
    runs, now, agreed = _whitened(here, found, sigma)
    if agreed > EXPLAINED:
        return None
    return here.finished(runs, now, share, sigma, 1, False)


def refined(
    r: Regression, found: Estimate, share: np.ndarray, progress: Told | None = None
) -> Weighed:
    """Gauss-Newton steps of the likelihood from a least-squares estimate, until parameters rest.

    Args:
        r: the regression; its motion is where the steps set out.
        found: least squares; what it holds at the prior and how it regroups is kept.
        share: of the motion's noise.
        progress: called with (what is being done, share done).

    Returns:
        The regression with rows whitened by the noise of torques and motion, the estimate from
        them, and what was done.
    """
    fine = tuple(finer(r.mechanism, e, FINER) for e in r.motion.experiments)
    here = _Place.at(r, found.solution.x, r.motion.experiments, fine, progress)
    sigma, runs, now = _weighed(here, found)
    step, settled = 1, False
    while step < STEPS and not settled:
        there = here.towards(runs, now.solution.x, fine, progress)
        for _ in range(HALVES):
            if there.loss(sigma) <= (1 + ROUNDING) * here.loss(sigma):
                break
            there = here.halfway(there, fine, progress)
        else:
            break  # no step lowers the loss: friction that jumps, or rounding
        if step == 1:  # the first motion was not yet one that the torques agree with
            sigma, runs, now = _weighed(there, found)
        else:
            runs, now, _ = _whitened(there, found, sigma)
        settled, step, here = _rests(now, there.x), step + 1, there
    return here.finished(runs, now, share, sigma, step, settled)


@dataclass(frozen=True, eq=False)
class _Place:
    """Parameters x and motions, and the likelihood linear about them."""

    regression: Regression
    x: np.ndarray
    experiments: tuple[Experiment, ...]
    parts: tuple[Linear, ...]

    @classmethod
    def at(
        cls,
        r: Regression,
        x: np.ndarray,
        experiments: tuple[Experiment, ...],
        fine: Sequence[Smooth],
        progress: Told | None,
        like: Sequence[Linear] | None = None,
    ) -> _Place:
        """Rows and gains at parameters and motions; rows inform or not as those of `like`."""
        point = r.point.at(r.mechanism, r.columns, x)
        parts: list[Linear] = []
        for number, (e, smooth) in enumerate(zip(experiments, fine, strict=True)):
            if progress:
                progress("weighing torques and motion together", number / len(fine))
            before = like[number] if like else None
            parts.append(linear(r.mechanism, r.columns, e, smooth, point, before))
        return cls(replace(r, point=point), x, experiments, tuple(parts))

    def noise(self) -> tuple[np.ndarray, np.ndarray]:
        """(d,), (d,) [N m | N] of the torques' rows: white noise of the sensors, which is the least
        that they can have, and what is left at x, which is the most.
        """
        left = [part.left(self.x) for part in self.parts]
        squares, counts = (sum(each[i] for each in left) for i in (0, 1))
        largest = np.sqrt(np.maximum(squares, 1e-300) / np.maximum(counts, 1))
        made = [
            torque_noise(self.regression.mechanism, e, rows_cutoff(part.fine, e.rate)) ** 2
            for e, part in zip(self.experiments, self.parts, strict=True)
        ]
        least = np.sqrt(np.mean(made, axis=0))
        return np.clip(least, 1e-3 * largest, largest), largest

    def loss(self, sigma: np.ndarray) -> float:
        """Of all experiments."""
        return sum(part.loss(self.x, sigma) for part in self.parts)

    def moved(self, runs: Sequence[Sequence[Run]], x: np.ndarray) -> tuple[Experiment, ...]:
        """The experiments on the motions that go with parameters x."""
        return tuple(
            along(self.regression.mechanism, e, part.moved(mine, x))
            for e, part, mine in zip(self.experiments, self.parts, runs, strict=True)
        )

    def towards(
        self,
        runs: Sequence[Sequence[Run]],
        x: np.ndarray,
        fine: Sequence[Smooth],
        progress: Told | None,
    ) -> _Place:
        """The place of a full step."""
        return _Place.at(self.regression, x, self.moved(runs, x), fine, progress, self.parts)

    def finished(
        self,
        runs: Sequence[Sequence[Run]],
        now: Estimate,
        share: np.ndarray,
        sigma: np.ndarray,
        steps: int,
        settled: bool,
    ) -> Weighed:
        """What a step from here gives."""
        r = replace(self.regression, runs=tuple(run for mine in runs for run in mine))

        def made() -> Motion:
            return replace(r.motion, experiments=self.moved(runs, now.solution.x))

        return r, now, Likelihood(share, sigma, steps, settled, made)

    def halfway(self, other: _Place, fine: Sequence[Smooth], progress: Told | None) -> _Place:
        """The place between this one and another."""
        r = self.regression
        experiments = tuple(
            along(r.mechanism, e, mine.between(theirs))
            for e, mine, theirs in zip(self.experiments, self.parts, other.parts, strict=True)
        )
        x = 0.5 * (self.x + other.x)
        return _Place.at(r, x, experiments, fine, progress, self.parts)


def _rests(now: Estimate, before: np.ndarray) -> bool:
    """Whether no base parameter moved by more than a fraction of its standard error."""
    base = now.base
    beta = before[base.independent] + base.K @ before[base.dependent]
    moved = np.abs(now.solution.beta - beta)
    return bool((moved <= SETTLED * np.sqrt(np.diag(now.solution.C))).all())


def _weighed(here: _Place, found: Estimate) -> tuple[np.ndarray, list[list[Run]], Estimate]:
    """The torques' noise at which residuals are as large as noise, and the estimate with it.

    σ = least^(1−θ) largest^θ with the smallest θ in [0, 1] at which |residual|² ≤ AGREED · rows:
    that of the sensors if it explains the residual, else as much more as the model's errors ask.
    """
    least, largest = here.noise()
    best: tuple[np.ndarray, list[list[Run]], Estimate] | None = None
    low, high, theta = 0.0, 1.0, 0.0
    for _ in range(TRIALS):
        sigma = least ** (1 - theta) * largest**theta
        runs, now, agreed = _whitened(here, found, sigma)
        if best is None or agreed <= AGREED:
            best = sigma, runs, now
        if (theta == 0.0 and agreed <= AGREED) or 1 / AGREED < agreed <= AGREED:
            break
        low, high = (low, theta) if agreed <= AGREED else (theta, high)
        theta = 0.5 * (low + high)
    assert best is not None
    return best


def _whitened(
    here: _Place, found: Estimate, sigma: np.ndarray
) -> tuple[list[list[Run]], Estimate, float]:
    """Runs by experiment, the estimate from them, and squared residual over rows."""
    r = here.regression
    runs = [part.eliminated(i, sigma) for i, part in enumerate(here.parts)]
    cells = cells_of([run for mine in runs for run in mine], r.columns, r.motion)
    one = np.ones(1)
    now = estimate(totals(cells, len(r.columns), 1), r.prior, one, sigma=one, held=found.held)
    rows = max(now.factor.rows - now.base.rank, 1)
    return runs, now, now.factor.residual_norm(now.solution.x) ** 2 / rows
