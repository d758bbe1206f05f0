"""Predicted fall of the held-out error for every effect, before anything is refitted.

    fall = 1 − L′ / L

with the left-out squares L of all joints now and L′ with the effect, in the weights by which a
diagnosis judges, from `PartialRegression`: exact for effects that are linear in their unknowns. It
judges nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ident.diagnosis.candidates import Contest, possible
from ident.diagnosis.result import announced_errors, errors_of
from ident.diagnosis.search import Search
from ident.diagnosis.selection import Decision, Evidence, alike, rank
from ident.diagnosis.unobservable import invisible, unsupported
from ident.effects import Effect
from ident.fit import Fit
from ident.information.blocks import Error
from ident.information.chance import Chance, zscore
from ident.progress import Progress, quiet

SOME = 2.0  # standard errors from which a gain is one
APART = 2.0  # standard errors of paired blocks within which two candidates are rivals
LEAST = 0.01  # of the held-out squares: a shape that gains less is not refined


@dataclass(frozen=True, eq=False)
class PredictedGain:
    """Change of the held-out error by one effect, predicted or present.

    Attributes:
        effect: which; present: whether it is in the model, with an unknown in it.
        fall, error: of the held-out squares and its standard error, as shares: what adding it would
            take away, or what it takes away now. None where that cannot be said.
        joints: whose errors it lowers, the one it lowers most first; before, after: the held-out
            error of that one without it and with it.
        gain: fall of the squares as a diagnosis weighs them, by which candidates are ordered behind
            the one that it would name first; below zero of one whose values no such effect can
            have. z: its standard errors.
        rivals: labels of effects that explain the same part as well, as far as can be told;
            better: that explain it better, by more than falls are known.
        shape: of a search, from which a refit sets out.
        why: it cannot be seen in this data, or should not be in the model; "" for most.
    """

    effect: Effect
    present: bool = False
    fall: float | None = None
    error: float | None = None
    joints: tuple[str, ...] = ()
    before: Error | None = None
    after: Error | None = None
    gain: float = 0.0
    z: float = 0.0
    rivals: tuple[str, ...] = ()
    better: tuple[str, ...] = ()
    shape: Mapping[str, float] = field(default_factory=dict)
    why: str = ""

    @property
    def label(self) -> str:
        """Label of the effect, as commands take it."""
        return self.effect.label

    @property
    def sure(self) -> bool:
        """Whether the error falls by more than chance makes it."""
        return self.fall is not None and self.z > SOME

    def __str__(self) -> str:
        if self.fall is None or self.error is None:
            return f"{self.label}: {self.why or 'not linear'}"
        return f"{self.label}: {100 * self.fall:.1f} ± {100 * self.error:.1f} %"


def rows_of(
    fit: Fit, effects: Sequence[Effect] = (), progress: Progress | None = None,
    earlier: Contest | None = None,
) -> Contest:  # fmt: skip
    """Return the rows of a fit away from reversals, with the columns of some effects.

    Args:
        fit: of the present model.
        effects: whose columns.
        progress: called with (what is being done, share done); what it raises stops the work.
        earlier: of another model, from which columns are taken that are the same there.
    """
    return Contest.of(fit, effects, progress or quiet, curved=False, earlier=earlier)


def _fall(before: np.ndarray, after: np.ndarray) -> tuple[float, float]:
    """Return the fall between squares (blocks,), as a share, and its standard error over blocks."""
    D, total = before - after, max(float(before.sum()), 1e-300)
    if len(D) < 2:
        return 0.0, 0.0
    return float(D.sum()) / total, float(D.std(ddof=1) * np.sqrt(len(D))) / total


def predicted_gains(contest: Contest) -> tuple[PredictedGain, ...]:
    """Return all effects that could be missing, then those of the model; each part best first."""
    fit = contest.fit
    every = possible(fit.mechanism, fit.motion)
    regression = contest.regression
    now = regression.loss
    decision = Decision()
    first = rank(
        contest,
        regression,
        None,
        decision,
        0,
        curved=False,
        chance=Chance({}, np.zeros(0), {}, decision.alpha, LEAST),
    )
    hidden = {each.effect.label: each.why for each in invisible(first)}
    found = [each for each in first.every(decision) if each.effect.label not in hidden]
    after = [each.refit.loss.sum(axis=1) for each in found]
    errors, losses = errors_of(fit), regression.losses.sum(axis=0)
    open_ = []
    for each, squares in zip(found, after, strict=True):
        mends = sorted(each.mends, key=lambda u: -each.refit.by[u])
        joints = tuple(fit.motion.independent[u] for u in mends)
        joint = fit.motion.independent[each.coordinate]
        with_it = announced_errors(errors, losses, each.refit.loss.sum(axis=0))[joint]
        open_.append(
            PredictedGain(
                each.effect, False, *_fall(now, squares), joints, errors[joint], with_it,
                each.gain if each.sensible else -1.0, float(each.z), shape=each.shape,
            )
        )  # fmt: skip
    given = [effect.label for effect in fit.mechanism.effects]
    lead = Search(contest, None, decision, 0, given, quiet).led(first)
    open_ = _with_rivals(found, after, open_)
    open_.sort(key=lambda each: (each.label != lead, -each.gain))
    shut = [PredictedGain(e, why=hidden[e.label]) for e in every if e.label in hidden]
    doubts = {x.effect.label: x.why for x in unsupported(fit, contest, decision)}
    present = []
    for effect, places in fit.columns.effects:
        mine = np.array([p for p in places if p >= 0], dtype=int)
        if len(mine):
            own = PredictedGain(effect, True, why=doubts.get(effect.label, ""))
            if not effect.corrects:  # a correction is undone by another motion, not by a column
                bare = regression.without(mine).losses
                fall, error = _fall(bare.sum(axis=1), now)
                without = announced_errors(errors, losses, bare.sum(axis=0))
                joint = max(errors, key=lambda name: without[name].rms / (errors[name].rms or 1.0))
                own = replace(
                    own, fall=fall, error=error, joints=(joint,), before=without[joint],
                    after=errors[joint],
                )  # fmt: skip
            present.append(own)
    return (*open_, *shut, *sorted(present, key=_largest))


def _largest(each: PredictedGain) -> float:
    return -(each.fall or 0.0)


def _with_rivals(
    found: Sequence[Evidence], after: Sequence[np.ndarray], gains: Sequence[PredictedGain]
) -> list[PredictedGain]:
    """Return each with those that explain the same part as well, or better.

    better: by APART standard errors of the paired difference, and by more than falls are known.
    """
    sure = [i for i, each in enumerate(gains) if each.sure]
    result = list(gains)
    for i in sure:
        z = {}
        for j in sure:
            if j != i and alike(found[i], found[j]):
                a, b = gains[i], gains[j]
                known = max(a.error or 0.0, b.error or 0.0)
                far = abs((a.fall or 0.0) - (b.fall or 0.0)) >= known
                z[b.label] = zscore(after[i] - after[j]) if far else 0.0
        result[i] = replace(
            gains[i],
            rivals=tuple(label for label, x in z.items() if abs(x) < APART),
            better=tuple(label for label, x in z.items() if x >= APART),
        )
    return result
