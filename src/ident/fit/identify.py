"""The verb `identify`: mechanism and motion become a fit."""

from __future__ import annotations

import numpy as np

from ident.equations.point import Point
from ident.errors import FitError, one_of
from ident.fit.assemble import assemble
from ident.fit.caveats import basis_bias
from ident.fit.constrain import constrained
from ident.fit.covariance import covariance
from ident.fit.descend import beyond
from ident.fit.estimate import Estimate, estimate, totals
from ident.fit.fit import Fit
from ident.fit.noisy import MATTERS, can_move, one_step, refined, share_of_motion
from ident.fit.regression import Regression
from ident.fit.settle import settled
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
    """Dynamic parameters, effects and multipliers by one least-squares solve.

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
    point = settled(mechanism, motion, start, progress)
    regression = Regression.of(mechanism, motion, point, progress)
    _check_scale(regression)
    found = estimated(regression)
    notes = bias_of(regression, found)
    likelihood = None
    if estimator == "likelihood":
        _check_refinable(regression)
        share = share_of_motion(regression, found)
        regression, found, likelihood = refined(regression, found, share, progress)
    elif estimator == "auto" and not regression.bands and len(regression.columns):
        share = share_of_motion(regression, found)
        if share.max(initial=0.0) >= MATTERS:
            better = one_step(regression, found, share, progress)
            if better is None:
                notes = [*notes, _unexplained(share)]
            else:
                regression, found, likelihood = better
    cov = covariance(regression.fitting, found)
    if likelihood is not None:
        cov = likelihood.covariance(cov, found)
        notes = [*notes, *likelihood.notes]
    if not isinstance(consistent, Consistency) and not consistent:
        notes = [*notes, *_ignored(mechanism)]
        return assemble(
            regression, found, cov, validate=validate, notes=notes, likelihood=likelihood,
            progress=progress,
        )  # fmt: skip
    asked = consistent if isinstance(consistent, Consistency) else Consistency()
    held = constrained(regression, found, mechanism.consistency | asked, progress)
    if held.regression is not regression:  # made anew where columns depend on the solution
        cov = covariance(held.regression.fitting, held.free)
    return assemble(
        held.regression,
        held.estimate,
        cov,
        validate=validate,
        outside=held.outside,
        binding=held.binding,
        likelihood=likelihood,
        notes=[*notes, *held.notes],
        progress=progress,
    )


def _unexplained(share: np.ndarray) -> str:
    """Why the motion's noise was left as it is."""
    return (
        f"noise of the motion makes up to {100 * min(float(share.max()), 1.0):.3g} % of the "
        "residual, but noise does not explain all of it, so the motion was taken as it is "
        "and parameters may be shrunk; something is missing (ident diagnose), or --refine"
    )


def _check_scale(r: Regression) -> None:
    """Refuse equations of which all right sides are zero.

    Raises:
        FitError: saying why, and what to do.
    """
    if (
        len(r.columns)
        and all(f.rhs_norm() == 0 for f in r.factors)
        and any(f.rows for f in r.factors)
    ):
        raise FitError(
            "every torque is zero and no body is known, so parameters are free up to a common "
            "factor; log a motion that is driven, or give what is known ([parameters] unknown)"
        )


def _check_refinable(r: Regression) -> None:
    """Refuse a refined fit where there is no likelihood.

    Raises:
        FitError: saying why, and what to do.
    """
    if r.bands:
        raise FitError(
            'a refined fit needs free multipliers, given: a time basis; write basis = "free" in '
            "[multipliers], or --basis free"
        )
    if not len(r.columns):
        raise FitError(f"{r.mechanism.name}: nothing is unknown, so there is nothing to refine")
    if not can_move(r.motion):
        clean = ", ".join(e.name for e in r.motion.experiments if e.smooth is None)
        raise FitError(
            f"{clean}: taken as logged, so there is no noise in the motion to refine the fit by; "
            "leave out --refine, or --smoothing none"
        )


def estimated(r: Regression) -> Estimate:
    """Least squares on the rows; weights, rank and what is held at the prior come from them too."""
    if r.stacked:  # the paper's: all rows weigh alike, and the basis' misfit is in the parameters
        ones = np.ones(1)
        return estimate(totals(r.fitting, len(r.columns), 1), r.prior, ones, r.sensible)
    found = estimate(r.factors, r.prior, r.torque, r.sensible)
    if (out := beyond(r.mechanism, r.columns, r.motion, r.point, found)).any():
        held = found.held | out
        found = estimate(r.factors, r.prior, r.torque, r.sensible, sigma=found.sigma, held=held)
    return found


def _ignored(mechanism: Mechanism) -> list[str]:
    """Limits that the mechanism has and nobody asked for."""
    if mechanism.consistency == Consistency():
        return []
    return ["bounds and total_mass of [parameters] hold in a consistent fit only: --consistent"]


def bias_of(r: Regression, found: Estimate) -> list[str]:
    """What a time basis does to the parameters."""
    if not r.stacked:
        return []
    free = estimate(r.factors, r.prior, r.torque, r.sensible)
    return basis_bias(r.mechanism, r.columns, found, free)
