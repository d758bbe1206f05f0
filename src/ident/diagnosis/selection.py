"""The rule of evidence: which candidates are credible, which one is preferred, which are rivals.

A candidate is credible (`information.evidence`) if

* its gain g exceeds the (1 − alpha) quantile of the largest gain over all candidates on residuals
  in which nothing is missing;
* its torque exceeds the share `material` of its joint's;
* it can be: its values are such as this kind of effect can have, a body with a mass among them, and
  differ from those that the model has of it beyond the errors of both. Waves of position must pass
  the filter at many speeds, not only around reversals, where friction that is not quite sign(v)
  looks like some wave.

Of candidates that explain the same part within PARSIMONY of the best gain, the one with the fewest
numbers is chosen, unless the best one is better by `rival_se` standard errors of the paired
difference and by more than chance.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from ident.diagnosis.candidates import STANDS_FOR, CandidateColumns, Contest, Shape
from ident.diagnosis.law_search import refined, refined_extent
from ident.diagnosis.null import judging, null_by_coordinate, null_shares
from ident.effects import Effect
from ident.fit.shapes import widened
from ident.information.evidence import (
    CERTAIN,
    NEGATIVE,
    PARSIMONY,
    SURROGATES,
    Chance,
    credible,
    limit_by_coordinate,
    paired,
    rivals_of,
    zscore,
)
from ident.information.hypotheses import Array, Gains, Index, PartialRegression, Refit
from ident.mechanism.mechanism import Mechanism

# level: cosine of what two candidates explain: half of the squares are the same part
SAME_PART = 0.7
THIRD = 1 / 3  # range: of a length, by which no drawing is off
EQUAL = 9  # numerics: digits of a gain, beyond which it is rounding
STARTS = 4  # work: of a searched shape, from which it is refined
EXTENT_STARTS = 2  # work: the same of a correction that is not linear
BODY = 10  # range: parameters of a body
REACH = 2.0  # range: times the lengths from joint to joint, within which a load's centre is
CLOSEST = 12  # work: candidates that are looked at in detail though they are not credible


Hint = tuple[Effect, float, float]


@dataclass(frozen=True, eq=False)
class Evidence:
    """The evidence for one candidate."""

    effect: Effect
    shape: Shape
    columns: Index  # its columns in the regression; () of a refined shape, …
    C: tuple[Array, ...]  # … whose columns and sensitivities (m, u) in each part are new
    refit: Refit  # with its columns, then its shapes' sensitivities
    gain: float  # share g of the left-out squares that it explains, all coordinates
    limit: float  # share that the gain was held against
    p: float  # chance of such a gain where nothing is missing; NaN without a null distribution
    size: float  # rms of its torque as a share of its joint's, the largest
    sensible: bool  # whether such an effect can have its values and its shape
    credible: bool  # all of it
    start: Shape = field(default_factory=dict)  # of its search, at which its columns were made

    @property
    def numbers(self) -> int:
        """Number of its parameters."""
        return len(self.effect.parameters)

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
    """All candidates on one model, best first."""

    contest: Contest  # with the model, and the random residuals of its null distribution
    evidence: tuple[Evidence, ...]  # of those that are credible or come closest
    # by label, share g of the left-out squares, visible share, and which start has that gain
    gains: Mapping[str, tuple[float, float, int]]
    starts: Mapping[str, Sequence[int]]  # by label, those with most gain, best first
    # by label of what acts on several coordinates, the share (d,) of each with the best start
    by_coordinate: Mapping[str, Array]
    curves: tuple[tuple[Effect, float], ...]  # credible ones with their gains, best first
    chance: Chance  # the largest gains of all laws where nothing is missing
    with_curves: Chance  # of the curves as well
    # by joint its best curve, its gain and the limit of this joint's curves, where that is less
    hints: tuple[Hint, ...]

    @property
    def regression(self) -> PartialRegression:
        """The model."""
        return self.contest.regression

    def limit_of(self, candidate: CandidateColumns) -> float:
        """What the gain of a candidate is held against, as a share."""
        chance, label = self.with_curves if candidate.curve else self.chance, candidate.effect.label
        shares = self.by_coordinate.get(label, np.zeros(0))
        gain = self.gains.get(label, (0.0,))[0]
        place = self.regression.place(candidate.groups[0])
        return limit_by_coordinate(chance, gain, place, shares)

    def limit_at(self, joint: str) -> float:
        """What the gain of a curve or law of a joint is held against, as a share."""
        groups = (e.groups[0] for e in self.contest.candidates if e.effect.joints == (joint,))
        place = min(map(self.regression.place, groups), default=self.regression.d)
        return max(self.chance.limit(place), self.with_curves.limit(place))

    def place(self, label: str) -> tuple[bool, float]:
        """Sort key of an effect: first what is credible alone, by what it explains alone."""
        alone = {evidence.effect.label for evidence in self.credible}
        return label not in alone, -self.gains.get(label, (0.0,))[0]

    @property
    def every(self) -> list[Evidence]:
        """The evidence for all laws, those that were not looked at in detail last."""
        done = {candidate.effect.label for candidate in self.evidence}
        laws = [e for e in self.contest.laws if e.effect.label in {*self.gains} - done]
        starts = [[self.gains[candidate.effect.label][2]] for candidate in laws]
        return [*self.evidence, *self.looked_at(laws, starts)]

    def looked_at(
        self, laws: Sequence[CandidateColumns], starts: Sequence[Sequence[int]]
    ) -> list[Evidence]:
        """The evidence for some laws, each from its starts, the best of them first."""
        refits = self.regression.refits(
            [law.groups[law_starts[0]] for law, law_starts in zip(laws, starts, strict=True)]
        )
        return [weigh(self, *arguments) for arguments in zip(laws, starts, refits, strict=True)]

    @property
    def credible(self) -> tuple[Evidence, ...]:
        """The credible ones."""
        return tuple(evidence for evidence in self.evidence if evidence.credible)


def rank(
    contest: Contest, without: Collection[str] = (), curved: bool = True,
    chance: Chance | None = None, least: float = 0.0, only: Collection[str] | None = None,
) -> Ranking:  # fmt: skip
    """Weighs all candidates beside a model, `curved`: the curves as well as the laws.

    With the limits of a `chance` no null distribution is made. Candidates below the share `least`
    of the largest gain are not looked at in detail; `only`: these are weighed, by their labels.
    """
    candidates = [
        candidate
        for candidate in contest.candidates
        if candidate.effect.label not in without
        and (curved or not candidate.curve)
        and (only is None or candidate.effect.label in only)
    ]
    contest = judging(contest) if chance is None and candidates else contest
    measured = contest.regression.gains([group for item in candidates for group in item.groups])
    gains, starts, shares = _gains_by_label(contest.regression, measured, candidates)
    limits = (chance, chance, ()) if chance else _limits(contest, measured, candidates, gains)
    return _in_detail(Ranking(contest, (), gains, starts, shares, (), *limits), least)


def rank_curves(ranking: Ranking, without: Collection[str] = ()) -> Ranking:
    """Return a ranking of laws with the curves as well, on the same random residuals, and with all
    laws in detail that are credible or come closest.
    """
    contest = ranking.contest
    curves = [c for c in contest.candidates if c.curve and c.effect.label not in without]
    if not ranking.gains:  # no law, and no random residuals
        return rank(contest, without)
    if curves:
        measured = contest.regression.gains([group for curve in curves for group in curve.groups])
        gains, starts, shares = _gains_by_label(contest.regression, measured, curves)
        _, of_curves, hints = _limits(contest, measured, curves, gains)
        ranking = replace(
            ranking,
            gains={**ranking.gains, **gains},
            starts={**ranking.starts, **starts},
            by_coordinate={**ranking.by_coordinate, **shares},
            with_curves=ranking.chance.largest(of_curves),
            hints=hints,
        )
    return _in_detail(ranking, 0.0)


def _gains_by_label(
    regression: PartialRegression, measured: Gains, candidates: Sequence[CandidateColumns]
) -> tuple[dict[str, tuple[float, float, int]], dict[str, list[int]], dict[str, Array]]:
    """Return by label the gain, the visible share and the best start of candidates, their starts
    with most gain, and the share (d,) of each coordinate of those that act on several.
    """
    shares, gains, starts, by_coordinate = regression.explained(measured.by), {}, {}, {}
    of_coordinates = regression.explained_by_coordinate(measured.by)
    ends = np.cumsum([0, *(len(candidate.groups) for candidate in candidates)])
    for candidate, (a, b) in zip(candidates, pairwise(ends), strict=True):
        label, order = candidate.effect.label, np.argsort(-shares[a:b], kind="stable")
        starts[label] = order[:STARTS].tolist()
        first = starts[label][0]
        gains[label] = float(shares[a + first]), float(measured.visible[a:b].max()), first
        if regression.place(candidate.groups[0]) == regression.d:
            by_coordinate[label] = of_coordinates[a + first]
    return gains, starts, by_coordinate


def _in_detail(ranking: Ranking, least: float) -> Ranking:
    """Return the ranking with the credible curves, and the evidence for the laws that are credible
    or come closest; see `rank` for the share `least`.
    """
    gains = ranking.gains
    candidates = [c for c in ranking.contest.candidates if c.effect.label in gains]
    candidates.sort(key=lambda candidate: -gains[candidate.effect.label][0])
    good = [c for c in candidates if gains[c.effect.label][0] > ranking.limit_of(c)]
    curves = tuple((c.effect, gains[c.effect.label][0]) for c in good if c.curve)
    labels = {candidate.effect.label for candidate in good}
    laws = [candidate for candidate in candidates if not candidate.curve]
    wanted = [c for k, c in enumerate(laws) if c.effect.label in labels or k < CLOSEST]
    evidence = [*ranking.evidence]
    done = {e.effect.label for e in evidence}
    most = max((e.gain for e in evidence if e.credible), default=0.0)  # of the first credible one
    while wanted and gains[wanted[0].effect.label][0] >= least * most:
        batch = wanted if most or not least else wanted[:1]
        wanted = wanted[len(batch) :]
        batch = [c for c in batch if gains[c.effect.label][0] >= least * most]
        batch = [c for c in batch if c.effect.label not in done]
        evidence += ranking.looked_at(batch, [ranking.starts[c.effect.label] for c in batch])
        most = max((e.gain for e in evidence if e.credible), default=0.0)
    evidence.sort(key=lambda e: -e.gain)
    return replace(ranking, evidence=tuple(evidence), curves=curves)


def _limits(
    contest: Contest, measured: Gains, candidates: Sequence[CandidateColumns],
    gains: Mapping[str, tuple[float, float, int]],
) -> tuple[Chance, Chance, tuple[Hint, ...]]:  # fmt: skip
    """Return what chance gives laws, and candidates with curves, and the hints of a ranking."""
    alpha, regression = contest.decision.alpha, contest.regression
    null = null_shares(regression, measured)
    gain = [gains[candidate.effect.label][0] for candidate in candidates]
    place = np.array([regression.place(candidate.groups[0]) for candidate in candidates], dtype=int)
    of = np.repeat(np.arange(len(candidates)), [len(candidate.groups) for candidate in candidates])

    def largest(chosen: Collection[int]) -> Chance:
        """The largest shares of random residuals that some candidates explain, by place."""
        at = np.isin(of, [*chosen])
        most = {int(u): null[at & (place[of] == u)].max(axis=0) for u in {*place[of[at]]}}
        several = at & (place[of] == regression.d)
        if several.any() and regression.d > 1:
            strongest = null_by_coordinate(regression, measured.null[several]).max(axis=0)
            most |= {regression.d + 1 + u: x for u, x in enumerate(strongest)}
        residual = {u: x[:SURROGATES] for u, x in most.items()}
        return Chance(residual, {u: x[SURROGATES:] for u, x in most.items()}, alpha)

    laws = largest([i for i, candidate in enumerate(candidates) if not candidate.curve])
    by_joint: dict[str, list[int]] = {}
    hints = list[Hint]()
    for i, candidate in enumerate(candidates):
        if candidate.curve:
            by_joint.setdefault(candidate.effect.joints[0], []).append(i)
    for indices in by_joint.values():
        best = max(indices, key=gain.__getitem__)
        limit = max(largest(indices).limit(int(place[best])), 0.0)
        hints += [(candidates[best].effect, gain[best], limit)] if gain[best] > limit else []
    return laws, largest(range(len(candidates))), tuple(hints)


def weigh(
    ranking: Ranking, candidate: CandidateColumns, starts: Sequence[int], refit: Refit
) -> Evidence:
    """Return the evidence for a candidate beside the model of a ranking.

    Its shape is refined from `starts`, the best first, since the error has many minima along the
    number of waves; `refit`: with the best start.
    """
    contest, regression = ranking.contest, ranking.regression
    gain = ranking.gains[candidate.effect.label][0]
    limit, place = ranking.limit_of(candidate), regression.place(candidate.groups[0])
    effect, shape = candidate.effect, dict(candidate.shapes[starts[0]])
    passed = gain > limit
    columns, C = candidate.groups[starts[0]], list[Array]()
    start: Shape = shape
    if effect.corrects:
        if passed and shape.get(effect.extent):
            ends = [
                refined_extent(contest, effect, candidate.shapes[i]) for i in starts[:EXTENT_STARTS]
            ]
            start, C, refit = max(ends, key=lambda end: regression.gain(end[2]))
            columns = columns[:0]
        bounds = contest.table.bounds(effect)
        # of a drive beyond the values of the model
        ends_of = {} if effect.supplies_torque else bounds
        values = refit.theta + shape_before(effect, start)
        shape = {
            parameter.name: float(np.clip(value, *ends_of.get(parameter.name, (-np.inf, np.inf))))
            for parameter, value in zip(effect.searched, values, strict=True)
        } | {name: x for name, x in start.items() if name in effect.values}
    elif passed and any(not parameter.discrete for parameter in effect.searched):
        ends = [refined(contest, effect, candidate.shapes[i]) for i in starts]
        refined_shape, C, refit = max(ends, key=lambda end: regression.gain(end[2]))
        shape, columns = dict(refined_shape), columns[:0]
    torque = np.where(contest.torque > 0, contest.torque, np.inf)
    size = float(
        np.sqrt(np.maximum(refit.by, 0.0) / torque)[refit.affected_coordinates].max(initial=0.0)
    )
    remaining = refit.loss.sum() / max(regression.loss.sum(), 1e-300)
    stderr = refit.stderr * np.sqrt(remaining)
    plausible = contest.possible(effect, shape)
    plausible &= sensible(contest, effect, refit.theta + shape_before(effect, start), stderr)
    massive = not effect.loaded_link or has_mass(
        contest.fit.mechanism, refit.theta[:BODY], stderr[:BODY]
    )
    resolved = (
        not effect.waves or contest.passed(effect.joints[0], shape[effect.waves]) > STANDS_FOR
    )
    possible = plausible and massive and resolved and differs(contest, effect, refit.theta, stderr)
    believed = credible(gain, limit, size=size, least=contest.decision.material, possible=possible)
    own_gain, p = regression.gain(refit), ranking.chance.p(gain, place)
    for u, share in enumerate(ranking.by_coordinate.get(effect.label, ())):
        p = float(np.fmin(p, ranking.chance.p(float(share), place + 1 + u)))
    return Evidence(
        effect, shape, columns, tuple(C), refit, own_gain, limit, p, size, plausible, believed,
        start,
    )  # fmt: skip


def shape_before(effect: Effect, start: Shape) -> Array:
    """Return what is added to the coefficients (u,) of a candidate to have its values: the start of
    shapes whose columns are slopes there, 0 else.
    """
    if not effect.corrects:
        return np.zeros(1)
    names = [parameter.name for parameter in effect.searched]
    return np.array([0.0 if name == effect.extent else start[name] for name in names])


def sensible(contest: Contest, effect: Effect, theta: Array, stderr: Array) -> bool:
    """Return whether an effect can have its values (u,), with those known already added."""
    names = effect.unknowns or effect.searched
    present = any(e.label == effect.label for e in contest.fit.mechanism.effects)
    known = contest.fit.point.values if present else {}
    values = theta[: len(names)] + [known.get(effect.full[p.name], 0.0) for p in names]
    if effect.corrects:
        bounds = contest.table.bounds(effect)
        ends = (widened(*bounds[parameter.name]) for parameter in names)
        if not all(a <= x <= b for x, (a, b) in zip(values, ends, strict=True)):
            return False
    return can_be(contest.fit.mechanism, effect, values, stderr)


def can_be(mechanism: Mechanism, effect: Effect, values: Array, stderr: Array) -> bool:
    """Return whether an effect can have values (u,); a length may be off by a third."""
    rounding = 1e-9 * float(np.abs(values).max(initial=0.0))  # of a value that no row determines
    if link := effect.loaded_link:
        place = mechanism.bodies.columns(link).start
        mass, known = mechanism.prior[place], mechanism.bodies.names[place] not in mechanism.unknown
        # a body sits on another one, and none can be taken off that is not there
        if known and (mass <= 0 or mass + values[0] < -NEGATIVE * stderr[0]):
            return False
    length = np.inf
    if effect.sits == "place" and effect.joints:
        length = abs(mechanism.lengths.get(effect.joints[0], np.inf))
    return all(
        parameter.possible(value, max(error, rounding), THIRD * length)
        for parameter, value, error in zip(
            effect.unknowns or effect.searched, values, stderr, strict=False
        )
    )


def has_mass(mechanism: Mechanism, values: Array, stderr: Array) -> bool:
    """Return whether ten values may be a body's: its mass is known to differ from zero, or a first
    moment h is and its moments may be those of a mass; which some body within the errors has within
    the machine's reach r,

        |h| ≤ r m        h_y² + h_z² ≤ m L_xx, and so about y and z
    """
    mass, moments = abs(values[0]) + NEGATIVE * stderr[0], values[1:4]
    h = np.where(np.abs(moments) > NEGATIVE * stderr[1:4], moments, 0.0)
    reach = REACH * sum(map(abs, mechanism.lengths.values())) or np.inf
    if np.linalg.norm(h) > reach * mass:
        return False
    if abs(values[0]) > CERTAIN * stderr[0]:
        return True
    diagonal = [4, 6, 9]  # Lxx, Lyy, Lzz
    known = stderr[diagonal] > 0
    most = np.abs(values[diagonal]) + NEGATIVE * stderr[diagonal]
    return bool(h.any() and np.all(((h @ h - h**2) <= mass * most)[known]))


def may_be_load(values: Array, stderr: Array) -> bool:
    """Return whether ten parameters may be those of a body that was put on, or taken off: its
    moments are those of a mass there at least, h_y² + h_z² ≤ m L_xx, and so about y and z.

    All within their errors of noise and calibration; a moment that has none is not determined.
    """
    load = np.sign(values[0]) * values
    error = NEGATIVE * np.where(np.isfinite(stderr), stderr, 0.0)
    diagonal = [4, 6, 9]  # Lxx, Lyy, Lzz
    h = np.maximum(np.abs(load[1:4]) - error[1:4], 0.0)
    most = (load[0] + error[0]) * (load[diagonal] + error[diagonal])
    return bool(np.all(((h @ h - h**2) <= most)[error[diagonal] > 0]))


def differs(contest: Contest, effect: Effect, theta: Array, stderr: Array) -> bool:
    """Return whether an effect is new to the model, or changes by theta (u,) beyond both errors."""
    errors, names = contest.fit.known_errors, effect.names
    if errors is None or not set(names) <= set(errors.names):
        return True
    of = dict(zip(errors.names, np.diag(errors.matrix), strict=True))
    both = np.sqrt([x**2 + of[name] for x, name in zip(stderr, names, strict=False)])
    return bool((np.abs(theta[: len(both)]) > NEGATIVE * both).any())


# --- names and sets ----------------------------------------------------------------------------


def same_part(a: Evidence, b: Evidence) -> bool:
    """Return whether two candidates explain the same part."""
    return float(a.refit.direction @ b.refit.direction) > SAME_PART


def behind(a: Evidence, b: Evidence) -> float:
    """Standard errors of paired blocks by which b is better than a."""
    return paired(a.refit.loss.sum(axis=1), b.refit.loss.sum(axis=1))


def by_chance(a: Evidence, b: Evidence, rows: Array, limit: float) -> bool:
    """Return whether b lowers the left-out squared error below that of a by no more than chance.

    The fall is the geometric mean over all rows (d,) of the coordinates, each weighted by its own
    error, so that joints in which neither explains anything do not dilute it; chance is `limit`.
    """
    one, other = (np.maximum(evidence.refit.loss.sum(axis=0), 1e-300) for evidence in (a, b))
    return 1 - float(np.exp(rows @ np.log(other / one) / rows.sum())) < limit


def as_good(best: Evidence, every: Sequence[Evidence], contest: Contest) -> list[Evidence]:
    """Return the candidates that explain the same part as well as the best."""
    rival_se, rows = contest.decision.rival_se, contest.regression.rows
    return [
        candidate
        for candidate in every
        if candidate is best
        or (
            same_part(candidate, best)
            and candidate.gain >= (1 - PARSIMONY) * best.gain
            and (behind(candidate, best) < rival_se or by_chance(candidate, best, rows, best.limit))
        )
    ]


def simplicity(evidence: Evidence) -> tuple[bool, bool, int, float]:
    """Return the sort key of candidates that explain as much: a cause before a description, what
    many machines have before what few have, then by the number of parameters.
    """
    return (
        evidence.effect.descriptive,
        evidence.effect.rare,
        evidence.numbers,
        -round(evidence.gain, EQUAL),
    )


def simplest(ranking: Ranking) -> Evidence | None:
    """The credible candidate with the fewest numbers among those as good as the best; of those with
    the same columns in a loop that of a drive, whose gears and bearings carry more.
    """
    believed = [
        candidate
        for candidate in ranking.credible
        if candidate.determined or not any(_nested(small, candidate) for small in ranking.credible)
    ]
    if not believed:
        return None
    equal = as_good(believed[0], believed, ranking.contest)
    best, driven = min(equal, key=simplicity), {*ranking.contest.fit.mechanism.driven}
    same = [e for e in equal if _same_columns(e, best) and e.numbers == best.numbers]
    best = min(same, key=lambda e: (not driven & {*e.effect.joints}, *simplicity(e)))
    constant = (
        e for e in believed if _nested(e, best) and e.gain >= (1 - PARSIMONY**2) * best.gain
    )
    return next(constant, best) if best.effect.of_position else best


def rivals(best: Evidence, ranking: Ranking) -> tuple[Evidence, ...]:
    """Credible candidates that explain the same part, as well within the error.

    An effect that only describes a curve names no cause: a law that is a special case of it is a
    rival however much better the curve is.
    """
    within = ranking.contest.decision.rival_se
    near = rivals_of(best, ranking.credible, lambda e: behind(e, best), within)
    return tuple(
        candidate
        for candidate in ranking.credible
        if candidate is not best
        and same_part(candidate, best)
        and (
            any(candidate is rival for rival in near)
            or (best.effect.descriptive and _nested(candidate, best))
        )
        and not (_nested(best, candidate) and behind(best, candidate) < 1.0)
    )


def _same_columns(a: Evidence, b: Evidence) -> bool:
    """Return whether two candidates have like columns here, as two joints of a loop may."""
    return a is b or (
        a.effect.kind == b.effect.kind
        and float(a.refit.direction @ b.refit.direction) > np.sqrt(1 - PARSIMONY**2)
    )


def _nested(small: Evidence, large: Evidence) -> bool:
    """Return whether one law is a special case of the other, at the same place."""
    a, b = small.effect, large.effect
    return a.joints == b.joints and b.kind in a.nested_in
