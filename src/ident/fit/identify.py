"""The verb `identify`: mechanism and motion become a fit."""

from __future__ import annotations

from collections.abc import Iterable

from ident.equations.unknowns import Point
from ident.errors import FitError, one_of
from ident.fit.consistency import Constrained, nearest_possible
from ident.fit.findings import Finding, basis_bias, findings_of
from ident.fit.likelihood import (
    MATTERS,
    Likelihood,
    check_refinable,
    one_step,
    refined,
    share_of_motion,
    unexplained,
)
from ident.fit.problem import Problem, information_of
from ident.fit.result import Fit
from ident.fit.shapes import beyond_bounds, working_point
from ident.fit.values import effect_values
from ident.information.blocks import Error
from ident.information.covariance import covariance, prior_covariance
from ident.information.estimate import Estimate
from ident.information.held_out import held_out
from ident.information.triangle import Array
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import Consistency
from ident.motion import Motion
from ident.progress import Progress

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
    point = working_point(mechanism, motion, start, progress)
    problem = Problem.of(mechanism, motion, point, progress)
    problem.check()
    estimate = estimate_of(problem)
    findings = basis_bias(problem, estimate)
    problem, estimate, likelihood, more = weighed(problem, estimate, estimator, progress)
    findings += more
    cov = covariance(problem.fitting, estimate)
    if likelihood is not None:
        cov = likelihood.covariance(cov, estimate)
    cov += prior_covariance(estimate, problem.plausible)
    possible = None
    limits = limits_asked(mechanism, consistent)
    if limits is not None:
        possible = nearest_possible(problem, estimate, limits, progress)
        if possible.problem is not problem:  # made anew where columns depend on the solution
            cov = covariance(possible.problem.fitting, possible.free)
            cov += prior_covariance(possible.free, possible.problem.plausible)
    elif mechanism.consistency != Consistency():
        text = "bounds and total_mass of [parameters] hold in a consistent fit only: --consistent"
        findings.append(Finding("limits ignored", text))
    return assembled(problem, estimate, cov, findings, likelihood, validate, progress, possible)


def estimate_of(problem: Problem) -> Estimate:
    """Solve least squares; weights, rank and what is held at the prior come from the rows too."""
    found = problem.estimate()
    if problem.stacked:
        return found
    if (beyond := beyond_bounds(problem, found)).any():
        found = problem.estimate(sigma=found.sigma, held=found.held | beyond)
    return found


def weighed(
    problem: Problem, estimate: Estimate, estimator: str, on_progress: Progress | None = None
) -> tuple[Problem, Estimate, Likelihood | None, list[Finding]]:
    """Weigh torques and motion together where that is asked for, or where the noise matters."""
    if estimator == "likelihood":
        check_refinable(problem)
        share = share_of_motion(problem, estimate)
        problem, estimate, likelihood = refined(problem, estimate, share, on_progress)
        return problem, estimate, likelihood, likelihood.findings
    if estimator == "auto" and not problem.bands and len(problem.columns):
        share = share_of_motion(problem, estimate)
        if share.max(initial=0.0) >= MATTERS:
            better = one_step(problem, estimate, share, on_progress)
            if better is None:
                return problem, estimate, None, [unexplained(share)]
            return *better, better[2].findings
    return problem, estimate, None, []


def limits_asked(mechanism: Mechanism, consistent: bool | Consistency) -> Consistency | None:
    """Return the limits of a consistent fit; None if none is asked for."""
    if not isinstance(consistent, Consistency):
        return mechanism.consistency | Consistency() if consistent else None
    return mechanism.consistency | consistent


def assembled(
    problem: Problem,
    estimate: Estimate,
    cov: Array,
    findings: Iterable[Finding] = (),
    likelihood: Likelihood | None = None,
    validate: Motion | None = None,
    on_progress: Progress | None = None,
    possible: Constrained | None = None,
) -> Fit:
    """Assemble a fit with its errors in the data, held out and in other logs.

    Args:
        problem: the equations; effects that are not linear are taken at its point.
        estimate: their solution; cov: (n_ind, n_ind) covariance of its base parameters.
        findings: of the way in which it was made, mentioned after all others.
        likelihood: how torques and motion were weighed together.
        validate: motion of other logs, on which errors are reported.
        on_progress: called with (what is being done, share done).
        possible: a consistent estimate that takes the place of problem and estimate.
    """
    if on_progress:
        on_progress("held-out errors", 0.9)
    if possible is None:
        outside = held_out(problem.fitting, problem.information, estimate, problem.prior)
    else:
        problem, estimate, outside = possible.problem, possible.estimate, possible.outside
        findings = [*findings, *possible.binding.findings]
    names, units = problem.motion.independent, problem.units
    train = problem.information.squares(estimate.x).errors(names, units)
    point = problem.point_at(estimate.x)
    effects = effect_values(problem.columns, estimate, cov, point)
    validation: dict[str, dict[str, Error]] = {}
    if validate is not None:
        model, joints = problem.mechanism, validate.independent
        other = information_of(model, problem.columns, validate, problem.point, on_progress)
        validation = {
            e.name: other.of_log(number)
            .squares(estimate.x)
            .errors(joints, [model.joint(name).force_unit for name in joints])
            for number, e in enumerate(validate.experiments)
        }
    every = findings_of(problem, estimate, train, effects, findings)
    return Fit(
        problem=problem,
        estimate=estimate,
        covariance=cov,
        train=train,
        held_out={} if outside is None else outside.errors(names, units),
        validation=validation,
        findings=every,
        binding=None if possible is None else possible.binding,
        likelihood=likelihood,
    )
