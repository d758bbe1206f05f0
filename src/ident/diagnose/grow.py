"""The verb `grow`: add the best effect, refit, repeat until nothing is missing.

After every addition the model is cut back: an effect that the new one has made superfluous goes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ident.diagnose.diagnose import diagnose
from ident.diagnose.diagnosis import Diagnosis
from ident.diagnose.explanation import errors_of
from ident.effects import Effect
from ident.fit import Fit, identify
from ident.fit.score import Error
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.progress import Told

MOST = 40  # effects added, lest two take turns for ever


@dataclass(frozen=True, eq=False)
class Step:
    """One rung of the ladder.

    Attributes:
        added, removed: effects, none on the first rung.
        rivals: that could as well have been added.
        fit: everything refitted.
        fall: of the held-out weighted sum of squares, as a share.
        errors: held out, by joint.
    """

    added: Effect | None
    removed: tuple[Effect, ...]
    rivals: tuple[Effect, ...]
    fit: Fit
    fall: float
    errors: dict[str, Error]


@dataclass(frozen=True, eq=False)
class History:
    """How a model grew. Made by `ident.grow`.

    Attributes:
        steps: the ladder, from the model that was given.
        diagnosis: of the last model.
    """

    steps: tuple[Step, ...]
    diagnosis: Diagnosis

    @property
    def fits(self) -> tuple[Fit, ...]:
        """One a rung."""
        return tuple(step.fit for step in self.steps)

    @property
    def fit(self) -> Fit:
        """The last."""
        return self.steps[-1].fit

    @property
    def mechanism(self) -> Mechanism:
        """The grown mechanism."""
        return self.fit.mechanism

    @property
    def added(self) -> tuple[Effect, ...]:
        """Effects that were added and are still there, in order."""
        present = {effect.label for effect in self.mechanism.effects}
        return tuple(s.added for s in self.steps if s.added and s.added.label in present)


def grow(
    mechanism: Mechanism,
    motion: Motion,
    *,
    validate: Motion | None = None,
    seed: int = 0,
    progress: Told | None = None,
    step: Callable[[Step], None] | None = None,
) -> History:
    """Adds the best effect, refits, and repeats until the verdict is not `missing`.

    Args:
        mechanism: to start from.
        motion: that is fitted.
        validate: of other logs, on which errors are reported.
        seed: of the clean logs' noise.
        progress: called with (what is being done, share done).
        step: called with every rung as it is reached.
    """
    fit = identify(mechanism, motion, validate=validate, progress=progress)
    steps = [Step(None, (), (), fit, 0.0, errors_of(fit))]
    told = step or (lambda rung: None)
    told(steps[0])
    while True:
        found = diagnose(fit, seed=seed, progress=progress)
        if found.best is None or len(steps) > MOST:
            return History(tuple(steps), found)
        best = found.candidates[0]
        fit = best.fit
        if validate is not None:
            fit = identify(fit.mechanism, motion, validate=validate, start=fit.point)
        steps.append(Step(best.effect, (), best.rivals, fit, best.fall, errors_of(fit)))
        told(steps[-1])
