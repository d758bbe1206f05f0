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

from ident.diagnosis.candidates import HIDDEN, SURROGATES, CandidateColumns, Contest, OnProgress
from ident.diagnosis.effect_set import EffectSet, Member, in_order, judged_member, past_responses
from ident.diagnosis.null import judging, null_shares, path_shares
from ident.diagnosis.selection import Ranking, behind, by_chance, rank, rivals, simplest
from ident.information.chance import Chance, exceeding, quantile, zscore
from ident.information.hypotheses import Index, PartialRegression

MOST = 60  # work: moves of one search
TOGETHER = 1.5  # tuned: times the largest gain, from which what every machine has enters at once
NEAR = 0.8  # work: share of the largest gain below which a candidate is not looked at in detail
PATH = 3  # work: effects of one joint that are looked at together
ALONE = 0.1  # tuned: of the squares beyond noise, that one effect leaves where a path is credible
TRIED = 3  # work: of the best candidates, until one makes a better set


@dataclass(eq=False)
class Search:
    """Adds effects with eliminations, then exchanges, until neither makes a better set."""

    contest: Contest  # rows, candidates and the rule of evidence
    given: Collection[str]  # labels of effects of the model that stay
    on_progress: OnProgress
    visited: set[frozenset[str]] = field(default_factory=set)  # sets that were searched before
    chance: Chance = field(init=False)
    judged: PartialRegression = field(init=False)  # with the draws of the last null distribution
    first: Ranking = field(init=False)  # beside the start
    all_common: bool = field(default=False, init=False)  # what every machine has is in the set

    @cached_property
    def start(self) -> EffectSet:
        """The fitted model; its effects that are not given may be eliminated."""
        fit, members = self.contest.fit, []
        for effect, places in fit.columns.effects:
            mine = np.array([p for p in places if p >= 0 and not fit.estimate.held[p]], dtype=int)
            if effect.label not in self.given and len(mine):
                members.append(Member(effect, mine))
        return EffectSet(self.contest, tuple(members))

    def run(self, first: Ranking | None = None) -> EffectSet:
        """The best set; `first`: all candidates beside the start, with their null distribution."""
        now = self.start
        self.visited.add(now.labels)
        if first is None:
            first = self.ranked(now)
        self.chance, self.judged, self.first = first.chance, first.regression, first
        now = self.grouped(self.joined(now, first))
        for number in range(MOST):
            self.on_progress(f"set of {len(now.members)} effects", number / MOST)
            ranking = first if now is self.start else self.ranked(now)
            following = self.forward(now, ranking) or self.exchanged(now) or self.grouped(now)
            if following is now and not self.new(now):
                following = self.several(now) or now
            if following is now:
                break
            now = following
        return replace(now, members=tuple(self.with_rivals(now, each) for each in now.members))

    def with_rivals(self, now: EffectSet, member: Member) -> Member:
        """The member; one that came with others with its rivals beside the rest of the set: of what
        every machine has none with more numbers, in a loop the same effect of other joints too.
        """
        if not member.grouped:
            return member
        kind = member.effect.kind if now.contest.fit.mechanism.closures else None
        beside = self.beside(now.minus(member), member, kind)
        own = next((e for e in beside.evidence if e.effect.label == member.label), None)
        if own is None:
            return member
        most = own.numbers if member.effect.common else np.inf
        equal = (e for e in rivals(own, beside) if e.numbers <= most)
        return replace(member, rivals=tuple(equal))

    def beside(self, bare: EffectSet, member: Member, kind: str | None = None) -> Ranking:
        """Rank what could take the place of a member: effects of its joints, or of a kind."""
        effects, joints = (each.effect for each in bare.contest.candidates), member.effect.joints
        mine = {
            each.label
            for each in effects
            if not each.joints or not joints or {*joints} & {*each.joints} or each.kind == kind
        }
        return rank(bare.contest, bare.labels, False, self.chance, NEAR, mine)

    def ranked(self, now: EffectSet) -> Ranking:
        """All laws beside a set, with a null distribution of its residual."""
        found = rank(now.contest, now.labels, curved=False, least=NEAR)
        self.chance, self.judged = found.chance, found.regression
        return found

    def accepted(self, now: EffectSet, new: EffectSet) -> EffectSet | None:
        """The set without what it made superfluous, if it is a new one and a better one."""
        if new.density <= now.density:
            return None
        new = self.lean(self.restored(new.reweighted()))
        if new.labels in self.visited:
            return None
        self.visited.add(new.labels)
        return new

    def lean(self, now: EffectSet) -> EffectSet:
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
            for each in sorted(doubtful, key=lambda e: now.shares[e.label]):
                bare = now.minus(each)
                if now.shares[each.label] < 0 or self.superfluous(now, bare, each):
                    now = bare
                    break
            else:
                return now

    def limit(self, now: EffectSet, member: Member) -> float:
        """What chance does where a member acts."""
        return self.chance.limit(now.regression.place(member.columns))

    def superfluous(self, now: EffectSet, bare: EffectSet, member: Member) -> bool:
        """Return whether a set is no worse without a member than chance makes it. What every
        machine has must only not be noise, and have columns of its own beside the others.
        """
        if member.effect.common:
            if bare.regression.gains([member.columns]).visible[0] < HIDDEN:
                return True
            D = (bare.regression.losses - now.regression.losses).sum(axis=1)
            return zscore(D) < self.contest.decision.rival_se
        return now.rise(bare) < self.limit(now, member)

    def joined(self, now: EffectSet, ranking: Ranking) -> EffectSet:
        """The set with what all drives have in common, before what single joints may have; even
        where it is too small to be named, lest its part be taken for an effect of each joint.
        """
        known = {effect.label for effect in now.contest.fit.mechanism.effects}
        for each in ranking.evidence:
            seen = each.gain > each.limit and each.sensible and each.effect.label not in known
            if each.effect.joined and (each.credible or seen):
                new = now.plus(each, rivals(each, ranking))
                return self.accepted(now, new) or now
        return now

    def together(self, now: EffectSet) -> Iterator[EffectSet]:
        """Yield the set with all effects that every machine has, then with its friction alone,
        where they explain more together: of few rows, chance explains much with many columns.
        """
        common = self.common(now, -np.inf)
        friction = [each for each in common if each.effect.companions]
        for some in (common, friction) if friction != common else (common,):
            if len(some) < 2:
                continue
            groups = [each.groups[0] for each in some]
            g = now.regression.shares([np.concatenate(groups), *groups])
            if g[0] >= TOGETHER * g[1:].max():
                yield self.with_candidates(now, some)

    def common(self, now: EffectSet, least: float) -> list[CandidateColumns]:
        """What every machine has and a set has not, with gains of so many standard errors."""
        every = (e for e in self.contest.candidates if e.effect.common)
        some = [each for each in every if each.effect.label not in now.labels]
        found = now.regression.gains([each.groups[0] for each in some])
        return [
            each
            for each, D, visible in zip(some, found.D, found.visible, strict=True)
            if visible > HIDDEN and zscore(D) > least
        ]

    def restored(self, now: EffectSet) -> EffectSet:
        """The set with what every machine has, where another effect has made it visible."""
        some = self.common(now, self.contest.decision.rival_se) if self.all_common else []
        if not some:
            return now
        new = self.with_candidates(now, some)
        return new if new.density > now.density else now

    def grouped(self, now: EffectSet) -> EffectSet:
        """The set with what every machine has, without what of it is superfluous."""
        for number, together in enumerate(self.together(now)):
            if self.beyond_chance(now, together):
                found = self.tried(now, together)
                if found is not None:
                    self.all_common |= number == 0
                    return found
        return now

    def tried(
        self, now: EffectSet, new: EffectSet, stays: Callable[[EffectSet], bool] = lambda _: True
    ) -> EffectSet | None:
        """The set, if it is accepted by a null distribution of its own and stays."""
        before = self.chance, self.judged
        self.ranked(new)
        found = self.accepted(now, new)
        if found is None or not stays(found):
            self.chance, self.judged = before
            return None
        return found

    def beyond_chance(self, now: EffectSet, together: EffectSet) -> bool:
        """Return whether a set's new members explain more than of residuals without them."""
        new = np.concatenate([e.columns for e in together.members if e.label not in now.labels])
        judged = judging(now.contest).regression
        found = judged.gains([new])
        surrogates, draws = np.split(null_shares(judged, found)[0], [SURROGATES])
        limit = max(quantile(x, self.contest.decision.alpha) for x in (surrogates, draws))
        return float(judged.explained(found.by)[0]) > limit

    def several(self, now: EffectSet) -> EffectSet | None:
        """The set with effects of one joint that are credible together, and none of them alone."""
        laws = [e for e in now.contest.laws if e.effect.label not in now.labels]
        place = [now.regression.place(each.groups[0]) for each in laws]
        for u in (u for u in range(now.regression.d) if place.count(u) > 1):
            mine = [each for each, v in zip(laws, place, strict=True) if v == u]
            steps, p = self.beyond(self.judged, u, [each.groups for each in mine])
            if not steps:
                continue
            new, labels = now, {each.effect.label for each in mine}
            while len(new.members) < len(now.members) + steps:
                rest = labels - new.labels
                beside = rank(new.contest, (), False, self.none, NEAR, rest) if rest else None
                best = simplest(beside) if beside else None
                if best is None:
                    break
                new = new.plus(best)
            found = self.tried(now, new, partial(self.explains, now, u))
            if found is not None:
                path = (
                    m if m.label in now.labels else replace(m, grouped=True, path=p)
                    for m in found.members
                )
                return replace(found, members=tuple(path))
        return None

    def explains(self, now: EffectSet, u: int, path: EffectSet) -> bool:
        """Return whether two effects of a path stay, or one that leaves next to nothing."""
        several = len(self.new(path)) > len(self.new(now)) + 1
        return several or self.left(path, u) < ALONE * self.left(now, u)

    def left(self, now: EffectSet, u: int) -> float:
        """Left-out squares of a coordinate beyond the sensors' noise [N²m² | N²]."""
        regression = now.regression
        floor = now.contest.draws.floor[u] if now.contest.draws is not None else 0.0
        squares = regression.losses.sum(axis=0)[u] / regression.weight[u] ** 2
        return max(float(squares - regression.rows[u] * floor**2), 0.0)

    def beyond(
        self, judged: PartialRegression, u: int, effects: Sequence[Sequence[Index]]
    ) -> tuple[int, float]:
        """Return how many effects of a coordinate, given by their groups of columns, explain
        together more than chance does, and the chance of such a path in any coordinate: k of them
        must be as improbable as k that are credible each, alphaᵏ. First a few draws are looked at.
        """
        alpha, looks = self.contest.decision.alpha, judged.d * (PATH - 1)
        few, every = SURROGATES // 6, judged.residual[0].shape[1] - 1  # and draws of noise
        for draws in (few, every):
            p = {}
            for k, g in enumerate(path_shares(judged, u, effects, PATH, draws)[1:], 2):
                nulls = (x for x in (g[1 : 1 + SURROGATES], g[1 + SURROGATES :]) if len(x))
                p[k] = looks * max(exceeding(float(g[0]), x) for x in nulls)
            if draws == few and min(p.values()) > looks * alpha:
                return 0, 1.0
        good = [k for k, x in p.items() if x <= alpha**k]
        k = min(good, key=lambda k: p[k], default=0)
        return k, p.get(k, 1.0)

    def led(self, first: Ranking) -> str:
        """Label of the effect that is named first, without a null distribution; "" if none is."""
        self.chance = first.chance
        now = self.joined(self.start, first)
        together = next(self.together(now), None)
        if together is not None and together.density > now.density:
            now = together
            most = max(self.new(now), key=lambda each: first.gains[each.label][0])
            if self.superfluous(now, now.minus(most), most):
                now = self.lean(now)
        alone = max((first.gains[each.label][0] for each in self.new(now)), default=0.0)
        louder = {e.effect.label for e in first.credible if e.gain > alone} - now.labels
        if louder:  # and not explained by what every machine has
            beside = rank(now.contest, curved=False, chance=self.chance, only=louder)
            if (best := simplest(beside)) is not None:
                now = now.plus(best)
        return next((e.label for e in in_order(self.new(now), first)), "")

    @property
    def none(self) -> Chance:
        """Limits that any gain exceeds."""
        return Chance({}, {}, self.contest.decision.alpha, -np.inf)

    def new(self, now: EffectSet) -> list[Member]:
        """The members that are not of the fit."""
        return [each for each in now.members if each.evidence is not None]

    def with_candidates(self, now: EffectSet, several: list[CandidateColumns]) -> EffectSet:
        """The set with several candidates, credible or not."""
        columns = np.concatenate([each.groups[0] for each in several])
        contest = now.contest.beside(now.regression.extended(columns))
        labels = [each.effect.label for each in several]
        ranking = rank(contest, curved=False, chance=self.none, only=labels)
        evidence = {each.effect.label: each for each in ranking.evidence}
        members = [
            Member(e.effect, e.groups[0], evidence[e.effect.label], grouped=True) for e in several
        ]
        return EffectSet(contest, (*now.members, *members)).reweighted()

    def forward(self, now: EffectSet, ranking: Ranking) -> EffectSet | None:
        """The set with the simplest of the best effects."""
        best = simplest(ranking)
        rest = [each for each in ranking.credible if each is not best]
        for each in [best, *rest][:TRIED] if best is not None else []:
            new = now.plus(each, rivals(each, ranking))
            if (found := self.accepted(now, new)) is not None:
                return found
        return None

    def exchanged(self, now: EffectSet) -> EffectSet | None:
        """The set with one effect exchanged for a better one of its joints, beyond chance."""
        for each in now.members:
            if each.evidence is None or each.label in now.required:
                continue
            bare = now.minus(each)
            ranking = self.beside(bare, each)
            own = next((e for e in ranking.evidence if e.effect.label == each.label), None)
            for other in ranking.credible[:TRIED]:
                if other is own or (own and behind(own, other) < self.contest.decision.rival_se):
                    continue
                if (
                    own
                    and other.numbers > own.numbers
                    and by_chance(own, other, bare.regression.rows, other.limit)
                ):
                    continue  # more numbers must bring more than chance does
                new = bare.plus(other, rivals(other, ranking))
                if (found := self.accepted(now, new)) is not None:
                    return found
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
    first = rank(contest)
    given = [effect.label for effect in contest.fit.mechanism.effects]
    found = Search(contest, given, on_progress).run(first)
    if not found.members:
        return Selection(first, (), first)
    found = found.polished()
    last = rank(found.contest, found.labels)
    past = past_responses(last)
    judged = [judged_member(each, found, last, past) for each in found.members]
    # of what came together only what is more than chance beside the others is a name
    members = [m for m in judged if m.path is not None or m.evidence is None or m.evidence.credible]
    if any(m.effect.loaded_link and not m.rejected for m in members):
        # what depends on the load is judged once the body that is added is in the model, and so is
        # all that is found beside it where an effect of the model depends on the load
        loaded = any(effect.implicit for effect in contest.fit.mechanism.effects)
        members = [
            m
            for m in members
            if m.evidence is None or m.effect.loaded_link or not (loaded or m.effect.implicit)
        ]
    left = {m.label for m in members}
    weak = [m for m in found.members if m.label not in left and m.label in given]
    if weak:
        bare = reduce(EffectSet.minus, weak, found)
        members = [m for m in members if _stands(m, bare, first)]
    return Selection(first, tuple(in_order(members, first)), last)


def _stands(member: Member, bare: EffectSet, first: Ranking) -> bool:
    """Whether a member is credible alone, or beside the set without other values of known effects
    that are too little to be named: these may together make up for a misfit that is everywhere.
    """
    if member.path is not None or any(e.effect.label == member.label for e in first.credible):
        return True
    others = bare.minus(next(m for m in bare.members if m.label == member.label))
    if not others.members:
        return False
    beside = rank(others.contest, others.labels, curved=False, least=NEAR)
    return any(e.effect.label == member.label for e in beside.credible)
