"""The search of formulas: terms of a grammar, their constants refined, sums of several terms.

Shapes of an effect are refined on the rows, everything else refitted (variable projection):

    [C̃ D̃] [c; δs] = r        D = ∂(C c)/∂s        C̃, D̃: what the model cannot make of C and D

Terms of a grammar are columns like any effect's. Each is projected off the model, which makes a
candidate a matrix product, and the fall of the squared error orders them. The best ones have their
constants refined, and are judged by the left-out error. Sums of two terms grow from the best single
ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from ident.diagnosis.candidates import ColumnsAround, Contest, OnProgress, Shape, swinging_freely
from ident.diagnosis.grammar import terms
from ident.effects import Effect
from ident.effects.formula import Formula, Term
from ident.information.evidence import ALPHA, NEGATIVE, SURROGATES, quantile
from ident.information.hypotheses import Array, PartialRegression, Refit
from ident.text import significant

STEPS = 8  # work: of Gauss-Newton
LONGEST_STEP = 0.3  # numerics: of a shape's range, the longest step
EXTENTS = 5  # work: rounds of a correction's extent
WIDER = 2.0  # work: times as large, or as small, as it becomes in one
RISE = 1e-3  # numerics: of the error, that a further step must bring
NEW_DIRECTION = 1e-6  # numerics: of a unit column's square: less of it is new
SLOPE = 1e-4  # numerics: of a shape's range, for its slope


def refined(contest: Contest, effect: Effect, shape: Shape) -> tuple[Shape, list[Array], Refit]:
    """Refine the shapes of an effect that have slopes, from where they are.

    Returns:
        The shapes; columns, then slopes, (m, u) in each part; everything refitted with both.
        Without slopes where the change that they ask for is beyond the shapes' bounds.
    """
    free, regression = [e.name for e in effect.searched if not e.discrete], contest.regression
    bounds, shape = contest.table.bounds(effect), dict(shape)

    def around(shape: Shape, beside: bool = True) -> tuple[ColumnsAround, Array, Array]:
        """Columns at a shape and `beside` it, in one call, and their normal equations."""
        steps = _steps(shape, free, bounds) if beside else {}
        columns = contest.columns_around(effect, shape, steps)
        return columns, *normal_equations(regression, columns.C)

    u = len(effect.unknowns)
    columns, S, g = around(shape)
    now = fall(S, g)
    low, high = (np.array([bounds[name][i] for name in free]) for i in (0, 1))
    for _ in range(STEPS if free else 0):
        both = columns.with_slopes(solved(S, g))
        step = solved(*normal_equations(regression, both))[u:]
        before, at = now, np.array([shape[name] for name in free])
        for half in range(4):
            most = LONGEST_STEP * (high - low)
            new = np.clip(at + 0.5**half * np.clip(step, -most, most), low, high)
            trial_shape = {**shape, **dict(zip(free, map(float, new), strict=True))}
            trial, S_new, g_new = around(trial_shape, beside=not half)  # mostly the whole step is
            if fall(S_new, g_new) > now:
                shape, S, g, now = trial_shape, S_new, g_new, fall(S_new, g_new)
                columns = around(shape)[0] if half else trial
                break
        felt = (r[:, 0] for r, c in zip(regression.residual, columns.C, strict=True) if c.any())
        if now - before < RISE * max(sum(float(r @ r) for r in felt) - now, 0.0):
            break
    if free:
        both = columns.with_slopes(solved(S, g))
        refit = regression.refit_with(both)
        end = np.array([shape[name] for name in free]) + refit.theta[u:]
        if (low <= end).all() and (end <= high).all():  # else the slopes are no change of shape
            return shape, both, refit
    return shape, columns.C, regression.refit_with(columns.C)


def refined_extent(
    contest: Contest, effect: Effect, start: Shape
) -> tuple[Shape, list[Array], Refit]:
    """Refine a correction that is not linear in its extent: its columns, of all the way from 0 to
    some extent, are made once more at the one that they ask for, while they explain more.

    Returns:
        The shape of the columns; columns (m, u) in each part; everything refitted with them.
    """
    bounds, shape, ends = contest.table.bounds(effect), dict(start), []
    for _ in range(EXTENTS):
        C = contest.columns(effect, shape)
        refit = contest.regression.refit_with(C)
        ends.append((dict(shape), C, refit))
        gains = [contest.regression.gain(end[2]) for end in ends]
        if gains[-1] < max(gains):
            break
        for parameter, value in zip(effect.searched, refit.theta, strict=True):
            name, before = parameter.name, shape[parameter.name]
            low, high = bounds[name]
            if name == effect.extent:
                low, high = max(low, before / WIDER), min(high, before * WIDER)
            else:
                value = before + value
            shape[name] = float(np.clip(value, low, high))
    return max(ends, key=lambda end: contest.regression.gain(end[2]))


def _steps(
    shape: Shape, free: Sequence[str], bounds: Mapping[str, tuple[float, float]]
) -> dict[str, float]:
    """Return by shape the step of its central difference."""
    return {
        name: max(
            min(SLOPE * (bounds[name][1] - bounds[name][0]), 1e-2 * abs(shape[name]) or np.inf),
            1e-9,
        )
        for name in free
    }


def screened(regression: PartialRegression, C: Sequence[np.ndarray], groups: int) -> Array:
    """(groups,) in-sample fall of the squares by each group of columns, equal in number."""
    S, g = normal_equations(regression, C)
    u = len(g) // groups
    parts = (slice(k * u, (k + 1) * u) for k in range(groups))
    return np.array([fall(S[at, at], g[at]) for at in parts])


def at_most(regression: PartialRegression, falls: Sequence[float] | Array) -> list[float]:
    """Return the largest shares that falls (n,) of one coordinate's squares each can explain."""
    r = np.concatenate([x[:, 0] for x in regression.residual])
    before = regression.by_coordinate(r**2).sum(axis=0)
    limited = np.minimum(np.reshape(falls, (-1, 1)), before)
    shares = regression.explained(limited[:, :, None] * np.eye(len(before)), before)
    return shares.max(axis=1).tolist()


def normal_equations(
    regression: PartialRegression, C: Sequence[np.ndarray], draws: int = 0
) -> tuple[Array, Array]:
    """C̃ᵀC̃ and C̃ᵀr, weighted, of columns C (m, u) in each part; (0, u) where they are zero.

    What is left of a column is set to zero where it is less than RANK of its squares. With `draws`,
    r has as many random residuals as further columns.
    """
    u = C[0].shape[1]
    of = slice(1 + draws) if draws else 0
    S, P = np.zeros((u, u)), np.zeros((regression.rank, u))
    g = np.zeros((u, 1 + draws) if draws else u)
    for part, Q, r, c in zip(regression.parts, regression.Q, regression.residual, C, strict=True):
        if c.any():
            c = c * regression.weight[part.coordinate]
            S += c.T @ c
            g += c.T @ r[:, of]
            P += Q.T @ c
    rest = S - P.T @ P
    new = np.diag(rest) > NEW_DIRECTION * np.diag(S)
    return rest * np.outer(new, new), (g.T * new).T


def own_shares(
    regression: PartialRegression, C: Sequence[np.ndarray], acts: Sequence[bool], groups: int,
    draws: int,
) -> Array:  # fmt: skip
    """Return the shares (groups, 1 + draws), in sample, of the squares of the parts on which the
    columns act that each group of columns C explains there, of the residual and random ones.

    Fitted to all parts, x = S⁺ g takes 2 xᵀ g_o − xᵀ S_o x of the squares of its own parts, where
    what is left of the columns is C − Q P, P = Qᵀ C:

        S_o = CᵀC − 2 PᵀP + Pᵀ Q_oᵀQ_o P        g_o = Cᵀ r_o − Pᵀ Q_oᵀ r_o
    """
    S, g = normal_equations(regression, C, draws)
    u, of = len(g) // groups, slice(1 + draws)
    acting = [
        (Q, r[:, of], c * regression.weight[part.coordinate])
        for part, Q, r, c, its in zip(
            regression.parts, regression.Q, regression.residual, C, acts, strict=True
        )
        if its
    ]
    K = sum(Q.T @ Q for Q, _, _ in acting)
    t = sum(Q.T @ r for Q, r, _ in acting)
    P = sum(Q.T @ c for Q, _, c in acting)
    before = sum((r**2).sum(axis=0) for _, r, _ in acting)
    shares = []
    for k in range(groups):
        at = slice(k * u, (k + 1) * u)
        x, p = solved(S[at, at], g[at]), P[:, at]
        S_o = S[at, at] - p.T @ p + p.T @ K @ p
        shares.append((2 * x * (g[at] - p.T @ t) - x * (S_o @ x)).sum(axis=0))
    return np.array(shares) / np.maximum(before, np.finfo(float).tiny)


def fall(S: Array, g: Array) -> float:
    """gᵀ S⁺ g in the directions that are new."""
    return float(g @ solved(S, g))


def inverse_root(S: Array) -> Array:
    """Return F (u, r) with S⁺ = F Fᵀ in the r directions that are new.

    Variances b S⁺ bᵀ = |b F|² are never negative, whatever rounding has made of S (u, u).
    """
    size = np.sqrt(np.where(np.diag(S) > 0, np.diag(S), 1.0))
    values, V = np.linalg.eigh(S / size[:, None] / size)
    good = values > NEW_DIRECTION
    return np.asarray(V[:, good] / np.sqrt(values[good]) / size[:, None])


def solved(S: Array, g: Array) -> Array:
    """Return S⁺ g in the directions that are new."""
    root = inverse_root(S)
    return np.asarray(root @ (root.T @ g))


REFINED_TERMS = 32  # work: terms whose constants are refined
WAVES = 4  # work: wave numbers of sines with which other functions of a wave are screened
NUMBERS = 8  # work: of a formula: more is a curve, not a law
BEAM = 2  # work: formulas to which a further term is added
TERMS = 2  # work: of a formula
EDGE = 1e-3  # numerics: of a constant's range, from its ends
ENDS = ("angle", "share", "power")  # constants whose ends are no limit of what the data can show
Starts = Sequence[Mapping[str, float]]


@dataclass(frozen=True, eq=False, repr=False)
class FittedFormula:
    """A formula with its constants refined, judged by the left-out error."""

    formula: Formula
    shape: Mapping[str, float]  # its constants
    C: tuple[Array, ...]  # its columns and slopes (m, u) in each part
    refit: Refit  # everything, with them

    def __repr__(self) -> str:
        constants = (f"{name} = {significant(value, 4)}" for name, value in self.shape.items())
        return ", ".join((self.formula.text, *constants))

    @property
    def loss(self) -> Array:
        """(blocks,) left-out squares."""
        return np.asarray(self.refit.loss.sum(axis=1))

    def determined(self, regression: PartialRegression) -> bool:
        """Whether no columns vanish and no term is within its error: else it is a simpler one."""
        S, _ = normal_equations(regression, self.C)
        size = np.sqrt(np.where(np.diag(S) > 0, np.diag(S), 1.0))
        least = np.linalg.eigvalsh(S / size[:, None] / size)[0]
        noise = np.sqrt(float(self.loss.sum()) / max(float(regression.rows.sum()), 1.0))
        count = len(self.formula.unknowns)
        large = (np.abs(self.refit.theta) > NEGATIVE * noise * self.refit.stderr)[:count]
        ends = np.cumsum([0, *(len(term.columns) for term in self.formula.terms)])
        return least > NEW_DIRECTION and all(large[a:b].any() for a, b in pairwise(ends))


@dataclass(eq=False)
class LawSearch:
    """Searches the formula that explains most beside a model."""

    contest: Contest  # rows, effects and the model
    joint: str  # whose torque
    # a joint on whose signals, with the own ones, the terms depend; empty: on the own ones alone
    other: str
    limit: float  # share g of the left-out squares that a term must explain
    noise: Array  # (d,) left-out squares that the sensors' noise alone makes, at most
    on_progress: OnProgress
    of_position: bool = False  # whether only functions of the joint's own position are searched
    # the model with SURROGATES random residuals, to be better than chance; None if that is known
    drawn: PartialRegression | None = None
    alpha: float = ALPHA  # chance that the best term explains as much of a random residual

    def __post_init__(self) -> None:
        self.regression = self.contest.regression

    @cached_property
    def terms(self) -> list[Formula]:
        """All terms as formulas of one term."""
        table = self.contest.table
        rotational = table.mechanism.joint(self.joint).rotational
        one = frozenset({"q_o"} if self.other else {"q"} if self.of_position else {"q", "v"})
        if self.joint in table.mechanism.sites.loaded and self.joint not in swinging_freely(
            self.contest.fit
        ):
            one |= {"load"}
        if all(f"temperature.{self.joint}" in e.extra for e in table.motion.experiments):
            one |= {"temperature"}
        joints = (self.joint, self.other) if self.other else (self.joint,)
        second = table.mechanism.joint(joints[-1]).rotational
        return [
            Formula(joints, {}, rotational, terms=(t,), second_rotational=second)
            for t in terms(one, rotational, second)
        ]

    @cached_property
    def screened(self) -> list[tuple[Starts, list[np.ndarray]]]:
        """Constants at which each term is screened, and its columns (m, starts · u) there in each
        part; a wave beside other constants has the wave numbers of the best plain sines.
        """
        screened_terms = []
        numbers: dict[str, list[float]] = {}
        for formula in self.terms:
            starts: Starts = self.contest.table.starts(formula)
            wave = next((entry.signal for entry in formula.scales if entry.name == "n"), "")
            if wave in numbers and len(formula.scales) > 1:
                near = dict.fromkeys(n / k for n in numbers[wave] for k in (1, 2))
                others = {tuple((k, x) for k, x in entry.items() if k != "n") for entry in starts}
                starts = [{**dict(entry), "n": n} for n in near for entry in sorted(others)]
            columns = self.columns(formula, starts)
            if wave and wave not in numbers:  # the plain sines come first
                falls = screened(self.regression, columns, len(starts))
                numbers[wave] = [starts[int(k)]["n"] for k in np.argsort(-falls)[:WAVES]]
            screened_terms.append((starts, columns))
        return screened_terms

    def columns(self, formula: Formula, starts: Starts) -> list[np.ndarray]:
        """Columns (m, starts · u) of a term in each part; (0, starts · u) where they are zero."""
        table = self.contest.table
        if not formula.memory:  # else its columns at all samples would be kept
            table = table.coarse
        C, felt = table.effect_columns(formula, starts)
        place = {int(u): i for i, u in enumerate(felt)}
        return [
            C[self.contest.use[:, p.coordinate], place[p.coordinate]].astype(np.float32)
            if p.coordinate in place
            else np.zeros((0, C.shape[2]), dtype=np.float32)
            for p in self.regression.parts
        ]

    @cached_property
    def beyond_chance(self) -> bool:
        """Whether the best term explains more of the residual than of random ones, at its start."""
        if self.drawn is None:
            return True
        acts = [len(c) > 0 for c in self.screened[0][1]]
        shares = np.zeros(1 + SURROGATES)
        for starts, columns in self.screened:
            term_shares = own_shares(self.drawn, columns, acts, len(starts), SURROGATES).max(axis=0)
            shares = np.maximum(shares, term_shares)
        return float(shares[0]) > quantile(shares[1:], self.alpha)

    def probed(self, term: Term) -> float:
        """The fall of the squares by a term without constants, in sample."""
        formula = replace(self.terms[0], terms=(term,))
        return float(screened(self.regression, self.columns(formula, [{}]), 1)[0])

    def run(self, known: FittedFormula | None = None) -> list[FittedFormula]:
        """All formulas that were fitted, single terms first, better than one that is `known`."""
        beam: list[FittedFormula | None] = [None]
        formulas: list[FittedFormula] = []
        if not self.beyond_chance:
            return []
        so_far = ""
        losses = (self.regression.losses if known is None else known.refit.loss).sum(axis=0)
        for number in range(TERMS):
            new: list[FittedFormula] = []
            for i, before in enumerate(beam):
                what = f"law of {self.joint} with {number + 1} term(s){so_far}"
                self.on_progress(what, (number + i / len(beam)) / TERMS)
                new += self.extended(before)
            new = [e for e in new if e.determined(self.regression) and self.inside(e)]
            falls = [losses - fitted.refit.loss.sum(axis=0) for fitted in new]
            shares = self.regression.explained(np.reshape(falls, (-1, len(losses))), losses)
            new = [fitted for fitted, share in zip(new, shares, strict=True) if share > self.limit]
            formulas += new
            if not new:
                break
            new.sort(key=lambda fitted: float(fitted.loss.sum()))
            losses = new[0].refit.loss.sum(axis=0)
            so_far = f", so far {new[0].formula.text}"
            self.on_progress(f"law of {self.joint}{so_far}", (number + 1) / TERMS)
            if self.explained(new[0]):
                break
            beam = list(new[:BEAM])
        return formulas

    def inside(self, fitted: FittedFormula) -> bool:
        """Whether no constant is at an end of its search, as tanh of a narrow range is a line."""
        bounds = self.contest.table.bounds(fitted.formula)
        for scale in fitted.formula.scales:
            low, high = bounds[scale.name]
            margin, value = EDGE * (high - low), fitted.shape[scale.name]
            if scale.of not in ENDS and not low + margin < value < high - margin:
                return False
        return True

    def explained(self, best: FittedFormula) -> bool:
        """Whether a formula leaves no more than noise in the coordinates that it mends."""
        return bool(
            (best.refit.loss.sum(axis=0) < self.noise)[best.refit.affected_coordinates].all()
        )

    def extended(self, before: FittedFormula | None) -> list[FittedFormula]:
        """The best formulas with one term more; all terms are screened beside those before."""
        regression, terms = self.regression, tuple[Term, ...]()
        values: list[float] = []
        if before is not None:
            regression = self.contest.extended(before.C)[0].regression
            terms = before.formula.terms
            values = [before.shape[scale.name] for scale in before.formula.scales]
        falls = []
        for i, one in enumerate(self.terms):
            if before is not None:  # a new term, of no third joint, and few numbers in all
                known, numbers = (
                    before.formula,
                    len(before.formula.parameters) + len(one.parameters),
                )
                other = known.joints[1:] in ((), one.joints[1:]) or not one.joints[1:]
                if one.terms[0] in terms or not other or numbers > NUMBERS:
                    continue
            starts, columns = self.screened[i]
            term_falls = screened(regression, columns, len(starts))
            falls += [
                (float(term_falls[k]), i, int(k))
                for k in np.argsort(-term_falls)[: 1 + len(one.scales)]
            ]
        falls.sort(reverse=True)
        most = at_most(regression, [term_falls for term_falls, *_ in falls])
        wide = REFINED_TERMS if before is None else REFINED_TERMS // 4
        chosen = list(dict.fromkeys(i for _, i, _ in falls))[:wide]
        fits: dict[int, FittedFormula] = {}
        for share, (_, i, start) in zip(most, falls, strict=True):
            if i not in chosen or share < self.limit:
                continue
            one = self.terms[i]
            joints = max([one.joints, before.formula.joints if before else ()], key=len)
            formula = replace(one, joints=joints, terms=(*terms, *one.terms))
            every = [*values, *(self.screened[i][0][start][scale.name] for scale in one.scales)]
            names = (scale.name for scale in formula.scales)
            fitted = self.fitted(formula, dict(zip(names, every, strict=True)))
            if i not in fits or fitted.loss.sum() < fits[i].loss.sum():
                fits[i] = fitted
        return list(fits.values())

    def fitted(self, formula: Formula, shape: Mapping[str, float]) -> FittedFormula:
        """The formula with its constants refined from where they are."""
        refined_shape, C, refit = refined(self.contest, formula, shape)
        return FittedFormula(formula, refined_shape, tuple(C), refit)
