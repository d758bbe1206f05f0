"""Logs that need not fit into memory become one fit: the verb `gather`, its noun `Gathered`."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ident.display import Displayed, no_progress, render
from ident.equations.problem import Problem
from ident.equations.unknowns import Point
from ident.errors import FitError
from ident.files import check_writable
from ident.finding import Finding, note
from ident.fit import Fit
from ident.fit.files import multipliers_rows, write_fit
from ident.fit.identify import estimate_of, fit_of
from ident.fit.likelihood import share_of_motion
from ident.fit.prediction import Reactions, identifiable_multipliers
from ident.fit.shapes import working_point
from ident.information.blocks import Block, Error, Information, Key, summed
from ident.information.evidence import MATTERS
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import Consistency
from ident.motion.closures import check_freedom
from ident.motion.recipe import AUTO
from ident.pool import Workers
from ident.request import PYTHON, Request
from ident.streams.logs import Given, LogOnDisk, excerpt, log_paths
from ident.streams.many_logs import LogComparison, compare_logs
from ident.streams.portions import Checkpoint, Plan, absorbed, multipliers_of, summaries, with_logs
from ident.streams.stream import with_free_multipliers

SAMPLES = 65_536  # work: of a portion


@dataclass(frozen=True, eq=False, repr=False)
class Gathered(Displayed):
    """One fit of many portions of logs. Made by `ident.gather`.

    Attributes:
        fit: of all logs; its motion, and with it every picture, is an excerpt.
        plan: what all portions had in common; its parts are the logs that were opened.
        workers: who did the work.
        worked, resumed: portions worked in this run, and those found in a checkpoint.
        checkpoint: the file of what is done, if one was kept; removed once the fit is written.
    """

    fit: Fit
    plan: Plan
    workers: Workers
    worked: int
    resumed: int
    checkpoint: Checkpoint | None = None

    @property
    def broken(self) -> Mapping[str, str]:
        """By name of a log, why it was left out."""
        return self.workers.broken

    @property
    def several(self) -> bool:
        """Whether several logs were given."""
        return not self.workers.alone

    @cached_property
    def each(self) -> LogComparison:
        """The logs one by one, and which of them disagree with the others."""
        names = {i: part.name for i, part in enumerate(self.plan.parts)}
        samples = {part.name: part.clock.count for part in self.plan.parts}
        return compare_logs(self.fit.problem, names, samples, self.broken)

    @property
    def notes(self) -> tuple[str, ...]:
        """Logs that were left out, first since only the first of several notes is always shown, and
        warnings of the fit.
        """
        of_logs = self.each.notes if self.several else ()
        return tuple(dict.fromkeys((*of_logs, *self.fit.warnings)))

    def write(
        self, folder: str | Path, reactions: Reactions | None = None, request: Request = PYTHON
    ) -> list[Path]:
        """Write what `Fit.write` writes, all or none, with multipliers of all samples; of several
        logs logs.csv too, one row a log, and a table in the report. It ends the checkpoint.

        Args:
            folder: made if it is not there.
            reactions: known ones, which the report draws beside the multipliers.
            request: the command that asked for it, which the report's next commands repeat.

        Raises:
            IdentError: if the folder cannot be written, or a log no longer be read.
        """
        folder = Path(folder)
        check_writable(folder)
        fit, more, sections = self.fit, {}, []
        if self.several:
            more = {"logs.csv": self.each.table.write_csv().encode()}
            sections = [render(self.each, "section")]
            if self.each.odd:  # first, since other notes may follow from it
                sentence = f"{render(self.each, 'sentence')}: see Log by log"
                fit = replace(fit, findings=(note(sentence), *fit.findings))
        multipliers = self._multiplier_rows() if fit.mechanism.closures else None
        paths = write_fit(fit, folder, reactions, multipliers, more, sections, request)
        if self.checkpoint is not None:
            self.checkpoint.remove()
        return paths

    def _multiplier_rows(self) -> Iterator[bytes]:
        """Yield the rows of all portions in order, the header first, in a second pass."""
        plan = replace(self.plan, point=self.fit.point)
        names = plan.mechanism.kinematics.multipliers
        portions = [p for p in plan.portions() if plan.parts[p.log].name not in self.broken]
        determined = identifiable_multipliers(plan.mechanism, self.fit.motion)
        of = [plan.parts[portion.log].name for portion in portions]
        nothing, several = (np.empty(0), np.empty((0, len(names)))), len({*of}) > 1
        yield multipliers_rows(names, *nothing, "" if several else None, header=True)
        done = self.workers.run(multipliers_of, portions, plan, of, "multipliers")
        for log, (_, multipliers) in zip(of, done, strict=True):
            t, values = multipliers or nothing
            values = np.where(determined, values, np.nan)
            yield multipliers_rows(names, t, values, log if several else None, header=False)


def gather(
    mechanism: Mechanism,
    logs: Given | Sequence[Given],
    *,
    cutoff: float | str | None = "auto",
    smoothing: float | str | None = AUTO,
    validate: Sequence[Given] = (),
    consistent: bool | Consistency = False,
    samples: int = SAMPLES,
    checkpoint: str | os.PathLike[str] | None = None,
    scheduler: str | None = None,
    jobs: int | None = 1,
    progress: Callable[[str, float], None] | None = None,
) -> Gathered:
    """Identify from logs that are read in portions, each a few times and never kept.

    What `complete` and `identify` decide from all samples is decided here from some stretches of
    each log: the filter, how channels are smoothed, speeds of standstill, where effects that are
    not linear are linearised. The motion's noise is not weighed against the torques'; a note says
    where that would matter. Of several logs, those that are broken are left out.

    Multipliers are free, one value a sample: a time basis would tie portions together.

    Args:
        mechanism: with what is unknown and which effects it has.
        logs: paths of logs and of folders of logs.
        cutoff, smoothing: as `complete` takes them.
        validate: logs on which errors are reported and nothing is fitted.
        consistent: as `identify` takes it.
        samples: of a portion, about.
        checkpoint: a folder for what is done; after a crash the same call goes on from there.
        scheduler: address of a Dask scheduler, whose workers do the work.
        jobs: processes that do it; 1: this one; None: one a core, or the scheduler's workers.
        progress: called with (what is being done, share done).

    Returns:
        The fit, and what it rests on. `Gathered.write` writes all files.

    Raises:
        IdentError: if no log can be identified from, or the only one is broken.
    """
    check_freedom(mechanism)
    _check_portionable(mechanism, consistent)
    mechanism, free_note = with_free_multipliers(mechanism)
    paths, others = log_paths(logs, scheduler), log_paths(validate, scheduler)
    if not paths:
        raise FitError(f"{mechanism.name}: no log given")
    workers = Workers(None if scheduler else jobs, scheduler, len(paths) == 1, progress)
    looked_at = summaries(mechanism, paths, workers.between(0.0, 0.3))
    sample_motion = excerpt(mechanism, looked_at, cutoff, smoothing, workers.broken)
    logged, prior = sample_motion.experiments[0].logged, Point.prior(mechanism)
    common = Plan(
        mechanism, logged, sample_motion.independent, sample_motion.band, smoothing, (), prior
    )
    plan = with_logs(common, looked_at, samples, workers.between(0.3, 0.4))
    on_shapes = workers.between(0.4, 0.45).on_progress or no_progress
    plan = replace(plan, point=working_point(mechanism, sample_motion, None, on_shapes))
    saved = None if checkpoint is None else Checkpoint(Path(checkpoint), plan)
    blocks, notes, findings, worked, resumed = _summed(plan, workers.between(0.45, 0.9), saved)
    information = Information.of(
        blocks, len(plan.columns), sample_motion.experiments[0].leverage.shape[2]
    )
    regression = Problem(mechanism, sample_motion, plan.point, plan.columns, information)
    fitted = estimate_of(regression)
    notes += free_note
    if not all(effect.linear for effect in mechanism.effects):
        notes.append(
            "effects that are not linear were estimated on the excerpt and refined by one "
            "Gauss-Newton step over all samples"
        )
    unseen = [
        part for part in plan.parts if part.name not in {log.name for log in sample_motion.logs}
    ]
    findings += _copied(plan, unseen, "standard errors are too small by √2", "leave it out")
    used = sample_motion.without(workers.broken)  # in pictures
    problem = replace(regression, motion=used)
    notes = [note for note in notes if note not in used.notes]
    share = float(share_of_motion(problem, fitted).max(initial=0.0)) if len(plan.columns) else 0.0
    if share >= MATTERS:
        notes.append(
            f"noise of the motion makes up to {100 * min(share, 1.0):.3g} % of the residual; in "
            "portions the motion is taken as it is, so that parameters may be shrunk: identify "
            "from a shorter log to see how much"
        )
    shown = sum(len(e) for e in used.experiments)
    if shown < used.samples:
        notes.append(
            f"{used.samples} samples were read in portions; pictures, unfiltered errors and "
            f"the table of multipliers show {shown} of them"
        )
    findings += map(note, notes)
    last = workers.between(0.9, 1.0).on_progress or no_progress
    fit = fit_of(problem, fitted, consistent, findings, on_progress=last)
    if others:
        x = fitted.solution.x
        errors, copies = _validation(plan, regression, x, workers, others, samples)
        fit = replace(fit, validation=errors, findings=(*fit.findings, *copies))
    return Gathered(fit, plan, workers, worked, resumed, saved)


def _check_portionable(mechanism: Mechanism, consistent: bool | Consistency) -> None:
    """Raise FitError for an effect or a fit that has no meaning in portions."""
    for effect in mechanism.effects:
        if consistent is not False and not effect.linear:
            raise FitError(
                f"{mechanism.name}: effect '{effect.label}' is not linear, so a consistent fit is "
                "made again where its limits put it, for which portions are not read; leave out "
                f"--consistent or {effect.label}, or identify logs that fit into memory"
            )
        if effect.memory and not effect.fades:
            raise FitError(
                f"{mechanism.name}: effect '{effect.label}' counts from a log's first sample, "
                "which a portion does not have; leave it out, or cut the log"
            )


def _summed(
    plan: Plan, workers: Workers, saved: Checkpoint | None
) -> tuple[list[Block], list[str], list[Finding], int, int]:
    """Sum the triangles of all portions, without those of broken logs.

    Returns the blocks, notes, the gravest finding of each kind and channel, and how many portions
    were done now and before an interruption.
    """
    total: dict[Key, Block] = {}
    messages, resumed = [], 0
    gravest: dict[tuple[str, str, tuple[str, ...]], Finding] = {}
    if saved is not None and (before := saved.read()) is not None:
        resumed, blocks, broken = before
        summed(total, blocks)
        workers.broken.update(broken)
        messages.append(f"went on from {saved.file}: {resumed} portions were done")
    elif saved is not None and saved.unused:
        messages.append(f"{saved.file}: {saved.unused}; not used, all portions are read")
    remaining = list(plan.portions())[resumed:]
    names = [plan.parts[portion.log].name for portion in remaining]
    tasks = workers.run(absorbed, remaining, plan, names, "equations")
    for count, (portion, done) in enumerate(tasks, start=resumed + 1):
        more, notes, findings = done or ((), (), ())
        summed(total, more)
        messages += notes
        for finding in findings:
            key = plan.parts[portion.log].name, finding.code, finding.where
            if key not in gravest or (finding.number or 0.0) > (gravest[key].number or 0.0):
                gravest[key] = finding
        if saved is not None:
            saved.write(count, total.values(), workers.broken)
    blocks = [b for b in total.values() if plan.parts[b.log].name not in workers.broken]
    if not blocks:
        cut = plan.band.cutoff
        whys = [f"{name}: {finding}" for name, finding in workers.broken.items()]
        at = f" filtered at {cut:.3g} Hz" if cut else ""
        raise FitError(
            f"{plan.mechanism.name}: no equations in {len(plan.parts)} log(s){at}; "
            f"{[*whys, 'give a longer log or a higher --cutoff'][0]}"
        )
    of_used = [finding for (name, *_), finding in gravest.items() if name not in workers.broken]
    return blocks, [*dict.fromkeys(messages)], of_used, len(remaining), resumed


def _copied(plan: Plan, parts: Sequence[LogOnDisk], harm: str, remedy: str) -> list[Finding]:
    """Return a finding for each log that holds the values of an earlier one of a plan."""
    first = {part.digest: part for part in reversed(plan.parts)}
    copies = []
    for part in parts:
        if (before := first.get(part.digest, part)) is not part:
            text = f"{part.name} holds {part.file.rows} samples of {before.name}: {harm}"
            copies.append(Finding("copy", text, remedy, (part.name,)))
    return copies


def _validation(
    plan: Plan, r: Problem, x: np.ndarray, workers: Workers, paths: Sequence[Path], samples: int
) -> tuple[dict[str, dict[str, Error]], list[Finding]]:
    """Errors of the parameters x (k,) in other logs, by log, then joint; and which are copies."""
    alone, before = replace(workers, alone=True, broken={}), plan
    plan = with_logs(plan, summaries(r.mechanism, paths, alone), samples, alone)
    texts = "its errors are no validation", "validate on another log"
    portions, names = list(plan.portions()), [part.name for part in plan.parts]
    logs = [names[portion.log] for portion in portions]
    done = alone.run(absorbed, portions, plan, logs, "validation")
    information = Information.of(
        (block for _, (blocks, _, _) in done for block in blocks), len(x), r.information.d
    )
    return {
        name: information.of_log(i).squares(x).errors(r.motion.independent, r.units)
        for i, name in enumerate(names)
    }, _copied(before, plan.parts, *texts)
