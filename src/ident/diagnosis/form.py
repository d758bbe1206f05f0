"""What speaks against the form of a law that explains much.

A law is a special case of a curve of the same signals. Where a curve explains more beside the law
than the best candidate does by chance, and more than a share PARSIMONY of what both explain, the
law has the wrong form; so it has where a law with impossible values explains its part and more, or
twice as much of its joint.

A law has one value of each coefficient, in slow and in fast motion. So a response to the past of
its joint's speed, a smooth function of frequency, is a curve too: friction that lags behind the
speed is not taken for hysteresis or viscous friction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ident.diagnosis.effect_set import Member
from ident.diagnosis.selection import MOST, PARSIMONY, Ranking
from ident.effects import Effect
from ident.effects.curve import PastSpeed
from ident.information.hypotheses import Index, PartialRegression


@dataclass(frozen=True, eq=False)
class Responses:
    """Responses to the past speed of each joint beside a set of effects.

    Attributes:
        beside: all candidates beside the set, on rows that have the responses' columns too.
        credible: responses that explain more than chance, with their columns and the share of the
            left-out squares.
    """

    beside: Ranking
    credible: tuple[tuple[Effect, Index, float], ...]

    @classmethod
    def of(cls, last: Ranking) -> Responses:
        """The responses of all joints that have curves; `last`: all candidates beside a set."""
        table, limit = last.contest.table, last.with_curves.limit
        cutoff = table.motion.band.cutoff or 0.25 * min(scene.e.rate for scene in table.scenes)
        shortest = {"T": 0.5 / (np.pi * cutoff)}
        regression = last.regression.judging([p.Y[:, :1] for p in last.regression.parts])
        contest, found = replace(last.contest, regression=regression), []
        for joint in dict.fromkeys(e.effect.joints[0] for e in last.contest.candidates if e.curve):
            response = table.mechanism.placed(PastSpeed((joint,), shortest, signal="past v"))
            contest, columns = contest.added(contest.columns(response, {}))
            found.append((response, columns))
        regression = contest.regression
        gains = regression.explained(regression.gains([columns for _, columns in found]).by)
        credible = tuple(
            (response, columns, float(more))
            for (response, columns), more in zip(found, gains, strict=True)
            if more > limit(regression.place(columns))
        )
        return cls(replace(last, contest=contest, regression=regression), credible)


def doubted(member: Member, bare: PartialRegression, last: Ranking, responses: Responses) -> Member:
    """The member with what speaks against it: a curve, or a law with impossible values.

    `bare`: the set without the member; `last`: all candidates beside the set, with `responses`.
    """
    impossible = _impossible(member, bare, last)
    curve = _curve(member, last) or _past(member, responses)
    return replace(member, curve=curve, impossible=impossible)


def _curve(member: Member, last: Ranking) -> Effect | None:
    for curve, more in last.curves:
        joint = curve.joints[0]
        if joint in member.effect.joints and more > PARSIMONY * (member.gain + more):
            own = next(each for each in last.contest.candidates if each.effect == curve)
            if _beside_best_law(own.groups[0], joint, member, last):
                return curve
    return None


def _past(member: Member, responses: Responses) -> Effect | None:
    """A response that explains much beside the set: of a joint of the law, whose coefficients are
    then not the same in slow and in fast motion, or one that leaves the law no more than chance.
    """
    last, regression = responses.beside, responses.beside.regression
    for response, columns, more in responses.credible:
        (joint,) = response.joints
        if joint in member.effect.joints:
            if more > PARSIMONY * (member.gain + more) and _beside_best_law(
                columns, joint, member, last
            ):
                return response
            continue
        instead = regression.extended(columns).without(member.columns)
        own = float(instead.explained(instead.gains([member.columns]).by)[0])
        if own <= last.chance.limit(regression.place(member.columns)):
            return response
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


def _beside_best_law(columns: Index, joint: str, member: Member, last: Ranking) -> bool:
    """Return whether columns explain as much beside the law of a joint that explains most beside
    the set, credible or not: what such a law explains speaks against no other law's form.
    """
    laws = [
        each
        for each in last.contest.candidates
        if not each.curve and joint in each.effect.joints and each.effect.label in last.gains
    ]
    if not laws:
        return True
    best = max(laws, key=lambda each: last.gains[each.effect.label][0])
    start = int(last.regression.explained(last.regression.gains(best.groups).by).argmax())
    richer = last.regression.extended(best.groups[start])
    more = float(richer.explained(richer.gains([columns]).by)[0])
    limit = last.chance.limit(last.regression.place(columns))
    return more > max(limit, PARSIMONY * member.gain)
