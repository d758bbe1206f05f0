"""A ladder of models tried by hand, and the predicted fall of the held-out error.

Of every effect, before anything is refitted:

    fall = 1 − L′ / L

with the left-out squares L of all joints now and L′ with the effect, in the weights by which a
diagnosis judges, from `PartialRegression`: exact for effects that are linear in their unknowns. It
judges nothing.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ident.diagnosis import Diagnosis, diagnose
from ident.diagnosis.candidates import Contest, candidates_of, possible
from ident.diagnosis.found_curves import FoundCurve
from ident.diagnosis.grow import Step
from ident.diagnosis.result import Law, announced_errors, errors_of
from ident.diagnosis.search import Search
from ident.diagnosis.selection import Evidence, Ranking, as_good, rank, simplicity
from ident.diagnosis.unobservable import invisible, unsupported
from ident.display import Displayed, Progress, no_progress, render
from ident.effects import KINDS, Effect
from ident.equations.unknowns import Point
from ident.errors import FitError, one_of
from ident.fit import Fit, identify
from ident.information.blocks import Error
from ident.information.evidence import RIVAL, Chance, credible
from ident.log import Log
from ident.mechanism import Mechanism
from ident.motion import Motion, complete

File = str | os.PathLike[str]
Logs = Log | File | Sequence[Log | File]
LEAST_GAIN = 0.01  # work: of the held-out squares: a shape that gains less is not refined


@dataclass(frozen=True, eq=False)
class PredictedGain:
    """Change of the held-out error by one effect, predicted or present.

    Attributes:
        effect: which; present: whether it is in the model, with an unknown in it.
        fall: of the held-out squares, as a share: what adding it would take away, or what it takes
            away now. None where that cannot be said.
        joints: whose errors it lowers, most first; before, after: the held-out error of the first
            of them without it and with it.
        gain: fall of the squares as a diagnosis weighs them; below zero of one whose values no such
            effect can have. z: its standard errors.
        shape: of a search, from which a refit sets out.
        why: it cannot be seen in this data, or should not be in the model; "" for most.
    """

    effect: Effect
    present: bool = False
    fall: float | None = None
    joints: tuple[str, ...] = ()
    before: Error | None = None
    after: Error | None = None
    gain: float = 0.0
    z: float = 0.0
    shape: Mapping[str, float] = field(default_factory=dict)
    why: str = ""

    @property
    def label(self) -> str:
        """Label of the effect, as commands take it."""
        return self.effect.label

    @property
    def sure(self) -> bool:
        """Whether the error falls by more than chance makes it, with values that can be."""
        possible = self.fall is not None and (self.present or self.gain >= 0)
        return credible(self.z, RIVAL, possible=possible)


def rows_of(
    fit: Fit, effects: Sequence[Effect] = (), progress: Progress | None = None,
    earlier: Contest | None = None,
) -> Contest:  # fmt: skip
    """Return the rows of a fit with the columns of effects; an `earlier` model's are used again."""
    return Contest.of(fit, effects, progress or no_progress, curved=False, earlier=earlier)


def simplest_first(first: Ranking, every: Sequence[Evidence]) -> list[Evidence]:
    """Return what explains most first; of what explains the same part as well, the effect with the
    fewest numbers, and of these the one that the library has first.
    """
    place = {kind: i for i, kind in enumerate(KINDS)}
    ordered: list[Evidence] = []
    remaining = sorted(
        every, key=lambda candidate: -(candidate.gain if candidate.sensible else -1.0)
    )
    while remaining:
        best = remaining[0]
        sound = [candidate for candidate in remaining if candidate is best or candidate.sensible]
        equal = as_good(best, sound, first.contest)
        best = min(equal, key=lambda e: (*simplicity(e)[:3], place.get(e.effect.kind, len(place))))
        ordered.append(best)
        remaining.remove(best)
    return ordered


def predicted_gains(contest: Contest) -> tuple[PredictedGain, ...]:
    """Return all effects that could be missing, then those of the model; each part best first."""
    fit, regression = contest.fit, contest.regression
    every, independent = possible(fit.mechanism, fit.motion), fit.motion.independent
    chance = Chance({}, {}, contest.decision.alpha, LEAST_GAIN)
    first = rank(contest, curved=False, chance=chance)
    hidden = {candidate.effect.label: candidate.why for candidate in invisible(first)}
    errors, losses = errors_of(fit), regression.losses.sum(axis=0)
    total = max(float(losses.sum()), 1e-300)
    open_ = []
    shown = [candidate for candidate in first.every if candidate.effect.label not in hidden]
    for candidate in simplest_first(first, shown):
        remaining = candidate.refit.loss.sum(axis=0)
        lowered = sorted(candidate.refit.affected_coordinates, key=lambda u: -candidate.refit.by[u])
        joint = independent[candidate.coordinate]
        open_.append(
            PredictedGain(
                candidate.effect, False, 1 - float(remaining.sum()) / total,
                tuple(independent[u] for u in lowered), errors[joint],
                announced_errors(errors, losses, remaining)[joint],
                candidate.gain if candidate.sensible else -1.0, float(candidate.z), candidate.shape,
            )
        )  # fmt: skip
    given = [effect.label for effect in fit.mechanism.effects]
    lead = Search(contest, given, no_progress).leader_first(first)
    open_.sort(key=lambda candidate: candidate.label != lead)
    shut = [PredictedGain(e, why=hidden[e.label]) for e in every if e.label in hidden]
    doubts = {x.effect.label: x.why for x in unsupported(first)}
    present = []
    for effect, places in fit.columns.effects:
        places_of_effect = np.array([p for p in places if p >= 0], dtype=int)
        if not len(places_of_effect):
            continue
        present_gain = PredictedGain(effect, True, why=doubts.get(effect.label, ""))
        if not effect.corrects:  # a correction is undone by another motion, not by a column
            bare = regression.without(places_of_effect).losses.sum(axis=0)
            without = announced_errors(errors, losses, bare)
            joint = max(errors, key=lambda name: without[name].rms / (errors[name].rms or 1.0))
            fall = 1 - total / max(float(bare.sum()), 1e-300)
            present_gain = replace(
                present_gain, fall=fall, joints=(joint,), before=without[joint], after=errors[joint]
            )
        present.append(present_gain)
    return (*open_, *shut, *sorted(present, key=lambda candidate: -(candidate.fall or 0.0)))


@dataclass(frozen=True, eq=False, repr=False)
class Exploration(Displayed):
    """Models tried one after the other. Each verb returns a new one; `before` is the way back.

    Attributes:
        rungs: from the model that was given to the present one, all fitted.
        candidates: predicted gain of every effect beside the present model; none before `screened`.
        diagnosis: of the present model; None before `judged`.
        before: what it was before the last change; None at the beginning.
        refused: labels of laws and curves that are not offered again.
        contest: columns of all effects, made for the model that was screened last.
    """

    rungs: tuple[Step, ...]
    candidates: tuple[PredictedGain, ...] = ()
    diagnosis: Diagnosis | None = None
    before: Exploration | None = None
    refused: frozenset[str] = frozenset()
    contest: Contest | None = None

    @classmethod
    def of(
        cls, mechanism: Mechanism, log: Motion | Logs, progress: Progress | None = None
    ) -> Exploration:
        """Fit the mechanism as it is given to a motion, or to logs that are completed: the first
        rung; progress is reported.

        Raises:
            IdentError: for a log that does not fit the mechanism, or without equations.
        """
        motion = log if isinstance(log, Motion) else complete(mechanism, log)
        fit = identify(mechanism, motion, estimator="least-squares", progress=progress)
        return cls((Step((), (), {}, fit, errors_of(fit)),))

    @property
    def now(self) -> Step:
        """The present rung."""
        return self.rungs[-1]

    @property
    def fit(self) -> Fit:
        """Fit of the present model."""
        return fit_of(self.now)

    @property
    def mechanism(self) -> Mechanism:
        """The present model."""
        return self.fit.mechanism

    @property
    def offered(self) -> tuple[Law | FoundCurve, ...]:
        """Laws and curves that the diagnosis of the present model found and nobody refused."""
        d = self.diagnosis
        every: tuple[Law | FoundCurve, ...] = () if d is None else (*d.laws, *d.curves)
        return tuple(law for law in every if law.effect.label not in self.refused)

    @property
    def first(self) -> PredictedGain | None:
        """The effect that surely lowers the error most; None where there is none."""
        return next((x for x in self.candidates if x.sure and not x.present), None)

    def effect(self, label: str) -> Effect | str:
        """Return the effect with a label among what is announced or offered; else the label."""
        every = (offer.effect for offer in (*self.offered, *self.candidates))
        return next((effect for effect in every if effect.label == label), label)

    def refuse(self, label: str) -> Exploration:
        """Leave out the offer of a law or a curve with a label.

        Raises:
            FitError: if it is not offered.
        """
        labels = [law.effect.label for law in self.offered]
        if label not in labels:
            raise FitError(f"'{label}' is not offered; {one_of(label, labels)}")
        return replace(self, refused=self.refused | {label}, before=self._past)

    def screened(self, progress: Progress | None = None) -> Exploration:
        """With the fall of error announced for every effect of the library; reports progress."""
        if self.candidates:
            return self
        contest = rows_of(self.fit, candidates_of(self.fit), progress, self.contest)
        return replace(self, candidates=predicted_gains(contest), contest=contest)

    def with_effect(
        self, effect: str | Effect | Sequence[str | Effect], progress: Progress | None = None
    ) -> Exploration:
        """With one more effect in the model, or several on one rung, everything refitted.

        Args:
            effect: `kind:joint[,joint]`, `kind` alone for all its joints, or an effect; or several.
            progress: called with (what is being done, share done), as by the other verbs; what it
                raises stops the work.

        Raises:
            IdentError: for one that the mechanism cannot have, or has already.
        """
        old = mechanism = self.mechanism
        for added in [effect] if isinstance(effect, str | Effect) else effect:
            if isinstance(added, str):
                mechanism = mechanism.with_effect(added)
            else:
                mechanism = mechanism + added
        before = {id(present) for present in old.effects}
        new = tuple(e for e in mechanism.effects if id(e) not in before)
        searched = {x.label: x.shape for x in self.candidates if not x.present}
        values = dict(self.fit.point.values)
        for added in new:
            shape = searched.get(added.label, {})
            names = zip(added.names[len(added.unknowns) :], added.shapes, strict=True)
            values |= {full: shape[s.name] for full, s in names if s.name in shape}
        start = Point(self.fit.point.pi, values)
        return self._extended(mechanism, start, progress, added=new)

    def without(self, label: str, progress: Progress | None = None) -> Exploration:
        """With the effect of a label less, everything refitted; progress is reported.

        Raises:
            MechanismError: if the model has no such effect.
        """
        mechanism = self.mechanism.without(label)
        removed = next(e for e in self.mechanism.effects if e.label == label)
        return self._extended(mechanism, self.fit.point, progress, removed=(removed,))

    def at(self, rung: int) -> Exploration:
        """Back to an earlier rung, 0 the model as given, with all that was known of it.

        Raises:
            FitError: if there is no such rung.
        """
        if not 0 <= rung < len(self.rungs):
            valid = one_of(str(rung), map(str, range(len(self.rungs))))
            raise FitError(f"there is no rung {rung}; {valid}")
        past = self
        while past.now is not self.rungs[rung]:
            assert past.before is not None
            past = past.before
        return self if past is self else replace(past, before=self._past, contest=self.contest)

    @property
    def undone(self) -> Exploration:
        """As before the last change; at the beginning, as it is."""
        return self if self.before is None else replace(self.before, contest=self.contest)

    def judged(self, progress: Progress | None = None) -> Exploration:
        """With the diagnosis of the present model: whether a fall counts. Reports progress."""
        if self.diagnosis is not None:
            return self
        return replace(self, diagnosis=diagnose(self.fit, progress=progress))

    def write(self, folder: str | Path) -> list[Path]:
        """Write the present mechanism's folder with its fit, and its diagnosis, where there is one.

        Returns:
            The files written, all of them or none.

        Raises:
            IdentError: if it is the folder of the mechanism itself, or cannot be written.
        """
        written: list[Path] = render(self, "files", folder)
        return written

    def table(self) -> list[list[str]]:
        """Return the ladder: the change, and every joint's held-out error."""
        rows: list[list[str]] = render(self, "ladder")
        return rows

    @property
    def _past(self) -> Exploration:
        return replace(self, contest=None)  # one contest is enough in memory

    def _extended(
        self, mechanism: Mechanism, start: Point, progress: Progress | None,
        added: tuple[Effect, ...] = (), removed: tuple[Effect, ...] = (),
    ) -> Exploration:  # fmt: skip
        fit = identify(  # least squares throughout, as the prediction has it
            mechanism, self.fit.motion, start=start, estimator="least-squares", progress=progress
        )
        step = Step(added, removed, {}, fit, errors_of(fit))
        return Exploration(
            (*self.rungs, step), before=self._past, refused=self.refused, contest=self.contest
        )


def fit_of(rung: Step) -> Fit:
    """Return the fit of a rung of an exploration."""
    assert rung.fit is not None
    return rung.fit
