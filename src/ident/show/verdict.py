"""The verdict of a diagnosis in a sentence, how sure it is, and what an earlier fit left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from ident.diagnosis.result import Diagnosis, Explanation, errors_of
from ident.diagnosis.selection import Evidence
from ident.effects import KINDS, Effect
from ident.effects.library import named
from ident.finding import Finding
from ident.fit import Fit
from ident.fit.files import Saved
from ident.fit.findings import DRIVING, NEGATIVE_VALUE
from ident.fit.residual import Failure
from ident.information.blocks import Error
from ident.show.card import MATERIAL, NOISY, spoiling, too_large
from ident.show.laws import numbers, solved
from ident.text import listed, percent, places, significant, some

MOST = 3  # effects that are mentioned of those that are not credible
PART = 0.5  # share that stays beyond noise, from which a name may be that of another cause
RAREST = 0.01  # chance below which a hundred draws say no more than that it is rarer


def noise_errors(fit: Fit) -> dict[str, Error]:
    """Return what noise alone would leave in each joint, beside the errors of its fit."""
    return {
        n: replace(e, rms=x, relative=e.relative and e.relative * x / max(e.rms, 1e-300))
        for n, e in errors_of(fit).items()
        for x in [fit.noise[n]]
        if not fit.train[n].unmeasured
    }


def failing(d: Diagnosis) -> list[Failure]:
    """Return the joints in which more than noise is left, the worst first; none if clean."""
    if d.verdict == "nothing":
        return []
    errors = errors_of(d.fit)
    return [f for f in d.where if errors[f.joint].rms > NOISY * d.floor[f.joint]] or [*d.where[:1]]


def spoilt(d: Diagnosis) -> list[Finding]:
    """Return the faults of the data that explain the log, where no effect is named beside them."""
    return [] if d.best else spoiling(d.health)


def verdict_line(d: Diagnosis) -> str:
    """Return the verdict in one sentence; what is wrong with the data comes before effects."""
    if wrong := spoilt(d):
        return f"the data look wrong: {wrong[0].meaning}"
    if d.best is not None:
        names = named([d.best, *d.rivals], "or") if d.rivals else named(d.group)
        clock = " or another scale of time" * _clock(d)
        apart = ", which this data cannot tell apart" * open_between(d)
        return f"missing: {'other values of ' * bool(d.candidates[0].known)}{names}{clock}{apart}"
    if left := left_before(d):
        return (
            "nothing has changed, but the earlier model was incomplete: it left more than noise in "
            f"{some(left, MOST)} of its own log, too"
        )
    formulas = listed(
        [f"torque of {law.joint} = {law.formula}, {numbers(law.parameters)}" for law in d.laws]
    )
    last = d.laws[-1].after if d.laws else {}  # its fit has all laws
    if open_ := [name for name in d.loud if d.laws and last[name].rms > NOISY * d.floor[name]]:
        formulas += f"; even with it more than noise is left in {listed(open_)}"
    if d.reversing:
        return (
            f"undecided: more is left in {listed(d.loud)} than the sensors' noise, but only around "
            "reversals, where dry friction may have any value"
        )
    impossible = [each for each in d.fit.findings if each.code in (NEGATIVE_VALUE, DRIVING)]
    but = f", but not all is well: {impossible[0].meaning}" if impossible else ""
    does = "does" if solved(d) else "lowers the error"
    return {
        "nothing": f"nothing is missing that this data could show{but}",
        "unexplained": "unexplained: something is missing, and no effect of the library explains "
        + ("it" if not d.laws else f"it, but a formula {does}: {formulas}"),
        "undecided": f"undecided: more is left in {listed(d.loud)} than the sensors' noise, and "
        "this log cannot tell coloured noise from physics",
    }[d.verdict]


def known_values(best: Explanation) -> str:
    """Return the values that the model has of an effect that it has."""
    own = [(v.name.rpartition(".")[2], v) for v in best.parameters if v.name in best.known]
    return some(
        [f"{n} = {significant(best.known[v.name], 4)} {v.unit}".removesuffix(" 1") for n, v in own]
    )


def _stays(d: Diagnosis, after: Mapping[str, Error]) -> float:
    """Return the share of squares beyond noise that the group leaves where the first name acts."""
    joint = d.candidates[0].joint
    if joint not in d.loud:
        return 0.0
    floor = d.floor[joint] ** 2
    before, left = (max(e.rms**2 - floor, 0.0) for e in (errors_of(d.fit)[joint], after[joint]))
    return left / max(before, floor)


def _clock(d: Diagnosis) -> bool:
    """Return whether another scale of time does as well as the best effect."""
    return any(each.code == "time" for each in d.health.findings)


def open_between(d: Diagnosis) -> bool:
    """Whether this data cannot tell something from the best effect."""
    return bool(d.rivals) or _clock(d)


def left_before(d: Diagnosis) -> list[str]:
    """Return the joints, with errors, in which an earlier model left more than noise in its log
    and leaves no more here; none where it does worse in some joint than then.
    """
    earlier = d.fit.earlier
    errors = earlier.errors if isinstance(earlier, Saved) else {}
    then = errors.get("held out") or errors.get("train") or {}
    if d.verdict == "nothing" or d.fit.residual.increased_errors(then):
        return []
    return [f"{j} ({percent(then[j].relative)})" for j in too_large(then, d.floor, MATERIAL)]


def separable(d: Diagnosis) -> tuple[str, ...]:
    """Return the best effect and a rival that `ident excite` can tell apart, at another place if
    there is one. Of bodies it cannot: only some of their ten parameters differ.
    """
    single = [x for x in d.advice.apart if not (x.signal or x.loaded_link) and x.kind in KINDS]
    best, apart = d.best, {each.label for each in single}
    rivals = [each for each in d.rivals if each.label in apart]
    if best is None or not rivals or best.label not in apart:
        return ()
    rival = next((each for each in rivals if each.kind == best.kind), rivals[0])
    return best.label, rival.label


def certainty(d: Diagnosis) -> str:
    """Return how sure the verdict is, in a sentence."""
    if d.best is None:
        more = [each for each in d.every if each.evidence.p < d.decision.alpha]
        none = "none explains it" if d.selection.members or d.laws else "none does more than chance"
        if more and not d.selection.members and not d.laws:
            none = f"none is named ({_not_named(d, [each.evidence for each in more[:MOST]])})"
        tried = sum(not each.curve for each in d.selection.first.contest.candidates)
        left = [] if d.reversing else at_reversals(d)
        where = f" What is left in {places(left)} is near reversals, where friction does not jump "
        where = f"{where}as in the model." * bool(left)
        return f"{tried} effects were tried, and {none}.{where}"
    best = d.candidates[0]
    certain = "Sure" if best.evidence.p < RAREST else "Not sure"
    if (stays := _stays(d, d.after)) > PART:
        certain = (
            f"Not sure that it is this (with it {100 * stays:.0f} % of the squared error beyond "
            f"noise stays in {best.joint})"
        )
    elif open_between(d):
        certain = f"Which of these it is remains open. It is {certain.lower()} that one is missing"
    value = f"{named([d.best])}: " if len(d.group) > 1 or open_between(d) else ""
    known = f", in the model {known_values(best)}" * bool(best.known)
    p, rare = best.evidence.p, best.evidence.p < RAREST
    logs = f"fewer than 1 in {1 / RAREST:,.0f}" if rare else f"1 in {1 / p:.0f}"
    chance = f"{logs} logs in which nothing is missing would show as much"
    found = f"{certain}: {chance}; {value}{numbers(best.parameters)}{known}."
    alone = {each.effect.label: each.evidence.p for each in d.every}
    weak = [each for each in d.group if alone.get(each.label, 0.0) > d.decision.alpha]
    beside = (
        f" By itself {named(weak)} explains no more than chance can: it is named for what it "
        "explains beside the others."
    )
    return found + beside * bool(weak)


def _not_named(d: Diagnosis, some: Sequence[Evidence]) -> str:
    reasons: dict[str, list[Effect]] = {}
    for e in some:
        why = "with an impossible value"
        if e.sensible:
            small = e.size <= d.decision.material
            why = "too small to matter away from reversals" if small else "not sure"
        reasons.setdefault(why, []).append(e.effect)
    return "; ".join(f"{why}: {named(own)}" for why, own in reasons.items())


def at_reversals(d: Diagnosis) -> list[str]:
    """Return joints where nothing is named, more than noise is left, and reversals fit worse."""
    if d.reversing:
        return [*d.loud]
    worse = {j for each in d.fit.all_findings if each.code == "reversals" for j in each.where}
    errors = errors_of(d.fit) if d.verdict == "nothing" else {}
    return [j for j, e in errors.items() if j in worse and e.rms > NOISY * d.floor[j]]
