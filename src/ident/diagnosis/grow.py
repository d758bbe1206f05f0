"""The verb `grow`: the set of effects that explains most, added one by one and refitted.

Sets are searched on the rows of one fit alone (`selection`); then their effects are added to the
model one after the other, a rung of the ladder each. At the new working point the search is made
again, until it adds nothing; an effect that the others have made superfluous goes.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ident.diagnosis.candidates import OnProgress
from ident.diagnosis.diagnosis import (
    Decision,
    Diagnosis,
    Judged,
    concluded,
    errors_of,
    fall_of,
    judge,
    started,
)
from ident.display import Displayed, Plotted, render
from ident.effects import Effect
from ident.equations.unknowns import Point
from ident.fit import Fit, identify
from ident.information.blocks import Error
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion

ROUNDS = 12  # searches, lest two effects take turns for ever


@dataclass(frozen=True, eq=False, repr=False)
class Step(Displayed):
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


@dataclass(frozen=True, eq=False, repr=False)
class History(Plotted):
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
        rows: list[list[str]] = render(self, "ladder")
        return rows

    def write(self, folder: str | Path) -> list[Path]:
        """The grown mechanism's folder, with its last fit, diagnosis and a report.

        Raises:
            IdentError: if the folder is the mechanism's own, or cannot be written.
        """
        paths: list[Path] = render(self, "files", folder)
        return paths


def grow(
    mechanism: Mechanism,
    motion: Motion,
    *,
    validate: Motion | None = None,
    seed: int = 0,
    alpha: float = 0.01,
    material: float = 0.003,
    rival_se: float = 2.0,
    progress: OnProgress | None = None,
    step: Callable[[Step], None] | None = None,
) -> History:
    """Adds the effects that explain most, and refits, until no effect is missing.

    Args:
        mechanism: to start from.
        motion: that is fitted.
        validate: of other logs, on which errors are reported.
        seed, alpha, material, rival_se: as `diagnose` takes them.
        progress: called with (what is being done, share done).
        step: called with every rung as it is reached.
    """
    on_progress = progress or (lambda what, share: None)
    decision = Decision(alpha, material, rival_se)

    def fitted(model: Mechanism, start: Point | None = None) -> Fit:
        """Least squares throughout, as the rows that announce an effect's fall."""
        return identify(model, motion, validate=validate, start=start, estimator="least-squares")

    steps: list[Step] = []

    def reach(fit: Fit, added: Effect | None, removed: tuple[Effect, ...] = (),
              rivals: tuple[Effect, ...] = ()) -> Fit:  # fmt: skip
        errors = errors_of(fit)
        fall = fall_of(errors_of(steps[-1].fit), errors) if added else 0.0
        steps.append(Step(added, removed, rivals, fit, fall, errors))
        if step:
            step(steps[-1])
        return fit

    fit = reach(fitted(mechanism), None)
    given = {effect.label for effect in mechanism.effects}
    gone: set[str] = set()
    for _ in range(ROUNDS):
        judged = judge(fit, decision, seed, on_progress, without=gone, exchanging=True)
        idle = superfluous(judged, given)
        if idle is not None:
            gone.add(idle.label)
            fit = reach(fitted(fit.mechanism.without(idle.label), fit.point), None, (idle,))
            continue
        if not judged.selection.members:
            break
        for number, member in enumerate(judged.selection.members):
            found = member.evidence
            on_progress(f"adding {member.label}", number / len(judged.selection.members))
            start = started(fit.point, fit, [found])
            rivals = tuple(each.effect for each in member.rivals)
            fit = reach(fitted(fit.mechanism + found.effect, start), found.effect, (), rivals)
    else:
        judged = judge(fit, decision, seed, on_progress, without=gone)
    return History(tuple(steps), concluded(judged, on_progress))


def superfluous(judged: Judged, given: Collection[str]) -> Effect | None:
    """The added effect that brings least, if it brings no more than chance does; one at a time, for
    of two that stand for each other one is needed.
    """
    regression, fit = judged.contest.regression, judged.fit
    total = float(regression.loss.sum())
    shares: list[tuple[float, Effect]] = []
    for effect, places in fit.columns.effects:
        mine = np.array([p for p in places if p >= 0 and not fit.estimate.held[p]], dtype=int)
        if effect.label not in given and len(mine):
            share = float(regression.without(mine).loss.sum()) / total - 1
            shares.append((share, effect))
    share, least = min(shares, key=lambda each: each[0], default=(np.inf, None))
    return least if share < judged.selection.first.limit else None
