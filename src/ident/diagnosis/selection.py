"""The rule of evidence: which candidates are credible, which one is preferred, which are rivals.

A candidate is credible if

* its gain g exceeds the (1 − alpha) quantile of the largest gain over all candidates on residuals
  in which nothing is missing. Waves of position must pass the filter at many speeds, not only
  around reversals, where friction that is not quite sign(v) looks like some wave;
* its torque exceeds the share `material` of its joint's;
* its values are such as this kind of effect can have, a body with a mass among them, and differ
  from those that the model has of it beyond the errors of both.

Of candidates that explain the same part within PARSIMONY of the best gain, the one with the fewest
numbers is chosen, unless the best one is better by `rival_se` standard errors of the paired
difference and by more than chance.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from numbers import Real

import numpy as np

from ident.diagnosis.candidates import STANDS_FOR, CandidateColumns, Contest, Shape
from ident.diagnosis.law_search import refined
from ident.diagnosis.null import SURROGATES, NoiseDraws, Screened, judging
from ident.effects import Effect
from ident.errors import FitError
from ident.fit.shapes import widened
from ident.information.chance import ALPHA, MINE, NEGATIVE, PARSIMONY, RIVAL, Chance, paired, zscore
from ident.information.estimate import MATERIAL
from ident.information.hypotheses import Array, Index, PartialRegression, Refit
from ident.mechanism.mechanism import Mechanism

MOST = 0.5  # level: of a joint's squares: what explains less of them is not its main cause
ALIKE = 0.7  # level: cosine of what two candidates explain: half of the squares are the same part
THIRD = 1 / 3  # range: of a length, by which no drawing is off
EQUAL = 9  # numerics: digits of a gain, beyond which it is rounding
CLOSEST = 12  # work: candidates that are looked at in detail though they are not credible
OnProgress = Callable[[str, float], None]


@dataclass(frozen=True)
class Decision:
    """The three arguments of the rule of evidence.

    Attributes:
        alpha: chance that anything is credible where nothing is missing.
        material: share of a joint's torque that an effect must have to matter.
        rival_se: standard errors of the paired difference within which two are rivals.
    """

    alpha: float = ALPHA
    material: float = MATERIAL
    rival_se: float = RIVAL

    def __post_init__(self) -> None:
        """Refuse what is no chance, no share, or below what the random residuals can show."""
        least = 1 / SURROGATES
        for name, number in vars(self).items():
            if not isinstance(number, Real):
                raise FitError(f"{name} = {number!r}: is no number; valid: 0.01, for one")
        if not least <= self.alpha <= 0.5:
            raise FitError(
                f"alpha = {self.alpha:g}: {SURROGATES} random residuals show chances from "
                f"{least:g}; valid: {least:g} to 0.5"
            )
        if not 0 <= self.material < 1:
            raise FitError(
                f"material = {self.material:g}: is no share of a joint's torque; valid: 0 to below "
                "1, such as 0.003"
            )
        if not 0 <= self.rival_se < np.inf:
            raise FitError(
                f"rival_se = {self.rival_se:g}: valid: 0 or more standard errors, such as 2"
            )

    def matters(self, before: Array | float, after: Array | float, torque: Array | float) -> bool:
        """Whether squares (d,) that fall as an effect or a law enters fall by more than the share
        `material` of the torque's in some joint.
        """
        return bool(np.any(np.subtract(before, after) > self.material**2 * np.asarray(torque)))

    def __str__(self) -> str:
        return f"alpha {self.alpha:g}, material {self.material:g}, rival-se {self.rival_se:g}"


@dataclass(frozen=True, eq=False)
class Evidence:
    """The evidence for one candidate.

    Attributes:
        effect, shape: which.
        columns: where its columns are in the regression; () of a refined shape, whose columns and
            sensitivities C (m, u) in each part are new.
        refit: everything refitted with it; its columns, then its shapes' sensitivities.
        gain: share g of the left-out squares that it explains, all coordinates.
        limit: what the gain was held against, as a share; p: chance of such a gain where nothing
            is missing, NaN where no null distribution was made.
        size: rms of its torque as a share of its joint's, the largest.
        sensible: whether no value and no shape is one that such an effect cannot have.
        credible: all of it.
    """

    effect: Effect
    shape: Shape
    columns: Index
    C: tuple[Array, ...]
    refit: Refit
    gain: float
    limit: float
    p: float
    size: float
    sensible: bool
    credible: bool

    @property
    def numbers(self) -> int:
        """Number of its parameters."""
        return len(self.effect.parameters)

    @property
    def mends(self) -> tuple[int, ...]:
        """Coordinates that it mends."""
        by = np.maximum(self.refit.by, 0.0)
        return tuple(int(u) for u in np.flatnonzero(by >= MINE * max(by.sum(), 1e-300)))

    @property
    def coordinate(self) -> int:
        """Coordinate whose error it lowers most."""
        return int(self.refit.by.argmax())

    def squares(self, regression: PartialRegression) -> Array:
        """(d,) squares of its torque in the rows in which it was found."""
        C = np.concatenate(self.C or [part.taken(self.columns) for part in regression.parts])
        return regression.by_coordinate((C @ self.refit.theta) ** 2).sum(axis=0)

    @property
    def determined(self) -> bool:
        """Whether some coefficient is larger than its error, with the noise that it leaves."""
        error = NEGATIVE * self.refit.stderr * np.sqrt(max(1.0 - self.gain, 0.0))
        count = len(self.effect.unknowns) or None
        return bool((np.abs(self.refit.theta) > error)[:count].any())

    @property
    def z(self) -> float:
        """Standard errors of its gain over blocks of time."""
        return zscore(self.refit.D)


@dataclass(frozen=True, eq=False)
class Ranking:
    """All candidates on one model, best first.

    Attributes:
        evidence: of those that are credible or come closest.
        gains: by label, share g of the left-out squares, visible share, and which start has
            that gain, of all.
        chance: the largest gains of all laws where nothing is missing; with_curves: of the curves
            as well.
        curves: credible curves, best first.
        hints: by joint its best curve, where the gain exceeds the quantile of the largest gain of
            this joint's curves; with both.
    """

    contest: Contest
    regression: PartialRegression
    evidence: tuple[Evidence, ...]
    gains: Mapping[str, tuple[float, float, int]]
    chance: Chance
    with_curves: Chance
    curves: tuple[tuple[Effect, float], ...]
    hints: tuple[tuple[Effect, float, float], ...]

    def limit_of(self, candidate: CandidateColumns) -> float:
        """What the gain of a candidate is held against, as a share."""
        place = self.regression.place(candidate.groups[0])
        return (self.with_curves if candidate.curve else self.chance).limit(place)

    def limit_at(self, joint: str) -> float:
        """What the gain of a curve or law of a joint is held against, as a share."""
        mine = (e.groups[0] for e in self.contest.candidates if e.effect.joints == (joint,))
        place = min(map(self.regression.place, mine), default=self.regression.d)
        return max(self.chance.limit(place), self.with_curves.limit(place))

    def place(self, label: str) -> tuple[bool, float]:
        """Sort key of an effect: first what is credible alone, by what it explains alone."""
        alone = {each.effect.label for each in self.credible}
        return label not in alone, -self.gains.get(label, (0.0,))[0]

    def every(self, decision: Decision) -> list[Evidence]:
        """The evidence for all laws, those that were not looked at in detail last."""
        done = {each.effect.label for each in self.evidence}
        laws = [e for e in self.contest.laws if e.effect.label in {*self.gains} - done]
        starts = [[self.gains[each.effect.label][2]] for each in laws]
        return [*self.evidence, *self.looked_at(laws, starts, decision)]

    def looked_at(
        self, laws: Sequence[CandidateColumns], starts: Sequence[Sequence[int]], decision: Decision
    ) -> list[Evidence]:
        """The evidence for some laws, each from its starts, the best of them first."""
        refits = self.regression.refits(
            [law.groups[own[0]] for law, own in zip(laws, starts, strict=True)]
        )
        return [
            weigh(self, law, own, decision, refit)
            for law, own, refit in zip(laws, starts, refits, strict=True)
        ]

    @property
    def credible(self) -> tuple[Evidence, ...]:
        """The credible ones."""
        return tuple(each for each in self.evidence if each.credible)


def rank(
    contest: Contest,
    regression: PartialRegression,
    noise: NoiseDraws | None,
    decision: Decision,
    seed: int,
    without: Collection[str] = (),
    curved: bool = True,
    chance: Chance | None = None,
    least: float = 0.0,
    only: Collection[str] | None = None,
) -> Ranking:
    """Weighs all candidates beside a model, `curved`: the curves as well as the laws.

    With the limits of a `chance` no null distribution is made. Candidates below the share `least`
    of the largest gain are not looked at in detail; `only`: these are weighed, by their labels.
    """
    mine = [
        each
        for each in contest.candidates
        if each.effect.label not in without
        and (curved or not each.curve)
        and (only is None or each.effect.label in only)
    ]
    if chance is None and mine:
        regression = judging(contest, regression, noise, seed)
    screened = Screened.beside(regression, mine)
    hints: tuple[tuple[Effect, float, float], ...] = ()
    if chance is None:
        laws = [i for i, each in enumerate(mine) if not each.curve]
        chance = screened.chance(laws, decision.alpha)
        with_curves = screened.chance(range(len(mine)), decision.alpha)
        hints = tuple(screened.hints(decision.alpha))
    else:
        with_curves = chance
    gain, labels = screened.gain.tolist(), [each.effect.label for each in mine]
    starts = screened.starts
    found = Ranking(
        contest,
        regression,
        (),
        {n: (gain[i], float(screened.visible[i]), starts[i][0]) for i, n in enumerate(labels)},
        chance,
        with_curves,
        (),
        hints,
    )
    order = np.argsort(-screened.gain).tolist()
    good = {i for i in order if gain[i] > found.limit_of(mine[i])}
    curves = tuple((mine[i].effect, gain[i]) for i in order if mine[i].curve and i in good)
    laws = [i for i in order if not mine[i].curve]
    wanted = [i for k, i in enumerate(laws) if i in good or k < CLOSEST]
    evidence = list[Evidence]()
    best = 0.0  # gain of the first candidate that is credible
    while wanted and gain[wanted[0]] >= least * best:
        some = wanted if best or not least else wanted[:1]
        wanted = wanted[len(some) :]
        some = [i for i in some if gain[i] >= least * best]
        evidence += found.looked_at([mine[i] for i in some], [starts[i] for i in some], decision)
        best = max((each.gain for each in evidence if each.credible), default=0.0)
    evidence.sort(key=lambda each: -each.gain)
    return replace(found, evidence=tuple(evidence), curves=curves)


def weigh(
    ranking: Ranking, candidate: CandidateColumns, starts: Sequence[int], decision: Decision,
    refit: Refit,
) -> Evidence:  # fmt: skip
    """Return the evidence for a candidate beside the model of a ranking.

    Args:
        starts: from which a shape is refined, the best first: the error of left-out blocks has many
            minima along the number of waves, and the least may lie between two starts.
        refit: with the best start.
    """
    contest, regression = ranking.contest, ranking.regression
    gain = ranking.gains[candidate.effect.label][0]
    limit, place = ranking.limit_of(candidate), regression.place(candidate.groups[0])
    effect, shape = candidate.effect, dict(candidate.shapes[starts[0]])
    passed = gain > limit
    columns, C = candidate.groups[starts[0]], list[Array]()
    if effect.corrects:
        bounds = contest.table.bounds(effect)
        for each, value in zip(effect.searched, refit.theta, strict=True):
            shape[each.name] = float(np.clip(shape[each.name] + value, *bounds[each.name]))
    elif passed and any(not each.discrete for each in effect.searched):
        ends = [refined(contest, regression, effect, candidate.shapes[i]) for i in starts]
        found, C, refit = max(ends, key=lambda end: regression.gain(end[2]))
        shape, columns = dict(found), columns[:0]
    torque = torque_squares(contest, regression)
    by = np.maximum(refit.by, 0.0)
    mends = by >= MINE * max(by.sum(), 1e-300)
    size = float(np.sqrt(by / np.where(torque > 0, torque, np.inf))[mends].max(initial=0.0))
    stderr = refit.stderr * np.sqrt(
        refit.loss.sum() / max(regression.loss.sum(), 1e-300)
    )  # by what is left with it
    plausible = contest.possible(effect, shape)
    plausible &= sensible(contest, effect, refit.theta, stderr)
    massive = not effect.loaded_link or bool(abs(refit.theta[0]) > NEGATIVE * stderr[0])
    seen = not effect.waves or contest.passed(effect.joints[0], shape[effect.waves]) > STANDS_FOR
    credible = passed and plausible and massive and seen and size > decision.material
    return Evidence(
        effect,
        shape,
        columns,
        tuple(C),
        refit,
        regression.gain(refit),
        limit,
        ranking.chance.p(gain, place),
        size,
        plausible,
        credible and differs(contest, effect, refit.theta, stderr),
    )


def torque_squares(contest: Contest, regression: PartialRegression) -> Array:
    """(d,) weighted squares of the measured torque in the rows that decide."""
    tau = contest.table.tau
    return np.array(
        [
            float((tau[contest.use[:, u], u] ** 2).sum()) * regression.weight[u] ** 2
            for u in range(regression.d)
        ]
    )


def sensible(contest: Contest, effect: Effect, theta: Array, stderr: Array) -> bool:
    """Return whether an effect can have its values (u,), with those known already added."""
    names = effect.unknowns or effect.searched
    own = next((e.values for e in contest.fit.mechanism.effects if e.label == effect.label), {})
    values = theta[: len(names)] + [own.get(each.name, 0.0) for each in names]
    if effect.corrects:
        bounds = contest.table.bounds(effect)
        ends = (widened(*bounds[each.name]) for each in names)
        if not all(a <= x <= b for x, (a, b) in zip(values, ends, strict=True)):
            return False
    return can_be(contest.fit.mechanism, effect, values, stderr)


def can_be(mechanism: Mechanism, effect: Effect, values: Array, stderr: Array) -> bool:
    """Return whether an effect can have values (u,) of its unknowns, of a correction of its shapes.

    None is larger than the kind allows, none that must not be negative is so beyond its error, and
    no length differs from the drawing by more than a third.
    """
    rounding = 1e-9 * float(np.abs(values).max(initial=0.0))  # of a value that no row determines
    length = np.inf
    if effect.sits == "place" and effect.joints:
        length = abs(mechanism.lengths.get(effect.joints[0], np.inf))
    return not any(
        abs(value) > min(each.largest, THIRD * length)
        or (each.nonnegative and value < -max(NEGATIVE * error, rounding))
        for each, value, error in zip(
            effect.unknowns or effect.searched, values, stderr, strict=False
        )
    )


def differs(contest: Contest, effect: Effect, theta: Array, stderr: Array) -> bool:
    """Return whether an effect is not in the model, or has values there from which these differ, by
    theta (u,), beyond the errors of both.
    """
    errors, names = contest.fit.known_errors, effect.names
    if errors is None or not set(names) <= set(errors.names):
        return True
    of = dict(zip(errors.names, np.diag(errors.matrix), strict=True))
    both = np.sqrt([x**2 + of[name] for x, name in zip(stderr, names, strict=False)])
    return bool((np.abs(theta[: len(both)]) > NEGATIVE * both).any())


# --- names and sets ----------------------------------------------------------------------------


def alike(a: Evidence, b: Evidence) -> bool:
    """Return whether two candidates explain the same part."""
    return float(a.refit.direction @ b.refit.direction) > ALIKE


def behind(a: Evidence, b: Evidence) -> float:
    """Standard errors of paired blocks by which b is better than a."""
    return paired(a.refit.loss.sum(axis=1), b.refit.loss.sum(axis=1))


def by_chance(a: Evidence, b: Evidence, rows: Array, limit: float) -> bool:
    """Return whether b lowers the left-out squared error below that of a by no more than chance.

    The fall is the geometric mean over all rows (d,) of the coordinates, each weighted by its own
    error, so that joints in which neither explains anything do not dilute it; chance is `limit`.
    """
    one, other = (np.maximum(each.refit.loss.sum(axis=0), 1e-300) for each in (a, b))
    return 1 - float(np.exp(rows @ np.log(other / one) / rows.sum())) < limit


def as_good(
    best: Evidence, every: Sequence[Evidence], rows: Array, decision: Decision
) -> list[Evidence]:
    """Return the candidates that explain the same part as well as the best; rows (d,)."""
    return [
        each
        for each in every
        if each is best
        or (
            alike(each, best)
            and each.gain >= (1 - PARSIMONY) * best.gain
            and (behind(each, best) < decision.rival_se or by_chance(each, best, rows, best.limit))
        )
    ]


def simplicity(each: Evidence) -> tuple[bool, bool, int, float]:
    """Return the sort key of candidates that explain as much: a cause before what only describes a
    curve, what many machines have before what few have, then by the number of parameters.
    """
    return each.effect.descriptive, each.effect.rare, each.numbers, -round(each.gain, EQUAL)


def simplest(ranking: Ranking, decision: Decision) -> Evidence | None:
    """The credible candidate with the fewest numbers among those as good as the best; of those with
    the same columns in a loop that of a drive, whose gears and bearings carry more.
    """
    credible = [
        each
        for each in ranking.credible
        if each.determined or not any(_nested(small, each) for small in ranking.credible)
    ]
    if not credible:
        return None
    equal = as_good(credible[0], credible, ranking.regression.rows, decision)
    driven = {*ranking.contest.fit.mechanism.driven}
    return min(equal, key=lambda each: (*simplicity(each), not driven & {*each.effect.joints}))


def rivals(best: Evidence, ranking: Ranking, decision: Decision) -> tuple[Evidence, ...]:
    """Credible candidates that explain the same part, as well within the error.

    An effect that only describes a curve names no cause: a law that is a special case of it is a
    rival however much better the curve is.
    """
    return tuple(
        each
        for each in ranking.credible
        if each is not best
        and alike(each, best)
        and (
            behind(each, best) < decision.rival_se
            or (best.effect.descriptive and _nested(each, best))
        )
        and not (_nested(best, each) and behind(best, each) < 1.0)
    )


def _nested(small: Evidence, large: Evidence) -> bool:
    """Return whether one law is a special case of the other, at the same place."""
    a, b = small.effect, large.effect
    return a.joints == b.joints and b.kind in a.nested_in
