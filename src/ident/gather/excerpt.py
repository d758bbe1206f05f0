"""The motion of logs too long to be held: some stretches of them, for pictures and decisions."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass, replace

from ident.errors import IdentError
from ident.gather.stretches import COUNT, LONGEST, stretches
from ident.gather.survey import Survey
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion, complete

SAMPLES = COUNT * LONGEST  # in all
LOGS = 12  # from which stretches are taken


@dataclass(frozen=True, eq=False, repr=False)
class Excerpt(Motion):
    """A motion that stands for a longer one, which it counts.

    Attributes:
        recorded: (name, samples, rate [Hz]) of the logs.
    """

    recorded: tuple[tuple[str, int, float], ...] = ()

    def without(self, logs: Container[str]) -> Excerpt:
        """The excerpt without some logs, if any is left to be shown."""
        recorded = tuple(each for each in self.recorded if each[0] not in logs)
        out = tuple(name for name in self.names if name in logs)
        kept = tuple(e for e in self.experiments if not any(_of(e.name, name) for name in out))
        return replace(self, recorded=recorded, experiments=kept or self.experiments)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the logs."""
        return tuple(name for name, _, _ in self.recorded)

    @property
    def samples(self) -> int:
        """Of all logs."""
        return sum(samples for _, samples, _ in self.recorded)

    @property
    def rows(self) -> list[list[str]]:
        """The logs as a table: name, samples, duration, rate, samples in pictures; head first."""
        rows = [["log", "samples", "duration", "rate", "in pictures"]]
        for name, samples, rate in self.recorded:
            mine = [e for e in self.experiments if _of(e.name, name)]
            shown = str(sum(len(e) for e in mine))
            rows.append([name, str(samples), f"{samples / rate:.4g} s", f"{rate:.4g} Hz", shown])
        return rows


def _of(stretch: str, log: str) -> bool:
    """Whether a stretch of this name is one of a log."""
    return stretch == log or stretch.startswith(f"{log}, ")


def excerpt(
    mechanism: Mechanism,
    surveys: Sequence[Survey],
    cutoff: float | str | None,
    smoothing: float | str | None,
    broken: dict[str, str],
) -> Excerpt:
    """The completed motion of stretches of the logs; those that cannot be completed are `broken`.

    Args:
        mechanism: the mechanism.
        surveys: of the logs.
        cutoff, smoothing: as `complete` takes them.
        broken: by name of a log, why; what is found here is added.

    Raises:
        IdentError: if no log can be completed.
    """
    left = [survey for survey in surveys if survey.name not in broken]
    every = max(1, -(-len(left) // LOGS))
    chosen = left if sum(each.log.rows for each in left) <= SAMPLES else left[::every]
    try:
        pieces = [_pieces(survey, SAMPLES // len(chosen)) for survey in chosen]
        logs = [log for mine in pieces for log in mine]
        motion = complete(mechanism, logs, cutoff=cutoff, smoothing=smoothing)
    except IdentError:
        found = _faults(mechanism, chosen, cutoff, smoothing)
        if len(surveys) == 1 or not found or len(found) == len(left):
            raise
        broken.update(found)
        return excerpt(mechanism, surveys, cutoff, smoothing, broken)
    recorded = tuple((s.name, s.clock.count, 1 / s.clock.step) for s in left)
    first = [replace(mine[0], name=s.name) for mine, s in zip(pieces, chosen, strict=True)]
    return Excerpt(
        motion.experiments, motion.independent, motion.band, motion.closure_error,
        _noted(motion, left), tuple(first), mechanism, recorded,
    )  # fmt: skip


def _pieces(survey: Survey, samples: int) -> list[Log]:
    found = stretches(survey, samples)
    logs = [survey.log.piece(*each) for each in found]
    if len(found) == 1:
        return [replace(log, name=survey.name) for log in logs]
    said = [f"{survey.name}, {log.t[0]:.6g} to {log.t[-1]:.6g} s" for log in logs]
    return [replace(log, name=name) for log, name in zip(logs, said, strict=True)]


def _faults(
    mechanism: Mechanism,
    surveys: Sequence[Survey],
    cutoff: float | str | None,
    smoothing: float | str | None,
) -> dict[str, str]:
    """The logs that cannot be completed alone, and why."""
    found = {}
    for survey in surveys:
        try:
            logs = _pieces(survey, SAMPLES // len(surveys))
            complete(mechanism, logs, cutoff=cutoff, smoothing=smoothing)
        except IdentError as error:
            found[survey.name] = " ".join(str(error).split())
    return found


def _noted(motion: Motion, surveys: Sequence[Survey]) -> tuple[str, ...]:
    """What was said of the stretches, once for each log, and what their surveys say."""
    said = [f"{survey.name}: {repair}" for survey in surveys for repair in survey.repairs]
    for note in motion.notes:
        for survey in surveys:
            head, comma, tail = note.partition(f"{survey.name}, ")
            if not head and comma:
                note = f"{survey.name}:{tail.partition(' s:')[2]}"
                if note.endswith("left out"):  # how many is not known of the whole log
                    note = ""
        said += [note] if note else []
    return tuple(dict.fromkeys(said))
