"""What speaks against the form of a law that explains much.

A law is a special case of a curve of the same signals. Where a curve explains more beside the law
than the best candidate does by chance, and more than a share PARSIMONY of what both explain, the
law has the wrong form; so it has where a law with impossible values explains its part and more, or
twice as much of its joint.
"""

from __future__ import annotations

from dataclasses import replace

from ident.diagnosis.effect_set import Member
from ident.diagnosis.selection import MOST, PARSIMONY, Ranking
from ident.effects import Effect
from ident.information.hypotheses import PartialRegression


def doubted(member: Member, bare: PartialRegression, last: Ranking) -> Member:
    """The member with what speaks against it: a curve, or a law with impossible values.

    `bare`: the set without the member; `last`: all candidates beside the set.
    """
    impossible = _impossible(member, bare, last)
    return replace(member, curve=_curve(member, last), impossible=impossible)


def _curve(member: Member, last: Ranking) -> Effect | None:
    joints, gain = set(member.effect.joints), member.gain
    for curve, more in last.curves:
        if joints & set(curve.joints[:1]) and more > PARSIMONY * (gain + more):
            richer = _with_best_law(curve.joints[0], last)
            own = next(each for each in last.contest.candidates if each.effect == curve)
            place = last.regression.place(own.groups[0])
            more = float(richer.explained(richer.gains(own.groups).by).max())
            if richer is last.regression or more > max(last.chance.limit(place), PARSIMONY * gain):
                return curve
    return None


def _impossible(member: Member, bare: PartialRegression, last: Ranking) -> Effect | None:
    """A law with impossible values that explains more, and either leaves the member no more than
    chance explains, so that both stand in for one unknown cause, or explains twice the squares of
    the member's joint, whose greater part then has an unknown cause.
    """
    assert member.evidence is not None
    mended, u = set(member.evidence.mends), member.evidence.coordinate
    for each in last.evidence:
        more = each.gain > max(each.limit, member.gain)
        if each.sensible or not more or not mended & set(each.mends):
            continue
        groups = next(c for c in last.contest.candidates if c.effect == each.effect).groups
        columns = groups[last.gains[each.effect.label][2]]
        mine, others = bare.gains([member.columns, columns]).by
        beside = bare.extended(columns)
        own = float(beside.explained(beside.gains([member.columns]).by)[0])
        if own <= last.chance.limit(bare.place(member.columns)) or mine[u] < MOST * others[u]:
            return each.effect
    return None


def _with_best_law(joint: str, last: Ranking) -> PartialRegression:
    """The model with the law of a joint that explains most beside it, credible or not.

    What such a law explains speaks against no other law's form.
    """
    laws = [
        each
        for each in last.contest.candidates
        if not each.curve and joint in each.effect.joints and each.effect.label in last.gains
    ]
    if not laws:
        return last.regression
    best = max(laws, key=lambda each: last.gains[each.effect.label][0])
    start = int(last.regression.explained(last.regression.gains(best.groups).by).argmax())
    return last.regression.extended(best.groups[start])
