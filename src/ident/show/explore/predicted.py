"""Predicted fall of the held-out error for every effect, before anything is refitted.

The only file of this package that does arithmetic: `of_fit`, `announce`, `fall`, `delivered` ask
the rows and candidates of a diagnosis. A prediction is the fall of a refit that has not been done:
exact for effects that are linear in their unknowns. It judges nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ident.diagnosis.candidates import CandidateColumns, Contest, absorbed, possible
from ident.diagnosis.diagnosis import hidden_of, unsupported
from ident.diagnosis.selection import Decision, Evidence, Weigh, alike, torque_squares
from ident.effects import Effect
from ident.fit import Fit
from ident.fit.table import Table
from ident.information.hypotheses import zscore
from ident.progress import Progress

Shapes = Sequence[Mapping[str, float]]
ROOM = 200_000_000  # bytes of columns that are kept


@dataclass(frozen=True, eq=False)
class ColumnCache:
    """Columns (N, c, unknowns · shapes) by what they were asked for, of one motion."""

    columns: dict[tuple[object, ...], np.ndarray] = field(default_factory=dict)

    @property
    def size(self) -> int:
        """Bytes."""
        return sum(x.nbytes for x in self.columns.values())


@dataclass(frozen=True, eq=False)
class CachedTable(Table):
    """A table that looks a column up before it makes it."""

    store: ColumnCache = field(default_factory=ColumnCache)

    @classmethod
    def of_fit(cls, fit: Fit, store: ColumnCache) -> CachedTable:
        """The rows of a fit; what `store` has of the same motion is not made again."""
        made = Table.of(fit.mechanism, fit.columns, fit.motion, fit.point)
        own = {name: getattr(made, name) for name in Table.__dataclass_fields__}
        return cls(**own, store=store)

    def with_effect(self, effect: Effect, shapes: Shapes) -> np.ndarray:
        """As `Table.with_effect`."""
        corrected = any(each.corrects for each in self.mechanism.effects)
        if corrected or effect.implicit or len(shapes) == 0:
            return super().with_effect(effect, shapes)
        asked = [tuple(sorted(each.items())) for each in (effect.values, *shapes)]
        key = (type(effect), effect.label, self.motion.independent, *asked)
        if key not in self.store.columns:
            found = super().with_effect(effect, shapes)
            if self.store.size + found.nbytes > ROOM:
                return found
            self.store.columns[key] = found
        return self.store.columns[key]


@dataclass(frozen=True, eq=False)
class ScreeningContext:
    """A fit with its rows away from reversals, and the columns of what could be added."""

    fit: Fit
    contest: Contest

    @classmethod
    def of(cls, fit: Fit, store: ColumnCache, progress: Progress | None = None) -> ScreeningContext:
        """Of a fit; its columns are looked up in `store` first."""
        wanted = [e for e in possible(fit.mechanism, fit.motion) if not absorbed(fit.mechanism, e)]
        table = CachedTable.of_fit(fit, store)
        told = progress or (lambda what, share: None)
        return cls(fit, Contest.of(fit, wanted, told, curved=False, table=table))

    @property
    def weight(self) -> np.ndarray:
        """w (d,); 0 for a joint without torque."""
        torque = torque_squares(self.contest, self.contest.regression)
        return np.where(torque > 0, 1.0 / np.where(torque > 0, torque, 1.0), 0.0)

    def difference(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """D (blocks,) of losses (blocks, d)."""
        return (before - after) @ self.weight

    def fall(self, after: np.ndarray) -> tuple[float, float]:
        """Of the model's own losses to others (blocks, d), and its standard error over blocks."""
        before = self.contest.regression.losses
        total = float((before @ self.weight).sum())
        D = self.difference(before, after)
        if total <= 0 or len(D) < 2:
            return 0.0, 0.0
        return float(D.sum() / total), float(D.std(ddof=1) * np.sqrt(len(D)) / total)

    def delivered(self, after: ScreeningContext) -> float | None:
        """The fall to another model, in the same rows and weights; None if its rows are others."""
        mine, other = self.contest, after.contest
        if mine.use.shape != other.use.shape or not np.array_equal(mine.use, other.use):
            return None
        return self.fall(other.regression.weighted(mine.regression.weight).losses)[0]


SOME = 2.0  # standard errors from which a fall is one
APART = 2.0  # standard errors of paired blocks within which two candidates are rivals
LEAST = 0.01  # of the held-out squares: a shape that gains less is not refined


@dataclass(frozen=True, eq=False)
class PredictedGain:
    """What one effect does to the held-out error, or would do.

    Attributes:
        effect: which; present: whether it is in the model, with an unknown in it.
        fall, error: of the held-out squares and its standard error, as shares: what adding it would
            take away, or what it takes away now. None where that cannot be said.
        joints: whose errors it lowers, the one it lowers most first.
        rivals: labels of effects that explain the same part as well, as far as can be told;
            better: that explain it better, by more than falls are known.
        shape: of a search, from which a refit sets out.
        why: it cannot be seen in this data, or had better not be in the model; "" for most.
    """

    effect: Effect
    present: bool = False
    fall: float | None = None
    error: float | None = None
    joints: tuple[str, ...] = ()
    rivals: tuple[str, ...] = ()
    better: tuple[str, ...] = ()
    shape: Mapping[str, float] = field(default_factory=dict)
    why: str = ""

    @property
    def label(self) -> str:
        """As commands take it."""
        return self.effect.label

    @property
    def words(self) -> str:
        """What it is."""
        return type(self.effect).summary()

    @property
    def sure(self) -> bool:
        """Whether the error falls by more than chance makes it."""
        return self.fall is not None and self.fall > SOME * (self.error or 0.0)

    def __str__(self) -> str:
        if self.fall is None or self.error is None:
            return f"{self.label}: {self.why or 'not linear'}"
        return f"{self.label}: {100 * self.fall:.1f} ± {100 * self.error:.1f} %"


def predicted_gains(
    ground: ScreeningContext, progress: Progress | None = None
) -> tuple[PredictedGain, ...]:
    """All effects that could be missing, then those of the model; each part best first.

    Args:
        ground: of the fit as it is.
        progress: called with (what is being done, share done); what it raises stops the work.
    """
    fit, contest = ground.fit, ground.contest
    hidden = hidden_of(fit, contest)
    seen = [each for each in contest.candidates if each.effect.label not in hidden]
    found = _weighed(contest, seen)
    open_ = _with_rivals(ground, found, [_of(ground, each) for each in found])
    every = possible(fit.mechanism, fit.motion)
    shut = [PredictedGain(e, why=hidden[e.label]) for e in every if e.label in hidden]
    best_first = sorted(open_, key=lambda each: -(each.fall or 0.0))
    return (*best_first, *shut, *_present(ground))


def _weighed(contest: Contest, seen: Sequence[CandidateColumns]) -> list[Evidence]:
    """Each candidate at its best start, refined where it does anything."""
    regression = contest.regression
    total = max(float(regression.loss.sum()), 1e-300)
    weigh = Weigh(contest, regression, Decision(), total)
    found = []
    gains = regression.gains([group for each in seen for group in each.groups]).G
    first = 0
    for each in seen:
        mine = gains[first : first + len(each.groups)]
        first += len(each.groups)
        start = int(mine.argmax())
        found.append(weigh(each, start, float(mine[start]) / total, LEAST, 1.0))
    return found


def _of(ground: ScreeningContext, found: Evidence) -> PredictedGain:
    joints, by = ground.fit.motion.independent, found.refit.by
    mends = sorted(found.mends, key=lambda u: -by[u])
    fall, error = ground.fall(found.refit.loss)
    names = tuple(joints[u] for u in mends)
    return PredictedGain(found.effect, False, fall, error, names, shape=found.shape)


def _with_rivals(
    ground: ScreeningContext, found: Sequence[Evidence], announced: Sequence[PredictedGain]
) -> list[PredictedGain]:
    """Each with those that explain the same part as well, or better.

    better: mean(D_b − D_a) ≥ APART standard errors of its own, and the falls differ by more than
    the standard error of either
    """
    sure = [i for i, each in enumerate(announced) if each.sure]
    before = ground.contest.regression.losses
    D = {i: ground.difference(before, found[i].refit.loss) for i in sure}
    result = list(announced)
    for i in sure:
        behind = {
            announced[j].label: 0.0 if _close(announced[i], announced[j]) else zscore(D[j] - D[i])
            for j in sure if j != i and alike(found[i], found[j])
        }  # fmt: skip
        result[i] = replace(
            announced[i],
            rivals=tuple(label for label, z in behind.items() if abs(z) < APART),
            better=tuple(label for label, z in behind.items() if z >= APART),
        )
    return result


def _close(a: PredictedGain, b: PredictedGain) -> bool:
    """Whether two falls differ by less than either is known: ranks of such falls say nothing."""
    apart = abs((a.fall or 0.0) - (b.fall or 0.0))
    return apart < max(a.error or 0.0, b.error or 0.0)


def _present(ground: ScreeningContext) -> list[PredictedGain]:
    """Effects of the model: what they take away now, and what speaks against them."""
    fit = ground.fit
    regression = ground.contest.regression
    doubts = {x.effect.label: x.why for x in unsupported(fit, ground.contest, Decision())}
    total = float((regression.losses @ ground.weight).sum())
    found = []
    for effect, places in fit.columns.effects:
        mine = np.array([p for p in places if p >= 0], dtype=int)
        if not len(mine):
            continue
        why = doubts.get(effect.label, "")
        if effect.corrects:  # it is undone by another motion, not by a column
            found.append(PredictedGain(effect, True, why=why))
            continue
        D = ground.difference(regression.without(mine).losses, regression.losses)
        before = max(total + float(D.sum()), 1e-300)
        error = float(D.std(ddof=1) * np.sqrt(len(D))) / before if len(D) > 1 else 0.0
        found.append(PredictedGain(effect, True, float(D.sum()) / before, error, why=why))
    return sorted(found, key=lambda each: -(each.fall or 0.0))
