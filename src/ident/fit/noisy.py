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

from ident.fit.estimate import Estimate
from ident.fit.regression import Regression
from ident.fit.vicinity import Vicinity
from ident.likelihood.noise import motion_noise
from ident.likelihood.step import Run
from ident.motion import Motion
from ident.motion.fuse import finer
from ident.progress import Progress

MATTERS = 0.05  # share of a coordinate's squared residual that is the motion's noise
FINER = 3  # knots of the likelihood for one of smoothing: torques tell more of the motion
EXPLAINED = 1.5  # squared residual over squared noise at which noise explains the residual
STEPS = 12
RAISED = 1.05  # times the sensors' noise from which noise does not explain the residual
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
        raised: sigma over the noise of the torque sensors: 1 where noise explains the residual.
        made: how the motion follows that torques and measured channels agree on best.
    """

    share: np.ndarray
    sigma: np.ndarray
    steps: int
    settled: bool
    raised: float
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
            "raised": self.raised,
        }

    @property
    def notes(self) -> list[str]:
        """What to know before trusting it."""
        found = []
        if self.raised > RAISED:
            found.append(
                f"the torques' noise had to be taken {self.raised:.3g} times as large as the "
                "sensors' to explain the residual: the model lacks something that the motion was "
                "bent to hide, and standard errors do not know of it (ident diagnose)"
            )
        if self.steps > 1 and not self.settled:
            found.append(
                f"the refined fit stopped after {self.steps} steps before it converged: the last "
                "one moved some parameter by more than a twentieth of its standard error, and "
                f"{'no step lowers the loss' if self.steps < STEPS else 'more are not made'}"
            )
        return found

    def covariance(self, cov: np.ndarray, now: Estimate) -> np.ndarray:
        """That of the base parameters (n_ind, n_ind), from the blocks' `cov`.

        Rows are whitened by noise that explains them, so (RᵀR)⁻¹ is a second witness, which does
        not hang on the few blocks of time that hold most of the information: the mean of both.
        """
        if self.raised > RAISED:
            return cov
        rows = max(now.factor.rows - now.base.rank, 1)
        size = max(1.0, now.factor.residual_norm(now.solution.x) ** 2 / rows)
        return 0.5 * (cov + size * now.solution.C)

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
    r: Regression, found: Estimate, share: np.ndarray, progress: Progress | None = None
) -> Weighed | None:
    """One step of the likelihood, with the noise that the channels show; None where that noise
    does not explain the residual.

    Then the model lacks something, and a motion bent until torques fit would hide it.

    Args and returns are those of `refined`.
    """
    fine = tuple(finer(r.mechanism, e, FINER) for e in r.motion.experiments)
    here = Vicinity.at(r, found.solution.x, r.motion.experiments, fine, progress)
    sigma = here.noise()[0]
    runs, now, agreed = here.whitened(found, sigma)
    if agreed > EXPLAINED:
        return None
    return _finished(here, runs, now, share, sigma, 1, False)


def refined(
    r: Regression, found: Estimate, share: np.ndarray, progress: Progress | None = None
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
    here = Vicinity.at(r, found.solution.x, r.motion.experiments, fine, progress)
    sigma, runs, now = here.weighed(found)
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
            sigma, runs, now = there.weighed(found)
        else:
            runs, now, _ = there.whitened(found, sigma)
        settled, step, here = _rests(now, there.x), step + 1, there
    return _finished(here, runs, now, share, sigma, step, settled)


def _finished(
    here: Vicinity,
    runs: Sequence[Sequence[Run]],
    now: Estimate,
    share: np.ndarray,
    sigma: np.ndarray,
    steps: int,
    settled: bool,
) -> Weighed:
    """What a step from here gives."""
    r = replace(here.regression, runs=tuple(run for mine in runs for run in mine))

    raised = float((sigma / here.noise()[0]).max())

    def made() -> Motion:
        return replace(r.motion, experiments=here.moved(runs, now.solution.x))

    return r, now, Likelihood(share, sigma, steps, settled, raised, made)


def _rests(now: Estimate, before: np.ndarray) -> bool:
    """Whether no base parameter moved by more than a fraction of its standard error."""
    base = now.base
    beta = before[base.independent] + base.K @ before[base.dependent]
    moved = np.abs(now.solution.beta - beta)
    return bool((moved <= SETTLED * np.sqrt(np.diag(now.solution.C))).all())
