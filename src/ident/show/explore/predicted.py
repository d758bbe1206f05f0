"""Predicted fall of the held-out error for every effect, before anything is refitted.

The only file of this package that does arithmetic: `of_fit`, `announce`, `fall`, `delivered` ask
the rows and candidates of a diagnosis. A prediction is the fall of a refit that has not been done:
exact for effects that are linear in their unknowns. It judges nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ident.diagnose.choose import ALIKE, APART
from ident.diagnose.evidence import MINE, torque_squares, zscore
from ident.diagnose.hidden import invisible, outright
from ident.diagnose.phrases import what
from ident.diagnose.quiet import quiet
from ident.diagnose.screen import Screen
from ident.diagnose.search import Candidate, search
from ident.diagnose.sites import candidates
from ident.diagnose.support import unsupported
from ident.effects import Correcting, Effect
from ident.fit import Fit
from ident.fit.table import Table
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
        corrected = any(isinstance(each, Correcting) for each in self.mechanism.effects)
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
    """A fit with its rows, the model projected out of those that are away from reversals."""

    fit: Fit
    table: CachedTable
    screen: Screen

    @classmethod
    def of(cls, fit: Fit, store: ColumnCache) -> ScreeningContext:
        """Of a fit; its columns are looked up in `store` first."""
        table = CachedTable.of_fit(fit, store)
        return cls(fit, table, Screen.of(table, quiet(table), fit.worth, fit.estimate.held))

    @property
    def weight(self) -> np.ndarray:
        """w (d,); 0 for a joint without torque."""
        torque = torque_squares(self.table, self.screen)
        return np.where(torque > 0, 1.0 / np.where(torque > 0, torque, 1.0), 0.0)

    def difference(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """D (blocks,) of losses (blocks, d)."""
        return (before - after) @ self.weight

    def fall(self, after: np.ndarray) -> tuple[float, float]:
        """Of the model's own losses to others (blocks, d), and its standard error over blocks."""
        total = float((self.screen.loss @ self.weight).sum())
        D = self.difference(self.screen.loss, after)
        if total <= 0 or len(D) < 2:
            return 0.0, 0.0
        return float(D.sum() / total), float(D.std(ddof=1) * np.sqrt(len(D)) / total)

    def without(self, held: np.ndarray) -> np.ndarray:
        """(blocks, d) losses with further unknowns (k,) held where they are without data."""
        return Screen.same_rows(self.screen, self.table, self.fit.estimate.held | held).loss

    def delivered(self, after: ScreeningContext) -> float | None:
        """The fall to another model, in the same rows and weights; None if its rows are others."""
        mine, other = self.table, after.table
        if len(mine.t) != len(other.t) or not np.array_equal(mine.sample, other.sample):
            return None
        loss = Screen.same_rows(self.screen, other, after.fit.estimate.held).loss
        return self.fall(loss)[0]


SOME = 2.0  # standard errors from which a fall is one


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
        return what(self.effect)

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
    fit, table, screen = ground.fit, ground.table, ground.screen
    wanted = candidates(fit.mechanism, fit.motion)
    absorbed = [x for x in (outright(fit.mechanism, each) for each in wanted) if x]
    given = {each.effect.label for each in absorbed}
    wanted = [each for each in wanted if each.label not in given]
    found = search(table, screen, wanted, np.zeros((len(screen.r), 0)), progress)
    hidden = {x.effect.label: x.why for x in invisible(fit, table, screen, found.candidates)}
    hidden |= {x.effect.label: x.why for x in absorbed}
    hidden |= {e.label: f"could not be tried: {why}" for e, why in found.failed}
    seen = [each for each in found.candidates if each.effect.label not in hidden]
    open_ = _with_rivals(ground, seen, [_of(ground, each) for each in seen])
    shut = [PredictedGain(e, why=hidden[e.label]) for e in (*wanted, *(x.effect for x in absorbed))
            if e.label in hidden]  # fmt: skip
    best_first = sorted(open_, key=lambda each: -(each.fall or 0.0))
    return (*best_first, *shut, *_present(ground))


def _of(ground: ScreeningContext, candidate: Candidate) -> PredictedGain:
    judged, joints = candidate.judged, ground.fit.motion.independent
    by = np.maximum(judged.by, 0.0)
    mends = [u for u in np.argsort(-by) if by[u] >= MINE * max(by.sum(), 1e-300)]
    fall, error = ground.fall(judged.loss)
    names = tuple(joints[u] for u in mends)
    return PredictedGain(candidate.effect, False, fall, error, names, shape=candidate.shape)


def _with_rivals(
    ground: ScreeningContext, found: Sequence[Candidate], announced: Sequence[PredictedGain]
) -> list[PredictedGain]:
    """Each with those that explain the same part as well, or better.

    cos(X̃_a θ_a, X̃_b θ_b) > ALIKE; better: mean(D_b − D_a) ≥ APART standard errors of its own, and
    the falls differ by more than the standard error of either
    """
    screen = ground.screen
    sure = [i for i, each in enumerate(announced) if each.sure]
    parts = np.zeros((len(screen.r), len(sure)))
    for column, i in enumerate(sure):
        part = screen.projected(found[i].columns @ found[i].judged.theta[:, None])[:, 0]
        parts[:, column] = part / max(float(np.linalg.norm(part)), 1e-300)
    alike = parts.T @ parts > ALIKE
    D = [ground.difference(screen.loss, found[i].judged.loss) for i in sure]
    result = list(announced)
    for a, i in enumerate(sure):
        behind = {
            announced[j].label: 0.0 if _close(announced[i], announced[j]) else zscore(D[b] - D[a])
            for b, j in enumerate(sure) if b != a and alike[a, b]
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
    doubts = {x.effect.label: x.why for x in unsupported(fit, ground.table, ground.screen)}
    total = float((ground.screen.loss @ ground.weight).sum())
    found = []
    for effect, places in fit.columns.effects:
        mine = places[places >= 0]
        if not len(mine):
            continue
        why = doubts.get(effect.label, "")
        if isinstance(effect, Correcting):  # it is undone by another motion, not by a column
            found.append(PredictedGain(effect, True, why=why))
            continue
        held = np.zeros(len(fit.columns), dtype=bool)
        held[mine] = True
        D = ground.difference(ground.without(held), ground.screen.loss)
        before = max(total + float(D.sum()), 1e-300)
        error = float(D.std(ddof=1) * np.sqrt(len(D))) / before if len(D) > 1 else 0.0
        found.append(PredictedGain(effect, True, float(D.sum()) / before, error, why=why))
    return sorted(found, key=lambda each: -(each.fall or 0.0))
