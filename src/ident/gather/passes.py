"""Passes over all portions: one where the equations are linear, a few where they are not."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ident.errors import FitError
from ident.fit.accumulate import Cell
from ident.fit.estimate import Estimate
from ident.fit.identify import estimated
from ident.fit.regression import Regression
from ident.gather.checkpoint import Checkpoint, State
from ident.gather.crew import Crew
from ident.gather.excerpt import Excerpt
from ident.gather.joined import Joined
from ident.gather.plan import Plan
from ident.gather.portion import Portioned, cells_of
from ident.gather.shapes import PASSES, Step, after
from ident.gather.stack import finished


@dataclass(frozen=True, eq=False)
class Passed:
    """What all passes have given.

    Attributes:
        plan: at the last pass' point.
        regression, estimate: of that pass.
        notes: what portions have said, and what there is to know of the passes.
        worked, resumed: portions worked in this run, and those found in a checkpoint.
    """

    plan: Plan
    regression: Regression
    estimate: Estimate
    notes: tuple[str, ...]
    worked: int
    resumed: int


def passes(plan: Plan, some: Excerpt, crew: Crew, kept: Checkpoint | None) -> Passed:
    """Passes until no shape moves.

    Args:
        plan: at the point of the first pass.
        some: the excerpt that stands for the motion.
        crew: who works.
        kept: where it is kept what is done.

    Raises:
        IdentError: if no log is left.
    """
    state = State(0, Step(plan.point))
    notes: list[str] = []
    resumed = worked = 0
    if kept is not None and (found := kept.read()) is not None:
        state = found
        crew.broken.update(found.broken)
        resumed = found.absorbed
        notes.append(
            f"went on from {kept.file}: pass {found.passed + 1}, {resumed} portions were done"
        )
    elif kept is not None and kept.other:
        notes.append(f"{kept.file}: of another mechanism, log, settings or version; not used")
    linear = all(effect.linear for effect in plan.mechanism.effects)
    while True:
        here = plan.at(state.step.point)
        cells, left, said, count = _pass(here, state, crew, kept)
        worked += count
        notes += said
        regression = Regression(plan.mechanism, some, here.point, plan.columns, cells, left=left)
        found_ = estimated(regression)
        step = state.step if linear else after(regression, found_, state.step)
        if linear or step.rests or state.passed + 1 == PASSES:
            break
        state = State(state.passed + 1, step, broken=dict(crew.broken))
        if kept is not None:
            kept.write(state)
    if not linear:
        how = "and rest" if step.rests else f"and still move predictions by {step.moves:.2g} ±"
        notes.append(
            f"what is not linear was settled on the excerpt and refined in {state.passed + 1} "
            f"passes over all samples, {how}"
        )
    return Passed(here, regression, found_, tuple(dict.fromkeys(notes)), worked, resumed)


def _pass(
    plan: Plan, state: State, crew: Crew, kept: Checkpoint | None
) -> tuple[list[Cell], list[Cell], list[str], int]:
    """The cells of all portions at the plan's point, those of stacks without their multipliers,
    what was said of them, and how many were worked.
    """
    portions = list(plan.portions())
    left = portions[state.absorbed :]
    joined = Joined(state.cells, state.absorbed, state.stretches)
    names = [plan.parts[portion.log].name for portion in left]
    said: dict[int, tuple[str, ...]] = {}
    what = "equations" if not state.passed else f"equations, pass {state.passed + 1}"
    done: Portioned | None
    for index, done in crew.over(cells_of, left, plan, names, what):
        left_over = (done.portion.log, done.stretch) if done and done.stretch else None
        joined.add(state.absorbed + index, done.cells if done else (), left_over)
        said[index] = done.notes if done else ()
        if kept is not None and kept.due(joined.absorbed):
            kept.write(
                replace(
                    state, absorbed=joined.absorbed, cells=joined.without(()),
                    stretches=dict(joined.stretches), broken=dict(crew.broken),
                )
            )  # fmt: skip
    out = [i for i, part in enumerate(plan.parts) if part.name in crew.broken]
    found = joined.without(out)
    if not found:
        cut = plan.band.cutoff
        why = "; ".join(f"{name}: {each}" for name, each in list(crew.broken.items())[:1])
        raise FitError(
            f"{plan.mechanism.name}: no equations in {len(plan.parts)} log(s)"
            + (f" filtered at {cut:.3g} Hz" if cut else "")
            + f"; {why or 'give a longer log or a higher --cutoff'}"
        )
    stacks = [
        cell
        for log, stretch in sorted(joined.stretches.items())
        if log not in out
        for cell in finished(plan, log, stretch)
    ]
    return found, stacks, [note for index in sorted(said) for note in said[index]], joined.worked
