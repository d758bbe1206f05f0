"""From paths to a plan: every log is looked at, and what long logs decide is decided."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ident.errors import FitError, MotionError
from ident.gather.crew import Crew
from ident.gather.decide import Extremes, decided, extremes, logged_speeds, with_extremes
from ident.gather.motion import check_columns
from ident.gather.plan import Part, Plan
from ident.gather.survey import Survey, surveyed
from ident.log.folder import names_of
from ident.mechanism.mechanism import Mechanism


def looked_at(mechanism: Mechanism, paths: Sequence[Path], crew: Crew) -> list[Survey]:
    """The surveys of all logs that can be opened, under names that differ.

    Args:
        mechanism: whose logs they are.
        paths: of the logs.
        crew: who works.

    Raises:
        IdentError: if none can be opened, or the only one cannot.
    """
    names = names_of(paths)
    found: dict[int, Survey] = {}
    for index, survey in crew.over(surveyed, paths, mechanism, names, "looking at the logs"):
        if survey is not None:
            found[index] = replace(survey, log=replace(survey.log, name=names[index]))
    _check_some(mechanism, crew, found)
    return [found[index] for index in sorted(found)]


def with_logs(plan: Plan, surveys: Sequence[Survey], samples: int, crew: Crew) -> Plan:
    """The plan with these logs, and with what long ones decide for all of their portions.

    Args:
        plan: of what logs have in common.
        surveys: of the logs.
        samples: of a portion, about.
        crew: who works.

    Raises:
        IdentError: if no log is left.
    """
    parts = []
    for survey in surveys:
        if survey.name in crew.broken:
            continue
        part = Part(survey, tuple(survey.borders(samples)))
        try:
            check_columns(plan, part)
            parts.append(part)
        except MotionError as error:
            if crew.alone:
                raise
            crew.broken[part.name] = str(error)
    _check_some(plan.mechanism, crew, parts)
    plan = _with_decisions(replace(plan, parts=tuple(parts)), crew)
    left = tuple(part for part in plan.parts if part.name not in crew.broken)
    _check_some(plan.mechanism, crew, left)
    return replace(plan, parts=left)


def _with_decisions(plan: Plan, crew: Crew) -> Plan:
    """With what long logs decide."""
    parts, several = list(plan.parts), list(plan.several)
    names = [parts[i].name for i in several]
    feigned = {}
    for index, found in crew.over(decided, several, plan, names, "deciding on smoothing"):
        if found is not None:
            parts[several[index]], feigned[several[index]] = found
    plan = replace(plan, parts=tuple(parts))
    if not plan.mechanism.effects:  # nothing asks whether a joint stands still
        return plan
    extreme: dict[int, list[Extremes]] = {i: [] for i in feigned}
    unknown = []
    for i, mine in extreme.items():
        if (told := logged_speeds(plan, i)) is not None:
            mine.append(told)
        else:
            unknown += list(plan.portions(i))
    names = [parts[portion.log].name for portion in unknown]
    for index, told in crew.over(extremes, unknown, plan, names, "top speeds"):
        if told is not None:
            extreme[unknown[index].log].append(told)
    for i, mine in extreme.items():
        if mine:
            parts[i] = with_extremes(parts[i], mine, feigned[i])
    return replace(plan, parts=tuple(parts))


def _check_some(mechanism: Mechanism, crew: Crew, left: object) -> None:
    if not left:
        alike = Counter(why.replace(name, "") for name, why in crew.broken.items())
        ((most, count),) = alike.most_common(1)
        name, why = next(x for x in crew.broken.items() if x[1].replace(x[0], "") == most)
        same = f" ({count} of them say the same)" if count > 1 else ""
        raise FitError(
            f"{mechanism.name}: none of {len(crew.broken)} logs can be used; {name}: {why}{same}"
        )
