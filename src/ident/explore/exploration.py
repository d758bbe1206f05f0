"""The noun: a ladder of models tried by hand, and what each further effect would do."""

from __future__ import annotations

import html
from dataclasses import dataclass, field, replace
from pathlib import Path

from ident.diagnose import diagnose
from ident.effects import Effect
from ident.equations.point import Point
from ident.errors import FitError, one_of
from ident.explore.announce import Announced, announce
from ident.explore.ground import Ground
from ident.explore.kept import Store
from ident.explore.output import write_exploration
from ident.explore.rung import Rung
from ident.explore.tables import ladder_rows
from ident.fit import Fit, identify
from ident.mechanism import Mechanism
from ident.motion import Motion
from ident.progress import Told
from ident.tables import table


@dataclass(frozen=True, eq=False)
class Exploration:
    """Models tried one after the other. Each verb returns a new one; `before` is the way back.

    Attributes:
        rungs: from the model that was given to the present one.
        before: what it was before the last change; None at the beginning.
    """

    rungs: tuple[Rung, ...]
    before: Exploration | None = None
    store: Store = field(default_factory=Store, repr=False)
    ground: Ground | None = field(default=None, repr=False)

    @classmethod
    def of(cls, mechanism: Mechanism, motion: Motion, progress: Told | None = None) -> Exploration:
        """The first rung: the model as it is given.

        Args:
            mechanism: the model.
            motion: what it is fitted to.
            progress: is told of every step, with the share that is done.

        Raises:
            FitError: if there are no equations to identify with.
        """
        fit = identify(mechanism, motion, estimator="least-squares", progress=progress)
        return cls((Rung(None, None, fit),))

    @property
    def now(self) -> Rung:
        """The present model."""
        return self.rungs[-1]

    @property
    def fit(self) -> Fit:
        """Of the present model."""
        return self.now.fit

    @property
    def mechanism(self) -> Mechanism:
        """The present model."""
        return self.fit.mechanism

    @property
    def candidates(self) -> tuple[Announced, ...]:
        """What is announced for every effect; empty before `screened`."""
        return self.now.candidates or ()

    def screened(self, progress: Told | None = None) -> Exploration:
        """With the fall of error announced for every effect of the library.

        Args:
            progress: called with (what is being done, share done); what it raises stops the work.
        """
        if self.now.candidates is not None:
            return self
        ground = self._ground()
        return self._with(replace(self.now, candidates=announce(ground, progress)), ground)

    def with_effect(self, effect: str | Effect, progress: Told | None = None) -> Exploration:
        """With one more effect in the model, everything refitted.

        Args:
            effect: `kind:joint[,joint]`, or an effect.
            progress: called with (what is being done, share done).

        Raises:
            IdentError: for one that the mechanism cannot have, or has already.
        """
        old = self.mechanism
        mechanism = old.with_effect(effect) if isinstance(effect, str) else old + effect
        new = [e for e in mechanism.effects if not any(e is own for own in old.effects)]
        if len(new) != 1:
            raise FitError(
                f"'{effect}' names {len(new)} effects; add one at a time: "
                f"{', '.join(each.label for each in new[:4])}"
            )
        told = self._announced(new[0].label, present=False)
        start = self.fit.point
        if told is not None and told.shape:
            names = zip(new[0].names[len(new[0].unknowns) :], new[0].shapes, strict=True)
            shape = {full: told.shape[s.name] for full, s in names if s.name in told.shape}
            start = Point(start.pi, {**start.values, **shape})
        fit = _fitted(mechanism, self.fit, start, progress)
        return self._grown(fit, told.fall if told else None, added=new[0])

    def without(self, label: str, progress: Told | None = None) -> Exploration:
        """With one effect less, everything refitted.

        Args:
            label: of the effect, as `coulomb:elbow`.
            progress: is told of every step.

        Raises:
            MechanismError: if the model has no such effect.
        """
        mechanism = self.mechanism.without(label)
        gone = next(e for e in self.mechanism.effects if e.label == label)
        told = self._announced(label, present=True)
        fit = _fitted(mechanism, self.fit, self.fit.point, progress)
        announced = None
        if told is not None and told.fall is not None and told.fall < 1:
            announced = -told.fall / (1 - told.fall)  # 1 − loss₀/loss₁ seen from the other side
        return self._grown(fit, announced, removed=gone)

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
        return replace(self, rungs=self.rungs[: rung + 1], before=self, ground=None)

    @property
    def undone(self) -> Exploration:
        """As before the last change; at the beginning, as it is."""
        return self if self.before is None else self.before

    def judged(self, progress: Told | None = None) -> Exploration:
        """With the diagnosis of the present model: whether a fall means anything.

        Args:
            progress: is told of every step.
        """
        if self.now.diagnosis is not None:
            return self
        found = diagnose(self.fit, progress=progress)
        return self._with(replace(self.now, diagnosis=found), self.ground)

    def write(self, folder: str | Path) -> list[Path]:
        """The present mechanism's folder with its fit; with its diagnosis, where there is one.

        Returns:
            The files written, all of them or none.

        Raises:
            IdentError: if it is the folder of the mechanism itself, or cannot be written.
        """
        return write_exploration(self.rungs, folder)

    def table(self) -> list[list[str]]:
        """The ladder as cells, the head first."""
        return ladder_rows(self.rungs)

    def _announced(self, label: str, *, present: bool) -> Announced | None:
        found = (x for x in self.candidates if x.label == label and x.present == present)
        return next(found, None)

    def _ground(self) -> Ground:
        return self.ground or Ground.of(self.fit, self.store)

    def _with(self, now: Rung, ground: Ground | None) -> Exploration:
        """The same model, with more known of it."""
        return replace(self, rungs=(*self.rungs[:-1], now), ground=ground)

    def _grown(
        self, fit: Fit, announced: float | None, added: Effect | None = None,
        removed: Effect | None = None,
    ) -> Exploration:  # fmt: skip
        ground = Ground.of(fit, self.store)
        delivered = self._ground().delivered(ground)
        rung = Rung.after(
            self.now, fit, added=added, removed=removed, announced=announced, delivered=delivered
        )
        return replace(self, rungs=(*self.rungs, rung), before=self, ground=ground)

    def __str__(self) -> str:
        return "\n".join(table(self.table(), ""))

    __repr__ = __str__

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(str(self))}</pre>"


def _fitted(mechanism: Mechanism, old: Fit, start: Point, progress: Told | None) -> Fit:
    """Least squares throughout, as the announcement has it."""
    return identify(
        mechanism, old.motion, start=start, estimator="least-squares", progress=progress
    )
