"""What every effect would do, announced before anything is refitted; it announces, and judges not.

An announcement is the held-out fall of error of a refit that has not been done: exact for effects
that are linear in their unknowns. Whether a fall means anything is what a diagnosis is for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ident.diagnose.choose import ALIKE, APART
from ident.diagnose.evidence import MINE, zscore
from ident.diagnose.hidden import invisible, outright
from ident.diagnose.phrases import what
from ident.diagnose.search import Candidate, search
from ident.diagnose.sites import candidates
from ident.diagnose.support import unsupported
from ident.effects import Correcting, Effect
from ident.explore.ground import Ground
from ident.progress import Told

SOME = 2.0  # standard errors from which a fall is one


@dataclass(frozen=True, eq=False)
class Announced:
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


def announce(ground: Ground, progress: Told | None = None) -> tuple[Announced, ...]:
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
    shut = [Announced(e, why=hidden[e.label]) for e in (*wanted, *(x.effect for x in absorbed))
            if e.label in hidden]  # fmt: skip
    best_first = sorted(open_, key=lambda each: -(each.fall or 0.0))
    return (*best_first, *shut, *_present(ground))


def _of(ground: Ground, candidate: Candidate) -> Announced:
    judged, joints = candidate.judged, ground.fit.motion.independent
    by = np.maximum(judged.by, 0.0)
    mends = [u for u in np.argsort(-by) if by[u] >= MINE * max(by.sum(), 1e-300)]
    fall, error = ground.fall(judged.loss)
    names = tuple(joints[u] for u in mends)
    return Announced(candidate.effect, False, fall, error, names, shape=candidate.shape)


def _with_rivals(
    ground: Ground, found: Sequence[Candidate], announced: Sequence[Announced]
) -> list[Announced]:
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


def _close(a: Announced, b: Announced) -> bool:
    """Whether two falls differ by less than either is known: ranks of such falls say nothing."""
    apart = abs((a.fall or 0.0) - (b.fall or 0.0))
    return apart < max(a.error or 0.0, b.error or 0.0)


def _present(ground: Ground) -> list[Announced]:
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
            found.append(Announced(effect, True, why=why))
            continue
        held = np.zeros(len(fit.columns), dtype=bool)
        held[mine] = True
        D = ground.difference(ground.without(held), ground.screen.loss)
        before = max(total + float(D.sum()), 1e-300)
        error = float(D.std(ddof=1) * np.sqrt(len(D))) / before if len(D) > 1 else 0.0
        found.append(Announced(effect, True, float(D.sum()) / before, error, why=why))
    return sorted(found, key=lambda each: -(each.fall or 0.0))
