"""multipliers.csv of whole logs, in a second pass over their portions, written one by one."""

from __future__ import annotations

import contextlib
import heapq
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ident.equations.scene import Scene
from ident.fit.output import multipliers_rows
from ident.fit.reach import identifiable_multipliers
from ident.gather.motion import experiment
from ident.gather.plan import Plan, Portion
from ident.gather.stack import multipliers_in
from ident.motion import Motion
from ident.residual.predict import predict

if TYPE_CHECKING:
    from ident.gather.gathered import Gathered


@contextlib.contextmanager
def written(gathered: Gathered, folder: Path) -> Iterator[Path | None]:
    """A hidden file in a folder with the multipliers of all samples; None for a tree.

    Whoever does not move it elsewhere has it taken away.
    """
    names = gathered.fit.mechanism.kinematics.multipliers
    if not names:
        yield None
        return
    folder.mkdir(parents=True, exist_ok=True)
    for stale in folder.glob(".multipliers.csv.*.part"):  # of a run that was killed
        stale.unlink(missing_ok=True)
    file = folder / f".multipliers.csv.{secrets.token_hex(4)}.part"
    try:
        with file.open("xb") as stream:
            for rows in _in_order(gathered):
                stream.write(rows)
        yield file
    finally:
        file.unlink(missing_ok=True)


def _in_order(gathered: Gathered) -> Iterator[bytes]:
    """The rows of all portions, the header first."""
    plan, crew = gathered.plan.at(gathered.fit.point), gathered.crew
    left = [i for i, part in enumerate(plan.parts) if part.name not in gathered.broken]
    portions = [portion for i in left for portion in plan.portions(i)]
    determined = identifiable_multipliers(plan.mechanism, gathered.fit.motion)
    names = plan.mechanism.kinematics.multipliers
    yield multipliers_rows(
        names, np.empty(0), np.empty((0, len(names))), "" if len(left) > 1 else None, header=True
    )
    of = [plan.parts[portion.log].name for portion in portions]
    early: list[tuple[int, np.ndarray, np.ndarray]] = []
    at = 0
    for index, found in crew.over(reactions, portions, plan, of, "multipliers"):
        heapq.heappush(early, (index, *(found or (np.empty(0), np.empty((0, len(names)))))))
        while early and early[0][0] == at:
            _, t, values = heapq.heappop(early)
            log = of[at] if len(left) > 1 else None
            yield multipliers_rows(names, t, np.where(determined, values, np.nan), log, False)
            at += 1


def reactions(plan: Plan, portion: Portion) -> tuple[np.ndarray, np.ndarray]:
    """t (n,) [s] and multipliers (n, m) [N | N m] of the samples that a portion answers for.

    Args:
        plan: at the identified parameters.
        portion: which one.
    """
    names = plan.mechanism.kinematics.multipliers
    e, _ = experiment(plan, portion)
    if e is None:
        return np.empty(0), np.empty((0, len(names)))
    inside = (e.t >= portion.since) & (e.t < portion.until)
    if plan.stacked:
        columns = plan.columns
        scene = Scene.of(plan.mechanism, columns, e, plan.point, plan.band.cutoff)
        values = multipliers_in(plan, portion.log, scene, plan.point.unknowns(columns))
        return e.t[inside], values[inside]
    motion = Motion((e,), plan.independent, plan.band, 0.0)
    (found,) = predict(plan.mechanism, motion, plan.point)
    values = np.where(found.usable[:, None], found.multipliers, np.nan)
    return found.t[inside], values[inside]
