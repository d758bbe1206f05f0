"""Many logs, each diagnosed by itself, beside the diagnosis of all of them together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import polars as pl

from ident.diagnosis import Diagnosis, diagnose
from ident.display import Displayed, render
from ident.errors import FitError
from ident.files import json_bytes
from ident.fit import identify
from ident.log.read import names_of
from ident.mechanism.mechanism import Mechanism
from ident.motion import complete
from ident.motion.recipe import AUTO
from ident.pool import Workers
from ident.progress import Progress, part
from ident.streams.logs import Given, excerpt, log_paths, summarise

TOGETHER = 300_000  # samples of all logs, from which stretches stand for them
EACH = 0.8  # of the work is done when each log has been diagnosed


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
        return {self.together.verdict, *(each.verdict for each in self.logs if each.verdict)}

    def json(self) -> dict[str, Any]:
        """The diagnosis of all logs together, with `each`: the rows of the table."""
        return {**self.together.json(), "each": self.table.to_dicts()}

    @property
    def notes(self) -> tuple[str, ...]:
        """Which logs were left out and why, and notes of the fit of all logs."""
        out = [f"{each.log}: left out: {each.left_out}" for each in self.logs if each.left_out]
        return (*out, *self.together.fit.warnings)

    @cached_property
    def table(self) -> pl.DataFrame:
        """One row a log: `log`, `samples`, `verdict`, `named`, `joint`, `error_before`,
        `error_after` (held out, as a share), `left_out` (why).
        """
        rows = [{**asdict(each), "named": " ".join(each.named)} for each in self.logs]
        words = ("verdict", "named", "joint", "left_out")
        types = dict.fromkeys(("error_before", "error_after"), pl.Float64)
        table = pl.DataFrame(rows, schema_overrides=types)
        return table.with_columns(pl.col(words).replace("", None))

    @property
    def short(self) -> str:
        """Verdicts, and what to read first of the diagnosis of all logs together."""
        return str(render(self, "short"))

    def write(self, folder: str | Path) -> list[Path]:
        """Write diagnosis.json and report.html of all logs together, and logs.csv.

        Args:
            folder: made if it is not there.

        Returns:
            The files written, all of them or none.

        Raises:
            IdentError: if the folder cannot be written.
        """
        more = {
            "diagnosis.json": json_bytes(self.json()),
            "logs.csv": self.table.write_csv().encode(),
        }
        sections = [render(self, "section")]
        paths: list[Path] = render(self.together, "files", folder, more, sections)
        return paths


def diagnose_each(
    mechanism: Mechanism,
    logs: Given | Sequence[Given],
    *,
    cutoff: float | str | None = "auto",
    smoothing: float | str | None = AUTO,
    seed: int = 0,
    alpha: float = 0.01,
    material: float = 0.003,
    rival_se: float = 2.0,
    jobs: int | None = None,
    scheduler: str | None = None,
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
        progress: called with (what is being done, share done).

    Returns:
        The diagnosis of all logs as one, and each log's verdict in short.

    Raises:
        IdentError: if no log is left.
    """
    paths = log_paths(logs, scheduler)
    names = names_of(paths)
    rule: Any = {"seed": seed, "alpha": alpha, "material": material, "rival_se": rival_se}
    settings: Any = {"cutoff": cutoff, "smoothing": smoothing}

    def on_progress(what: str, share: float) -> None:
        if progress:
            progress(f"log {round(share * len(paths))} of {len(paths)}", EACH * share)

    workers = Workers(jobs, scheduler, False, on_progress)
    tasks = list(zip(names, paths, strict=True))
    done = workers.over(_verdict, tasks, (mechanism, settings, rule), names, "logs")
    verdicts = tuple(
        verdict or Verdict(name, left_out=workers.broken[name]) for (name, _), verdict in done
    )
    good = [path for path, each in zip(paths, verdicts, strict=True) if not each.left_out]
    if not good:
        raise FitError(
            f"none of {len(paths)} logs can be used; {verdicts[0].log}: {verdicts[0].left_out}"
            if verdicts else "no log given; valid: paths of logs, and of folders of them"
        )  # fmt: skip
    if sum(each.samples for each in verdicts) <= TOGETHER:
        motion = complete(mechanism, good, **settings)
    else:
        looked_at = [summarise(mechanism, path) for path in good]
        some = excerpt(mechanism, looked_at, cutoff, smoothing, {})
        shown = sum(len(each) for each in some.experiments)
        note = f"all logs together are judged on {shown} of their {some.samples} samples"
        motion = replace(some, notes=(*some.notes, note))
    fit = identify(mechanism, motion, estimator="least-squares")
    return Verdicts(diagnose(fit, progress=part(progress, EACH, 1.0), **rule), verdicts)


def _verdict(common: tuple[Mechanism, Any, Any], task: tuple[str, Path]) -> Verdict:
    """Diagnose one log."""
    (mechanism, settings, rule), (name, path) = common, task
    motion = complete(mechanism, path, **settings)
    d = diagnose(identify(mechanism, motion, estimator="least-squares"), **rule)
    if d.best is None:
        return Verdict(name, motion.samples, d.verdict)
    named, first = tuple(effect.label for effect in (d.best, *d.rivals)), d.candidates[0]
    errors = first.error_before, first.error_after
    return Verdict(name, motion.samples, d.verdict, named, first.joint, *errors)
