"""The verb `identify`: mechanism and motion become a fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from ident.equations.unknowns import Point
from ident.errors import FitError, one_of
from ident.fit.channel_checks import copies
from ident.fit.consistency import nearest_possible
from ident.fit.findings import Finding, basis_bias, findings_of
from ident.fit.likelihood import Likelihood, weighed
from ident.fit.problem import Problem, information_of
from ident.fit.result import Fit
from ident.fit.shapes import beyond_bounds, working_point
from ident.fit.values import effect_values
from ident.information.blocks import Error
from ident.information.covariance import covariance, held_out, prior_covariance
from ident.information.estimate import Estimate
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import Consistency
from ident.motion import Motion
from ident.progress import Progress, part

ESTIMATORS = ("auto", "least-squares", "likelihood")


def identify(
    mechanism: Mechanism,
    motion: Motion,
    *,
    validate: Motion | None = None,
    start: Point | None = None,
    consistent: bool | Consistency = False,
    estimator: str = "auto",
    progress: Progress | None = None,
) -> Fit:
    """Identify dynamic parameters, effects and multipliers by one least-squares solve.

    Args:
        mechanism: with what is unknown and which effects it has.
        motion: from `complete`.
        validate: motion of other logs, on which errors are reported and nothing is fitted.
        start: a working point from which shape parameters are searched; default: a coarse search.
        consistent: whether every body must be possible and no friction or stiffness negative, with
            the mechanism's own bounds; or further bounds, as a `Consistency`.
        estimator: `least-squares` takes the motion as it is; `likelihood` lets the motion move
            within its noise, until nothing changes; `auto` is least squares, with one step of the
            likelihood where noise of the motion makes a twentieth of the residual or more.
        progress: called with (what is being done, share done).

    Returns:
        The fit; `print(fit)` is its summary. Of a mechanism in which nothing is unknown, the errors
        of the model as it is.

    Raises:
        FitError: if it is given no motion, if there are no equations to identify with, or if the
            limits of a consistent fit contradict each other.
    """
    if not isinstance(motion, Motion):
        raise FitError(
            f"identify needs a motion, given: {type(motion).__name__}; write "
            "ident.identify(mechanism, ident.complete(mechanism, log))"
        )
    if estimator not in ESTIMATORS:
        raise FitError(f"estimator '{estimator}'; {one_of(estimator, ESTIMATORS)}")
    shapes, equations, likely, rest, last = (
        part(progress, *ends) for ends in pairwise((0.0, 0.3, 0.5, 0.8, 0.95, 1.0))
    )
    point = working_point(mechanism, motion, start, shapes)
    problem = Problem.of(mechanism, motion, point, equations)
    estimate = estimate_of(problem)
    problem, estimate, likelihood, findings = weighed(problem, estimate, estimator, likely)
    fit = fit_of(problem, estimate, consistent, findings, likelihood, rest)
    if validate is None:
        return fit
    texts = "its errors are no validation", "validate on another log"
    same = [each for a in motion.logs for b in validate.logs for each in copies(a, b, *texts)]
    if validate.band.cutoff != motion.band.cutoff:
        bands = tuple(f"{m.band.cutoff or np.inf:.3g} Hz" for m in (validate, motion))
        text = (
            "the validation logs are filtered at {}, the fit's at {}: their errors are no measure"
        )
        remedy = "complete them with cutoff=motion.band.cutoff"
        same.append(Finding("another cut-off", text.format(*bands), remedy))
    errors = _errors_on(fit, validate, last)
    return replace(fit, validation=errors, findings=(*fit.findings, *same))


def estimate_of(problem: Problem) -> Estimate:
    """Solve least squares; weights, rank and what is held at the prior come from the rows too."""
    found = problem.estimate()
    if not problem.stacked and (beyond := beyond_bounds(problem, found)).any():
        found = problem.estimate(sigma=found.sigma, held=found.held | beyond)
    return found


def fit_of(
    problem: Problem,
    estimate: Estimate,
    consistent: bool | Consistency = False,
    findings: Sequence[Finding] = (),
    likelihood: Likelihood | None = None,
    on_progress: Progress | None = None,
) -> Fit:
    """Return the fit of an estimate: within limits if asked for, with standard errors and errors.

    Args:
        problem: the equations; effects that are not linear are taken at its point.
        estimate: their solution.
        consistent: as in `identify`.
        findings: of the way in which the estimate was made, mentioned after those of the data.
        likelihood: how torques and motion were weighed together.
        on_progress: called with (what is being done, share done).

    Raises:
        FitError: if limits contradict each other.
    """
    findings = [*basis_bias(problem, estimate), *findings]
    free, binding, limits = estimate, None, problem.mechanism.consistency
    if consistent:
        limits |= consistent if isinstance(consistent, Consistency) else Consistency()
        possible = nearest_possible(problem, estimate, limits, on_progress)
        problem, estimate, free = possible.problem, possible.estimate, possible.free
        outside, binding = possible.outside, possible.binding
        findings += binding.findings
    else:
        outside = held_out(problem.fitting, problem.information, estimate, problem.prior)
        if limits != Consistency():
            text = "bounds and total_mass of [parameters] hold in a consistent fit only"
            findings.append(Finding("limits ignored", text, "--consistent"))
    cov = covariance(problem.fitting, free)
    if likelihood is not None:
        cov = likelihood.covariance(cov, free)
    cov += prior_covariance(free, problem.plausible)
    if on_progress:
        on_progress("errors", 0.9)
    names, units = problem.motion.independent, problem.units
    train = problem.information.squares(estimate.x).errors(names, units)
    left_out = {} if outside is None else outside.errors(names, units)
    effects = effect_values(problem.columns, estimate, cov, problem.point_at(estimate.x))
    return Fit(
        problem=problem,
        estimate=estimate,
        scatter=cov,
        train=train,
        held_out=left_out,
        findings=findings_of(problem, estimate, train, effects, findings),
        binding=binding,
        likelihood=likelihood,
    )


def _errors_on(
    fit: Fit, motion: Motion, on_progress: Progress | None
) -> dict[str, dict[str, Error]]:
    """Return the errors in other logs, by log, then joint."""
    mechanism, joints = fit.mechanism, motion.independent
    units = [mechanism.joint(name).force_unit for name in joints]
    rows = information_of(mechanism, fit.columns, motion, fit.problem.point, on_progress)
    return {
        e.name: rows.of_log(number).squares(fit.estimate.x).errors(joints, units)
        for number, e in enumerate(motion.experiments)
    }
