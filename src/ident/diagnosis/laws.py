"""Laws that no library holds: a curve of signals, then a formula with its constants.

Terms of a grammar are columns like any effect's. Each is projected off the model, which makes a
candidate a matrix product, and the fall of the squared error orders them. The best ones have their
constants refined,

    [C̃ D̃] [c; δs] = r        D = ∂(C c)/∂s, everything else refitted (variable projection)

and are judged by the left-out error. Sums of two and three terms grow from the best single ones.
Of formulas that left-out errors cannot tell apart the one of least complexity is the law.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ident.diagnosis.candidates import Contest
from ident.diagnosis.grammar import terms
from ident.diagnosis.search import Member, Selection
from ident.diagnosis.selection import Decision
from ident.effects.formula import Formula, Term
from ident.information.hypotheses import Array, PartialRegression, Refit, zscore

WIDE = 24  # terms whose constants are refined
STARTS = 3  # of a term whose constants are refined
NUMBERS = 8  # of a formula: more is a curve, not a law
BEAM = 3  # formulas to which a further term is added
TERMS = 3  # of a formula
STEPS = 8  # of Gauss-Newton
LONGEST = 0.3  # of a constant's range, the longest step
RISE = 1e-3  # of the error, that a further step must bring
RANK = 1e-6  # of a unit column's square: less of it is new
SLOPE = 1e-4  # of a constant's range, for its slope
LOUD = 1.25  # times the rms of noise, from which more than noise is left
OTHERS = 6  # joints whose signals are tried beside the own ones
JOINTS = 2  # whose laws are searched
PARSIMONY = 0.1  # of the least left-out squares, within which the least complex formula is chosen
# standard errors within which the simplest formula is preferred to the best one (Breiman,
# Friedman, Olshen, Stone, Classification and Regression Trees, 1984, 3.4.3)
ONE_SE = 1.0
WRONG_FORM = 1.5  # times a formula's left-out squares, from which an effect has the wrong form
MINE = 0.1  # share of a fall that makes a coordinate one that a law mends
RIVALS = 12  # formulas that are listed beside the law
CUBIC = Term(("1", "q", "q**2", "q**3"))
OnProgress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class FittedFormula:
    """A formula with its constants refined, judged by the left-out error.

    Attributes:
        formula, shape: which, at which constants.
        C: its columns and slopes (m, u) in each part.
        refit: everything refitted with them.
    """

    formula: Formula
    shape: Mapping[str, float]
    C: tuple[Array, ...]
    refit: Refit

    @property
    def loss(self) -> Array:
        """(blocks,) left-out squares."""
        return np.asarray(self.refit.loss.sum(axis=1))


@dataclass(frozen=True, eq=False)
class FoundLaw:
    """A formula that explains what is left in a joint.

    Attributes:
        found: the formula; joint: of its torque.
        gain: share of the left-out squared error; explained: of what exceeds the noise.
        limit: what the gain was held against.
        nearest: name of the closest law of the literature, with its distance: the share of the
            torque (rms) that is different over the motion.
        rivals: other formulas that the left-out error cannot tell from it.
        front: (complexity, share of the squared error left, formula), of the best of each
            complexity.
        replaced: labels of effects of the library in whose place it stands.
        beside: the model's rows without those effects.
        bounds: of its constants.
    """

    found: FittedFormula
    joint: str
    gain: float
    explained: float
    limit: float
    nearest: str
    distance: float
    rivals: tuple[FittedFormula, ...]
    front: tuple[tuple[int, float, str], ...]
    replaced: tuple[str, ...]
    beside: PartialRegression
    bounds: Mapping[str, tuple[float, float]]

    @property
    def formula(self) -> Formula:
        """Its formula."""
        return self.found.formula


# --- the search ---------------------------------------------------------------------------------


@dataclass(eq=False)
class LawSearch:
    """Searches the formula that explains most beside a model.

    Args:
        contest: rows and effects; regression: the model.
        joint: whose torque.
        other: a joint on whose signals, with the own ones, the terms depend; empty for terms of
            the own signals alone.
        limit: share of the left-out squared error that a term must explain.
        noise: (d,) left-out squares that the sensors' noise alone makes, at most.
        decision: the rule of evidence.
        on_progress: called with (what is being done, share done).
    """

    contest: Contest
    regression: PartialRegression
    joint: str
    other: str
    limit: float
    noise: Array
    on_progress: OnProgress

    @cached_property
    def terms(self) -> list[Formula]:
        """All terms as formulas of one term."""
        table = self.contest.table
        rotational = table.mechanism.joint(self.joint).rotational
        one = frozenset({"q", "v", "a", "t"})
        if self.joint in table.mechanism.sites.loaded:
            one |= {"load"}
        if all(f"temperature.{self.joint}" in s.e.extra for s in table.scenes):
            one |= {"temperature"}
        if self.other:
            one = frozenset({"q_o", "v_o"})
        joints = (self.joint, self.other) if self.other else (self.joint,)
        return [Formula(joints, {}, rotational, terms=(t,)) for t in terms(one, rotational)]

    @cached_property
    def starts(self) -> list[list[Mapping[str, float]]]:
        """Constants at which each term is screened."""
        return [self.contest.table.starts(each) for each in self.terms]

    @cached_property
    def columns(self) -> list[list[np.ndarray]]:
        """Columns (m, starts · u) of each term in each part, in single precision."""
        found = []
        for formula, starts in zip(self.terms, self.starts, strict=True):
            C, felt = self.contest.table.effect_columns(formula, starts)
            place = {int(u): i for i, u in enumerate(felt)}
            found.append(
                [
                    C[self.contest.use[:, p.coordinate], place[p.coordinate]].astype(np.float32)
                    if p.coordinate in place
                    else np.zeros((0, C.shape[2]), dtype=np.float32)
                    for p in self.regression.parts
                ]
            )
        return found

    def run(self) -> list[FittedFormula]:
        """All formulas that were fitted, those of one term first."""
        beam: list[FittedFormula | None] = [None]
        found: list[FittedFormula] = []
        least = float(self.regression.loss.sum())
        for number in range(TERMS):
            new: list[FittedFormula] = []
            for i, before in enumerate(beam):
                share = (number + i / len(beam)) / TERMS
                self.on_progress(f"formulas of {number + 1} term(s)", share)
                new += self.extended(before)
            found += [each for each in new if float(each.loss.sum()) < (1 - self.limit) * least]
            new = [each for each in new if each in found]
            if not new:
                break
            new.sort(key=lambda each: float(each.loss.sum()))
            least = float(new[0].loss.sum())
            if self.explained(new[0]):
                break
            beam = list(new[:BEAM])
        return found

    def explained(self, best: FittedFormula) -> bool:
        """Whether a formula leaves no more than noise in the coordinates that it mends."""
        mends = best.refit.by >= MINE * best.refit.by.sum()
        return bool((best.refit.loss.sum(axis=0) < self.noise)[mends].all())

    def extended(self, before: FittedFormula | None) -> list[FittedFormula]:
        """The best formulas with one term more; all terms are screened beside those before."""
        regression, terms = self.regression, tuple[Term, ...]()
        values: list[float] = []
        if before is not None:
            contest, new = replace(self.contest, regression=regression).added(before.C)
            regression = contest.regression.extended(new)
            terms = before.formula.terms
            values = [before.shape[scale.name] for scale in before.formula.scales]
        falls = []
        for i, (one, starts) in enumerate(zip(self.terms, self.starts, strict=True)):
            if before is not None and not _fits(before.formula, one):
                continue
            each = screened(regression, self.columns[i], len(starts))
            falls += [(float(each[k]), i, int(k)) for k in np.argsort(-each)[:STARTS]]
        falls.sort(reverse=True)
        wide = WIDE if before is None else WIDE // 2
        chosen = list(dict.fromkeys(i for _, i, _ in falls))[:wide]
        found: dict[int, FittedFormula] = {}
        for gain, i, start in falls:
            if i not in chosen or gain < self.limit * float(regression.loss.sum()):
                continue
            one = self.terms[i]
            joints = max([one.joints, before.formula.joints if before else ()], key=len)
            formula = replace(one, joints=joints, terms=(*terms, *one.terms))
            every = [*values, *(self.starts[i][start][scale.name] for scale in one.scales)]
            names = (scale.name for scale in formula.scales)
            fitted = self.fitted(formula, dict(zip(names, every, strict=True)))
            if i not in found or fitted.loss.sum() < found[i].loss.sum():
                found[i] = fitted
        return list(found.values())

    def fitted(self, formula: Formula, shape: dict[str, float]) -> FittedFormula:
        """The formula with its constants refined from where they are."""
        bounds = self.contest.table.bounds(formula)
        u = len(formula.unknowns)
        low, high = (np.array([bounds[name][i] for name in shape]) for i in (0, 1))
        C = self.contest.columns(formula, shape)
        S, g = normal_equations(self.regression, C)
        now = fall(S, g)
        for _ in range(STEPS if shape else 0):
            both = self.with_slopes(formula, shape, C, solved(S, g), bounds)
            step = solved(*normal_equations(self.regression, both))[u:]
            before, at = now, np.array(list(shape.values()))
            for half in range(4):
                most = LONGEST * (high - low)
                new = np.clip(at + np.clip(0.5**half * step, -most, most), low, high)
                tried = dict(zip(shape, map(float, new), strict=True))
                trial = self.contest.columns(formula, tried)
                S_new, g_new = normal_equations(self.regression, trial)
                if fall(S_new, g_new) > now:
                    shape, C, S, g, now = tried, trial, S_new, g_new, fall(S_new, g_new)
                    break
            if now - before < RISE * max(self.squares(C) - now, 0.0):
                break
        if shape:
            C = self.with_slopes(formula, shape, C, solved(S, g), bounds)
        return FittedFormula(formula, shape, tuple(C), self.regression.refit_with(C))

    def squares(self, C: Sequence[Array]) -> float:
        """|r|² in the coordinates in which columns are."""
        pairs = zip(self.regression.residual, C, strict=True)
        return sum(float(r[:, 0] @ r[:, 0]) for r, c in pairs if c.any())

    def with_slopes(
        self, formula: Formula, shape: Mapping[str, float], C: list[Array], theta: Array,
        bounds: Mapping[str, tuple[float, float]],
    ) -> list[Array]:  # fmt: skip
        """C(s), then ∂(C θ)/∂s by central differences."""
        for name, (low, high) in bounds.items():
            h = SLOPE * (high - low)
            up, down = (
                self.contest.columns(formula, {**shape, name: shape[name] + sign * h})
                for sign in (1, -1)
            )
            C = [
                np.column_stack([c, (a - b) @ theta / (2 * h)])
                for c, a, b in zip(C, up, down, strict=True)
            ]
        return C


def _fits(before: Formula, one: Formula) -> bool:
    """Return whether a term can be added: a new one, of no third joint, and few numbers in all."""
    numbers = len(before.parameters) + len(one.parameters)
    other = before.joints[1:] in ((), one.joints[1:]) or not one.joints[1:]
    return one.terms[0] not in before.terms and other and numbers <= NUMBERS


def screened(regression: PartialRegression, C: Sequence[np.ndarray], groups: int) -> Array:
    """(groups,) in-sample fall of the squares by each group of columns, equal in number."""
    S, g = normal_equations(regression, C)
    u = len(g) // groups
    parts = (slice(k * u, (k + 1) * u) for k in range(groups))
    return np.array([fall(S[at, at], g[at]) for at in parts])


def normal_equations(regression: PartialRegression, C: Sequence[np.ndarray]) -> tuple[Array, Array]:
    """C̃ᵀC̃ and C̃ᵀr, weighted, of columns C (m, u) in each part; (0, u) where they are zero.

    What is left of a column is set to zero where it is less than RANK of its squares.
    """
    u = C[0].shape[1]
    S, g, P = np.zeros((u, u)), np.zeros(u), np.zeros((regression.rank, u))
    for part, Q, r, c in zip(regression.parts, regression.Q, regression.residual, C, strict=True):
        if len(c):
            c = c * regression.weight[part.coordinate]
            S += c.T @ c
            g += c.T @ r[:, 0]
            P += Q.T @ c
    rest = S - P.T @ P
    new = np.diag(rest) > RANK * np.diag(S)
    return rest * np.outer(new, new), g * new


def fall(S: Array, g: Array) -> float:
    """gᵀ S⁺ g in the directions that are new."""
    return float(g @ solved(S, g))


def solved(S: Array, g: Array) -> Array:
    """S⁺ g in the directions that are new."""
    size = np.sqrt(np.where(np.diag(S) > 0, np.diag(S), 1.0))
    values, V = np.linalg.eigh(S / size[:, None] / size)
    good = values > RANK
    return np.asarray((V[:, good] / values[good]) @ (V[:, good].T @ (g / size)) / size)


# --- the choice ---------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Comparison:
    """Left-out squares of models in the coordinates that a law mends.

    Attributes:
        mends: coordinates.
        rival_se: standard errors of paired blocks within which two are equal.
    """

    mends: Sequence[int]
    rival_se: float

    def loss(self, losses: Array) -> Array:
        """(blocks,) of losses (blocks, d)."""
        return np.asarray(losses[:, list(self.mends)].sum(axis=1))

    def ratio(self, worse: Array, best: Array) -> float:
        """Return how many times larger the left-out squares of the first are."""
        return float(self.loss(worse).sum() / max(float(self.loss(best).sum()), 1e-300))

    def better(self, worse: Array, best: Array) -> float:
        """Return standard errors of paired blocks by which the second is better: of the
        differences of the squares, or of their logarithms, the larger.
        """
        a, b = self.loss(worse), self.loss(best)
        tiny = 1e-12 * max(float(a.sum()), float(b.sum())) + 1e-300
        return max(zscore(a - b), zscore(np.log((a + tiny) / (b + tiny))))

    def clear(self, worse: Array, best: Array, ratio: float) -> bool:
        """Return whether the second is better by `rival_se` and by a ratio."""
        better = self.better(worse, best) >= self.rival_se
        return better and self.ratio(worse, best) > ratio

    def equal(self, found: Sequence[FittedFormula], within: float) -> list[FittedFormula]:
        """Return the formulas within so many standard errors of the best one, simplest first."""
        best = min(found, key=lambda each: float(self.loss(each.refit.loss).sum()))
        equal = [
            each
            for each in found
            if self.ratio(each.refit.loss, best.refit.loss) < 1 + PARSIMONY
            and self.better(each.refit.loss, best.refit.loss) < within
        ]
        return sorted(equal, key=lambda e: (e.formula.cost, float(self.loss(e.refit.loss).sum())))


def laws_of(
    contest: Contest,
    selection: Selection,
    loud: Collection[str],
    floor: Mapping[str, float],
    decision: Decision,
    on_progress: OnProgress,
) -> tuple[Selection, tuple[FoundLaw, ...]]:
    """Search laws where no effect of the library has the right form.

    Args:
        contest, selection: of the diagnosis.
        loud: joints in which more than noise is left; floor: rms of noise by joint [N m | N].
        decision: the rule of evidence.
        on_progress: called with (what is being done, share done).

    Returns:
        The selection, in which a law rejects the effects that it replaces, and the laws.
    """
    found = []
    for joint in _joints(contest, selection, loud)[:JOINTS]:
        law = _law(contest, selection, joint, floor, decision, on_progress)
        if law is None:
            continue
        found.append(law)
        members = [
            replace(m, law=law.formula) if m.label in law.replaced else m for m in selection.members
        ]
        selection = replace(selection, members=tuple(members))
    return selection, tuple(found)


def _joints(contest: Contest, selection: Selection, loud: Collection[str]) -> list[str]:
    """Joints where a law may be missing: those of curves first, then of doubtful effects."""
    known = contest.table.mechanism.joint_index
    found = [curve.joints[0] for curve, _ in selection.last.curves[:1]]
    for m in selection.members:
        joint = m.effect.joints[0] if m.effect.joints else ""
        if joint in known and not m.effect.common:
            several = len(_doubtful(selection, joint)) > 1
            if m.rejected or m.effect.descriptive or several or joint in loud:
                found.append(joint)
    return list(dict.fromkeys(found))


def _doubtful(selection: Selection, joint: str) -> list[Member]:
    """Members at a joint that a law could replace."""
    return [m for m in selection.members if joint in m.effect.joints[:1] and not m.effect.common]


def _law(
    contest: Contest, selection: Selection, joint: str, floor: Mapping[str, float],
    decision: Decision, on_progress: OnProgress,
) -> FoundLaw | None:  # fmt: skip
    last = selection.last
    doubtful = _doubtful(selection, joint)
    regression = last.regression.judging([p.Y[:, :1] for p in last.regression.parts])
    for m in doubtful:
        if m.rejected:
            regression = regression.without(m.columns)
    with_names = regression
    named = [m for m in doubtful if not m.rejected]
    for m in named:
        regression = regression.without(m.columns)
    limit = max(last.limit, last.limit_with_curves)
    others = [
        curve.joints[1]
        for curve, _ in (*selection.first.curves, *last.curves)
        if curve.arity > 1 and curve.joints[0] == joint
    ]
    one = replace(last.contest, regression=regression)
    noise = regression.rows * (_floors(contest, floor) * regression.weight) ** 2
    found: list[FittedFormula] = []
    for other in ("", *dict.fromkeys((*others, *_moving(contest, joint)))):
        search = LawSearch(one, regression, joint, other, limit, LOUD**2 * noise, on_progress)
        found += search.run()
        if found and search.explained(min(found, key=lambda each: float(each.loss.sum()))):
            break
    if not found:
        return None
    best = min(found, key=lambda each: float(each.loss.sum()))
    mends = np.flatnonzero(best.refit.by >= MINE * best.refit.by.sum())
    compare = Comparison([int(u) for u in mends], decision.rival_se)
    law = compare.equal(found, ONE_SE)[0]
    equal = compare.equal(found, decision.rival_se)
    loose = any(m.effect.descriptive for m in named)
    kept = False
    if loose:  # where a cubic does as well as a law, the names stay, and the law stands beside them
        cubic = search.fitted(replace(law.formula, joints=(joint,), terms=(CUBIC,)), {})
        kept = not compare.clear(cubic.refit.loss, law.refit.loss, 1.0)
    numbers = sum(len(m.effect.parameters) for m in named)
    fewer = (1 if loose else 2) * len(law.formula.parameters) <= numbers
    wrong = compare.clear(with_names.losses, law.refit.loss, WRONG_FORM)
    as_good = not compare.clear(law.refit.loss, with_names.losses, 1.0)
    if named and not (kept or wrong or (fewer and as_good)):
        return None  # the names do as well
    whole, new = replace(last.contest, regression=regression).added(law.C)
    richer = whole.regression.extended(new)
    for m in selection.members:
        if not kept and joint in m.effect.joints[:1] and m.effect.common:
            bare = richer.without(m.columns)
            if not compare.clear(bare.losses, richer.losses, 1.0):
                doubtful.append(m)
    total = float(regression.loss.sum())
    nearest, distance = _nearest(law, found)
    before, after = (float(compare.loss(x).sum()) for x in (regression.losses, law.refit.loss))
    return FoundLaw(
        found=law,
        joint=joint,
        gain=law.refit.G / total,
        explained=float(
            np.clip((before - after) / max(before - noise[compare.mends].sum(), 1e-300), 0.0, 1.0)
        ),
        limit=limit,
        nearest=nearest,
        distance=distance,
        rivals=tuple(each for each in equal if each is not law)[:RIVALS],
        front=tuple(_front(found, compare, before)),
        replaced=tuple(m.label for m in doubtful if not kept),
        beside=regression,
        bounds=contest.table.bounds(law.formula),
    )


def _moving(contest: Contest, joint: str) -> list[str]:
    """Other joints that move, at most OTHERS."""
    curves = [e.effect for e in contest.candidates if e.curve and len(e.effect.joints) > 1]
    return [c.joints[1] for c in curves if c.joints[0] == joint][:OTHERS]


def _floors(contest: Contest, floor: Mapping[str, float]) -> Array:
    return np.array([floor[name] for name in contest.fit.motion.independent])


def _nearest(law: FittedFormula, found: Sequence[FittedFormula]) -> tuple[str, float]:
    """Return the law of the literature that is closest over this motion, and its distance.

    The distance is the share of the law's torque, rms, that is different beside the model.
    """
    named = [e for e in found if len(e.formula.terms) == 1 and e.formula.terms[0].known_as]
    if not named:
        return "", 1.0
    cosines = [float(e.refit.direction @ law.refit.direction) for e in named]
    if law in named:
        return law.formula.terms[0].known_as, 0.0
    best = int(np.argmax(cosines))
    distance = float(np.sqrt(max(1 - cosines[best] ** 2, 0.0)))
    return named[best].formula.terms[0].known_as, distance


def _front(
    found: Sequence[FittedFormula], compare: Comparison, before: float
) -> list[tuple[int, float, str]]:
    """Return complexity, share left and text of formulas that no simpler one is better than."""
    front: list[tuple[int, float, str]] = []
    for each in sorted(found, key=lambda e: (e.formula.cost, float(e.loss.sum()))):
        left = float(compare.loss(each.refit.loss).sum()) / before
        if not front or left < front[-1][1]:
            front = [e for e in front if e[0] < each.formula.cost]
            front.append((each.formula.cost, left, each.formula.text))
    return front
