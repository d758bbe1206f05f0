"""The verb `grow`: the set of effects that explains most, searched, fitted, and searched again.

One pass makes the rows of the model and of all candidates, on which a set is searched. The set is
then fitted once; if at the new working point the search finds another set, it goes on from there.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ident.diagnosis.candidates import (
    ColumnStore,
    Contest,
    OnProgress,
    candidates_of,
)
from ident.diagnosis.diagnosis import (
    Decision,
    Diagnosis,
    announced_errors,
    concluded,
    errors_of,
    fall_of,
    started,
)
from ident.diagnosis.null import noise
from ident.diagnosis.search import EffectSet, Search, reweighted
from ident.display import Displayed, Plotted, render
from ident.effects import Effect
from ident.fit import Fit, identify
from ident.information.blocks import Error
from ident.information.hypotheses import PartialRegression
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion

ROUNDS = 4  # fits, lest shapes that move with the working point take turns for ever


@dataclass(frozen=True, eq=False, repr=False)
class Step(Displayed):
    """One rung of the ladder.

    Attributes:
        added, removed: effects, none on the first rung.
        rivals: that could as well have been added.
        fit: everything refitted; None where the errors are announced by the search.
        fall: of the held-out weighted sum of squares, as a share.
        errors: held out, by joint.
    """

    added: Effect | None
    removed: tuple[Effect, ...]
    rivals: tuple[Effect, ...]
    fit: Fit | None
    fall: float
    errors: dict[str, Error]


@dataclass(frozen=True, eq=False, repr=False)
class History(Plotted):
    """The ladder of a growing model, from `ident.grow`.

    Attributes:
        steps: the ladder, from the model that was given.
        diagnosis: of the last model.
    """

    steps: tuple[Step, ...]
    diagnosis: Diagnosis

    @property
    def fits(self) -> tuple[Fit, ...]:
        """Return the fits of the rungs that were fitted, the first and the last among them."""
        return tuple(step.fit for step in self.steps if step.fit is not None)

    @property
    def fit(self) -> Fit:
        """The last."""
        return self.fits[-1]

    @property
    def mechanism(self) -> Mechanism:
        """The grown mechanism."""
        return self.fit.mechanism

    @property
    def added(self) -> tuple[Effect, ...]:
        """Effects that were added and are still there, in order."""
        present = {effect.label for effect in self.mechanism.effects}
        every = (step.added for step in self.steps if step.added is not None)
        return tuple({e.label: e for e in every if e.label in present}.values())

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
    """Adds the effects that explain most until no effect is missing, and refits.

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
    given = frozenset(effect.label for effect in mechanism.effects if not effect.known)
    # least squares throughout, as the rows that announce an effect's fall
    fit = identify(mechanism, motion, validate=validate, estimator="least-squares")
    steps = [Step(None, (), (), fit, 0.0, errors_of(fit))]

    def reached(rungs: Collection[Step]) -> None:
        steps.extend(rungs)
        if step:
            for each in rungs:
                step(each)

    if step:
        step(steps[0])
    visited: set[frozenset[str]] = set()
    for number in range(ROUNDS):
        # curves judge what is left in the end, the search needs none
        contest = Contest.of(fit, candidates_of(fit), on_progress, curved=number > 0)
        draws = noise(contest, seed)
        search = Search(contest, draws, decision, seed, given, on_progress, visited)
        found = search.run()
        if found.labels == search.start.labels:
            break
        on_progress("refitting", 0.7)
        model = fit.mechanism
        removed = tuple(e for e in model.effects
                        if e.label in search.start.labels - found.labels)  # fmt: skip
        for effect in removed:
            model = model.without(effect.label)
        new = [each for each in found.members if each.evidence is not None]
        start = started(fit.point, fit, [each.evidence for each in new if each.evidence])
        for each in new:
            model = model + each.effect
        again = identify(model, motion, validate=validate, start=start, estimator="least-squares")
        if not better(errors_of(fit), errors_of(again)):
            break
        reached(ladder(search.start, found, removed, fit, again))
        fit = again
    else:
        number = 0
    if number == 0 or contest.fit is not fit:
        contest = Contest.of(fit, candidates_of(fit), on_progress)
        draws = noise(contest, seed)
    return History(tuple(steps), concluded(contest, draws, decision, seed, on_progress))


def better(before: Mapping[str, Error], after: Mapping[str, Error]) -> bool:
    """Return whether a fit has the larger held-out log density, all joints together."""
    return sum(np.log(max(after[n].rms, 1e-300) / max(before[n].rms, 1e-300)) for n in before) < 0


# --- the ladder --------------------------------------------------------------------------------


def ladder(
    start: EffectSet, found: EffectSet, removed: tuple[Effect, ...], before: Fit, after: Fit
) -> list[Step]:
    """A rung an effect, the one that explains most of what is left first; the last one fitted.

    Errors between are announced by the same regression, of all rows.
    """
    table = start.contest.table
    held = before.estimate.held
    prior = table.columns.prior_at(table.point.values)
    store = ColumnStore(table, table.informed, table.A, table.b - table.A[:, :, held] @ prior[held])
    new = [each for each in found.members if each.evidence is not None]
    columns = {}
    for each in new:
        assert each.evidence is not None
        shape = each.evidence.shape
        if each.effect.corrects:
            shape = {p.name: each.effect.values.get(p.name, 0.0) for p in each.effect.shapes}
        columns[each.effect.label] = store.add(each.effect, [shape])
    model, weight = start.contest.regression.model, start.contest.regression.weight
    regression = PartialRegression(store.parts(), model, weight)
    first = regression.losses.sum(axis=0) / regression.weight**2
    errors, rungs = errors_of(before), list[Step]()

    def announced(regression: PartialRegression) -> dict[str, Error]:
        now = regression.losses.sum(axis=0) / regression.weight**2
        return announced_errors(errors, first, now)

    last = errors
    if removed:
        gone = {effect.label for effect in removed}
        for each in start.members:
            if each.effect.label in gone:
                regression = regression.without(each.columns)
        now = announced(regression)
        rungs.append(Step(None, removed, (), None, fall_of(last, now), now))
        last = now
    while new:
        G = regression.gains([columns[each.effect.label] for each in new]).G
        steps = []
        for i in np.argsort(-G):  # of all steps the largest that raises no error
            richer = reweighted(regression.extended(columns[new[i].effect.label]))
            now = announced(richer)
            steps.append((fall_of(last, now), int(i), richer, now))
            if steps[-1][0] >= 0:
                break
        fall, i, regression, last = max(steps, key=lambda step: step[0])
        best = new.pop(i)
        equal = tuple(rival.effect for rival in best.rivals)
        rungs.append(Step(best.effect, (), equal, None, fall, last))
    last, fitted = rungs[-2].errors if len(rungs) > 1 else errors, errors_of(after)
    rungs[-1] = replace(rungs[-1], fit=after, fall=fall_of(last, fitted), errors=fitted)
    return rungs
