"""A ladder of models tried by hand, and the predicted fall of the held-out error.

Of every effect, before anything is refitted:

    fall = 1 − L′ / L

with the left-out squares L of all joints now and L′ with the effect, in the weights by which a
diagnosis judges, from `PartialRegression`: exact for effects that are linear in their unknowns. It
judges nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ident.diagnosis import Diagnosis, History, diagnose
from ident.diagnosis.candidates import Contest, candidates_of, possible
from ident.diagnosis.found_curves import FoundCurve
from ident.diagnosis.grow import Step
from ident.diagnosis.result import Law, announced_errors, errors_of
from ident.diagnosis.search import Search
from ident.diagnosis.selection import Decision, Evidence, alike, rank
from ident.diagnosis.unobservable import invisible, unsupported
from ident.display import Displayed, Progress, quiet
from ident.effects import Effect
from ident.equations.unknowns import Point
from ident.errors import FitError, one_of
from ident.files import write_all
from ident.fit import Fit, identify
from ident.information.blocks import Error
from ident.information.chance import Chance, zscore
from ident.mechanism import Mechanism
from ident.motion import Motion
from ident.show.html import named
from ident.show.ladder import model_files, refuse_own
from ident.show.ladder import write as write_history
from ident.show.laws import curve_name, law_words
from ident.text import percent, table

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
        chance=Chance({}, {}, decision.alpha, LEAST),
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


START = "as given"


@dataclass(frozen=True, eq=False)
class ModelStep:
    """A rung of the ladder.

    Attributes:
        added, removed: what was changed, several of a kind at once; nothing on the first rung.
        fit: everything refitted.
        candidates: what is announced for the next change; None before that has been worked out.
        diagnosis: None before it was asked for.
    """

    added: tuple[Effect, ...]
    removed: tuple[Effect, ...]
    fit: Fit
    candidates: tuple[PredictedGain, ...] | None = None
    diagnosis: Diagnosis | None = None

    @property
    def name(self) -> str:
        """`+ viscous:elbow`."""
        if self.added:
            return f"+ {named(self.added)}"
        return f"− {named(self.removed)}" if self.removed else START

    @property
    def errors(self) -> dict[str, Error]:
        """Held out, by joint; of the fitted data where the log is too short for that."""
        return errors_of(self.fit)

    @property
    def step(self) -> Step:
        """As `grow` has it."""
        return Step(self.added, self.removed, (), self.fit, self.errors)


def error_text(error: Error | None) -> str:
    """Relative to the torque, or the rms where there is none."""
    if error is None:
        return "–"
    return f"{error.rms:.3g} {error.unit}" if error.relative is None else percent(error.relative)


@dataclass(frozen=True, eq=False, repr=False)
class Exploration(Displayed):
    """Models tried one after the other. Each verb returns a new one; `before` is the way back.

    Attributes:
        rungs: from the model that was given to the present one.
        before: what it was before the last change; None at the beginning.
        refused: labels of laws and curves that are not offered again.
        contest: columns of all effects beside the model that was screened last.
    """

    rungs: tuple[ModelStep, ...]
    before: Exploration | None = None
    refused: frozenset[str] = frozenset()
    contest: Contest | None = None

    @classmethod
    def of(
        cls, mechanism: Mechanism, motion: Motion, progress: Progress | None = None
    ) -> Exploration:
        """The first rung: the model as it is given.

        Args:
            mechanism: the model.
            motion: what it is fitted to.
            progress: called with (what is being done, share done).

        Raises:
            FitError: if there are no equations to identify with.
        """
        fit = identify(mechanism, motion, estimator="least-squares", progress=progress)
        return cls((ModelStep((), (), fit),))

    @property
    def now(self) -> ModelStep:
        """The present model."""
        return self.rungs[-1]

    @property
    def fit(self) -> Fit:
        """Fit of the present model."""
        return self.now.fit

    @property
    def mechanism(self) -> Mechanism:
        """The present model."""
        return self.fit.mechanism

    @property
    def candidates(self) -> tuple[PredictedGain, ...]:
        """Predicted gain of every effect; empty before `screened`."""
        return self.now.candidates or ()

    @property
    def offered(self) -> tuple[Law | FoundCurve, ...]:
        """Laws and curves that the diagnosis of the present model found and nobody refused."""
        d = self.now.diagnosis
        every: tuple[Law | FoundCurve, ...] = () if d is None else (*d.laws, *d.curves)
        return tuple(each for each in every if each.effect.label not in self.refused)

    @property
    def summary(self) -> str:
        """What is offered or announced first, in a sentence, and what to do about it."""
        if self.offered:
            first = self.offered[0]
            form = law_words(first) if isinstance(first, Law) else f"a {curve_name(first.effect)}"
            more = f", and {len(self.offered) - 1} more" if len(self.offered) > 1 else ""
            return f"Offered for what no effect explains: {form}{more}; accept it or refuse it."
        best = next((x for x in self.candidates if x.sure and not x.present), None)
        if best is None:
            return "No effect lowers the error by more than chance would; judge it to be sure."
        if self.now.diagnosis is not None:
            return f"The first candidate is {best.label}; the verdict on it is under Verdict."
        return (
            f"The first candidate is {best.label}. A falling error is no proof of a cause: judge "
            "it to weigh what speaks for it."
        )

    def effect(self, label: str) -> Effect | str:
        """Return the effect with a label among what is announced or offered; else the label."""
        every = (each.effect for each in (*self.offered, *self.candidates))
        return next((effect for effect in every if effect.label == label), label)

    def refuse(self, label: str) -> Exploration:
        """Leave out the offer of a law or a curve.

        Args:
            label: of the offer.

        Raises:
            FitError: if it is not offered.
        """
        labels = [each.effect.label for each in self.offered]
        if label not in labels:
            raise FitError(f"'{label}' is not offered; {one_of(label, labels)}")
        return replace(self, refused=self.refused | {label}, before=replace(self, contest=None))

    def screened(self, progress: Progress | None = None) -> Exploration:
        """With the fall of error announced for every effect of the library.

        Args:
            progress: called with (what is being done, share done); what it raises stops the work.
        """
        if self.now.candidates is not None:
            return self
        contest = rows_of(self.fit, candidates_of(self.fit), progress, self.contest)
        now = replace(self.now, candidates=predicted_gains(contest))
        return replace(self._with(now), contest=contest)

    def with_effect(
        self, effect: str | Effect | Sequence[str | Effect], progress: Progress | None = None
    ) -> Exploration:
        """With one more effect in the model, or several on one rung, everything refitted.

        Args:
            effect: `kind:joint[,joint]`, `kind` alone for all its joints, or an effect; or several.
            progress: called with (what is being done, share done).

        Raises:
            IdentError: for one that the mechanism cannot have, or has already.
        """
        old = mechanism = self.mechanism
        for each in [effect] if isinstance(effect, str | Effect) else effect:
            mechanism = mechanism.with_effect(each) if isinstance(each, str) else mechanism + each
        new = tuple(e for e in mechanism.effects if not any(e is own for own in old.effects))
        gains = {x.label: x for x in self.candidates if not x.present}
        shapes = {
            full: gain.shape[s.name]
            for each in new
            if (gain := gains.get(each.label)) is not None
            for full, s in zip(each.names[len(each.unknowns) :], each.shapes, strict=True)
            if s.name in gain.shape
        }
        start = Point(self.fit.point.pi, {**self.fit.point.values, **shapes})
        return self._extended(mechanism, start, progress, added=new)

    def without(self, label: str, progress: Progress | None = None) -> Exploration:
        """With one effect less, everything refitted.

        Args:
            label: of the effect, as `coulomb:elbow`.
            progress: called with (what is being done, share done).

        Raises:
            MechanismError: if the model has no such effect.
        """
        mechanism = self.mechanism.without(label)
        removed = next(e for e in self.mechanism.effects if e.label == label)
        return self._extended(mechanism, self.fit.point, progress, removed=(removed,))

    def at(self, rung: int) -> Exploration:
        """Back to an earlier rung, 0 the model as given.

        Raises:
            FitError: if there is no such rung.
        """
        if not 0 <= rung < len(self.rungs):
            valid = one_of(str(rung), map(str, range(len(self.rungs))))
            raise FitError(f"there is no rung {rung}; {valid}")
        if rung == len(self.rungs) - 1:
            return self
        return replace(self, rungs=self.rungs[: rung + 1], before=replace(self, contest=None))

    @property
    def undone(self) -> Exploration:
        """As before the last change; at the beginning, as it is."""
        return self if self.before is None else replace(self.before, contest=self.contest)

    def judged(self, progress: Progress | None = None) -> Exploration:
        """With the diagnosis of the present model: whether a fall means anything.

        Args:
            progress: called with (what is being done, share done).
        """
        if self.now.diagnosis is not None:
            return self
        found = diagnose(self.fit, progress=progress)
        return self._with(replace(self.now, diagnosis=found))

    def write(self, folder: str | Path) -> list[Path]:
        """The present mechanism's folder with its fit; with its diagnosis, where there is one.

        Returns:
            The files written, all of them or none.

        Raises:
            IdentError: if it is the folder of the mechanism itself, or cannot be written.
        """
        now, folder = self.now, Path(folder)
        if now.diagnosis is not None:
            steps = tuple(rung.step for rung in self.rungs)
            return write_history(History(steps, now.diagnosis), folder)
        refuse_own(now.fit.mechanism, folder)
        return write_all(folder, model_files(now.fit))

    def table(self) -> list[list[str]]:
        """The ladder: the change, and every joint's held-out error."""
        joints = self.rungs[0].fit.motion.independent
        rungs = ([r.name, *(error_text(r.errors.get(j)) for j in joints)] for r in self.rungs)
        return [["model", *joints], *rungs]

    def _with(self, now: ModelStep) -> Exploration:
        """Return the same model with more known of it."""
        return replace(self, rungs=(*self.rungs[:-1], now))

    def _extended(
        self, mechanism: Mechanism, start: Point, progress: Progress | None,
        added: tuple[Effect, ...] = (), removed: tuple[Effect, ...] = (),
    ) -> Exploration:  # fmt: skip
        fit = identify(  # least squares throughout, as the prediction has it
            mechanism, self.fit.motion, start=start, estimator="least-squares", progress=progress
        )
        step = ModelStep(added, removed, fit)
        return replace(self, rungs=(*self.rungs, step), before=replace(self, contest=None))

    def __str__(self) -> str:
        return "\n".join(table(self.table(), ""))

    __repr__ = __str__
