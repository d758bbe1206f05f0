"""From the cells of all portions to the noun `Fit`."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path

from ident.fit import Fit
from ident.fit.accumulate import Cell
from ident.fit.assemble import assemble
from ident.fit.banded import banded
from ident.fit.constrain import constrained
from ident.fit.covariance import covariance
from ident.fit.identify import bias_of
from ident.fit.noisy import MATTERS, share_of_motion
from ident.fit.score import squares
from ident.gather.crew import Crew
from ident.gather.excerpt import Excerpt
from ident.gather.joined import Joined
from ident.gather.passes import Passed
from ident.gather.planned import looked_at, with_logs
from ident.gather.portion import cells_of
from ident.mechanism.parameters import Consistency
from ident.residual.error import Error


def concluded(done: Passed, crew: Crew, consistent: bool | Consistency) -> Fit:
    """The fit of all portions.

    Args:
        done: the passes.
        crew: who works.
        consistent: as `identify` takes it.
    """
    r, found = done.regression, done.estimate
    left = r.motion.without(crew.broken) if isinstance(r.motion, Excerpt) else r.motion
    r = replace(r, motion=left)
    cov = covariance(r.fitting, found)
    notes = [note for note in done.notes if note not in r.motion.notes] + _noise(done)
    notes += bias_of(r, found)
    shown = sum(len(e) for e in r.motion.experiments)
    if shown < r.motion.samples:
        notes.append(
            f"{r.motion.samples} samples were read in portions; pictures, unfiltered errors and "
            f"the table of multipliers show {shown} of them"
        )
    if not isinstance(consistent, Consistency) and not consistent:
        fit = assemble(r, found, cov, notes=notes, progress=crew.progress)
    else:
        asked = consistent if isinstance(consistent, Consistency) else Consistency()
        held = constrained(r, found, r.mechanism.consistency | asked, crew.progress)
        fit = assemble(
            held.regression, held.estimate, cov, outside=held.outside, binding=held.binding,
            notes=[*notes, *held.notes], progress=crew.progress,
        )  # fmt: skip
    cut = {log for e in left.experiments if (log := e.name.partition(", ")[0]) != e.name}
    told = [w for w in fit.warnings if not _of_ends(w, cut)]
    bands = banded(r.mechanism, r.columns, left, None, r.point) if r.left else ()
    return replace(fit, warnings=tuple(told), bands=tuple(bands))  # λ of the excerpt


def _of_ends(note: str, cut: Collection[str]) -> bool:
    """Whether a note is of the ends of an excerpt's stretch, which the log does not have."""
    return ": the filter takes" in note and note.partition(", ")[0] in cut


def validated(
    done: Passed, crew: Crew, paths: Sequence[Path], samples: int
) -> dict[str, dict[str, Error]]:
    """Errors in other logs, by log, then joint.

    Args:
        done: the passes, whose parameters are judged.
        crew: who works.
        paths: of the other logs.
        samples: of a portion, about.

    Raises:
        IdentError: if one of them is broken.
    """
    r, alone = done.regression, replace(crew, alone=True, broken={})
    plan = with_logs(done.plan, looked_at(r.mechanism, paths, alone), samples, alone)
    portions = list(plan.portions())
    names = [part.name for part in plan.parts]
    of = [names[portion.log] for portion in portions]
    found = Joined()
    for index, each in alone.over(cells_of, portions, plan, of, "validation"):
        found.add(index, each.cells)
    x = done.estimate.solution.x
    by: dict[str, list[Cell]] = {name: [] for name in names}
    for cell in found.without(()):
        if cell.coordinate < r.d:  # in which errors count
            by[names[cell.experiment]].append(cell)
    return {
        name: squares(cells, x, r.d).errors(r.motion.independent, r.units)
        for name, cells in by.items()
    }


def _noise(done: Passed) -> list[str]:
    """Whether the motion's noise is more than least squares should bear; judged on the excerpt."""
    if not len(done.regression.columns):
        return []
    share = float(share_of_motion(done.regression, done.estimate).max(initial=0.0))
    if share < MATTERS:
        return []
    return [
        f"noise of the motion makes up to {100 * min(share, 1.0):.3g} % of the residual; in "
        "portions the motion is taken as it is, so that parameters may be shrunk: identify from a "
        "shorter log to see how much"
    ]
