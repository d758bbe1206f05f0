"""`monitor`."""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated

import typer

from ident.cli.arguments import (
    Absolute,
    AllowCode,
    Cutoff,
    MechanismPath,
    Smoothing,
    With,
    cutoff_of,
    mechanism_of,
    motion_of,
    output_folder,
)
from ident.cli.console import notes, progress, result
from ident.cli.recording import Record
from ident.equations.rows import Rows
from ident.errors import FitError, LogError, not_there
from ident.fit import Fit, identify
from ident.log.follow import Line, follow
from ident.streams import Alarm, Monitor, Online, Setting, Snapshot, Stream
from ident.streams.suspects import STICKING

SAID = 20  # lines that are left out, of which each is said; then they are counted


def monitor(
    mechanism: MechanismPath,
    log: Annotated[
        str, typer.Argument(metavar="LOG", help="A .csv file, or - for standard input.")
    ],
    with_: With = None,
    like: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="LOG",
            help="A log of normal running, best several, as varied as it is: they decide the "
            "filter and shapes, and what differs from them raises an alarm.",
        ),
    ] = None,
    forget: Annotated[
        float | None,
        typer.Option(metavar="S", help="After so many seconds an equation counts e times less."),
    ] = None,
    every: Annotated[
        float, typer.Option(metavar="S", min=0.0, help="Seconds of the log between two lines.")
    ] = 1.0,
    follow_: Annotated[
        bool, typer.Option("--follow", help="Wait for more at the end of the file.")
    ] = False,
    cutoff: Cutoff = "auto",
    smoothing: Smoothing = "auto",
    absolute: Absolute = False,
    allow_code: AllowCode = False,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Append to parameters.csv, multipliers.csv, alarms.csv in it."
        ),
    ] = None,
) -> None:
    """Identify a machine while it runs; say when it changes.

    Reads a CSV file, or standard input, line by line, until it ends, Ctrl-C or SIGTERM.
    """
    output_folder(out)
    model = mechanism_of(mechanism, with_, allow_code=allow_code, absolute=absolute)
    cut, knots = cutoff_of(cutoff), None if smoothing == "none" else smoothing
    fit, watch = None, None
    if log != "-" and not Path(log).is_file():
        why = "is a folder" if Path(log).is_dir() else not_there(Path(log))
        raise LogError(f"{log}: {why}; name a CSV file, or - for standard input")
    if like:
        with progress() as told:
            motion = motion_of(model, like, cut, told, smoothing=smoothing)
            fit = identify(model, motion, progress=told)
        notes(motion.notes)
        watch = _watch(fit)
        if watch is not None and len(like) == 1:
            notes(
                [
                    f"alarms rest on {like[0].name} alone: other motions than this one will raise "
                    "more false alarms than stated; give several logs (--like A --like B)"
                ]
            )
    online = Online(model, like=fit, forget=forget, cutoff=cut, smoothing=knots)
    with Record(out, model) as record, _until_told() as told_to_stop:
        running = Running(online, watch, record, every)
        for line in follow(None if log == "-" else Path(log), grow=follow_, stop=told_to_stop):
            running.take(line)
        if not online.samples:
            name = "standard input" if log == "-" else log
            raise LogError(
                f"{name}: no sample came; a header line (t, q.<joint>, tau.<joint>, …) and rows of "
                "numbers are needed"
            )
        found = running.end()
    result(found)
    if running.raised:
        notes(
            [
                f"{len(running.raised)} alarm(s), first {running.raised[0].headline}; parameters "
                "of all samples are a mean of before and after it: --forget S, or a new start, "
                "tells what they are now"
            ]
        )


class Watch:
    """A monitor, and the stream that makes its rows."""

    def __init__(self, monitor: Monitor, stream: Stream) -> None:
        self._monitor, self._stream = monitor, stream

    def alarms(self, sample: Mapping[str, float]) -> list[Alarm]:
        """What a further sample raises."""
        return self._of(self._stream.push(sample))

    def last(self) -> list[Alarm]:
        """What the samples that still wait raise, and what has no name yet."""
        return [*self._of(self._stream.flush()), *self._monitor.finish()]

    def _of(self, made: list[Rows]) -> list[Alarm]:
        q = self._stream.configurations
        return [alarm for rows in made for alarm in self._monitor.absorb(rows, q(rows))]


def _watch(fit: Fit) -> Watch | None:
    """What raises alarms where a log differs from the one that was fitted."""
    try:
        monitor = Monitor.of(fit, fit.motion)
    except FitError as error:
        notes([f"no alarms: {error}"])
        return None
    notes(str(monitor).splitlines()[:3])
    watched = monitor.watched
    setting = Setting.of(watched.mechanism, fit.motion)
    stream = Stream(
        watched.mechanism,
        watched.columns,
        setting,
        watched.point,
        latency=monitor.seconds / 2,  # alarms come by intervals
        sticking=STICKING,
    )
    return Watch(monitor, stream)


class Running:
    """Takes lines, one by one, and says what they say.

    Args:
        online: what identifies; watch: what raises alarms, if anything does.
        record: of all that is said.
        every: seconds of the log between two lines [s].

    Attributes:
        raised: alarms so far.
    """

    def __init__(self, online: Online, watch: Watch | None, record: Record, every: float) -> None:
        self._online, self._watch, self._record, self._every = online, watch, record, every
        self._due = -float("inf")
        self.raised: list[Alarm] = []
        self._out = 0

    def take(self, line: Line) -> None:
        """One line of the log."""
        online = self._online
        if line.sample is None:
            self._leave_out(line, line.why)
            return
        try:
            online.update(line.sample)
        except LogError as error:
            self._leave_out(line, str(error))
            return
        self._record.multipliers(online.multipliers)
        self._warn(self._watch.alarms(line.sample) if self._watch else [])
        if online.warm and online.t >= self._due:
            self._due = online.t + self._every
            with contextlib.suppress(FitError):  # no equation yet, so soon
                result(self.snapshot().line)
                sys.stdout.flush()

    def end(self) -> Snapshot:
        """The last alarm, and what is known."""
        self._warn(self._watch.last() if self._watch else [])
        return self.snapshot()

    def snapshot(self) -> Snapshot:
        """What is known by now, recorded."""
        found = self._online.snapshot()
        self._record.multipliers(self._online.multipliers)
        self._record.snapshot(found)
        return found

    def _warn(self, alarms: list[Alarm]) -> None:
        for alarm in alarms:
            self.raised.append(alarm)
            result(f"alarm: {alarm.headline}")
            sys.stdout.flush()
            self._record.alarm(alarm)

    def _leave_out(self, line: Line, why: str) -> None:
        self._out += 1
        if self._out <= SAID:
            notes([f"line {line.number} is left out: {why}"])
        elif self._out == SAID + 1:
            notes(["further lines are left out, and not said"])


@contextlib.contextmanager
def _until_told() -> Iterator[Callable[[], bool]]:
    """Whether Ctrl-C or SIGTERM has asked for an end, within a `with`."""
    told = threading.Event()
    before = {s: signal.signal(s, lambda *_: told.set()) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield told.is_set
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
