"""The likelihood about some parameters and motions, where it is as good as linear."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.fit.banded import cells_of
from ident.fit.estimate import Estimate, estimate, totals
from ident.fit.regression import Regression
from ident.likelihood.noise import torque_noise
from ident.likelihood.step import Linear, Run, linear, rows_cutoff
from ident.motion import Experiment
from ident.motion.fuse import along
from ident.motion.smooth import Smooth
from ident.progress import Progress

AGREED = 1.2  # squared residual over squared noise at which noise explains the residual
TRIALS = 6  # of the torques' noise


@dataclass(frozen=True, eq=False)
class Vicinity:
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
        progress: Progress | None,
        like: Sequence[Linear] | None = None,
    ) -> Vicinity:
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
        least = np.maximum(least, 1e-3 * largest)
        return least, np.maximum(largest, least)  # a motion that has moved leaves less than noise

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
        progress: Progress | None,
    ) -> Vicinity:
        """The place of a full step."""
        return Vicinity.at(self.regression, x, self.moved(runs, x), fine, progress, self.parts)

    def halfway(
        self, other: Vicinity, fine: Sequence[Smooth], progress: Progress | None
    ) -> Vicinity:
        """The place between this one and another."""
        r = self.regression
        experiments = tuple(
            along(r.mechanism, e, mine.between(theirs))
            for e, mine, theirs in zip(self.experiments, self.parts, other.parts, strict=True)
        )
        x = 0.5 * (self.x + other.x)
        return Vicinity.at(r, x, experiments, fine, progress, self.parts)

    def weighed(self, found: Estimate) -> tuple[np.ndarray, list[list[Run]], Estimate]:
        """The torques' noise at which residuals are as large as noise, and the estimate with it.

        σ = least^(1−θ) largest^θ with the smallest θ in [0, 1] at which |residual|² ≤ AGREED rows:
        that of the sensors if it explains the residual, else as much more as model errors ask.
        """
        least, largest = self.noise()
        best: tuple[np.ndarray, list[list[Run]], Estimate] | None = None
        low, high, theta = 0.0, 1.0, 0.0
        for _ in range(TRIALS):
            sigma = least ** (1 - theta) * largest**theta
            runs, now, agreed = self.whitened(found, sigma)
            if best is None or agreed <= AGREED:
                best = sigma, runs, now
            if (theta == 0.0 and agreed <= AGREED) or 1 / AGREED < agreed <= AGREED:
                break
            low, high = (low, theta) if agreed <= AGREED else (theta, high)
            theta = 0.5 * (low + high)
        assert best is not None
        return best

    def whitened(
        self, found: Estimate, sigma: np.ndarray
    ) -> tuple[list[list[Run]], Estimate, float]:
        """Runs by experiment, the estimate from them, and squared residual over rows."""
        r = self.regression
        runs = [part.eliminated(i, sigma) for i, part in enumerate(self.parts)]
        cells = cells_of([run for mine in runs for run in mine], r.motion)
        one = np.ones(1)
        now = estimate(totals(cells, len(r.columns), 1), r.prior, one, sigma=one, held=found.held)
        rows = max(now.factor.rows - now.base.rank, 1)
        return runs, now, now.factor.residual_norm(now.solution.x) ** 2 / rows
