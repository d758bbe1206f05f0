"""The verdict of a diagnosis in sentences: what it says, and how sure that is."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from ident.assess.assessment import Assessment
from ident.assess.diagnosis import assess_diagnosis
from ident.assess.verdict import (
    clock_is_a_rival,
    errors_with_named,
    formulas_explain,
    incomplete_before,
    is_open,
    joints_at_reversals,
    noisy_joints,
    share_unexplained,
    spoiling_faults,
)
from ident.diagnosis.changes import CODE
from ident.diagnosis.result import Diagnosis, Explanation
from ident.diagnosis.selection import Evidence
from ident.effects import Effect
from ident.effects.library import named
from ident.fit.findings import DRIVING, NEGATIVE_VALUE
from ident.information.evidence import MAIN_CAUSE
from ident.show.headline import causes_words, error_words, remainder_sentence
from ident.show.laws import numbers
from ident.text import listed, percent, places, shortlist, significant

NEAREST = 3  # shown: effects that are mentioned of those that are not credible
RAREST = 0.01  # shown: chance below which a hundred draws say no more than that it is rarer
VALUES = 7  # shown: joints whose values stand in the first lines


def verdict_line(d: Diagnosis, a: Assessment | None = None) -> str:
    """Return what was found, how far the error falls with it, and what is left; what is wrong with
    the data comes before effects.
    """
    a = a or assess_diagnosis(d)
    if wrong := spoiling_faults(d):
        title = "it changed within the log" if wrong[0].code == CODE else "the data look wrong"
        return f"{title}: {wrong[0].meaning}"
    if d.best is not None:
        clock = " or another scale of time" * clock_is_a_rival(d)
        apart = ", which this data cannot tell apart" * (bool(clock) and not d.rivals)
        return _sentences(a, error_words(a), f"Missing: {causes_words(a.causes)}{clock}{apart}")
    if then := incomplete_before(d):
        joints = [f"{joint} ({percent(error.relative)})" for joint, error in then.items()]
        return (
            f"{error_words(a)}. Nothing has changed, but the earlier model was incomplete: it left "
            f"more than noise in {shortlist(joints, NEAREST)} of its own log, too"
        )
    if d.verdict == "nothing":
        impossible = [x for x in d.fit.findings if x.code in (NEGATIVE_VALUE, DRIVING)]
        but = f", but not all is well: {impossible[0].meaning}" if impossible else ""
        return _sentences(a, error_words(a), f"Nothing is missing that this data could show{but}")
    if d.laws:
        does = "explains it" if formulas_explain(d) else "lowers the error"
        return _sentences(
            a,
            f"{error_words(a)} with a formula",
            f"No effect of the library explains it, but a formula {does}: {formulas_of(d)}",
        )
    if d.reversing:
        return (
            f"{error_words(a)}. Undecided: more than noise is left in {listed(d.loud)}, but only "
            "around reversals, where dry friction may have any value"
        )
    return _sentences(a, error_words(a))


def _sentences(a: Assessment, *parts: str) -> str:
    return ". ".join([*parts, *filter(None, [remainder_sentence(a)])])


def formulas_of(d: Diagnosis) -> str:
    """Return the formulas with their constants, and where more than noise is left with them."""
    texts = [f"torque of {x.joint} = {x.formula}, {numbers(x.parameters)}" for x in d.laws]
    last = errors_with_named(d)
    noisy = {*noisy_joints(last, d.floor)} & {*d.loud}
    even = f"; even with it more than noise is left in {listed(sorted(noisy))}" if noisy else ""
    return listed(texts) + even


def known_values(best: Explanation) -> str:
    """Return the values that the model has of an effect that it has."""
    known = [(v.name.rpartition(".")[2], v) for v in best.parameters if v.name in best.known]
    return shortlist(
        [
            f"{n} = {significant(best.known[v.name], 4)} {v.unit}".removesuffix(" 1")
            for n, v in known
        ]
    )


def certainty(d: Diagnosis) -> str:
    """Return how sure the verdict is, in a sentence, with the values of what is named."""
    if d.best is None:
        return _unnamed(d)
    best = d.candidates[0]
    p, rare = best.evidence.p, best.evidence.p < RAREST
    level = (
        f"false alarms below {100 * RAREST:g} %"
        if rare
        else (f"1 in {1 / p:.0f} logs in which nothing is missing would show as much")
    )
    form = ", but for its form" * bool(rare and d.relatives)  # others do as well
    sure = f"{'Certain' if rare else 'Not certain'}{form} ({level})"
    if (rest := share_unexplained(d)) > MAIN_CAUSE:
        sure = (
            f"Not certain that it is this: with it {100 * rest:.0f} % of the squared error beyond "
            f"noise stays in {best.joint}"
        )
    elif is_open(d):
        what = "It is certain" if rare else "It is not certain"
        sure = f"Which of these it is remains open. {what} that one is missing ({level})"
    known = f", in the model {known_values(best)}" * bool(best.known)
    # values of an effect are not to be relied on while much beside it is missing
    values = f" {_capital_values(d)}{known}." * (not d.also)
    text = f"{sure}.{values}"
    by_label = {x.effect.label: x.evidence.p for x in d.every}
    weak = [x for x in d.group if by_label.get(x.label, 0.0) > d.decision.alpha]
    if weak:
        text += (
            f" By itself {named(weak)} explains no more than chance can: it is named for what it "
            "explains beside the others."
        )
    return text


def _capital_values(d: Diagnosis) -> str:
    """Return the values of all that is named, joint by joint."""
    order = [*d.fit.mechanism.joint_index]
    group = sorted(
        d.group, key=lambda effect: [order.index(j) for j in effect.joints if j in order]
    )
    labels = [effect.label for effect in group]
    by_label = {x.effect.label: x for x in d.every}
    if len(labels) == 1 and not is_open(d):
        return numbers(by_label[labels[0]].parameters)
    kinds = {by_label[label].effect.kind for label in labels}
    texts = []
    for effect in (by_label[label].effect for label in labels):
        site = places(effect.joints)
        place = site if site and len(kinds) == 1 else " of ".join(filter(None, (effect.kind, site)))
        texts.append(f"{place} {numbers(by_label[effect.label].parameters)}")
    return shortlist(texts, VALUES)


def _unnamed(d: Diagnosis) -> str:
    """Return how many effects were tried, and what comes nearest."""
    tried = sum(not candidate.curve for candidate in d.selection.first.contest.candidates)
    more = [item for item in d.every if item.evidence.p < d.decision.alpha]
    further = f"{tried}{' more' * bool(d.fit.mechanism.effects)} effects were tried"
    text = f"{further}; none of them helps more than chance"
    if d.selection.members or d.laws:
        text = f"{tried} effects were tried; none explains it"
    elif more:
        near = _not_named(d, [element.evidence for element in more[:NEAREST]])
        text = f"{further}; none is named. Nearest: {near}"
    turns = [] if d.reversing else joints_at_reversals(d)
    where = f" What is left in {places(turns)} is near reversals, where friction does not jump "
    return f"{text}.{f'{where}as in the model.' * bool(turns)}"


def _not_named(d: Diagnosis, evidence: Sequence[Evidence]) -> str:
    reasons: dict[str, list[Effect]] = {}
    for e in evidence:
        why = "with an impossible value"
        if e.sensible:
            small = e.size <= d.decision.material
            why = "too small to matter away from reversals" if small else "not sure"
        reasons.setdefault(why, []).append(e.effect)
    return "; ".join(f"{named(effects)} ({why})" for why, effects in reasons.items())


def doubts_words(findings: Iterable[object]) -> list[str]:
    """Return the doubts on the data as sentences."""
    return [f"The data look wrong: {finding}." for finding in findings]
