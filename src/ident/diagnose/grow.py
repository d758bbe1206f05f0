"""The verb `grow`: add the best effect, refit, repeat until nothing is missing.

After every addition the model is cut back: an effect that the new one has made superfluous goes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from markupsafe import Markup

from ident.diagnose.diagnose import judge, told_of
from ident.diagnose.diagnosis import Diagnosis
from ident.diagnose.explanation import errors_of, explain
from ident.diagnose.ladder import ladder_rows, ladder_text, rung
from ident.diagnose.output import write_history
from ident.diagnose.plots import plot_ladder
from ident.diagnose.support import unsupported
from ident.diagnose.tables import verdict_line
from ident.effects import Effect
from ident.equations.point import Point
from ident.fit import Fit, identify
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.progress import Progress
from ident.residual.error import Error
from ident.show.charts import Chart
from ident.show.html import Shown, strong, table

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

    def __str__(self) -> str:
        return rung(self, list(self.errors))

    __repr__ = __str__


@dataclass(frozen=True, eq=False)
class History(Shown):
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

    def table(self) -> list[list[str]]:
        """The ladder as cells: effect, held-out error a joint, fall, rivals; the head first."""
        return ladder_rows(self)

    def plot(self) -> Chart:
        """Held-out error of every joint, rung by rung."""
        return plot_ladder(self)

    def write(self, folder: str | Path) -> list[Path]:
        """The grown mechanism's folder, with its last fit, diagnosis and a report.

        Raises:
            IdentError: if the folder is the mechanism's own, or cannot be written.
        """
        return write_history(self, folder)

    def __str__(self) -> str:
        return ladder_text(self)

    __repr__ = __str__

    def _blocks(self) -> tuple[Markup, ...]:
        rows = table(self.table(), "Held-out error, rung by rung", tied=False)
        return strong(verdict_line(self.diagnosis)), rows


def grow(
    mechanism: Mechanism,
    motion: Motion,
    *,
    validate: Motion | None = None,
    seed: int = 0,
    progress: Progress | None = None,
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
    fit = _fitted(mechanism, motion, validate, progress=progress)
    given = {effect.label for effect in mechanism.effects}
    steps = [Step(None, (), (), fit, 0.0, errors_of(fit))]
    told = step or (lambda rung: None)
    told(steps[0])
    gone: set[str] = set()
    while True:
        judged = judge(fit, seed=seed, without=gone, progress=progress)
        idle = [
            each.effect for each in unsupported(fit, judged.table, judged.screen)
            if each.effect.label not in given | gone | _just(steps)
        ]  # fmt: skip
        if idle:
            fit = _without(fit, idle, validate)
            gone |= {effect.label for effect in idle}
            steps.append(Step(None, tuple(idle), (), fit, 0.0, errors_of(fit)))
            told(steps[-1])
            continue
        best = judged.choice.best
        if best is None or len(steps) > MOST:
            return History(tuple(steps), told_of(judged, progress))
        rivals = tuple(each.candidate.effect for each in judged.choice.rivals)
        found = explain(fit, best, rivals)
        fit = found.fit
        if validate is not None:
            fit = _fitted(fit.mechanism, motion, validate, start=fit.point)
        steps.append(Step(found.effect, (), rivals, fit, found.fall, errors_of(fit)))
        told(steps[-1])


def _fitted(
    mechanism: Mechanism,
    motion: Motion,
    validate: Motion | None,
    start: Point | None = None,
    progress: Progress | None = None,
) -> Fit:
    """Least squares throughout, as the screen that announces an effect's fall."""
    return identify(
        mechanism, motion, validate=validate, start=start, estimator="least-squares",
        progress=progress,
    )  # fmt: skip


def _just(steps: list[Step]) -> set[str]:
    """What was added last: the next addition may be what it waits for."""
    return {steps[-1].added.label} if steps[-1].added else set()


def _without(fit: Fit, idle: list[Effect], validate: Motion | None) -> Fit:
    """The fit refitted without effects that nothing speaks for any more."""
    mechanism = fit.mechanism
    for effect in idle:
        mechanism = mechanism.without(effect.label)
    return _fitted(mechanism, fit.motion, validate, start=fit.point)
