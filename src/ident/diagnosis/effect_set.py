"""A model with a set of effects added, on the rows of one fit: no model is refitted."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ident.diagnosis.candidates import ColumnStore, Contest
from ident.diagnosis.law_search import refined
from ident.diagnosis.selection import Evidence, sensible
from ident.effects import Effect
from ident.effects.formula import Formula
from ident.information import linear
from ident.information.hypotheses import Index, PartialRegression
from ident.information.projection import EXACT


@dataclass(frozen=True, eq=False)
class Member:
    """An effect of a set.

    Attributes:
        columns: its columns in the regression.
        evidence: when it was chosen, None of an effect of the fit; rivals: then, or beside the
            rest of the set of one that came with others.
        gain: rise of the left-out squared error of the whole set without it, as a share.
        curve: a curve of its signals that explains much beside it: the law has the wrong form.
        impossible: a law that explains more of the same joint than it does, with values that no
            machine has: the cause is something else.
        law: a formula that stands in its place, because it has the right form.
        stands_in: whether its columns are of another effect, for which it stands.
        grouped: whether it came with others, which every machine has or which are a path.
        path: chance of the path with which it came; None of what came without one.
    """

    effect: Effect
    columns: Index
    evidence: Evidence | None = None
    rivals: tuple[Evidence, ...] = ()
    gain: float = np.nan
    curve: Effect | None = None
    impossible: Effect | None = None
    law: Formula | None = None
    stands_in: bool = False
    grouped: bool = False
    path: float | None = None

    @property
    def rejected(self) -> bool:
        """Whether something speaks against its form."""
        return any(each is not None for each in (self.curve, self.impossible, self.law))

    @property
    def label(self) -> str:
        """The effect's label."""
        return self.effect.label


def leading(members: Sequence[Member]) -> list[Member]:
    """Return what is added at once: the first, with those of its kind at other joints; the first
    alone where it has rivals or stands for another effect. A path is added as a whole.
    """
    first, *rest = members
    if first.path is not None:
        return [first, *(m for m in rest if m.path is not None)]
    alone = first.rivals or first.stands_in
    return [first, *(m for m in rest if not alone and m.effect.kind == first.effect.kind)]


@dataclass(frozen=True, eq=False)
class EffectSet:
    """The model with a set of effects added, on the rows of one fit."""

    contest: Contest
    regression: PartialRegression
    members: tuple[Member, ...] = ()

    @property
    def labels(self) -> frozenset[str]:
        """Labels of its effects."""
        return frozenset(each.label for each in self.members)

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

    def rise(self, bare: EffectSet) -> float:
        """Rise of the left-out squares without some effects, as a share; see `hypotheses`."""
        more = bare.regression.losses - self.regression.losses
        share = float(bare.regression.explained(more.sum(axis=0)))
        return share / max(1 - share, EXACT)

    def plus(self, found: Evidence, equal: tuple[Evidence, ...] = ()) -> EffectSet:
        """The set with a further effect and its rivals."""
        contest, columns = replace(self.contest, regression=self.regression), found.columns
        if found.C:  # of a refined shape
            contest, columns = contest.added(found.C)
        member = Member(found.effect, columns, found, equal)
        return EffectSet(contest, contest.regression.extended(columns), (*self.members, member))

    def minus(self, member: Member) -> EffectSet:
        """The set without one of its effects."""
        left = tuple(each for each in self.members if each is not member)
        return replace(self, regression=self.regression.without(member.columns), members=left)

    def polished(self) -> EffectSet:
        """The set with all shapes refined beside each other: weights have changed since."""
        found = self
        for m in self.members:
            if m.evidence is None or m.effect.corrects or not m.evidence.C:
                continue
            bare = found.minus(m)
            contest = replace(bare.contest, regression=bare.regression)
            shape, C, refit = refined(contest, bare.regression, m.effect, m.evidence.shape)
            e = replace(m.evidence, shape=shape, columns=m.columns[:0], C=tuple(C), refit=refit)
            found = bare.plus(e, m.rivals)
        return found

    def reweighted(self) -> EffectSet:
        """The set with weights by the left-out errors that it leaves."""
        return replace(self, regression=reweighted(self.regression))

    @cached_property
    def shares(self) -> dict[str, float]:
        """Rise of the in-sample squared error without each effect, as a share, by label.

        It is larger than the left-out one; −1 of an effect whose values cannot be.

            θ_gᵀ ((XᵀX)⁻¹)_gg⁻¹ θ_g / |e|²
        """
        theta, inverse = self.regression.solved
        place = {int(column): i for i, column in enumerate(self.regression.model)}
        found = {}
        for each in self.members:
            at = np.array([place[int(column)] for column in each.columns])
            t = theta[at]
            rise = float(t @ linear.pinv(inverse[np.ix_(at, at)], hermitian=True) @ t)
            stderr = np.sqrt(np.maximum(np.diag(inverse)[at], 0.0))
            possible = each.evidence is None or sensible(self.contest, each.effect, t, stderr)
            found[each.label] = rise / self.loss if possible else -1.0
        return found


def reweighted(regression: PartialRegression) -> PartialRegression:
    """The regression with weights by the left-out errors of its model."""
    sigma = np.sqrt(regression.losses.sum(axis=0) / np.maximum(regression.rows, 1))
    return regression.weighted(regression.weight / np.where(sigma > 0, sigma, 1.0))


def on_all_rows(
    contest: Contest, members: Iterable[Member]
) -> tuple[PartialRegression, dict[str, Index]]:
    """The rows of a fit, those at reversals too, with columns of members by label and without
    pulses: on them errors are announced, as a refit has them.
    """
    table, held = contest.table, contest.fit.estimate.held
    prior = table.columns.prior_at(table.point.values)
    store = ColumnStore(table, table.informed, table.A, table.b - table.A[:, :, held] @ prior[held])
    columns = {}
    for each in members:
        assert each.evidence is not None
        shape = each.evidence.shape
        if each.effect.corrects:
            shape = {p.name: each.effect.values.get(p.name, 0.0) for p in each.effect.shapes}
        columns[each.effect.label] = store.add(each.effect, [shape])
    rows = contest.regression.without(contest.pulses)
    return PartialRegression(store.parts(), rows.model, rows.weight, store.count), columns
