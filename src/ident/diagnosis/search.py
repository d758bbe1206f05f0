"""The set of effects that explains most, searched on the rows of one fit.

No model is refitted between the moves of the search:

    L = −½ Σ_u n_u log(|e_u|²/n_u)        e_u: errors of left-out blocks in coordinate u

must rise with every effect that is added or exchanged, and no set is visited twice. What every
machine has enters together where that explains more than any single effect, and so do two or three
effects of one joint where none is credible alone. An addition is followed by eliminations of what
brings less than chance does.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial, reduce

import numpy as np

from ident.diagnosis.candidates import HIDDEN, CandidateColumns, Contest, OnProgress
from ident.diagnosis.effect_set import EffectSet, Member, evaluate_member, in_order, past_responses
from ident.diagnosis.null import judging, null_shares, path_shares
from ident.diagnosis.selection import (
    Ranking,
    behind,
    by_chance,
    rank,
    rank_curves,
    rivals,
    simplest,
)
from ident.information.evidence import PARSIMONY, SURROGATES, Chance, exceeding, quantile, zscore
from ident.information.hypotheses import Index, PartialRegression

MOST_MOVES = 60  # work: moves of one search
# tuned: times the largest gain, from which what every machine has enters at once
COMMON_RATIO = 1.5
NEAR = 0.8  # work: share of the largest gain below which a candidate is not looked at in detail
PATH_LENGTH = 3  # work: effects of one joint that are looked at together
BEST_TRIED = 3  # work: of the best candidates, until one makes a better set


@dataclass(eq=False)
class Search:
    """Adds effects with eliminations, then exchanges, until neither makes a better set."""

    contest: Contest  # rows, candidates and the rule of evidence
    given: Collection[str]  # labels of effects of the model that stay
    on_progress: OnProgress
    visited: set[frozenset[str]] = field(default_factory=set)  # sets that were searched before
    # whether the search ends with an effect that corrects the state, lest what its slopes at the
    # working point leave of a large correction be taken for further effects
    to_refit: bool = False
    chance: Chance = field(init=False)
    null_regression: PartialRegression = field(
        init=False
    )  # with the draws of the last null distribution
    first: Ranking = field(init=False)  # beside the start
    at_end: Ranking | None = field(default=None, init=False)  # beside the set that was found
    all_common: bool = field(default=False, init=False)  # what every machine has is in the set

    @cached_property
    def start(self) -> EffectSet:
        """The fitted model; its effects that are not given may be eliminated."""
        fit, members = self.contest.fit, []
        for effect, places in fit.columns.effects:
            columns = np.array(
                [p for p in places if p >= 0 and not fit.estimate.fixed[p]], dtype=int
            )
            # without a drive, whose gains were known at first, there is no torque; pulses at
            # reversals come with its friction
            stays = effect.supplies_torque or (effect.in_rows_alone and fit.mechanism.drives)
            removable = effect.label not in self.given and not stays
            if removable and len(columns):
                members.append(Member(effect, columns))
        return EffectSet(self.contest, tuple(members))

    def run(self, first: Ranking | None = None) -> EffectSet:
        """The best set; `first`: all candidates beside the start, with their null distribution."""
        now = self.start
        self.visited.add(now.labels)
        if first is None:
            first = self.ranked(now)
        self.chance, self.null_regression, self.first = first.chance, first.regression, first
        if (pruned := self.prune(now)) is not now:  # at another working point than it was found
            now = pruned
            self.visited.add(now.labels)
        now = self.add_common(self.add_group(now, first if now is self.start else self.ranked(now)))
        for number in range(MOST_MOVES):
            self.on_progress(f"set of {len(now.members)} effects", number / MOST_MOVES)
            if self.to_refit and any(member.effect.corrects for member in self.new(now)):
                break
            ranking = first if now is self.start else self.ranked(now)
            following = self.forward(now, ranking) or self.exchanged(now) or self.add_common(now)
            if following is now and not self.new(now):
                following = self.add_pairs(now) or now
            if following is now:
                self.at_end = ranking
                break
            now = following
        now = self.driven_first(now)
        return replace(now, members=tuple(self.with_rivals(now, member) for member in now.members))

    def driven_first(self, now: EffectSet) -> EffectSet:
        """The set with effects of drives in the place of those of passive joints of a loop, where
        the rows cannot tell them apart: gears and bearings of drives carry more.
        """
        driven = {*now.contest.fit.mechanism.driven}
        if not now.contest.fit.mechanism.closures:
            return now
        for member in self.new(now):
            if not member.effect.joints or driven & {*member.effect.joints}:
                continue
            bare = now.minus(member)
            ranking = self.replacements(bare, member, member.effect.kind)
            present = next((e for e in ranking.evidence if e.effect.label == member.label), None)
            if present is None:
                continue
            of_drive = (
                e
                for e in rivals(present, ranking)
                if e.effect.kind == member.effect.kind and driven & {*e.effect.joints}
            )
            if (other := next(of_drive, None)) is not None:
                now = bare.plus(other)
                *rest, new = now.members
                now = replace(now, members=(*rest, replace(new, grouped=True)))
        return now

    def with_rivals(self, now: EffectSet, member: Member) -> Member:
        """The member; one that came with others with its rivals beside the rest of the set: of what
        every machine has none with more numbers, in a loop the same effect of other joints too.
        """
        if not member.grouped:
            return member
        kind = member.effect.kind if now.contest.fit.mechanism.closures else None
        ranking = self.replacements(now.minus(member), member, kind)
        evidence = next((e for e in ranking.evidence if e.effect.label == member.label), None)
        if evidence is None:
            return member
        most = evidence.numbers if member.effect.common else np.inf
        equal = (e for e in rivals(evidence, ranking) if e.numbers <= most)
        return replace(member, rivals=tuple(equal))

    def replacements(self, bare: EffectSet, member: Member, kind: str | None = None) -> Ranking:
        """Rank what could take the place of a member: effects of its joints, or of a kind."""
        effects, joints = (
            (candidate.effect for candidate in bare.contest.candidates),
            member.effect.joints,
        )
        labels = {
            effect.label
            for effect in effects
            if not effect.joints
            or not joints
            or {*joints} & {*effect.joints}
            or effect.kind == kind
        }
        return rank(bare.contest, bare.labels, False, self.chance, NEAR, labels)

    def ranked(self, now: EffectSet) -> Ranking:
        """All laws beside a set, with a null distribution of its residual."""
        ranking = rank(now.contest, now.labels, curved=False, least=NEAR)
        self.chance, self.null_regression = ranking.chance, ranking.regression
        return ranking

    def accepted(self, now: EffectSet, new: EffectSet) -> EffectSet | None:
        """The set without what it made superfluous, if it is a new one and a better one."""
        if new.density <= now.density:
            return None
        new = self.prune(self.readmit(new.reweighted()))
        if new.labels in self.visited:
            return None
        self.visited.add(new.labels)
        return new

    def prune(self, now: EffectSet) -> EffectSet:
        """The set without what brings no more than chance does, the least first."""
        while True:
            doubtful = [
                e
                for e in now.members
                if e.label not in now.required
                if now.shares[e.label] < 2 * self.limit(now, e)
                or any(
                    e.effect.joints == other.effect.joints
                    and other.effect.kind in e.effect.nested_in
                    for other in now.members
                )
            ]
            for member in sorted(doubtful, key=lambda e: now.shares[e.label]):
                if now.shares[member.label] < 0 or self.superfluous(now, member):
                    now = now.minus(member)
                    break
            else:
                return now

    def limit(self, now: EffectSet, member: Member) -> float:
        """What chance does where a member acts."""
        return self.chance.limit(now.regression.place(member.columns))

    def superfluous(self, now: EffectSet, member: Member) -> bool:
        """Return whether a set is no worse without a member than chance makes it. What every
        machine has must only not be noise, and have columns of its own beside the others.
        """
        if not member.effect.common:
            return now.rise(member) < self.limit(now, member)
        D = (now.losses_without(member) - now.regression.losses).sum(axis=1)
        if zscore(D) < self.contest.decision.rival_se:
            return True
        bare = now.regression.without(member.columns)
        return bool(bare.visible([member.columns])[0] < HIDDEN)

    def add_group(self, now: EffectSet, ranking: Ranking) -> EffectSet:
        """The set with what all drives have in common, before what single joints may have; even
        where it is too small to be named, lest its part be taken for an effect of each joint.
        """
        known = {effect.label for effect in now.contest.fit.mechanism.effects}
        for evidence in ranking.evidence:
            significant = (
                evidence.gain > evidence.limit
                and evidence.sensible
                and evidence.effect.label not in known
            )
            if evidence.effect.joined and (evidence.credible or significant):
                new = now.plus(evidence, rivals(evidence, ranking))
                return self.accepted(now, new) or now
        return now

    def candidate_groups(self, now: EffectSet) -> Iterator[EffectSet]:
        """Yield the set with all effects that every machine has, then with its friction alone,
        where they explain more together: of few rows, chance explains much with many columns.
        """
        common = self.common(now, -np.inf)
        friction = [candidate for candidate in common if candidate.effect.companions]
        for group in (common, friction) if friction != common else (common,):
            if len(group) < 2:
                continue
            groups = [candidate.groups[0] for candidate in group]
            g = now.regression.shares([np.concatenate(groups), *groups])
            if g[0] >= COMMON_RATIO * g[1:].max():
                yield self.with_candidates(now, group)

    def common(self, now: EffectSet, least: float) -> list[CandidateColumns]:
        """What every machine has and a set has not, with gains of so many standard errors."""
        every = (e for e in self.contest.candidates if e.effect.common)
        candidates = [candidate for candidate in every if candidate.effect.label not in now.labels]
        gains = now.regression.gains([candidate.groups[0] for candidate in candidates])
        return [
            candidate
            for candidate, D, visible in zip(candidates, gains.D, gains.visible, strict=True)
            if visible > HIDDEN and zscore(D) > least
        ]

    def readmit(self, now: EffectSet) -> EffectSet:
        """The set with what every machine has, where another effect has made it visible."""
        common = self.common(now, self.contest.decision.rival_se) if self.all_common else []
        if not common:
            return now
        new = self.with_candidates(now, common)
        return new if new.density > now.density else now

    def add_common(self, now: EffectSet) -> EffectSet:
        """The set with what every machine has, without what of it is superfluous."""
        for number, group in enumerate(self.candidate_groups(now)):
            if self.beyond_chance(now, group):
                accepted = self.accept_with_own_null(now, group)
                if accepted is not None:
                    self.all_common |= number == 0
                    return accepted
        return now

    def accept_with_own_null(
        self, now: EffectSet, new: EffectSet, stays: Callable[[EffectSet], bool] = lambda _: True
    ) -> EffectSet | None:
        """The set, if it is accepted by a null distribution of its own and stays."""
        before = self.chance, self.null_regression
        self.ranked(new)
        accepted = self.accepted(now, new)
        if accepted is None or not stays(accepted):
            self.chance, self.null_regression = before
            return None
        return accepted

    def beyond_chance(self, now: EffectSet, group: EffectSet) -> bool:
        """Return whether a set's new members explain more than of residuals without them."""
        new = np.concatenate([e.columns for e in group.members if e.label not in now.labels])
        null_regression = judging(now.contest).regression
        gains = null_regression.gains([new])
        surrogates, draws = np.split(null_shares(null_regression, gains)[0], [SURROGATES])
        limit = max(quantile(x, self.contest.decision.alpha) for x in (surrogates, draws))
        return float(null_regression.explained(gains.by)[0]) > limit

    def add_pairs(self, now: EffectSet) -> EffectSet | None:
        """The set with effects of one joint that are credible together, and none of them alone."""
        laws = [e for e in now.contest.laws if e.effect.label not in now.labels]
        place = [now.regression.place(law.groups[0]) for law in laws]
        for u in (u for u in range(now.regression.d) if place.count(u) > 1):
            local_laws = [law for law, v in zip(laws, place, strict=True) if v == u]
            steps, p = self.path_beyond_chance(
                self.null_regression, u, [law.groups for law in local_laws]
            )
            if not steps:
                continue
            new, labels = now, {law.effect.label for law in local_laws}
            while len(new.members) < len(now.members) + steps:
                rest = labels - new.labels
                ranking = rank(new.contest, (), False, self.none, NEAR, rest) if rest else None
                best = simplest(ranking) if ranking else None
                if best is None:
                    break
                new = new.plus(best)
            accepted = self.accept_with_own_null(now, new, partial(self.explains, now, u))
            if accepted is not None:
                path = (
                    m if m.label in now.labels else replace(m, grouped=True, path=p)
                    for m in accepted.members
                )
                return replace(accepted, members=tuple(path))
        return None

    def explains(self, now: EffectSet, u: int, path: EffectSet) -> bool:
        """Return whether two effects of a path stay, or one that leaves next to nothing."""
        two = len(self.new(path)) > len(self.new(now)) + 1
        return two or self.remaining(path, u) < PARSIMONY * self.remaining(now, u)

    def remaining(self, now: EffectSet, u: int) -> float:
        """Left-out squares of a coordinate beyond the sensors' noise [N²m² | N²]."""
        regression = now.regression
        floor = now.contest.draws.floor[u] if now.contest.draws is not None else 0.0
        squares = regression.losses.sum(axis=0)[u] / regression.weight[u] ** 2
        return max(float(squares - regression.rows[u] * floor**2), 0.0)

    def path_beyond_chance(
        self, null_regression: PartialRegression, u: int, effects: Sequence[Sequence[Index]]
    ) -> tuple[int, float]:
        """Return how many effects of a coordinate, given by their groups of columns, explain
        together more than chance does, and the chance of such a path in any coordinate: k of them
        must be as improbable as k that are credible each, alphaᵏ. First a few draws are looked at.
        """
        alpha, looks = self.contest.decision.alpha, null_regression.d * (PATH_LENGTH - 1)
        few_draws, every = (
            SURROGATES // 6,
            null_regression.residual[0].shape[1] - 1,
        )  # and draws of noise
        for draws in (few_draws, every):
            p = {}
            for k, g in enumerate(
                path_shares(null_regression, u, effects, PATH_LENGTH, draws)[1:], 2
            ):
                nulls = (x for x in (g[1 : 1 + SURROGATES], g[1 + SURROGATES :]) if len(x))
                p[k] = looks * max(exceeding(float(g[0]), x) for x in nulls)
            if draws == few_draws and min(p.values()) > looks * alpha:
                return 0, 1.0
        good = [k for k, x in p.items() if x <= alpha**k]
        k = min(good, key=lambda k: p[k], default=0)
        return k, p.get(k, 1.0)

    def leader_first(self, first: Ranking) -> str:
        """Label of the effect that is named first, without a null distribution; "" if none is."""
        self.chance = first.chance
        now = self.add_group(self.start, first)
        group = next(self.candidate_groups(now), None)
        if group is not None and group.density > now.density:
            now = group
            most = max(self.new(now), key=lambda member: first.gains[member.label][0])
            if self.superfluous(now, most):
                now = self.prune(now)
        alone = max((first.gains[member.label][0] for member in self.new(now)), default=0.0)
        louder = {e.effect.label for e in first.credible if e.gain > alone} - now.labels
        if louder:  # and not explained by what every machine has
            ranking = rank(now.contest, curved=False, chance=self.chance, only=louder)
            if (best := simplest(ranking)) is not None:
                now = now.plus(best)
        return next((e.label for e in in_order(self.new(now), first)), "")

    @property
    def none(self) -> Chance:
        """Limits that any gain exceeds."""
        return Chance({}, {}, self.contest.decision.alpha, -np.inf)

    def new(self, now: EffectSet) -> list[Member]:
        """The members that are not of the fit."""
        return [member for member in now.members if member.evidence is not None]

    def with_candidates(self, now: EffectSet, several: list[CandidateColumns]) -> EffectSet:
        """The set with several candidates, credible or not."""
        columns = np.concatenate([candidate.groups[0] for candidate in several])
        contest = now.contest.with_model(now.regression.extended(columns))
        labels = [candidate.effect.label for candidate in several]
        ranking = rank(contest, curved=False, chance=self.none, only=labels)
        evidence = {candidate.effect.label: candidate for candidate in ranking.evidence}
        members = [
            Member(e.effect, e.groups[0], evidence[e.effect.label], grouped=True) for e in several
        ]
        return EffectSet(contest, (*now.members, *members)).reweighted()

    def forward(self, now: EffectSet, ranking: Ranking) -> EffectSet | None:
        """The set with the simplest of the best effects."""
        best = simplest(ranking)
        rest = [evidence for evidence in ranking.credible if evidence is not best]
        for evidence in [best, *rest][:BEST_TRIED] if best is not None else []:
            new = now.plus(evidence, rivals(evidence, ranking))
            if (accepted := self.accepted(now, new)) is not None:
                return accepted
        return None

    def exchanged(self, now: EffectSet) -> EffectSet | None:
        """The set with one effect exchanged for a better one of its joints, beyond chance."""
        for member in now.members:
            if member.evidence is None or member.label in now.required:
                continue
            bare = now.minus(member)
            ranking = self.replacements(bare, member)
            present = next((e for e in ranking.evidence if e.effect.label == member.label), None)
            for other in ranking.credible[:BEST_TRIED]:
                if other is present or (
                    present and behind(present, other) < self.contest.decision.rival_se
                ):
                    continue
                if (
                    present
                    and other.numbers > present.numbers
                    and by_chance(present, other, bare.regression.rows, other.limit)
                ):
                    continue  # more numbers must bring more than chance does
                new = bare.plus(other, rivals(other, ranking))
                if (accepted := self.accepted(now, new)) is not None:
                    return accepted
        return None


# --- the set of a diagnosis ----------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Selection:
    """The set of effects that explains most."""

    first: Ranking  # all candidates on the model as it is
    members: tuple[Member, ...]  # first those that are credible alone, by what they explain alone
    last: Ranking  # all candidates beside the set

    @property
    def contest(self) -> Contest:
        """The contest with the set in its model."""
        return self.last.contest

    @property
    def named(self) -> tuple[Member, ...]:
        """Members against which nothing speaks."""
        return tuple(m for m in self.members if not m.rejected)


def select(contest: Contest, on_progress: OnProgress) -> Selection:
    """Searches the set that explains most beside a fitted model, and judges its members."""
    first = rank(contest, curved=False)
    given = [effect.label for effect in contest.fit.mechanism.effects]
    search = Search(contest, given, on_progress)
    effect_set = search.run(first)
    if not effect_set.members:
        first = rank_curves(first)
        return Selection(first, (), first)
    polished = effect_set.polished()
    if polished is effect_set and search.at_end is not None:
        last = rank_curves(search.at_end, effect_set.labels)
    else:
        effect_set = polished
        last = rank(effect_set.contest, effect_set.labels)
    past = past_responses(last)
    evaluated = [evaluate_member(member, effect_set, last, past) for member in effect_set.members]
    # of what came together only what is more than chance beside the others is a name
    members = [
        m for m in evaluated if m.path is not None or m.evidence is None or m.evidence.credible
    ]
    accepted = [m for m in members if not m.rejected]
    of_loads, of_others = (
        max((m.gain for m in accepted if bool(m.effect.loaded_link) == load), default=-np.inf)
        for load in (True, False)
    )
    # of a load, and of what depends on it or acts beside such an effect of the model, what explains
    # more is named first: the other is judged once that is in the model. So is a load beside a
    # spring, as slopes of a link that swings leave some of it to what the link carries
    loaded = any(effect.implicit for effect in contest.fit.mechanism.effects)
    springs = any(m.effect.extent and m.gain > of_loads for m in accepted)
    if springs or (loaded and of_others > of_loads):
        members = [m for m in members if not m.effect.loaded_link]
    elif np.isfinite(of_loads):
        members = [
            m
            for m in members
            if m.evidence is None or m.effect.loaded_link or not (loaded or m.effect.implicit)
        ]
    labels = {m.label for m in members}
    weak = [m for m in effect_set.members if m.label not in labels and m.label in given]
    if weak:
        bare = reduce(EffectSet.minus, weak, effect_set)
        members = [m for m in members if _credible_without(m, bare, first)]
    return Selection(first, tuple(in_order(members, first)), last)


def _credible_without(member: Member, bare: EffectSet, first: Ranking) -> bool:
    """Whether a member is credible alone, or beside the set without other values of known effects
    that are too little to be named: these may together make up for a misfit that is everywhere.
    """
    if member.path is not None or any(e.effect.label == member.label for e in first.credible):
        return True
    others = bare.minus(next(m for m in bare.members if m.label == member.label))
    if not others.members:
        return False
    ranking = rank(others.contest, others.labels, curved=False, least=NEAR)
    return any(e.effect.label == member.label for e in ranking.credible)
