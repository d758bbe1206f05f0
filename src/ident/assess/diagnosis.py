"""The judgement on a diagnosis, and on a model that grew."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from ident.assess.assessment import Assessment, NamedCause, Remainder
from ident.assess.errors import (
    EARLIER_NUMBERS,
    REFITTED_BODIES,
    REFITTED_MODEL,
    JointErrors,
    joint_errors,
)
from ident.assess.experiment import Inseparable, SeparateRivals, next_experiment
from ident.assess.fit import worst_on_validation
from ident.assess.good_enough import Answer, good_enough
from ident.assess.machine import TESTING, watching_step
from ident.assess.repairs import correcting_step, repairing_step
from ident.assess.verdict import (
    errors_with_named,
    incomplete_before,
    joints_at_reversals,
    spoiling_faults,
)
from ident.diagnosis.grow import History
from ident.diagnosis.result import Diagnosis, errors_of
from ident.effects import Effect
from ident.effects.library import by_kind
from ident.fit import Fit
from ident.fit.values import Value
from ident.request import Step

# shown: times its least on the ladder, from which an error on a validation log is listed
HIGHER = 1.1


def assess_diagnosis(
    d: Diagnosis,
    *,
    acceptable: float | None = None,
    added: Sequence[Effect] = (),
    grown: bool = False,
) -> Assessment:
    """Judge a diagnosis; `added` effects are in its model, but not in the mechanism as given,
    `grown`: but in the folder that `grow` writes.
    """
    errors, after = errors_of(d.fit), errors_with_named(d)
    bars = tuple(
        JointErrors(joint, error, after.get(joint), d.floor[joint])
        for joint, error in errors.items()
        if not error.unmeasured
    )
    now = {**errors, **after}
    turns = joints_at_reversals(d)
    left = Remainder.of(now, d.floor, turns, d.decision.material)
    if d.verdict == "nothing" and d.fit.known_errors is not None:
        left = replace(left, within_known=bool(left.joints))
    answer = good_enough(
        errors, d.floor, acceptable=acceptable,
        away_from_reversals=d.fit.residual.errors_away_from_reversals,
        # where nothing was fitted the log is another one
        logs=() if len(d.fit.columns) else d.fit.motion.names,
        doubts=d.health.findings,
    )  # fmt: skip
    worst = d.candidates[0].joint if d.best else d.laws[0].felt if d.laws else ""
    step = next_step(d, added, grown=grown)
    if left.within_known and step.verb == "monitor":  # what comes would differ as much
        step = Step("explore")
    if step.verb == "explore" and not left.joints:  # nothing is left that an effect could explain
        step = replace(TESTING, effects=step.effects, grown=step.grown)
    return Assessment(
        subject=f"{d.fit.mechanism.name} on {', '.join(d.fit.motion.names)}",
        verdict=d.verdict,
        errors=bars,
        compared=(before_words(d.fit), "with what is named") if after else ("", ""),
        causes=causes_of(d),
        left=left,
        doubts=tuple(spoiling_faults(d)),
        good_enough=answer,
        next=step,
        worst=worst,
    )


def causes_of(d: Diagnosis) -> tuple[NamedCause, ...]:
    """Return what a diagnosis names: what has no rivals together, then each with its own."""
    if d.best is None:
        return ()
    values = {x.effect.label: x.parameters for x in d.every}
    changed = bool(d.candidates[0].known)
    return tuple(
        NamedCause(
            group,
            tuple(v for effect in group for v in values.get(effect.label, ())),
            d.rivals_in_group.get(group[0].label, ()),
            changed,
        )
        for group in apart_with_rivals(d.group, d.rivals_in_group)
    )


def apart_with_rivals(
    effects: Sequence[Effect], rivals: Mapping[str, Sequence[Effect]]
) -> list[tuple[Effect, ...]]:
    """Return effects without rivals together, then each of the others by itself."""
    sure = tuple(effect for effect in effects if effect.label not in rivals)
    return [sure] * bool(sure) + [(effect,) for effect in effects if effect.label in rivals]


def next_step(d: Diagnosis, added: Sequence[Effect] = (), *, grown: bool = False) -> Step:
    """Return what goes on from a diagnosis: a motion that separates rivals, a model with what is
    named, an experiment, or another verb.
    """
    step = _next_step(d)
    labels = tuple(effect.label for effect in added)
    if grown:
        return replace(step, grown=labels)
    return replace(step, effects=(*labels, *step.effects))


def _next_step(d: Diagnosis) -> Step:
    if step := correcting_step("diagnose", d.health.findings):
        return step
    if d.verdict == "nothing":  # of a model without unknowns nothing is to be identified
        if step := repairing_step(d.fit):
            return step
        return Step("identify" if len(d.fit.columns) else "monitor")
    if incomplete_before(d):
        return Step("grow")
    if d.best is not None and d.also and len(d.fit.columns):  # which `grow` names, too
        return Step("grow")
    separates = isinstance(next_experiment(d).suggestions[0], SeparateRivals)
    if d.health.good and d.rivals and separates:
        return next_experiment(d).step
    if d.best is not None:
        named = tuple(effect.label for effect in d.group)
        # a model in which everything is known is a reference, and stays as it is
        return Step("add" if len(d.fit.columns) else "diagnose", named)
    if d.laws:
        return Step("add", (), tuple(law.option for law in d.laws))
    return Step("explore")


def inseparable_effects(d: Diagnosis) -> tuple[Effect, ...]:
    """Return the effects that no motion tells apart, where that is what a diagnosis ends with."""
    first = next_experiment(d).suggestions[0]
    return first.effects if isinstance(first, Inseparable) else ()


def before_words(fit: Fit) -> str:
    """Return what the errors of a fit are of, to which effects are added: unlike the URDF's
    numbers, its own are fitted to the same log.
    """
    if not len(fit.columns):
        return EARLIER_NUMBERS
    return REFITTED_MODEL if fit.mechanism.effects else REFITTED_BODIES


def assess_growth(history: History, *, acceptable: float | None = None) -> Assessment:
    """Judge a model that grew: from the model as given to the last one with all that is named."""
    d, first = history.diagnosis, history.steps[0].errors
    last = next((step.added for step in history.steps[::-1] if step.added), ())
    assessment = assess_diagnosis(d, acceptable=acceptable, added=history.added, grown=True)
    errors = {**errors_of(history.fit), **errors_with_named(d)}
    joints = [assessment.worst, *(joint for effect in last for joint in effect.joints)]
    step, answer, fit = assessment.next, assessment.good_enough, history.fit
    if fit.validation:  # a log that was held back answers
        held, floor = worst_on_validation(fit, lambda e, x: e.rms / (x or 1e-300))
        answer = good_enough(held, floor, acceptable=acceptable, logs=[*fit.validation])
    if d.verdict == "nothing":
        # what the log hides, another motion shows: on which the model is tested, too
        step = next_experiment(d).step or TESTING
        if answer.answer is Answer.YES and not next_experiment(d).step:
            step = watching_step(fit.motion)
        step = replace(step, grown=tuple(effect.label for effect in history.added))
        labels = [effect.label for effect in history.added]
        step = repairing_step(fit, labels, _with_rivals(history)) or step
    return Assessment(
        subject=assessment.subject,
        verdict=d.verdict,
        errors=joint_errors(first, errors, d.floor),
        compared=(before_words(history.fits[0]), "with all that is named"),
        causes=(*causes_of_growth(history), *assessment.causes),
        left=assessment.left,
        doubts=assessment.doubts,
        good_enough=answer,
        next=step,
        worst=next(filter(None, joints), ""),
    )


def _with_rivals(history: History) -> set[str]:
    """Return the labels of what was added in place of rivals: nobody can tell which is wrong."""
    return {label for step in history.steps for label, near in step.rivals_of.items() if near}


def causes_of_growth(history: History) -> tuple[NamedCause, ...]:
    """Return what was added and is still in the model, kind by kind, with its rivals."""
    rivals = {label: near for step in history.steps for label, near in step.rivals_of.items()}
    values = values_by_effect(history.fit)
    causes = []
    for effects in by_kind(history.added):
        for group in apart_with_rivals(effects, rivals):
            of_group = tuple(v for e in group for v in values.get(e.label, ()))
            causes.append(NamedCause(group, of_group, tuple(rivals.get(group[0].label, ()))))
    return tuple(causes)


def values_by_effect(fit: Fit) -> dict[str, tuple[Value, ...]]:
    """Return the values of a fit's effects by label."""
    return {effect.effect.label: tuple(effect.parameters) for effect in fit.effects}


def larger_on_validation(history: History) -> dict[str, list[tuple[str, float, float]]]:
    """Return by validation log the joints whose error was clearly smaller on an earlier rung, with
    that error and the last one as shares of the torque.
    """
    logs: dict[str, list[tuple[str, float, float]]] = {}
    for log, errors in history.fit.validation.items():
        for joint, error in errors.items():
            least = min(fit.validation[log][joint].rms for fit in history.fits)
            if error.relative and error.rms > HIGHER * least:
                before = least / error.rms * error.relative
                logs.setdefault(log, []).append((joint, before, error.relative))
    return logs
