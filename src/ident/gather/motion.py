"""The motion of one portion of a log, as the whole log would have made it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ident.errors import MotionError, one_of
from ident.gather.plan import Part, Plan, Portion
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.motion import Experiment
from ident.motion.experiment import experiment_of
from ident.motion.measure import Signals, measure
from ident.motion.place import nearness, reduced, with_leverage
from ident.motion.rest import standstill


def experiment(plan: Plan, portion: Portion) -> tuple[Experiment | None, list[str]]:
    """The experiment of a portion with its margins, and what a person should know of it.

    None where no sample of it can be used.

    Args:
        plan: of all portions.
        portion: which one.

    Raises:
        LogError, MotionError: where `read_log` or `complete` would raise one.
    """
    part, mechanism = plan.parts[portion.log], plan.mechanism
    log = replace(part.survey.log.piece(portion.begin, portion.end), name=part.name)
    if part.decided is None:
        return _alone(plan, log)
    asked = {name for effect in mechanism.effects for name in effect.reads()}
    asked |= {name for name, count in part.survey.values.items() if count > 1}
    absent = [n for n in sorted(asked & {*log.columns}) if np.isfinite(log.columns[n]).sum() < 2]
    where = f"{part.name}: rows {portion.begin} to {portion.end - 1}"
    if absent:
        return None, [f"{where}: {absent[0]} is empty; they are left out"]
    signals = measure(mechanism, log, part.decided)
    if not signals.usable.any():
        return None, [f"{where}: no run at which all columns have samples; they are left out"]
    near = _near(mechanism, part, portion)
    e, _ = experiment_of(near, signals, plan.logged, plan.band, plan.smoothing, part.decided)
    if mechanism.closures:
        e, _ = with_leverage(mechanism, e, plan.independent)
        e = replace(e, usable=e.usable & (nearness(e) < part.largest))
    still = np.full(len(mechanism.joints), 1e-9) if part.still is None else part.still
    return (replace(e, still=still) if e.usable.any() else None), []


def needed(plan: Plan) -> list[str]:
    """Columns without which a log is none of this plan."""
    return [
        *(f"q.{name}" for name in plan.logged),
        *(f"tau.{name}" for name in plan.mechanism.driven),
    ]


def check_columns(plan: Plan, part: Part) -> None:
    """Refuse a log that lacks what the others have.

    Raises:
        MotionError: naming the column.
    """
    for name in needed(plan):
        if name not in part.survey.log.columns:
            raise MotionError(
                f"{part.name}: has no column '{name}', which the other logs have; "
                f"{one_of(name, part.survey.log.columns)}"
            )


def _alone(plan: Plan, log: Log) -> tuple[Experiment, list[str]]:
    """A log in one portion: what `complete` makes of it."""
    signals = measure(plan.mechanism, log)
    e, said = experiment_of(plan.mechanism, signals, plan.logged, plan.band, plan.smoothing)
    said = [*signals.notes, *said]
    if plan.mechanism.closures:
        e, _, more = reduced(plan.mechanism, e, plan.independent)
        said += more
    return replace(e, still=standstill(plan.mechanism, signals, e, plan.logged)), said


def _near(mechanism: Mechanism, part: Part, portion: Portion) -> Mechanism:
    """The mechanism assembled where the portion begins, on the branch on which the log arrives."""
    if part.anchors is None:
        return mechanism
    there = replace(mechanism, start=part.anchors[portion.number])
    there.__dict__["kinematics"] = mechanism.kinematics  # compiled functions, of no start
    return there


def excerpted(plan: Plan, signals: Signals) -> Experiment:
    """The experiment of a stretch of a log, which decides by itself.

    Raises:
        MotionError: where `complete` would raise one.
    """
    e, _ = experiment_of(plan.mechanism, signals, plan.logged, plan.band, plan.smoothing)
    return reduced(plan.mechanism, e, plan.independent)[0] if plan.mechanism.closures else e
