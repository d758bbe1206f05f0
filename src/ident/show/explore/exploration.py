"""The noun `Exploration`: a ladder of models tried by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ident.diagnosis import Diagnosis, History, diagnose
from ident.diagnosis.candidates import Contest, candidates_of
from ident.diagnosis.found_curves import FoundCurve
from ident.diagnosis.grow import Step
from ident.diagnosis.result import Law, errors_of
from ident.display import Displayed
from ident.effects import Effect
from ident.equations.unknowns import Point
from ident.errors import FitError, one_of
from ident.files import write_all
from ident.fit import Fit, identify
from ident.information.blocks import Error
from ident.mechanism import Mechanism
from ident.motion import Motion
from ident.progress import Progress
from ident.show.card import named
from ident.show.explore.predicted import PredictedGain, predicted_gains, rows_of
from ident.show.ladder import model_files, refuse_own
from ident.show.ladder import write as write_history
from ident.show.laws import curve_name, law_words
from ident.text import percent, table

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
