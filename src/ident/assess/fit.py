"""The judgement on a fit: better than the model before or not, and good enough or not."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ident.assess.assessment import Assessment, NamedCause, Remainder
from ident.assess.errors import EARLIER_NUMBERS, URDF_NUMBERS, JointErrors, joint_errors
from ident.assess.good_enough import GoodEnough, good_enough
from ident.assess.machine import TESTING, watching_step
from ident.assess.repairs import correcting_step, repairing_step
from ident.assess.verdict import doubts_of, faults_that_explain
from ident.effects.library import by_kind
from ident.fit import Fit
from ident.fit.files import Saved, residual_before
from ident.information.blocks import Error
from ident.information.estimate import MATERIAL
from ident.information.evidence import BEYOND, CERTAIN
from ident.request import Step

FRICTION = ("viscous", "coulomb")  # the kinds that are offered where no friction is in the model
# of the residual of a joint, which say that it rubs, and effects that would make it so
RUBS = ("v", "sign(v)")


@dataclass(frozen=True)
class Increase:
    """Joints whose error the identified numbers have made larger.

    Attributes:
        joints: them; in_fit: whether it is larger in the rows that were fitted, too.
    """

    joints: tuple[str, ...] = ()
    in_fit: bool = False


def assess_fit(fit: Fit, *, acceptable: float | None = None) -> Assessment:
    """Judge a fit, beside the model before it: the URDF's numbers, or those of an earlier fit."""
    errors, floor = fit.held_out or fit.train, fit.noise
    away_from_reversals: Mapping[str, float] = fit.residual.errors_away_from_reversals
    bars, compared = errors_beside(fit), names_of(fit)
    if fit.validation:
        errors, floor = worst_on_validation(fit, lambda e, x: e.rms / (x or 1e-300))
        away_from_reversals = {}
    doubts = doubts_of(fit.health, fit.findings)
    answer = good_enough(
        errors, floor, acceptable=acceptable,
        away_from_reversals=away_from_reversals, logs=[*fit.validation],
        doubts=fit.health.findings,
    )  # fmt: skip
    reversals = [
        j
        for j in errors
        if j in away_from_reversals and away_from_reversals[j] <= 1.5 * floor.get(j, 0.0)
    ]
    verdict = "identified"
    if fit.changes is not None:
        verdict = "changed" if fit.changes.changed else "unchanged"
    return Assessment(
        subject=subject_of(fit),
        verdict=verdict,
        errors=bars,
        compared=compared,
        causes=causes_of_fit(fit),
        left=Remainder.of(errors, floor, reversals, MATERIAL),
        doubts=doubts,
        good_enough=answer,
        next=next_step(fit, answer),
        changed=joints_changed(fit),
        spoilt=bool(faults_that_explain(fit.health)),
        untrusted=fit.untrusted and bool(len(fit.columns)),
        freely=share_of_gravity(fit, errors),
    )


def share_of_gravity(fit: Fit, errors: Mapping[str, Error]) -> float | None:
    """Return the largest error over gravity's torque, rms, of joints whose torque is always 0; None
    where there is no such joint, or no gravity.
    """
    shares = list[float]()
    if any(e.wrench is not None and np.any(e.wrench) for e in fit.motion.experiments):
        return None  # thrust or contact moves it
    if any(effect.site == "frame" for effect in fit.mechanism.effects):
        return None
    for u, joint in enumerate(fit.motion.independent):
        error = errors.get(joint)
        if error is None or error.relative is not None or error.unmeasured:
            continue
        gravity = np.concatenate([trace.gravity[:, u] for trace in fit.residual.traces])
        size = float(np.sqrt(np.mean(gravity**2))) if len(gravity) else 0.0
        shares += [error.rms / size] if size > 0 else []
    return max(shares, default=None)


def subject_of(fit: Fit) -> str:
    """Return the mechanism and the logs that its errors are of."""
    name, logs = fit.mechanism.name, ", ".join(fit.motion.names)
    if fit.validation:
        return f"{name}, fitted to {logs}, on {', '.join(fit.validation)}"
    return f"{name} on {logs}"


def errors_beside(fit: Fit) -> tuple[JointErrors, ...]:
    """Return errors before and now: of the model before and of the fit, both on the fitted logs, or
    on that validation log in which the fit is worst; those now alone where nothing was unknown, or
    where validation logs were read in portions.
    """
    errors = fit.held_out or fit.train
    if fit.validation:
        logs = {
            joint: max(fit.validation, key=lambda log: _size(fit.validation[log][joint]))
            for joint in fit.train
        }
        shown = {joint: fit.validation[log][joint] for joint, log in logs.items()}
        floor = {joint: fit.noise_on(log)[joint] for joint, log in logs.items()}
        before = errors
        if len(fit.columns):
            has_motion = fit.validated_on is not None
            before = {
                joint: residual_before(fit, log).errors[joint]
                for joint, log in logs.items()
                if has_motion
            }
        return joint_errors(before, shown, floor)
    if not len(fit.columns):  # nothing is unknown: the model is as it was
        return joint_errors({}, errors, fit.noise)
    return joint_errors(residual_before(fit).errors, errors, fit.noise)


def _size(error: Error) -> tuple[float, float]:
    """Return what errors are ordered by: their share of the torque, else their rms."""
    return error.relative or 0.0, error.rms


def names_of(fit: Fit) -> tuple[str, str]:
    """Return what the errors before and now are of."""
    fixed = "held out" if fit.held_out else "in the fit"
    if not len(fit.columns):
        return (fixed, ", ".join(fit.validation)) if fit.validation else ("", "")
    # the URDF's numbers, or those of the fit that wrote the mechanism
    earlier = earlier_of(fit)
    urdf = fit.mechanism.covariance is None
    before = URDF_NUMBERS if urdf else EARLIER_NUMBERS
    after = "with the identified ones" if fit.validation else f"with the identified ones, {fixed}"
    if fit.validation and fit.validated_on is None:
        return "", ""
    return f"with {earlier.name}" if earlier else before, after


def earlier_of(fit: Fit) -> Fit | Saved | None:
    """Return the fit since which changes are looked for; None of a first fit."""
    return fit.earlier if isinstance(fit.earlier, Fit | Saved) else None


def worst_on_validation(
    fit: Fit, size: Callable[[Error, float], Any]
) -> tuple[dict[str, Error], dict[str, float]]:
    """Return error and noise by joint in the validation log in which `size` of both is largest."""
    errors, floor = dict[str, Error](), dict[str, float]()
    for joint in fit.train:
        pairs = [(e[joint], fit.noise_on(log)[joint]) for log, e in fit.validation.items()]
        errors[joint], floor[joint] = max(pairs, key=lambda pair: size(*pair))
    return errors, floor


def causes_of_fit(fit: Fit) -> tuple[NamedCause, ...]:
    """Return the effects of the model, kind by kind, that were identified clearly."""
    values = {effect.effect.label: tuple(effect.parameters) for effect in fit.effects}
    clear = [
        item.effect
        for item in fit.effects
        if not (item.effect.known or item.effect.in_rows_alone)
        and any(v.stderr and abs(v.value) > CERTAIN * v.stderr for v in item.parameters)
    ]
    return tuple(
        NamedCause(tuple(group), tuple(v for e in group for v in values[e.label]))
        for group in by_kind(clear)
    )


def joints_changed(fit: Fit) -> tuple[str, ...]:
    """Return the joints in which an earlier fit does clearly worse than on its own log; and those
    in which time that was left out shows a multiple of its error, beyond noise: too many numbers
    have moved to fit.
    """
    earlier = earlier_of(fit)
    if fit.changes is None or earlier is None:
        return ()
    then = earlier.errors.get("held out") or earlier.errors.get("train") or {}
    far = Remainder.of(fit.held_out, fit.noise, material=MATERIAL).joints
    held_out = [j for j in far if j in then and fit.held_out[j].rms > BEYOND * then[j].rms]
    return tuple(dict.fromkeys([*fit.residual.increased_errors(then), *held_out]))


def increase_of(fit: Fit) -> Increase:
    """Return the joints whose error the identified numbers make larger than the URDF's."""
    if earlier_of(fit) or fit.validation:
        return Increase()
    bars = [bar for bar in errors_beside(fit) if bar.rises]
    in_fit = [fit.train[bar.joint].rms > bar.before.rms for bar in bars]
    return Increase(tuple(bar.joint for bar in bars), bool(bars) and all(in_fit))


def next_step(fit: Fit, answer: GoodEnough) -> Step:
    """Return what goes on from a fit: another log, a diagnosis, or friction where it rubs."""
    if fit.changes is not None and fit.changes.changed:
        return Step("diagnose", known=True)  # with the earlier bodies known, which names the cause
    if step := correcting_step("identify", fit.health.findings):
        return step
    if answer.fits:
        if step := repairing_step(fit):
            return step
        if len(fit.columns) and not fit.validation:
            return TESTING
        return watching_step(fit.motion)
    if rubs(fit):
        return Step("identify", FRICTION)
    return Step("diagnose")


def rubs(fit: Fit) -> bool:
    """Return whether the model has no friction, and the residual of a joint with much of the misfit
    follows its speed or the direction of it.
    """
    if not len(fit.columns) or not fit.health.good:
        return False
    if any(effect.kind in FRICTION or effect.jumps for effect in fit.mechanism.effects):
        return False
    return any(
        depends.signal in {f"{kind}.{joint}" for kind in RUBS}
        for joint in fit.residual.worst[:2]
        for depends in fit.residual.failure(joint).depends_on[:2]
    )
