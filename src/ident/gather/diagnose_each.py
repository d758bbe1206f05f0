"""The verb `diagnose_each`: many logs, each diagnosed by itself and all of them together."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

from ident.diagnose import diagnose
from ident.errors import FitError
from ident.fit import identify
from ident.gather.excerpt import excerpt
from ident.gather.survey import surveyed
from ident.gather.verdicts import Verdict, Verdicts
from ident.log import read_log
from ident.log.folder import expanded, names_of
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion, complete
from ident.motion.derive import AUTO
from ident.pool import spread
from ident.progress import Told

TOGETHER = 300_000  # samples of all logs, from which stretches stand for them
Given = str | os.PathLike[str]


@dataclass(frozen=True, eq=False)
class Asked:
    """What all logs have in common: the mechanism, and settings as `diagnose_each` takes them."""

    mechanism: Mechanism
    cutoff: float | str | None
    smoothing: float | str | None
    seed: int


def diagnose_each(
    mechanism: Mechanism,
    logs: Given | Sequence[Given],
    *,
    cutoff: float | str | None = "auto",
    smoothing: float | str | None = AUTO,
    seed: int = 0,
    jobs: int | None = None,
    scheduler: str | None = None,
    progress: Told | None = None,
) -> Verdicts:
    """What each log says is missing, and what all of them say together.

    A log that cannot be read, completed or identified from is left out, with the reason.

    Args:
        mechanism: with what is unknown and which effects it has.
        logs: paths of logs and of folders of logs.
        cutoff, smoothing: as `complete` takes them.
        seed: of the clean logs' noise.
        jobs: processes; None: one a core; 1: this one alone.
        scheduler: address of a Dask scheduler whose workers do it, in place of processes.
        progress: called with (what is being done, share done).

    Returns:
        The diagnosis of all logs as one, and each log's verdict in short.

    Raises:
        IdentError: if no log is left.
    """
    paths = expanded([logs] if isinstance(logs, str | os.PathLike) else logs)
    if scheduler is not None:  # its workers are in folders of their own
        paths = [path.absolute() for path in paths]
    names = names_of(paths)
    asked = Asked(mechanism, cutoff, smoothing, seed)
    tasks = list(zip(names, paths, strict=True))
    found: dict[int, Verdict] = {}
    with closing(spread(_verdict, tasks, common=asked, jobs=jobs, scheduler=scheduler)) as ended:
        for done in ended:
            broken = Verdict(names[done.index], left_out=done.error or "")
            found[done.index] = broken if done.error else done.value
            if progress:
                progress(f"log {len(found)} of {len(tasks)}", 0.8 * len(found) / len(tasks))
    verdicts = tuple(found[i] for i in range(len(tasks)))
    good = [path for path, each in zip(paths, verdicts, strict=True) if not each.left_out]
    if not good:
        raise FitError(
            f"none of {len(paths)} logs can be used; {verdicts[0].log}: {verdicts[0].left_out}"
            if verdicts else "no log given; valid: paths of logs, and of folders of them"
        )  # fmt: skip
    samples = sum(each.samples for each in verdicts)
    motion = _motion(asked, good) if samples <= TOGETHER else _excerpt(asked, good)
    fit = identify(mechanism, motion, estimator="least-squares")
    together = diagnose(fit, seed=seed, progress=_last(progress))
    return Verdicts(together, verdicts)


def _verdict(asked: Asked, task: tuple[str, Path]) -> Verdict:
    """Of one log."""
    name, path = task
    motion = _motion(asked, [path])
    fit = identify(asked.mechanism, motion, estimator="least-squares")
    samples = sum(len(each) for each in motion.experiments)
    return Verdict.of(name, samples, diagnose(fit, seed=asked.seed))


def _motion(asked: Asked, paths: Sequence[Path]) -> Motion:
    logs = [read_log(path, asked.mechanism.columns) for path in paths]
    return complete(asked.mechanism, logs, cutoff=asked.cutoff, smoothing=asked.smoothing)


def _excerpt(asked: Asked, paths: Sequence[Path]) -> Motion:
    """Of logs that together are too long: some stretches of each, or of some of them."""
    surveys = [surveyed(asked.mechanism, path) for path in paths]
    found = excerpt(asked.mechanism, surveys, asked.cutoff, asked.smoothing, {})
    shown = sum(len(each) for each in found.experiments)
    note = f"all logs together are judged on {shown} of their {found.samples} samples"
    return replace(found, notes=(*found.notes, note))


def _last(progress: Told | None) -> Told | None:
    """The last fifth of what is done."""
    if progress is None:
        return None
    return lambda what, share: progress(what, 0.8 + 0.2 * share)
