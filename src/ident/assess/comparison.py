"""The judgement on models side by side: what has changed since a fit, or from model to model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from ident.assess.assessment import Assessment, Remainder
from ident.assess.errors import NOISY, JointErrors, joint_errors, largest_change
from ident.assess.good_enough import good_enough
from ident.assess.machine import watching_step
from ident.fit.identify import Comparison
from ident.information.blocks import Error
from ident.information.estimate import MATERIAL
from ident.request import Step

# shown: of the torque of every joint, from which a log may be of another machine
OTHERWISE = 0.1
SAME_ROWS = 0.02  # shown: of an error: a fit may weigh the rows of its own log otherwise
NamedErrors = tuple[str, Mapping[str, Error]]  # what the errors are, as `held-out error`; by joint


def fitted_errors(c: Comparison, name: str) -> Mapping[str, Error]:
    """Return a model's errors when it was fitted, held out in time where that is known."""
    return c.fitted[name].get("held out") or c.fitted[name].get("train") or {}


def is_fitted_log(c: Comparison, name: str) -> bool:
    """Return whether the motion is the one that a model was fitted to."""
    errors, train = c.errors[name], c.fitted[name].get("train", {})
    return train.keys() == errors.keys() and all(
        math.isclose(train[j].rms, e.rms, rel_tol=SAME_ROWS) for j, e in errors.items()
    )


def errors_that_count(c: Comparison, name: str) -> NamedErrors:
    """Return a model's errors, on the data of its own fit those held out of it, with their name."""
    if not is_fitted_log(c, name):
        return "error", c.errors[name]
    held_out = c.fitted[name].get("held out")
    return "held-out error" if held_out else "error in the fit", fitted_errors(c, name)


def _larger(bar: JointErrors, changed: Sequence[str]) -> bool:
    """Return whether an error is larger than at the fit: where it has `changed`, and if anything
    has, where it is larger too and above the noise.
    """
    if bar.joint in changed or not changed:
        return bar.joint in changed
    return bar.rises and bar.times_noise > NOISY


def assess_comparison(
    c: Comparison, *, names: Mapping[str, str], acceptable: float | None = None
) -> Assessment:
    """Judge one model beside its own fit, or the last of several beside the first.

    Args:
        c: the comparison.
        names: of models as they are shown.
        acceptable: share of the torque that the user accepts.
    """
    first, last = (list(c.residuals.values())[i] for i in (0, -1))
    alone, floor = first is last, last.noise
    errors = errors_that_count(c, last.name)[1]
    before = fitted_errors(c, first.name) if alone else errors_that_count(c, first.name)[1]
    now = {joint for joint, e in errors.items() if not e.unmeasured}
    blind = [joint for joint, e in before.items() if e.unmeasured and joint in now]
    before = {joint: e for joint, e in before.items() if joint not in blind}
    changed = first.increased_errors(before) if alone else []
    bars = joint_errors(before, errors, floor)
    if alone:  # one decision, which holds the scatter of motions and the noise of this log
        bars = tuple(replace(bar, larger=_larger(bar, changed)) for bar in bars)
    fitted, logs = is_fitted_log(c, last.name), [trace.name for trace in first.traces]
    answer = good_enough(
        errors, floor, acceptable=acceptable, away_from_reversals=last.errors_away_from_reversals,
        logs=[] if fitted else logs,
    )  # fmt: skip
    rises, falls = [b for b in bars if b.rises], [b for b in bars if b.falls]
    if alone:
        verdict = "changed" if changed else "unchanged"
        compared = ("when it was fitted", "on this log") if before and not fitted else ("", "")
    else:
        verdict = {(True, True): "mixed", (True, False): "rises", (False, True): "falls"}.get(
            (bool(rises), bool(falls)), "same"
        )
        compared = names[first.name], names[last.name]
    differs = bool(changed)
    watch = watching_step(last.motion)
    step = Step("diagnose", known=differs) if differs or not answer.fits else watch
    joints = [] if alone else largest_change(first.errors, last.errors)
    worst = next(iter([*changed, *joints]), "")
    models = names[first.name] if alone else f"{names[first.name]} → {names[last.name]}"
    return Assessment(
        subject=f"{models} on {', '.join(logs)}",
        verdict=verdict,
        errors=bars,
        compared=compared,
        left=Remainder.of(errors, floor, material=MATERIAL),
        good_enough=answer,
        next=step,
        worst=worst,
        changed=tuple(changed),
        unmeasured_before=tuple(blind),
        other_machine=differs and all((b.now.relative or 0.0) > OTHERWISE for b in bars),
    )
