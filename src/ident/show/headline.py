"""An assessment in words: what was gained, what was found, what is left, and whether that will do.

Error 31–112 % → 0.4–0.8 %. Found: dry friction in joint1 to joint7. Left: …
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from ident.assess.assessment import Assessment, NamedCause, Range, Remainder
from ident.assess.errors import BEFORE_NAMES
from ident.assess.good_enough import Answer, GoodEnough, Reason
from ident.effects import Effect
from ident.effects.library import effect_noun, named
from ident.fit.values import Value
from ident.show.body import body_words
from ident.text import listed, percent, places, rounded, shortlist, significant, two_digits

ABOUT = 1.2  # shown: times the noise, up to which an error is called noise
CLEAR = 10.0  # shown: times the noise, beyond which the number says nothing
MANY = 3  # shown: joints, from which they are counted in the first line
CAUSES = 5  # shown: causes in the first line
VALUES, GROUPS = 8, 6  # shown: values of one parameter, and parameters, in the first lines


def share_words(shares: Range) -> str:
    """Return a range of shares of the torque in percent.

    >>> share_words((0.312, 1.12)), share_words((0.0041, 0.0041)), share_words((0.004, 0.0079))
    ('31–112 %', '0.41 %', '0.4–0.79 %')
    """
    low, high = (_percent(share) for share in shares)
    if high == low:
        return percent(shares[1]) if "over" in high else f"{high} %"
    return f"{low}–{high} %" if "over" not in high else f"{low} % to {high} %"


def _percent(share: float) -> str:
    if share > 10.0:
        return "over 1000"
    return f"{100 * share:.0f}" if share >= 0.1 else significant(100 * share, 2)


def times_words(times: Range) -> str:
    """Return a range of multiples of the noise, the word `times` included; empty where it is so
    large that it says nothing, or unknown.

    >>> times_words((2.04, 3.9)), times_words((2.0, 2.01))
    ('2 to 3.9 times', '2 times')
    """
    if times[1] > CLEAR or math.isinf(times[1]):
        return ""
    low, high = map(two_digits, times)
    return f"{high} times" if low == high else f"{low} to {high} times"


def error_words(a: Assessment) -> str:
    """Return the error before and now as shares of the torque, all joints in a range."""
    now = a.now
    if now is None and a.freely is not None:
        return f"no torque acts; it swings freely, error {percent(a.freely)} of gravity's torque"
    if now is None:
        return "no torque was measured that could be compared"
    if a.before is None:
        return f"error {share_words(now)} of the torque"
    name = a.compared[0].removeprefix("with ")
    before = f" ({name})" * (a.compared[0] in BEFORE_NAMES)
    return f"error {share_words(a.before)}{before} → {share_words(now)}"


def cause_words(cause: NamedCause, alone: bool = True) -> str:
    """Return a cause: effects of one kind with their joints, counted where they are many, and what
    this data cannot tell from them, in brackets where it is not `alone`.
    """
    words = effects_words(cause.effects)
    if cause.rivals:
        rivals = f"or {named(cause.rivals, 'or')}"
        words += f" {rivals}, which this data cannot tell apart" if alone else f" [{rivals}]"
    return f"{'other values of ' * cause.changed}{words}"


def values_words(causes: Sequence[NamedCause]) -> str:
    """Return the values of what was found with their standard errors, those of one parameter of
    several joints together; empty without any.
    """
    groups: dict[tuple[str, str, str], list[str]] = {}
    bodies = []
    for effect, values in values_by_effect(causes):
        if effect.loaded_link:
            words = body_words(values)
            bodies += [f"{effect_noun(effect)} on {effect.loaded_link}: {words}"] * bool(words)
            continue
        for value in values:
            if value.stderr is None or not math.isfinite(value.stderr):
                continue
            key = effect_noun(effect), value.name.rpartition(".")[2], value.unit
            number = rounded(value.value, value.stderr)
            if effect.kind == "torque_gain":  # of the torque that is read too much
                number += f" (it reads {1 + value.value:.3g} times the torque)"
            groups.setdefault(key, []).append(f"{'/'.join(effect.joints)} {number}".strip())
    texts = [
        f"{noun} {name}: {shortlist(numbers, VALUES)} {unit}".removesuffix(" 1")
        for (noun, name, unit), numbers in groups.items()
    ]
    return "; ".join([*bodies, *texts[:GROUPS], *["more in the tables"] * (len(texts) > GROUPS)])


def values_by_effect(causes: Sequence[NamedCause]) -> list[tuple[Effect, list[Value]]]:
    """Return each effect of the causes with its own values."""
    return [
        (effect, [v for v in cause.values if v.name in effect.names])
        for cause in causes
        for effect in cause.effects
    ]


def effects_words(effects: Sequence[Effect]) -> str:
    """Return effects of one kind, of many joints their number."""
    single = [effect.joints[0] for effect in effects if len(effect.joints) == 1]
    if len(single) < len(effects) or len(single) <= MANY or any(x.signal for x in effects):
        return named(effects)
    return f"{effect_noun(effects[0])} in {joints_words(single)}"


def causes_words(causes: Sequence[NamedCause]) -> str:
    """Return all causes; the kinds of effects in the same joints together."""
    same: dict[tuple[str, ...], list[NamedCause]] = {}
    for i, cause in enumerate(causes):
        similar = not (cause.rivals or cause.changed or any(x.signal for x in cause.effects))
        single = similar and all(len(effect.joints) == 1 for effect in cause.effects)
        joints = sorted(effect.joints[0] for effect in cause.effects) if single else [f"{i}"]
        same.setdefault((str(single), *joints), []).append(cause)
    words, alone = [], len(same) == 1
    for group in same.values():
        if not group[1:]:
            words.append(cause_words(group[0], alone))
            continue
        nouns = [effect_noun(cause.effects[0]) for cause in group]
        joints = [effect.joints[0] for effect in group[0].effects]
        words.append(f"{_common_noun(nouns)} in {joints_words(joints)}")
    text = shortlist(words, CAUSES)
    # one that the list leaves out has no brackets
    unclear = "; what is in brackets this data cannot tell from it" * ("[or" in text)
    return f"{text}{unclear}"


def _common_noun(nouns: Sequence[str]) -> str:
    """Return nouns as an enumeration, the last word once if they share it.

    >>> _common_noun(["viscous friction", "dry friction"])
    'viscous and dry friction'
    """
    lasts = {noun.rpartition(" ")[2] for noun in nouns}
    firsts = [noun.rpartition(" ")[0] for noun in nouns]
    return f"{listed(firsts)} {lasts.pop()}" if len(lasts) == 1 and all(firsts) else listed(nouns)


def joints_words(joints: Sequence[str]) -> str:
    """Return joints by name, of many their number, unless their names make a range."""
    names = places(joints)
    return names if len(joints) <= MANY or " to " in names else f"{len(joints)} joints"


def left_words(remainder: Remainder) -> str:
    """Return how much is left beyond noise, in which joints, and where; empty where noise is all
    that is left.
    """
    if not remainder.joints:
        return ""
    size = f"{share_words(remainder.share)} of the torque" if remainder.share else "more than noise"
    times = times_words(remainder.times) if remainder.times else ""
    aside = f" ({times} the noise)" if times else ""
    where = ", near reversals only" if remainder.near_reversals else ""
    return f"{size}{aside} in {joints_words(remainder.joints)}{where}"


def headline(a: Assessment) -> str:
    """Return what was gained, what was found, and what is left: the first line of every result."""
    worse = a.verdict == "identified" and a.before is not None and a.increased
    larger = f", larger in {joints_words(a.increased)}" if worse else ""
    parts = [f"{a.subject}: {error_words(a)}{larger}"]
    if a.causes:
        parts.append(f"Found: {causes_words(a.causes)}")
    parts.append(remainder_sentence(a))
    return ". ".join(filter(None, parts)) + "."


def remainder_sentence(a: Assessment) -> str:
    """Return what is left in a sentence without its full stop, and whether anything explains it."""
    remainder = left_words(a.left)
    if a.verdict == "identified" and remainder and not a.causes:
        return ""  # it is the error itself
    if a.verdict == "nothing" and a.left.within_known:
        return (
            f"Left: {remainder}, no more than the standard errors of the known values make here: "
            "identify them on this log, too"
        )
    if a.verdict == "nothing":
        return (
            f"Left: {remainder}, too little to matter"
            if remainder
            else "Left: noise of the sensors"
        )
    if not remainder:
        return "Left: noise of the sensors" if a.floor and a.verdict != "unexplained" else ""
    why = {
        "unexplained": "; no effect of the library explains that",
        "undecided": "; this log cannot tell whether that is noise or physics",
    }.get(a.verdict, "")
    return f"Left: {remainder}{why}"


def good_enough_words(answer: GoodEnough) -> str:
    """Return whether the errors are good enough, in a sentence; empty where nothing can be said."""
    if answer.reason is Reason.UNKNOWN or answer.errors is None:
        return ""
    logs = f" on {shortlist([*answer.logs], 2)}" if answer.logs else ""
    ask, size = f"Good enough{logs}?", share_words(answer.errors)
    noise = f"; noise would leave {share_words(answer.noise)}" if answer.noise else ""
    turns = (
        ", near reversals only, where a smoothed speed misses the jump of dry friction"
        * answer.near_reversals
    )
    if answer.reason is Reason.HIDDEN and answer.noise:
        size = f"{percent(answer.noise[1])} of the torque of {answer.joints[0]}"
        return f"{ask} These logs cannot show it: noise is {size}."
    if answer.reason is Reason.DOUBTFUL:
        return f"{ask} Doubtful: it fits, but the size of the torques looks wrong."
    if answer.reason is Reason.COMPUTED:
        return f"{ask} No: a model computed these torques, so that it fits itself says nothing."
    if answer.reason is Reason.LARGE:
        if answer.answer is Answer.NOT_TESTED:
            return f"It fits this log to {size} of the torque{noise}{turns}; not tested on another."
        of = f"{len(answer.joints)} of {answer.count} joints"
        if len(answer.joints) < min(answer.count, MANY + 1):
            of = listed(answer.joints)
        beyond = f", more than {percent(answer.acceptable)}" * answer.stated
        return f"{ask} No: the error is {size} of the torque in {of}{beyond}{noise}{turns}."
    how = "noise of the sensors"
    if answer.times and answer.times > ABOUT:
        how = f"at most {two_digits(answer.times)} times the noise of the sensors"
    if answer.reason is Reason.SMALL:
        how = f"noise, or below {percent(answer.acceptable)} of the torque"
    if answer.answer is Answer.YES:
        return f"{ask} Yes: in every joint the error is {how} ({size})."
    return f"It fits this log: in every joint the error is {how}; not tested on another."
