"""The verb `grow`: the set of effects that explains most, searched on the rows of one fit.

One pass makes the rows of the model and of all candidates; the search runs on them alone, with no
refit between its moves:

    L = −½ Σ_u n_u log(|e_u|²/n_u)        e_u: errors of left-out blocks in coordinate u

must rise with every effect that is added or exchanged, and no set is visited twice. An addition is
followed by eliminations of what brings less than chance does. The set is then fitted once; if at
the new working point the search finds another set, it goes on from there.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ident.diagnosis.candidates import (
    ColumnStore,
    Contest,
    OnProgress,
    absorbed,
    possible,
)
from ident.diagnosis.diagnosis import (
    Decision,
    Diagnosis,
    concluded,
    errors_of,
    fall_of,
    judged_on,
    started,
)
from ident.diagnosis.null import NoiseDraws, noise
from ident.diagnosis.selection import (
    HIDDEN,
    Evidence,
    Ranking,
    behind,
    rank,
    reweighted,
    rivals,
    sensible,
    simplest,
)
from ident.display import Displayed, Plotted, render
from ident.effects import Effect
from ident.fit import Fit, identify
from ident.information.blocks import Error
from ident.information.hypotheses import Index, PartialRegression
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion

ROUNDS = 4  # fits, lest shapes that move with the working point take turns for ever
MOST = 60  # moves of one search
CLEAR = 3.0  # times the last quantile, from which a gain needs no new null distribution
TOGETHER = 1.5  # times the largest single gain, from which what every machine has enters at once
NEAR = 0.8  # share of the largest gain below which a candidate is not looked at in detail


@dataclass(frozen=True, eq=False, repr=False)
class Step(Displayed):
    """One rung of the ladder.

    Attributes:
        added, removed: effects, none on the first rung.
        rivals: that could as well have been added.
        fit: everything refitted; None where the errors are announced by the search.
        fall: of the held-out weighted sum of squares, as a share.
        errors: held out, by joint.
    """

    added: Effect | None
    removed: tuple[Effect, ...]
    rivals: tuple[Effect, ...]
    fit: Fit | None
    fall: float
    errors: dict[str, Error]


@dataclass(frozen=True, eq=False, repr=False)
class History(Plotted):
    """How a model grew. Made by `ident.grow`.

    Attributes:
        steps: the ladder, from the model that was given.
        diagnosis: of the last model.
    """

    steps: tuple[Step, ...]
    diagnosis: Diagnosis

    @property
    def fits(self) -> tuple[Fit, ...]:
        """Of the rungs that were fitted, the first and the last among them."""
        return tuple(step.fit for step in self.steps if step.fit is not None)

    @property
    def fit(self) -> Fit:
        """The last."""
        return self.fits[-1]

    @property
    def mechanism(self) -> Mechanism:
        """The grown mechanism."""
        return self.fit.mechanism

    @property
    def added(self) -> tuple[Effect, ...]:
        """Effects that were added and are still there, in order."""
        present = {effect.label for effect in self.mechanism.effects}
        return tuple(s.added for s in self.steps if s.added and s.added.label in present)

    def table(self) -> list[list[str]]:
        """The ladder as cells: effect, held-out error a joint, fall, rivals; the head first."""
        rows: list[list[str]] = render(self, "ladder")
        return rows

    def write(self, folder: str | Path) -> list[Path]:
        """The grown mechanism's folder, with its last fit, diagnosis and a report.

        Raises:
            IdentError: if the folder is the mechanism's own, or cannot be written.
        """
        paths: list[Path] = render(self, "files", folder)
        return paths


def grow(
    mechanism: Mechanism,
    motion: Motion,
    *,
    validate: Motion | None = None,
    seed: int = 0,
    alpha: float = 0.01,
    material: float = 0.003,
    rival_se: float = 2.0,
    progress: OnProgress | None = None,
    step: Callable[[Step], None] | None = None,
) -> History:
    """Adds the effects that explain most until no effect is missing, and refits.

    Args:
        mechanism: to start from.
        motion: that is fitted.
        validate: of other logs, on which errors are reported.
        seed, alpha, material, rival_se: as `diagnose` takes them.
        progress: called with (what is being done, share done).
        step: called with every rung as it is reached.
    """
    on_progress = progress or (lambda what, share: None)
    decision = Decision(alpha, material, rival_se)
    given = frozenset(effect.label for effect in mechanism.effects if not effect.known)
    # least squares throughout, as the rows that announce an effect's fall
    fit = identify(mechanism, motion, validate=validate, estimator="least-squares")
    steps = [Step(None, (), (), fit, 0.0, errors_of(fit))]

    def reached(rungs: Collection[Step]) -> None:
        steps.extend(rungs)
        if step:
            for each in rungs:
                step(each)

    if step:
        step(steps[0])
    visited: set[frozenset[str]] = set()
    for number in range(ROUNDS):
        # curves judge what is left in the end, the search needs none
        contest = Contest.of(fit, candidates_of(fit), on_progress, curved=number > 0)
        draws = noise(contest, seed)
        search = Search(contest, draws, decision, seed, given, on_progress, visited)
        found = search.run()
        if found.labels == search.start.labels:
            break
        on_progress("refitting", 0.7)
        model = fit.mechanism
        removed = tuple(e for e in model.effects
                        if e.label in search.start.labels - found.labels)  # fmt: skip
        for effect in removed:
            model = model.without(effect.label)
        new = [each for each in found.members if each.evidence is not None]
        start = started(fit.point, fit, [each.evidence for each in new if each.evidence])
        for each in new:
            model = model + each.effect
        again = identify(model, motion, validate=validate, start=start, estimator="least-squares")
        if not better(errors_of(fit), errors_of(again)):
            break
        reached(ladder(search.start, found, removed, fit, again))
        fit = again
    else:
        number = 0
    if number == 0 or contest.fit is not fit:
        contest = Contest.of(fit, candidates_of(fit), on_progress)
        draws = noise(contest, seed)
    return History(
        tuple(steps), concluded(judged_on(contest, draws, decision, seed, on_progress), on_progress)
    )


def candidates_of(fit: Fit) -> list[Effect]:
    """Effects that could be missing, without those whose columns a link has already."""
    wanted = possible(fit.mechanism, fit.motion)
    return [each for each in wanted if not absorbed(fit.mechanism, each)]


def better(before: Mapping[str, Error], after: Mapping[str, Error]) -> bool:
    """Whether the held-out log density of a fit is larger, all joints together."""
    return sum(np.log(max(after[n].rms, 1e-300) / max(before[n].rms, 1e-300)) for n in before) < 0


# --- the search --------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Chosen:
    """An effect of a set; its columns, and why it is there: None of one that is fitted already."""

    effect: Effect
    columns: Index
    evidence: Evidence | None = None
    rivals: tuple[Effect, ...] = ()


@dataclass(frozen=True, eq=False)
class EffectSet:
    """The model with a set of effects added, on the rows of one fit."""

    contest: Contest
    regression: PartialRegression
    members: tuple[Chosen, ...]

    @property
    def labels(self) -> frozenset[str]:
        """Of its effects."""
        return frozenset(each.effect.label for each in self.members)

    @property
    def density(self) -> float:
        """L, of left-out blocks."""
        return density(self.regression.losses.sum(axis=0), self.regression)

    def plus(self, found: Evidence, rivals: tuple[Effect, ...] = ()) -> EffectSet:
        """With a further effect."""
        contest, columns = replace(self.contest, regression=self.regression).added(found.C)
        regression = contest.regression.extended(columns)
        member = Chosen(found.effect, columns, found, rivals)
        return EffectSet(contest, regression, (*self.members, member))

    def minus(self, member: Chosen) -> EffectSet:
        """Without one of its effects."""
        left = tuple(each for each in self.members if each is not member)
        return replace(self, regression=self.regression.without(member.columns), members=left)

    @cached_property
    def shares(self) -> dict[str, float]:
        """By label, the in-sample rise of the squared error without each, as a share: more than the
        left-out one; −1 of an effect whose values cannot be.

            θ_gᵀ ((XᵀX)⁻¹)_gg⁻¹ θ_g / |e|²
        """
        theta, inverse = self.regression.solved
        total = float(self.regression.loss.sum())
        place = {int(column): i for i, column in enumerate(self.regression.model)}
        found = {}
        for each in self.members:
            at = np.array([place[int(column)] for column in each.columns])
            t = theta[at]
            rise = float(t @ np.linalg.pinv(inverse[np.ix_(at, at)], hermitian=True) @ t)
            possible = each.evidence is None or sensible(self.contest, each.effect, t)
            found[each.effect.label] = rise / total if possible else -1.0
        return found


def density(squares: np.ndarray, regression: PartialRegression) -> float:
    """L of squares (d,) of weighted errors."""
    n = np.maximum(regression.rows, 1)
    return float(-0.5 * (n * np.log(squares / regression.weight**2 / n + 1e-300)).sum())


@dataclass(eq=False)
class Search:
    """Forward with eliminations, then exchanges, until neither finds a better set."""

    contest: Contest
    noise: NoiseDraws
    decision: Decision
    seed: int
    given: Collection[str]
    on_progress: OnProgress
    visited: set[frozenset[str]]
    limit: float = field(default=np.inf, init=False)

    @cached_property
    def start(self) -> EffectSet:
        """The fitted model; effects that were added to the given one may go."""
        fit, members = self.contest.fit, []
        for effect, places in fit.columns.effects:
            mine = np.array([p for p in places if p >= 0 and not fit.estimate.held[p]], dtype=int)
            if effect.label not in self.given and len(mine):
                members.append(Chosen(effect, mine))
        return EffectSet(self.contest, self.contest.regression, tuple(members))

    def run(self) -> EffectSet:
        """The best set."""
        now = self.start
        self.visited.add(now.labels)
        self.ranked(now, fresh=True)
        now = self.grouped(now)
        for number in range(MOST):
            self.on_progress(f"set of {len(now.members)} effects", 0.4 + 0.3 * number / MOST)
            following = self.forward(now) or self.exchanged(now)
            if following is None:
                return now
            now = following
        return now

    def ranked(self, now: EffectSet, fresh: bool) -> Ranking:
        """All laws beside a set; `fresh`: with a null distribution of its residual."""
        found = rank(
            now.contest, now.regression, self.noise, self.decision, self.seed,
            now.labels, curved=False, limit=None if fresh else self.limit, least=NEAR,
        )  # fmt: skip
        self.limit = found.limit
        return found

    def accepted(self, now: EffectSet, new: EffectSet) -> EffectSet | None:
        """The set without what it made superfluous, if it is a new one and a better one."""
        if new.density <= now.density:
            return None
        new = self.lean(replace(new, regression=reweighted(new.regression)))
        if new.labels in self.visited:
            return None
        self.visited.add(new.labels)
        return new

    def lean(self, now: EffectSet) -> EffectSet:
        """Without what brings no more than chance does, the least first, one at a time."""
        while now.members:
            total = float(now.regression.loss.sum())
            doubtful = [e for e in now.members if now.shares[e.effect.label] < 2 * self.limit]
            for each in sorted(doubtful, key=lambda e: now.shares[e.effect.label]):
                bare = now.minus(each)
                rise = float(bare.regression.loss.sum()) / total - 1
                if now.shares[each.effect.label] < 0 or rise < self.limit:
                    now = bare
                    break
            else:
                break
        return now

    def grouped(self, now: EffectSet) -> EffectSet:
        """With all effects that every machine has, where together they bring more than any one."""
        common = [each for each in self.contest.candidates if each.effect.common]
        seen = now.regression.gains([each.groups[0] for each in common]).visible > HIDDEN
        common = [each for each, good in zip(common, seen, strict=True) if good]
        if len(common) < 2:
            return now
        columns = np.concatenate([each.groups[0] for each in common])
        G = now.regression.gains([columns, *(each.groups[0] for each in common)]).G
        if G[0] / float(now.regression.loss.sum()) < self.limit or G[0] < TOGETHER * G[1:].max():
            return now
        all_ = replace(now, regression=now.regression.extended(columns))
        ranking = rank(
            now.contest, now.regression, None, self.decision, self.seed, limit=-np.inf,
            curved=False, only={each.effect.label for each in common},
        )  # fmt: skip
        evidence = {each.effect.label: each for each in ranking.evidence}
        members = [Chosen(each.effect, each.groups[0], evidence[each.effect.label])
                   for each in common]  # fmt: skip
        all_ = replace(all_, members=(*now.members, *members))
        all_ = replace(all_, regression=reweighted(all_.regression))
        self.ranked(all_, fresh=True)
        return self.accepted(now, all_) or now

    def forward(self, now: EffectSet) -> EffectSet | None:
        """With the simplest of the best effects."""
        ranking = self.ranked(now, fresh=False)
        gain = ranking.evidence[0].gain if ranking.evidence else 0.0
        if gain < CLEAR * self.limit:
            ranking = self.ranked(now, fresh=True)
        best = simplest(ranking, self.decision)
        rest = [each for each in ranking.credible if each is not best]
        for each in [best, *rest][:3] if best is not None else []:
            equal = tuple(e.effect for e in rivals(each, ranking, self.decision))
            if (found := self.accepted(now, now.plus(each, equal))) is not None:
                return found
        return None

    def exchanged(self, now: EffectSet) -> EffectSet | None:
        """With one effect exchanged for another of its joints that is better beyond chance."""
        for each in now.members:
            if each.evidence is None:
                continue
            bare = now.minus(each)
            ranking = rank(
                bare.contest, bare.regression, None, self.decision, self.seed,
                bare.labels, curved=False, limit=self.limit, least=NEAR, joints=each.effect.joints,
            )  # fmt: skip
            own = next((e for e in ranking.evidence if e.effect.label == each.effect.label), None)
            for other in ranking.credible[:3]:
                if other is own or (own and behind(own, other) < self.decision.rival_se):
                    continue
                if own and other.numbers > own.numbers and _fall(own, other) < self.limit:
                    continue  # more numbers must bring more than chance does
                equal = tuple(e.effect for e in rivals(other, ranking, self.decision))
                new = bare.plus(other, equal)
                if (found := self.accepted(now, new)) is not None:
                    return found
        return None


def _fall(a: Evidence, b: Evidence) -> float:
    """By how much the left-out squared error is smaller with b than with a, as a share."""
    return float(a.refit.loss.sum() / b.refit.loss.sum()) - 1


# --- the ladder --------------------------------------------------------------------------------


def ladder(
    start: EffectSet, found: EffectSet, removed: tuple[Effect, ...], before: Fit, after: Fit
) -> list[Step]:
    """A rung an effect, the one that explains most of what is left first; the last one fitted.

    Errors between are announced by the same regression, of all rows.
    """
    table = start.contest.table
    held = before.estimate.held
    prior = table.columns.prior_at(table.point.values)
    store = ColumnStore(table, table.informed, table.A, table.b - table.A[:, :, held] @ prior[held])
    new = [each for each in found.members if each.evidence is not None]
    columns = {}
    for each in new:
        assert each.evidence is not None
        shape = each.evidence.shape
        if each.effect.corrects:
            shape = {p.name: each.effect.values.get(p.name, 0.0) for p in each.effect.shapes}
        columns[each.effect.label] = store.add(each.effect, [shape])
    model, weight = start.contest.regression.model, start.contest.regression.weight
    regression = PartialRegression(store.parts(), model, weight)
    first = regression.losses.sum(axis=0) / regression.weight**2
    errors, rungs = errors_of(before), list[Step]()

    def reached(added: Effect | None, out: tuple[Effect, ...], equal: tuple[Effect, ...]) -> None:
        now = regression.losses.sum(axis=0) / regression.weight**2
        share = np.sqrt(now / np.where(first > 0, first, 1.0))
        announced = {
            name: replace(e, rms=e.rms * s, relative=None if e.relative is None else e.relative * s)
            for (name, e), s in zip(errors.items(), map(float, share), strict=True)
        }
        last = rungs[-1].errors if rungs else errors
        rungs.append(Step(added, out, equal, None, fall_of(last, announced), announced))

    if removed:
        gone = {effect.label for effect in removed}
        for each in start.members:
            if each.effect.label in gone:
                regression = regression.without(each.columns)
        reached(None, removed, ())
    while new:
        G = regression.gains([columns[each.effect.label] for each in new]).G
        best = new.pop(int(G.argmax()))
        regression = reweighted(regression.extended(columns[best.effect.label]))
        reached(best.effect, (), best.rivals)
    last, fitted = rungs[-2].errors if len(rungs) > 1 else errors, errors_of(after)
    rungs[-1] = replace(rungs[-1], fit=after, fall=fall_of(last, fitted), errors=fitted)
    return rungs
