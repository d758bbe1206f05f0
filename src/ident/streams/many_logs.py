"""Many logs one by one: their errors, which of them disagree, and a diagnosis of each.

Diagnoses of each log stand beside that of all of them together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ident.display import Displayed, Progress, part, render
from ident.equations.problem import Problem
from ident.errors import FitError, check_whole
from ident.faults.disagreements import Disagreement, OwnFits, disagreements
from ident.files import json_bytes
from ident.fit import identify
from ident.information.estimate import MATERIAL
from ident.information.evidence import ALPHA, RIVAL
from ident.lazy import lazy
from ident.log.read import distinct
from ident.mechanism.mechanism import Mechanism
from ident.motion import complete
from ident.motion.recipe import AUTO
from ident.pool import Workers
from ident.request import PYTHON, Request
from ident.streams.logs import Given, excerpt, log_paths, summarise

if TYPE_CHECKING:
    import polars as pl

    from ident.diagnosis import Diagnosis
else:
    pl = lazy("polars")


@dataclass(frozen=True)
class LogRow:
    """One log among others."""

    log: str  # its name
    samples: int = 0  # of it
    # errors of the joint model and of the log's own fit in this log, a share of the typical torque,
    # all joints weighed alike; None where nothing could be compared
    error: float | None = None
    own: float | None = None
    worst: str = ""  # the joint in which the joint model does worst beside the own fit
    disagreement: Disagreement | None = None  # with the majority of the others, if there are any
    left_out: str = ""  # why it is in no fit; empty if it is

    @property
    def disagrees(self) -> bool:
        """Whether it clearly disagrees with the others."""
        return self.disagreement is not None and self.disagreement.clear


@dataclass(frozen=True, eq=False, repr=False)
class LogComparison(Displayed):
    """Logs one by one, beside the fit of all of them."""

    logs: tuple[LogRow, ...]  # in the order in which they were given, those left out last

    @cached_property
    def table(self) -> pl.DataFrame:
        """One row a log.

        Columns: `log`, `samples`, `error`, `own_error` [share of the typical torque],
        `worst_joint`, `p_value`, `disagrees`, `unknown` that alone explains it best, `change` ±
        `stderr` [`unit`], `part` of the model that does, its `share` of the excess of squared
        error, `left_out` (why).
        """
        rows = []
        for row in self.logs:
            odd = row.disagreement
            rows.append(
                {
                    "log": row.log, "samples": row.samples, "error": row.error,
                    "own_error": row.own, "worst_joint": row.worst or None,
                    "p_value": odd and odd.p_value, "disagrees": row.disagrees,
                    "unknown": odd and odd.unknown, "change": odd and odd.change,
                    "stderr": odd and odd.stderr, "unit": odd and odd.unit,
                    "part": odd and ", ".join(odd.parts), "share": odd and odd.share,
                    "left_out": row.left_out or None,
                }
            )  # fmt: skip
        numbers = ("error", "own_error", "p_value", "change", "stderr", "share")
        words = ("log", "worst_joint", "unknown", "unit", "part", "left_out")
        types = dict.fromkeys(numbers, pl.Float64) | dict.fromkeys(words, pl.String)
        return pl.DataFrame(rows, schema_overrides=types)

    @property
    def used(self) -> tuple[LogRow, ...]:
        """The logs that were not left out."""
        return tuple(row for row in self.logs if not row.left_out)

    @property
    def odd(self) -> tuple[str, ...]:
        """Names of the logs that clearly disagree with the others."""
        return tuple(row.log for row in self.logs if row.disagrees)

    @property
    def notes(self) -> tuple[str, ...]:
        """Which logs were left out and why, and what the table cannot say."""
        notes = [f"{row.log}: left out: {row.left_out}" for row in self.logs if row.left_out]
        if len(self.used) == 2 and self.odd:
            notes.append("of two logs that disagree, neither can be called the wrong one")
        elif self.odd and 2 * len(self.odd) >= len(self.used):
            notes.append(
                "half of the logs or more disagree: they differ by more than their noise, or the "
                "model lacks what differs between them (ident diagnose); the joint fit is a mean"
            )
        return tuple(notes)


def compare_logs(
    r: Problem,
    names: Mapping[int, str],
    samples: Mapping[str, int],
    left_out: Mapping[str, str] | None = None,
) -> LogComparison:
    """Compare each log with the fit of all logs and with a fit of its own."""
    broken, fits = left_out or {}, OwnFits(r)
    joint, own_estimates = fits.joint, fits.solutions
    odd = disagreements(r.information, fits.weighed, r.columns)
    torque = np.where(r.torque > 0, r.torque, np.inf) ** 2
    results = [LogRow(name, left_out=broken[name]) for name in broken if name not in names.values()]
    for number, name in names.items():
        information, count = fits.by_log.get(number), samples.get(name, 0)
        if name in broken or information is None:
            why = broken.get(name, "no sample of it can be used")
            results.append(LogRow(name, count, left_out=why))
            continue
        both = [information.squares(x).counted for x in (joint.x, own_estimates[number])]
        row = LogRow(name, count, disagreement=odd.get(number))
        if total := float(both[0][2, np.isfinite(torque)].sum()):
            shares = [error / torque for error, _, _ in both]
            worst = r.motion.independent[int(np.argmax(shares[0] - shares[1]))]
            errors = [float(np.sqrt(share.sum() / total)) for share in shares]
            row = replace(row, error=errors[0], own=errors[1], worst=worst)
        results.append(row)
    return LogComparison(tuple(sorted(results, key=lambda row: bool(row.left_out))))


TOGETHER = 300_000  # work: samples of all logs, from which stretches stand for them
SHARE_OF_LOGS = 0.8  # shown: of the work is done when each log has been diagnosed


@dataclass(frozen=True)
class Verdict:
    """The diagnosis of one log, in short."""

    log: str  # its name
    samples: int = 0  # of it
    verdict: str = ""  # as `Diagnosis.verdict`
    named: tuple[str, ...] = ()  # the effect that it names and those it cannot tell from it
    joint: str = ""  # whose error the first of `named` lowers
    error_before: float | None = None  # held out, as a share
    error_after: float | None = None
    left_out: str = ""  # why there is no diagnosis; empty if there is


@dataclass(frozen=True, eq=False, repr=False)
class Verdicts(Displayed):
    """Diagnoses of many logs. Made by `ident.diagnose_each`.

    Attributes:
        together: the diagnosis of all logs as one.
        logs: the diagnosis of each by itself, in the order in which they were given.
    """

    together: Diagnosis
    logs: tuple[Verdict, ...]

    @property
    def verdicts(self) -> set[str]:
        """Every verdict there is: that of all logs together and that of each."""
        return {self.together.verdict, *(row.verdict for row in self.logs if row.verdict)}

    def json(self) -> dict[str, Any]:
        """The diagnosis of all logs together, with `each`: the rows of the table."""
        return {**self.together.json(), "each": self.table.to_dicts()}

    @property
    def notes(self) -> tuple[str, ...]:
        """Which logs were left out and why, and notes of the fit of all logs."""
        out = [f"{row.log}: left out: {row.left_out}" for row in self.logs if row.left_out]
        return (*out, *self.together.fit.warnings)

    @cached_property
    def table(self) -> pl.DataFrame:
        """One row a log, as `table_of` has it."""
        return table_of(self.logs)

    @property
    def short(self) -> str:
        """Verdicts, and what to read first of the diagnosis of all logs together."""
        return str(render(self, "short"))

    def write(self, folder: str | Path, request: Request = PYTHON) -> list[Path]:
        """Write diagnosis.json and report.html of all logs together, and logs.csv, all or none, to
        a folder. Return the files.

        Args:
            folder: made if it is not there.
            request: the command that asked for it, which the report's next commands repeat.

        Raises:
            IdentError: if the folder cannot be written.
        """
        more = {
            "diagnosis.json": json_bytes(self.json()),
            "logs.csv": self.table.write_csv().encode(),
        }
        sections = [render(self, "section")]
        paths: list[Path] = render(self.together, "files", folder, more, sections, request)
        return paths


def table_of(logs: Sequence[Verdict]) -> pl.DataFrame:
    """Return a row a log: `log`, `samples`, `verdict`, `named`, `joint`, `error_before`,
    `error_after` (held out, as a share), `left_out` (why).
    """
    rows = [{**asdict(row), "named": " ".join(row.named)} for row in logs]
    types = dict.fromkeys(("error_before", "error_after"), pl.Float64)
    words = pl.col("verdict", "named", "joint", "left_out")
    return pl.DataFrame(rows, schema_overrides=types).with_columns(words.replace("", None))


def diagnose_each(
    mechanism: Mechanism,
    logs: Given | Sequence[Given],
    *,
    cutoff: float | str | None = "auto",
    smoothing: float | str | None = AUTO,
    seed: int = 0,
    alpha: float = ALPHA,
    material: float = MATERIAL,
    rival_se: float = RIVAL,
    jobs: int | None = None,
    scheduler: str | None = None,
    done: list[Verdict] | None = None,
    progress: Progress | None = None,
) -> Verdicts:
    """Diagnose each log by itself, and all of them together.

    A log that cannot be read, completed or identified from is left out, with the reason.

    Args:
        mechanism: with what is unknown and which effects it has.
        logs: paths of logs and of folders of logs.
        cutoff, smoothing: as `complete` takes them.
        seed, alpha, material, rival_se: as `diagnose` takes them.
        jobs: processes; None: one a core; 1: this one alone.
        scheduler: address of a Dask scheduler whose workers do it, in place of processes.
        done: a list that gets each verdict as it is there, for one who interrupts this.
        progress: called with (what is being done, share done).

    Returns:
        The diagnosis of all logs as one, and each log's verdict in short.

    Raises:
        IdentError: if no log is left.
    """
    if done is not None and not isinstance(done, list):
        raise FitError(f"done is a {type(done).__name__}; give a list, which gets the verdicts")
    check_whole("seed", seed)
    from ident.diagnosis import diagnose  # without it `identify` starts sooner
    from ident.information.evidence import Decision

    Decision(alpha, material, rival_se)
    paths = log_paths(logs, scheduler)
    names = distinct(path.name or str(path) for path in paths)
    rule: Any = {"seed": seed, "alpha": alpha, "material": material, "rival_se": rival_se}
    settings: Any = {"cutoff": cutoff, "smoothing": smoothing}

    def on_progress(what: str, share: float) -> None:
        if progress:
            progress(f"log {round(share * len(paths))} of {len(paths)}", SHARE_OF_LOGS * share)

    workers = Workers(jobs, scheduler, False, on_progress)
    tasks = list(zip(names, paths, strict=True))
    verdicts, common = list[Verdict](), (mechanism, settings, rule)
    for (name, _), verdict in workers.run(_verdict, tasks, common, names, "logs"):
        verdicts.append(verdict or Verdict(name, left_out=workers.broken[name]))
        if done is not None:
            done.append(verdicts[-1])
    if not verdicts:
        raise FitError("no log given; valid: paths of logs, and of folders of them")
    good = [path for path, row in zip(paths, verdicts, strict=True) if not row.left_out]
    if not good:
        why = f"{verdicts[0].log}: {verdicts[0].left_out}"
        raise FitError(f"none of {len(paths)} logs can be used; {why}")
    if sum(row.samples for row in verdicts) <= TOGETHER:
        motion = complete(mechanism, good, **settings)
    else:
        looked_at = [summarise(mechanism, path) for path in good]
        sample_motion = excerpt(mechanism, looked_at, cutoff, smoothing, {})
        shown = sum(len(row) for row in sample_motion.experiments)
        note = f"all logs together are judged on {shown} of their {sample_motion.samples} samples"
        motion = replace(sample_motion, notes=(*sample_motion.notes, note))
    fit = identify(mechanism, motion, estimator="least-squares")
    return Verdicts(
        diagnose(fit, progress=part(progress, SHARE_OF_LOGS, 1.0), **rule), tuple(verdicts)
    )


def _verdict(common: tuple[Mechanism, Any, Any], task: tuple[str, Path]) -> Verdict:
    """Diagnose one log."""
    from ident.diagnosis import diagnose

    (mechanism, settings, rule), (name, path) = common, task
    motion = complete(mechanism, path, **settings)
    d = diagnose(identify(mechanism, motion, estimator="least-squares"), **rule)
    verdict = Verdict(name, motion.samples, d.verdict)
    if d.best is None:
        return verdict
    named, c = tuple(effect.label for effect in (d.best, *d.rivals)), d.candidates[0]
    before, after = c.error_before, c.error_after
    return replace(verdict, named=named, joint=c.joint, error_before=before, error_after=after)
