"""A model with a set of effects added, on the rows of one fit, and what speaks against a member.

No model is refitted. A law is a special case of a curve of the same signals. Where a curve explains
more beside the law than the best candidate does by chance, and more than a share PARSIMONY of what
both explain, the law has the wrong form; so it has where a law with impossible values explains its
part and more, or twice as much of its joint.

A law has one value of each coefficient, in slow and in fast motion. So a response to the past of
its joint's speed, a smooth function of frequency, is a curve too: friction that lags behind the
speed is not taken for hysteresis or viscous friction.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ident.diagnosis.candidates import ColumnStore, Contest
from ident.diagnosis.law_search import refined
from ident.diagnosis.selection import (
    PARSIMONY,
    Evidence,
    Ranking,
    behind,
    rivals,
    same_part,
    sensible,
    shape_before,
    simplest,
)
from ident.effects import Effect
from ident.effects.curve import PastSpeed
from ident.effects.formula import Formula
from ident.information import linear
from ident.information.evidence import MAIN_CAUSE, credible, limit_by_coordinate
from ident.information.hypotheses import Array, Index, PartialRegression
from ident.information.projection import EXACT


@dataclass(frozen=True, eq=False)
class Member:
    """An effect of a set."""

    effect: Effect
    columns: Index  # in the regression
    evidence: Evidence | None = None  # when it was chosen; None of an effect of the fit
    rivals: tuple[Evidence, ...] = ()  # then, or beside the rest of the set if it came with others
    gain: float = np.nan  # rise of the left-out squares of the whole set without it, as a share
    curve: Effect | None = None  # that explains much beside it: the law has the wrong form
    # a law that explains more of the joint, with values that no machine has: the cause is another
    impossible: Effect | None = None
    law: Formula | None = None  # that stands in its place, because it has the right form
    stands_in: bool = False  # whether its columns are of another effect, for which it stands
    grouped: bool = False  # whether it came with others, which every machine has or a path has
    path: float | None = None  # chance of the path with which it came, if it did

    @property
    def rejected(self) -> bool:
        """Whether something speaks against its form."""
        return any(objection is not None for objection in (self.curve, self.impossible, self.law))

    @property
    def label(self) -> str:
        """The effect's label."""
        return self.effect.label


def leading(members: Sequence[Member]) -> list[Member]:
    """Return what is added at once: the first, with those of its kind at other joints; the first
    alone where it has rivals, stands for another effect or is a load, of which a machine takes up
    one at a time. A path is added as a whole.
    """
    first, *rest = members
    if first.path is not None:
        return [first, *(m for m in rest if m.path is not None)]
    alone = first.rivals or first.stands_in or first.effect.loaded_link
    return [first, *(m for m in rest if not alone and m.effect.kind == first.effect.kind)]


@dataclass(frozen=True, eq=False)
class EffectSet:
    """The model with a set of effects added, on the rows of one fit."""

    contest: Contest
    members: tuple[Member, ...] = ()

    @property
    def regression(self) -> PartialRegression:
        """The model with the set."""
        return self.contest.regression

    @property
    def labels(self) -> frozenset[str]:
        """Labels of its effects."""
        return frozenset(member.label for member in self.members)

    @property
    def required(self) -> set[str]:
        """Labels of effects that its effects change, without which they are nothing."""
        return {label for member in self.members for label in member.effect.required}

    @property
    def loss(self) -> float:
        """Weighted squared error of left-out blocks."""
        return float(self.regression.loss.sum())

    @property
    def density(self) -> float:
        """Log density L of left-out blocks."""
        n = np.maximum(self.regression.rows, 1)
        squares = self.regression.losses.sum(axis=0) / self.regression.weight**2
        return float(-0.5 * (n * np.log(squares / n + 1e-300)).sum())

    def losses_without(self, member: Member) -> Array:
        """Left-out squares (blocks, d) without an effect."""
        if self.regression.sets[1:]:  # of few coordinates, whose rows are projected by themselves
            return self.minus(member).regression.losses
        return self.regression.losses_without(member.columns)

    def rise(self, member: Member) -> float:
        """Rise of the left-out squares without an effect, as a share; see `hypotheses`."""
        before = self.losses_without(member).sum(axis=0)
        fall = before - self.regression.losses.sum(axis=0)
        share = float(self.regression.explained(fall, before))
        return share / max(1 - share, EXACT)

    def plus(self, evidence: Evidence, equal: tuple[Evidence, ...] = ()) -> EffectSet:
        """The set with a further effect and its rivals."""
        if evidence.C:  # of a refined shape
            contest, columns = self.contest.extended(evidence.C)
        else:
            contest = self.contest.with_model(self.regression.extended(evidence.columns))
            columns = evidence.columns
        return EffectSet(
            contest, (*self.members, Member(evidence.effect, columns, evidence, equal))
        )

    def minus(self, member: Member) -> EffectSet:
        """The set without one of its effects."""
        rest = tuple(other for other in self.members if other is not member)
        return EffectSet(self.contest.with_model(self.regression.without(member.columns)), rest)

    def polished(self) -> EffectSet:
        """The set with all shapes refined beside each other: weights have changed since."""
        polished = self
        for m in self.members:
            if m.evidence is None or m.effect.corrects or not m.evidence.C:
                continue
            bare = polished.minus(m)
            shape, C, refit = refined(bare.contest, m.effect, m.evidence.shape)
            e = replace(m.evidence, shape=shape, columns=m.columns[:0], C=tuple(C), refit=refit)
            polished = bare.plus(e, m.rivals)
        return polished

    def reweighted(self) -> EffectSet:
        """The set with weights by the left-out errors that it leaves."""
        return replace(self, contest=self.contest.with_model(reweighted(self.regression)))

    @cached_property
    def shares(self) -> dict[str, float]:
        """Rise of the in-sample squares without each effect, as a share, by label; −1 of an effect
        whose values cannot be. It is larger than the left-out one.

            θ_gᵀ ((XᵀX)⁻¹)_gg⁻¹ θ_g / |e|²
        """
        theta, inverse = self.regression.solved
        place = {int(column): i for i, column in enumerate(self.regression.model)}
        rises = {}
        for member in self.members:
            at = np.array([place[int(column)] for column in member.columns])
            t = theta[at]
            rise = float(t @ linear.pinv(inverse[np.ix_(at, at)], hermitian=True) @ t)
            stderr = np.sqrt(np.maximum(np.diag(inverse)[at], 0.0))
            start = member.evidence.start if member.evidence is not None else {}
            possible = member.evidence is None or (
                sensible(
                    self.contest, member.effect, t + shape_before(member.effect, start), stderr
                )
                and self.contest.possible(member.effect, member.evidence.shape)
            )
            rises[member.label] = rise / self.loss if possible else -1.0
        return rises


def reweighted(regression: PartialRegression) -> PartialRegression:
    """The regression with weights by the left-out errors of its model."""
    sigma = np.sqrt(regression.losses.sum(axis=0) / np.maximum(regression.rows, 1))
    return regression.weighted(regression.weight / np.where(sigma > 0, sigma, 1.0))


def on_rows_in_motion(
    contest: Contest, members: Iterable[Member]
) -> tuple[PartialRegression, dict[str, Index]]:
    """The rows of a fit in motion, those at reversals too, with columns of members by label and
    without pulses, on which errors are announced; of a joint that never moves all that inform.
    """
    table = contest.table
    use = np.where(table.moving.any(axis=0), table.moving, table.informed)
    store, columns = ColumnStore(table, use, contest.fit.estimate.fixed), {}
    for member in members:
        assert member.evidence is not None
        shape = member.evidence.shape
        if member.effect.corrects and not member.effect.extent:
            shape = {p.name: member.effect.values.get(p.name, 0.0) for p in member.effect.shapes}
        columns[member.effect.label] = store.add_at(member.effect, shape)
    rows = contest.regression.without(contest.pulses)
    return PartialRegression(store.parts(), rows.model, rows.weight, store.count), columns


Response = tuple[Effect, Index, float]
"""To the past speed of a joint, with its columns and the share of the left-out squares."""


def past_responses(last: Ranking) -> tuple[Ranking, list[Response]]:
    """Return all candidates beside a set on rows that have columns of responses to the past speed
    of each joint that has curves too, and the responses that explain more than chance.
    """
    table, limit = last.contest.table, last.with_curves.limit
    rates = [scene.e.rate for scene in table.scenes if not scene.e.poses]
    if not rates:
        return last, []  # poses have no past
    cutoff = table.motion.band.cutoff or 0.25 * min(rates)
    shortest = {"T": 0.5 / (np.pi * cutoff)}
    regression, responses = last.regression.bare, []
    for joint in dict.fromkeys(e.effect.joints[0] for e in last.contest.candidates if e.curve):
        response = table.mechanism.placed(PastSpeed((joint,), shortest, signal="past v"))
        regression, columns = regression.added(last.contest.columns(response, {}))
        responses.append((response, columns))
    shares = regression.shares([columns for _, columns in responses])
    beyond_chance = [
        (response, columns, float(more))
        for (response, columns), more in zip(responses, shares, strict=True)
        if more > limit(regression.place(columns))
    ]
    return replace(last, contest=last.contest.with_model(regression)), beyond_chance


def _curve(member: Member, last: Ranking) -> Effect | None:
    for curve, more in last.curves:
        joint = curve.joints[0]
        if joint in member.effect.joints and more > PARSIMONY * (member.gain + more):
            candidate = next(other for other in last.contest.candidates if other.effect == curve)
            if _beside_best_law(candidate.groups[0], joint, member, last):
                return curve
    return None


def _past(member: Member, last: Ranking, responses: Sequence[Response]) -> Effect | None:
    """A response to the speed of a joint of the law, or one that leaves the law only chance."""
    regression = last.regression
    for response, columns, more in responses:
        (joint,) = response.joints
        if joint in member.effect.joints:
            if more > PARSIMONY * (member.gain + more) and _beside_best_law(
                columns, joint, member, last
            ):
                return response
            continue
        if _by_chance(member, regression.extended(columns).without(member.columns), last):
            return response
    return None


def _by_chance(member: Member, regression: PartialRegression, last: Ranking) -> bool:
    """Whether a member explains no more beside a model than chance."""
    by, place = regression.gains([member.columns]).by[0], regression.place(member.columns)
    shares = regression.explained_by_coordinate(by) if place == regression.d else np.zeros(0)
    share = float(regression.explained(by))
    return share <= limit_by_coordinate(last.chance, share, place, shares)


def _impossible(member: Member, bare: PartialRegression, last: Ranking) -> Effect | None:
    """A law with impossible values that explains more, and leaves the member no more than chance
    explains, or explains twice the squares of the member's joint: the cause is unknown.
    """
    assert member.evidence is not None
    mended, u = set(member.evidence.refit.affected_coordinates), member.evidence.coordinate
    for law in last.evidence:
        more = law.gain > max(law.limit, member.gain)
        if law.sensible or not more or not mended & set(law.refit.affected_coordinates):
            continue
        groups = next(c for c in last.contest.candidates if c.effect == law.effect).groups
        columns = groups[last.gains[law.effect.label][2]]
        member_fall, others = bare.gains([member.columns, columns]).by
        if (
            _by_chance(member, bare.extended(columns), last)
            or member_fall[u] < MAIN_CAUSE * others[u]
        ):
            return law.effect
    return None


def _beside_best_law(columns: Index, joint: str, member: Member, last: Ranking) -> bool:
    """Whether columns explain as much beside the law of the joint that explains most."""
    laws = [law for law in last.contest.laws if joint in law.effect.joints]
    laws = [law for law in laws if law.effect.label in last.gains]
    if not laws:
        return True
    best = max(laws, key=lambda law: last.gains[law.effect.label][0])
    start = int(last.regression.shares(best.groups).argmax())
    more = float(last.regression.extended(best.groups[start]).shares([columns])[0])
    limit = last.chance.limit(last.regression.place(columns))
    return more > max(limit, PARSIMONY * member.gain)


# --- of a set that is found -----------------------------------------------------------------------


def leader(named: Sequence[Member], first: Ranking) -> Member:
    """Return which of some members, sorted by what they explain alone, is named first: one that
    every machine has, if it explains as much as the best within PARSIMONY, for a bare model lacks
    friction of all joints.
    """
    alone = {e.effect.label: e.gain for e in first.credible}
    least = (1 - PARSIMONY) * alone.get(named[0].label, np.inf)
    common = [m for m in named if m.effect.common and alone.get(m.label, 0.0) >= least]
    return min(common, key=lambda m: len(m.effect.parameters), default=named[0])


def in_order(members: Sequence[Member], first: Ranking) -> list[Member]:
    """Put members of a set in the order in which they are named: first those that are credible on
    the model as it is, by what they explain there; the first name with its evidence there.
    """
    ordered = sorted(members, key=lambda member: first.place(member.label))
    named = [m for m in ordered if not m.rejected]
    if named:
        at, lead = ordered.index(named[0]), leader(named, first)
        ordered.remove(lead)
        ordered.insert(at, _with_evidence_alone(lead, first))
    return ordered


def _with_evidence_alone(member: Member, first: Ranking) -> Member:
    """The member with its evidence on the model as it is, where it is credible there.

    Beside other effects a member may be better than the simplest effect that explains the same part
    alone; a user who adds one effect is given the latter, with the member among its rivals.
    """
    evidence = next((e for e in first.credible if e.effect.label == member.label), None)
    if evidence is None:
        return member
    if member.grouped:
        return replace(member, evidence=evidence)
    simple, least = simplest(first), first.contest.decision.rival_se
    if simple is not None and same_part(evidence, simple) and behind(evidence, simple) >= least:
        evidence = simple
        member = replace(member, stands_in=True)
    return replace(
        member, effect=evidence.effect, evidence=evidence, rivals=rivals(evidence, first)
    )


def evaluate_member(
    member: Member, effect_set: EffectSet, last: Ranking, past: tuple[Ranking, Sequence[Response]]
) -> Member:
    """The member with its gain and with what speaks against it: a curve, or a law with impossible
    values; `last`: all candidates beside the set, `past`: see `past_responses`.
    """
    bare, e = effect_set.minus(member), member.evidence
    assert e is not None
    if np.isnan(e.p):  # it came with others, and is judged beside them
        refit = bare.regression.refit(member.columns)
        share = bare.regression.gain(refit)
        place = last.regression.place(member.columns)
        p, limit = last.chance.p(share, place), last.chance.limit(place)
        p = max(p, member.path or 0.0)
        believed = credible(share, limit, possible=e.sensible)
        e = replace(e, refit=refit, gain=share, limit=limit, p=p, credible=believed)
    member = replace(member, evidence=e, gain=effect_set.rise(member))
    curve = _curve(member, last) or _past(member, *past)
    return replace(member, curve=curve, impossible=_impossible(member, bare.regression, last))
