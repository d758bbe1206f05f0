"""The verbs `identify`: mechanism and motion become a fit; `compare`: fits on the same motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from ident.display import Progress, no_progress, part
from ident.effects import Effect
from ident.equations.problem import Problem, information_of
from ident.equations.rest import unweighed, with_rest
from ident.equations.unknowns import Point
from ident.errors import FitError, one_of
from ident.faults.channel_checks import copies
from ident.files import Written
from ident.finding import Finding
from ident.fit.consistency import nearest_possible, possible_bodies
from ident.fit.drives import (
    delays_at_bounds,
    held_at_zero,
    held_drives,
    narrow_intervals,
    with_known_drives,
    with_reversal_pulses,
    with_sensors_first,
    without_held_drives,
    without_long_pulses,
    without_negative_delay,
)
from ident.fit.files import Saved
from ident.fit.findings import basis_bias, beyond_range, findings_of, predicts_better
from ident.fit.likelihood import Likelihood, weighed
from ident.fit.prediction import Prediction
from ident.fit.residual import Charted, Failure, Residual, floor_of, residual_of
from ident.fit.result import Fit
from ident.fit.shapes import NoScale, beyond_bounds, refuse_scales, unknown_scales, working_point
from ident.fit.springs import at_zero, beyond_band, biases, within_signs
from ident.fit.values import ParameterValues
from ident.information.blocks import Error
from ident.information.chance import covariance, held_out, prior_covariance
from ident.information.estimate import Estimate
from ident.information.evidence import NEGATIVE
from ident.information.left_out import LeftOut
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import Consistency
from ident.motion import Motion

RUNS = 0.5  # numerics: share of a scale; one that the last step changes by more has not settled
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
    motion = unweighed(motion)
    mechanism, compared = with_sensors_first(mechanism, motion, validate)
    mechanism = with_reversal_pulses(mechanism).for_logs(motion.names)
    try:
        problem, estimate = _solved(mechanism, motion, start, shapes, equations)
    except NoScale as unscaled:
        mechanism = without_held_drives(mechanism, motion, unscaled)
        compared = (*compared, *held_drives(sorted(unscaled.joints)))
        problem, estimate = _solved(mechanism, motion, start, shapes, equations)
    estimate, of_drives = held_at_zero(problem, estimate)
    at_once, early = without_negative_delay(problem, estimate)
    if at_once is not None:
        mechanism = at_once
        problem, estimate = _solved(mechanism, motion, start, shapes, equations)
        estimate, of_drives = held_at_zero(problem, estimate)
    problem, estimate, rigid = within_signs(problem, estimate)
    rigid += beyond_band(problem, estimate)
    wider = biases(problem, estimate)
    least_squares = estimate
    problem, estimate, likelihood, findings = weighed(problem, estimate, estimator, likely)
    findings = [
        *findings,
        *rigid,
        *at_zero(problem, estimate, least_squares),
        *compared,
        *of_drives,
        *early,
        *delays_at_bounds(problem, estimate),
        *narrow_intervals(problem),
    ]
    fit = fit_of(problem, estimate, consistent, findings, likelihood, rest, wider)
    refuse_scales(scales_within_error(fit))
    if validate is None:
        return fit
    texts = "its errors are no validation", "validate on another log"
    same = [finding for a in motion.logs for b in validate.logs for finding in copies(a, b, *texts)]
    if validate.band.cutoff != motion.band.cutoff:
        cutoff_there, cutoff_here = (
            f"{m.band.cutoff or np.inf:.3g} Hz" for m in (validate, motion)
        )
        text = f"the validation logs are filtered at {cutoff_there}, the fit's at {cutoff_here}"
        remedy = "complete them with cutoff=motion.band.cutoff"
        same.append(Finding("another cut-off", f"{text}: their errors are no measure", remedy))
    same += beyond_range(mechanism, motion, validate)
    errors, floors = dict[str, dict[str, Error]](), dict[str, dict[str, float]]()
    joints = validate.independent
    units = [mechanism.joint(name).force_unit for name in joints]
    rows = information_of(mechanism, fit.columns, validate, fit.problem.point, last)
    possible = None if consistent else possible_bodies(fit.problem, fit.estimate, fit.findings)
    for number, e in enumerate(validate.experiments):
        log_rows = rows.of_log(number)
        errors[e.name] = log_rows.squares(fit.estimate.x).errors(joints, units)
        floors[e.name] = floor_of(fit, replace(validate, experiments=(e,)))
        if possible is not None:
            with_possible = log_rows.squares(possible).errors(joints, units)
            same += predicts_better(e.name, errors[e.name], with_possible)
    return replace(
        fit, validation=errors, floors=floors, validated_on=validate,
        findings=(*fit.findings, *same),
    )  # fmt: skip


def _solved(
    mechanism: Mechanism, motion: Motion, start: Point | None, shapes: Progress, equations: Progress
) -> tuple[Problem, Estimate]:
    """Return the equations at their working point, rows at rest among them, and least squares."""
    point = working_point(mechanism, motion, start, shapes)
    problem = Problem.of(mechanism, motion, point, equations)
    problem, estimate = with_rest(problem, estimate_of(problem))
    return problem, without_long_pulses(problem, estimate)


def estimate_of(problem: Problem) -> Estimate:
    """Solve least squares; weights, rank and what is held at the prior come from the rows too."""
    estimate = problem.estimate()
    # a shape that is held may send another one out of its bounds
    while not problem.stacked:
        beyond = beyond_bounds(problem, estimate) & ~estimate.fixed
        if not beyond.any():
            break
        estimate = problem.estimate(sigma=estimate.sigma, fixed=estimate.fixed | beyond)
    # a scale that ran to the end of its search is none, and one that would go on from there while
    # unknown bodies go with it
    fixed, point = estimate.fixed, problem.point.unknowns(problem.columns)
    runs = np.abs(estimate.x - point) > RUNS * np.abs(point)
    runs &= bool(len(problem.columns.rigid))
    refuse_scales([e for e, at in unknown_scales(problem.columns) if fixed[at] or runs[at]])
    return estimate


def scales_within_error(fit: Fit) -> list[Effect]:
    """Return the drives whose scale is zero as far as its standard error tells, where bodies that
    are unknown could be larger with it.
    """
    if not unknown_scales(fit.columns) or not len(fit.columns.rigid):
        return []
    values = ParameterValues(fit.columns, fit.estimate, fit.scatter).effects(fit.problem.point)
    return [
        effect.effect
        for effect in values
        for p in effect.parameters
        if effect.effect.scale and p.name == effect.effect.full[effect.effect.scale]
        if p.stderr is not None and p.value < NEGATIVE * p.stderr
    ]


def fit_of(
    problem: Problem,
    estimate: Estimate,
    consistent: bool | Consistency = False,
    findings: Sequence[Finding] = (),
    likelihood: Likelihood | None = None,
    on_progress: Progress = no_progress,
    wider: Mapping[int, float] | None = None,
) -> Fit:
    """Return the fit of an estimate: within limits if asked for, with standard errors and errors;
    `findings` are of the way in which the estimate was made, `consistent` as in `identify`, `wider`
    standard errors on top of the jackknife's, by place in x.
    """
    findings = [*basis_bias(problem, estimate), *findings]
    free, binding, limits = estimate, None, problem.mechanism.consistency
    blocks: LeftOut | None = None
    if consistent:
        limits |= consistent if isinstance(consistent, Consistency) else Consistency()
        nearest = nearest_possible(problem, estimate, limits, on_progress)
        problem, estimate, free, outside, binding = nearest
        findings += binding.findings
    else:
        blocks = LeftOut.of(problem.fitting, estimate)
        outside = held_out(
            problem.fitting, problem.information, estimate, problem.prior, left_out=blocks
        )
        if limits != Consistency():
            text = "bounds and total_mass of [parameters] hold in a consistent fit only"
            findings.append(Finding("limits ignored", text, "--consistent"))
    cov = covariance(problem.fitting, free, blocks)
    if likelihood is not None:
        cov = likelihood.covariance(cov, free)
    cov += prior_covariance(free, problem.plausible)
    bias = np.array([(wider or {}).get(place, 0.0) for place in free.base.independent.tolist()])
    cov += np.diag(bias**2)
    on_progress("errors", 0.9)
    names, units = problem.motion.independent, problem.units
    train = problem.information.squares(estimate.x).errors(names, units)
    left_out = {} if outside is None else outside.errors(names, units)
    values = ParameterValues(problem.columns, estimate, cov)
    effects = values.effects(problem.point_at(estimate.x))
    every = findings_of(problem, estimate, train, effects, findings)
    return Fit(
        problem, estimate, cov, train, left_out,
        findings=every, binding=binding, likelihood=likelihood, bias=bias,
    )  # fmt: skip


# --- models on the same motion --------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Charted, Written):
    """One or several models on the same motion. Made by `ident.compare`.

    Attributes:
        residuals: residual of each model, by its name.
        fitted: errors of each model's own fit, by name: `train`, `held out`, and logs it was
            validated on; by joint.
        findings: what to know of a model on this motion, by its name.
    """

    residuals: Mapping[str, Residual]
    fitted: Mapping[str, Mapping[str, Mapping[str, Error]]]
    findings: Mapping[str, tuple[Finding, ...]] = field(default_factory=dict)

    @property
    def errors(self) -> dict[str, dict[str, Error]]:
        """Errors on this motion, by model, then joint."""
        return {name: residual.errors for name, residual in self.residuals.items()}

    @property
    def where(self) -> dict[str, tuple[Failure, ...]]:
        """Where each model fails, the joint with the largest share first."""
        return {name: residual.where for name, residual in self.residuals.items()}

    @cached_property
    def predictions(self) -> dict[str, list[Prediction]]:
        """Predictions of each model, one an experiment, at full rate and unfiltered."""
        return {name: [*residual.predictions] for name, residual in self.residuals.items()}

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the independent joints' torques."""
        return next(iter(self.residuals.values())).units


def compare(
    *models: Fit | Saved, motion: Motion | None = None, progress: Progress | None = None
) -> Comparison:
    """Compare models with measurement on one motion.

    Args:
        models: fits, or fit.json files read back.
        motion: on which to compare; default: the one that the first fit was made from.
        progress: called with (what is being done, share done).

    Raises:
        FitError: if there is no model, or no motion to compare on.
    """
    if not models:
        raise FitError("nothing to compare; give one fit or several")
    for model in models:
        if not isinstance(model, Fit | Saved):
            kind = type(model).__name__
            raise FitError(f"compare needs fits, given: {kind}; a motion goes by name: motion=…")
    motion = models[0].motion if motion is None else motion
    residuals: dict[str, Residual] = {}
    fitted: dict[str, Mapping[str, Mapping[str, Error]]] = {}
    findings: dict[str, tuple[Finding, ...]] = {}
    for i, model in enumerate(models):
        name = f"fit {i + 1}" if isinstance(model, Fit) and len(models) > 1 else ""
        compared, differing = beside_sensors(model, motion)
        residual = residual_of(compared, motion, name=name)
        residuals[residual.name] = residual
        fitted[residual.name] = model.errors
        if differing:
            findings[residual.name] = differing
        if progress:
            progress(f"where {residual.name} fails", (i + 0.5) / len(models))
    return Comparison(residuals, fitted, findings)


def beside_sensors(
    model: Fit | Saved, motion: Motion | None
) -> tuple[Fit | Saved, tuple[Finding, ...]]:
    """Return the model without the drives of joints whose torque the motion's logs have, so that
    the measured ones are compared, and a finding on each drive that makes another torque.

    Raises:
        FitError: if some logs have the torque of a driven joint, and others its command alone.
    """
    if motion is None or motion is model.motion or not model.mechanism.drives:
        return model, ()
    known, point = with_known_drives(model.mechanism, model.point)
    mechanism, findings = with_sensors_first(known, motion)
    if mechanism is known:
        return model, ()
    base_parameters = tuple(model.base_parameters)
    return Saved(
        model.name, mechanism, point, motion.band.cutoff, model.errors, base_parameters
    ), findings
