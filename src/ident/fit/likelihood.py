"""Errors in variables: torques and motion weighed together, where the motion itself is noisy.

Least squares takes the smooth motion as it is. Its noise is in all columns alike, so parameters are
shrunk (bias), and instants at which accelerations matter most get too much weight (scatter). The
likelihood lets the motion move within its noise; about some parameters and motion it is as good as
linear, and a Gauss-Newton step of it is a least-squares problem in the parameters alone
(`ident.equations.motion_noise`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ident.display import Displayed, Progress, no_progress, part
from ident.equations.motion_noise import (
    EliminatedRun,
    LinearRun,
    linear_runs,
    motion_noise,
    rows_cutoff,
    torque_noise,
)
from ident.equations.problem import Problem, stacks_information
from ident.errors import FitError
from ident.finding import Finding
from ident.fit.springs import extents
from ident.information.estimate import Estimate, estimate
from ident.information.evidence import EXCESS, MATTERS
from ident.motion import Motion, State
from ident.motion.smoothing import along, finer
from ident.motion.spline import Smooth

FINER = 3  # work: knots of the likelihood for one of smoothing: torques tell more of the motion
AGREED = 1.2  # numerics: the same, for the noise that a refined fit takes for the torques'
TRIALS = 6  # work: of the torques' noise
STEPS = 12  # work
DESCENT_ROUNDING = 1e-6  # numerics
# numerics: of what is left in rows, the least that they are off by: with a sensor, and of a passive
# joint, whose torque of exactly 0 has no noise, where splines are no exact motion
LEAST, LEAST_PASSIVE = 1e-3, 3e-2
# numerics: of a standard error: a first step of more changes the equations of which it was made
SECOND_ORDER = 1.0
CONVERGED = 0.05  # numerics: of a standard error: a smaller step is the last

Weighed = tuple[Problem, Estimate, "Likelihood"]
Runs = Sequence[EliminatedRun]


@dataclass(frozen=True, eq=False, repr=False)
class Likelihood(Displayed):
    """How torques and motion were weighed together."""

    share: np.ndarray  #: (d,) of each squared residual, what noise of the motion can make
    sigma: np.ndarray  #: (d,) noise of the torque rows [N m | N]
    steps: int  #: Gauss-Newton steps that were made
    settled: bool  #: whether the last one changed nothing
    raised: float  #: sigma over noise of the torque sensors, 1 where that explains the residual
    make_motion: Callable[[], Motion]  #: that torques and measured channels agree on best
    linear: Linearization  #: of which the estimate was made

    @cached_property
    def motion(self) -> Motion:
        """The motion on which torques and measured channels agree best."""
        return self.make_motion()

    def described(self) -> dict[str, Any]:
        """Return the entry of fit.json."""
        return {
            "share": [float(x) for x in self.share],
            "torque_noise": [float(x) for x in self.sigma],
            "steps": self.steps,
            "settled": self.settled,
            "raised": self.raised,
        }

    @property
    def findings(self) -> list[Finding]:
        """Findings to read before the estimate is trusted."""
        findings = []
        if self.raised > EXCESS:
            text = (
                f"the torques' noise had to be taken {self.raised:.3g} times as large as the "
                "sensors' to explain the residual: the model lacks something that the motion was "
                "bent to hide, and standard errors do not know of it (ident diagnose)"
            )
            findings.append(Finding("noise raised", text, number=self.raised, threshold=EXCESS))
        if self.steps > 1 and not self.settled:
            text = (
                f"the refined fit stopped after {self.steps} steps before it converged: the last "
                "one moved some parameter by more than a twentieth of its standard error, and "
                f"{'no step lowers the loss' if self.steps < STEPS else 'more are not made'}"
            )
            findings.append(Finding("not converged", text, number=self.steps))
        return findings

    def covariance(self, cov: np.ndarray, now: Estimate) -> np.ndarray:
        """Return that of the base parameters (n_ind, n_ind): the mean of the blocks' `cov` and, as
        noise explains the rows, (RᵀR)⁻¹, which does not hang on the few blocks that tell most.
        """
        return self.mean_covariance(cov, now.solution.C, self.linear.squares_per_row(now))

    def mean_covariance(self, cov: np.ndarray, white: np.ndarray, squares: float) -> np.ndarray:
        """Return the mean of the blocks' covariance and that of rows with unit noise, (n, n) both,
        of which `squares` per row are left.
        """
        return cov if self.raised > EXCESS else 0.5 * (cov + max(1.0, squares) * white)


def check_refinable(problem: Problem) -> None:
    """Refuse a refined fit where there is no likelihood, with the reason and the remedy."""
    if problem.bands:
        raise FitError(
            'a refined fit needs free multipliers, given: a time basis; write basis = "free" in '
            "[multipliers], or --basis free"
        )
    if not len(problem.columns):
        name = problem.mechanism.name
        raise FitError(f"{name}: nothing is unknown, so there is nothing to refine")
    if clean := ", ".join(e.name for e in problem.motion.experiments if e.smooth is None):
        raise FitError(
            f"{clean}: taken as logged, so there is no noise in the motion to refine the fit by; "
            "leave out --refine, or --smoothing none"
        )


def share_of_motion(problem: Problem, estimate: Estimate) -> np.ndarray:
    """Return the part (d,) of each squared residual that noise of the motion can make."""
    experiments = problem.motion.experiments
    if any(e.smooth is None for e in experiments):  # those of clean logs are as logged
        return np.zeros(problem.information.d)
    point, cutoff = problem.point_at(estimate.x), problem.motion.band.cutoff
    noise = [motion_noise(problem.mechanism, e, point, cutoff) for e in experiments]
    error, _, rows = problem.information.squares(estimate.x).counted
    variance = error / np.maximum(rows, 1)
    return np.asarray(np.mean(noise, axis=0) / np.where(variance > 0, variance, np.inf))


def weighed(
    problem: Problem, estimate: Estimate, estimator: str, on_progress: Progress = no_progress
) -> tuple[Problem, Estimate, Likelihood | None, list[Finding]]:
    """Weigh torques and motion together where that is asked for, or where the noise matters: with
    `likelihood` in steps until nothing changes, with `auto` where noise of the motion matters, in
    one, or where no torque is measured, until nothing changes if that one is long.
    """
    if estimator == "likelihood":
        check_refinable(problem)
        share = share_of_motion(problem, estimate)
        better = refined(problem, estimate, share, on_progress)
        return *better, better[2].findings
    if estimator != "auto" or problem.bands or not len(problem.columns):
        return problem, estimate, None, []
    share = share_of_motion(problem, estimate)
    if (largest := min(float(share.max(initial=0.0)), 1.0)) < MATTERS:
        return problem, estimate, None, []
    # one step with the noise that the channels show; where that leaves more than noise, the model
    # lacks something, and a motion bent until torques fit would hide it
    at = Linearization.at(problem, estimate.x, problem.motion.experiments, on_progress)
    sigma = at.noise()[0]
    runs, now = at.whitened(estimate, sigma)
    if at.squares_per_row(now) <= EXCESS**2:
        # without a sensor of torques nothing but the motion is noisy, and equations are far from
        # linear over a long first step
        if not problem.mechanism.measured and _moved(estimate.x, now) > SECOND_ORDER:
            better = refined(problem, estimate, share, on_progress, sigma)
            return *better, better[2].findings
        likelihood = Likelihood(share, sigma, 1, False, 1.0, at.motion(runs, now.x), at)
        return replace(at.problem, runs=runs), now, likelihood, likelihood.findings
    text = (
        f"noise of the motion makes up to {100 * largest:.3g} % of the "
        "residual, but noise does not explain all of it, so the motion was taken as it is "
        "and parameters may be shrunk; something is missing (ident diagnose), or --refine"
    )
    return problem, estimate, None, [Finding("motion noise", text, "", (), largest, MATTERS)]


def refined(
    problem: Problem,
    estimate: Estimate,
    share: np.ndarray,
    on_progress: Progress = no_progress,
    sigma: np.ndarray | None = None,
) -> Weighed:
    """Make Gauss-Newton steps from a least-squares estimate and the problem's motion, until
    parameters are at rest; what `found` holds at the prior, and how it regroups, stays. The problem
    that is returned has rows whitened by noise of torques and motion: of torques `sigma` (d,), or
    as much as explains the residual.
    """
    progress = part(on_progress, 0.0, 1 / STEPS)
    at = Linearization.at(problem, estimate.x, problem.motion.experiments, progress)
    balances = sigma is None
    if sigma is None:
        sigma, runs, now = at.balanced(estimate)
    else:
        runs, now = at.whitened(estimate, sigma)
    raised = at.raised(sigma)
    step, converged = 1, False
    while step < STEPS and not converged:
        progress = part(on_progress, step / STEPS, (step + 1) / STEPS)
        after = Linearization.at(problem, now.x, at.with_motion(runs, now.x), progress, at)
        if after.loss(sigma) > (1 + DESCENT_ROUNDING) * at.loss(sigma):
            break  # no step lowers the loss: friction that jumps, or rounding
        if step == 1 and balances:  # the first motion was not yet one that the torques agree with
            sigma, runs, now = after.balanced(estimate)
            raised = after.raised(sigma)
        else:
            runs, now = after.whitened(estimate, sigma)
        converged = _moved(after.x, now) <= CONVERGED
        step, at = step + 1, after
    motion = at.motion(runs, now.x)
    likelihood = Likelihood(share, sigma, step, converged, raised, motion, at)
    return replace(at.problem, runs=runs), now, likelihood


def _moved(x: np.ndarray, now: Estimate) -> float:
    """Return the largest step of a base parameter from x (k,), in its standard errors."""
    change = np.abs(now.solution.beta - now.at(x).solution.beta)
    return float((change / np.sqrt(np.diag(now.solution.C))).max(initial=0.0))


@dataclass(frozen=True, eq=False)
class Linearization:
    """Parameters x and motions, and the likelihood linear about them: `fine`, the splines of each
    experiment with what channels say of them, and all runs that have rows.
    """

    problem: Problem
    x: np.ndarray
    experiments: tuple[State, ...]
    fine: tuple[Smooth, ...]
    parts: tuple[LinearRun, ...]

    @classmethod
    def at(
        cls,
        problem: Problem,
        x: np.ndarray,
        experiments: tuple[State, ...],
        on_progress: Progress,
        like: Linearization | None = None,
    ) -> Linearization:
        """Make rows and gains at parameters and motions; rows inform or not as those of `like`."""
        mechanism, point = problem.mechanism, problem.point_at(x)
        before = like.parts if like else ()
        fine = like.fine if like else tuple(finer(mechanism, e, FINER) for e in experiments)
        parts: list[LinearRun] = []
        for number, (e, smooth) in enumerate(zip(experiments, fine, strict=True)):
            on_progress("weighing torques and motion together", number / len(experiments))
            parts += linear_runs(mechanism, problem.columns, (number, e), smooth, point, before)
        return cls(replace(problem, point=point), x, experiments, fine, tuple(parts))

    def squares_per_row(self, now: Estimate) -> float:
        """Return the squared residual of whitened rows over the number of independent ones, less
        the unknowns'.
        """
        counts = np.array([np.count_nonzero(part.rows.informed) for part in self.parts])
        share = counts @ [part.independent for part in self.parts] / max(counts.sum(), 1)
        rows = max(share * now.triangle.rows - now.base.rank, 1.0)
        return float(now.triangle.residual_norm(now.x) ** 2 / rows)

    def again(self, problem: Problem, x: np.ndarray) -> Linearization:
        """Return the same rows of another problem, at parameters x (k,) of it."""
        return Linearization.at(problem, x, self.experiments, no_progress, self)

    def noise(self) -> tuple[np.ndarray, np.ndarray]:
        """Return (d,), (d,) [N m | N] of the torques' rows: white noise of the sensors, which is
        the least that they can have, and what is left at x, which is the most.
        """
        squares = sum((part.residual(self.x) ** 2).sum(axis=0) for part in self.parts)
        counts = sum(part.rows.informed.sum(axis=0) for part in self.parts)
        largest = np.sqrt(np.maximum(squares, 1e-300) / np.maximum(counts, 1))
        mechanism = self.problem.mechanism
        sensors = [
            torque_noise(mechanism, e, rows_cutoff(smooth, e.rate), self.problem.point) ** 2
            for e, smooth in zip(self.experiments, self.fine, strict=True)
        ]
        white = np.sqrt(np.mean(sensors, axis=0))
        names = self.problem.motion.independent
        passive = [name in mechanism.passive and not mechanism.closures for name in names]
        least = np.maximum(white, np.where(passive, LEAST_PASSIVE, LEAST) * largest)
        return least, np.maximum(largest, least)  # a motion that has moved leaves less than noise

    def raised(self, sigma: np.ndarray) -> float:
        """Return how many times as large as that of the sensors some noise of the torques is; of
        passive joints there is no sensor.
        """
        names = self.problem.motion.independent
        sensed = [name not in self.problem.mechanism.passive for name in names]
        return float((sigma / self.noise()[0])[sensed].max(initial=1.0))

    def loss(self, sigma: np.ndarray) -> float:
        """Return the loss of all experiments."""
        return sum(part.loss(self.x, sigma) for part in self.parts)

    def with_motion(self, runs: Runs, x: np.ndarray) -> tuple[State, ...]:
        """Return the experiments on the motions that go with parameters x."""
        states = []
        for number, (e, smooth) in enumerate(zip(self.experiments, self.fine, strict=True)):
            splines = tuple(
                (p.segment, replace(p.spline, c=p.spline.c + run.elimination.back_substitute(x)))
                for p, run in zip(self.parts, runs, strict=True)
                if p.experiment == number
            )
            states.append(along(self.problem.mechanism, e, replace(smooth, runs=splines)))
        return tuple(states)

    def motion(self, runs: Runs, x: np.ndarray) -> Callable[[], Motion]:
        """Return the function that makes the motion that goes with parameters x."""
        return lambda: replace(self.problem.motion, experiments=self.with_motion(runs, x))

    def balanced(self, estimate: Estimate) -> tuple[np.ndarray, Runs, Estimate]:
        """Return the torques' noise at which residuals are as large as noise, and its estimate.

        σ = least^(1−θ) largest^θ with the smallest θ in [0, 1] at which |residual|² ≤ AGREED rows:
        that of the sensors if it explains the residual, else as much more as model errors ask.
        """
        least, largest = self.noise()
        low, high, theta = 0.0, 1.0, 0.0
        for trial in range(TRIALS):
            sigma = least ** (1 - theta) * largest**theta
            runs, now = self.whitened(estimate, sigma)
            squares = self.squares_per_row(now)
            if not trial or squares <= AGREED:
                best = sigma, runs, now
            if (theta == 0.0 and squares <= AGREED) or 1 / AGREED < squares <= AGREED:
                break
            low, high = (low, theta) if squares <= AGREED else (theta, high)
            theta = 0.5 * (low + high)
        return best

    def whitened(self, first: Estimate, sigma: np.ndarray) -> tuple[Runs, Estimate]:
        """Return the runs without their motion, and the estimate from them."""
        problem, one = self.problem, np.ones(1)
        runs = tuple(part.eliminated(sigma) for part in self.parts)
        information = problem.with_rest_rows(stacks_information(runs, problem.motion))
        free = estimate(
            information.totals, problem.prior, one, problem.plausible, one, first.fixed,
            known=first.base.independent,
        )  # fmt: skip
        places = np.array([*extents(problem)], dtype=int)
        return runs, free.limited(first.at_limit, first.x[first.at_limit]).nonnegative(places)
