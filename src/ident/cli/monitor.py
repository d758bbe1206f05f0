"""`monitor`."""

from __future__ import annotations

import contextlib
import csv
import io
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ident.cli.console import notes, progress, result
from ident.cli.options import (
    Absolute,
    AllowCode,
    Cutoff,
    MechanismPath,
    Paths,
    Smoothing,
    With,
    argument,
    cutoff_of,
    knots_of,
    mechanism_of,
    motion_of,
    option,
    output_folder,
)
from ident.errors import FitError, IdentError, LogError, not_there
from ident.fit import Fit, identify
from ident.log.follow import CsvLine, follow
from ident.streams.monitor import Alarm, Monitor
from ident.streams.online import Online, Snapshot
from ident.streams.stream import Setting, Stream
from ident.streams.suspects import STICKING

if TYPE_CHECKING:
    from ident.mechanism import Mechanism
    from ident.streams.online import Forces
    from ident.streams.stream import StreamedRows

MOST_SAID = 20  # lines that are left out, of which each is noted; then they are counted
PARAMETERS = ("t", "quantity", "value", "stderr", "unit", "state")
ALARMS = ("onset", "detected", "named", "verdict", "suspects", "evidence", "text")


def monitor(
    mechanism: MechanismPath,
    log: Annotated[str, argument("A .csv file, or - for standard input.", "LOG")],
    with_: With = None,
    like: Annotated[
        Paths,
        option(
            "A log of normal running, best several, as varied as it is: they decide the "
            "filter and shapes, and what differs from them raises an alarm.",
            "LOG",
        ),
    ] = None,
    forget: Annotated[
        float | None,
        option("After so many seconds an equation counts e times less.", "S"),
    ] = None,
    every: Annotated[float, option("Seconds of the log between two lines.", "S", min=0.0)] = 1.0,
    follow_: Annotated[
        bool, option("Wait for more at the end of the file.", None, "--follow")
    ] = False,
    cutoff: Cutoff = "auto",
    smoothing: Smoothing = "auto",
    absolute: Absolute = False,
    allow_code: AllowCode = False,
    out: Annotated[
        Path | None,
        option("Append to parameters.csv, multipliers.csv, alarms.csv in it.", "DIR"),
    ] = None,
) -> None:
    """Identify a machine while it runs; say when it changes.

    Reads a CSV file, or standard input, line by line, until it ends, Ctrl-C or SIGTERM.
    """
    output_folder(out)
    model = mechanism_of(mechanism, with_, allow_code=allow_code, absolute=absolute)
    cut, knots = cutoff_of(cutoff), knots_of(smoothing)
    fit, watch = None, None
    if log != "-" and not Path(log).is_file():
        why = "is a folder" if Path(log).is_dir() else not_there(Path(log))
        raise LogError(f"{log}: {why}; name a CSV file, or - for standard input")
    if like:
        with progress() as on_progress:
            motion = motion_of(model, like, cut, on_progress, smoothing=smoothing)
            fit = identify(model, motion, progress=on_progress)
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
    with Record(out, model) as record, _until_interrupted() as interrupted:
        running = Running(online, watch, record, every)
        for line in follow(None if log == "-" else Path(log), grow=follow_, stop=interrupted):
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

    def _of(self, made: Sequence[StreamedRows]) -> list[Alarm]:
        return [alarm for rows in made for alarm in self._monitor.absorb(rows, rows.q)]


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

    def take(self, line: CsvLine) -> None:
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
            self._record.alarm(alarm)

    def _leave_out(self, line: CsvLine, why: str) -> None:
        self._out += 1
        if self._out <= MOST_SAID:
            notes([f"line {line.number} is left out: {why}"])
        elif self._out == MOST_SAID + 1:
            notes(["further lines are left out, and not said"])


@contextlib.contextmanager
def _until_interrupted() -> Iterator[Callable[[], bool]]:
    """Whether Ctrl-C or SIGTERM has asked for an end, within a `with`."""
    stop = threading.Event()
    before = {s: signal.signal(s, lambda *_: stop.set()) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop.is_set
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)


class Record(AbstractContextManager["Record"]):
    """parameters.csv, multipliers.csv and alarms.csv of a folder; nothing where there is none.

    Args:
        folder: is made if it is not there.
        mechanism: whose multipliers are written.

    Raises:
        IdentError: if a file cannot be written, or has other columns already.
    """

    def __init__(self, folder: Path | None, mechanism: Mechanism) -> None:
        self._files: dict[str, Growing] = {}
        if folder is None:
            return
        folder.mkdir(parents=True, exist_ok=True)
        names = mechanism.kinematics.multipliers if mechanism.closures else ()
        headers = {"parameters": PARAMETERS, "alarms": ALARMS}
        if names:
            headers["multipliers"] = ("t", *names, *(f"{name}.stderr" for name in names))
        for name, header in headers.items():
            self._files[name] = Growing(folder / f"{name}.csv", header)

    def __exit__(self, *_: object) -> None:
        for each in self._files.values():
            each.close()

    def snapshot(self, found: Snapshot) -> None:
        """Its parameters and errors."""
        self._write("parameters", _parameter_rows(found))

    def multipliers(self, found: Forces | None) -> None:
        """λ of some samples."""
        if found is not None:
            self._write("multipliers", _multiplier_rows(found))

    def alarm(self, found: Alarm) -> None:
        """An alarm."""
        said = (found.onset, found.detected, found.named, found.verdict)
        row = (*said, " ".join(found.suspects), found.evidence, found.headline)
        self._write("alarms", [row])

    def _write(self, name: str, rows: Iterable[Sequence[object]]) -> None:
        if name in self._files:
            self._files[name].write(rows)


class Growing:
    """A CSV file to whose end lines are written; begun with its header, or gone on with.

    Args:
        path: of the file.
        header: its columns.

    Raises:
        IdentError: if it cannot be written, or has other columns already.
    """

    def __init__(self, path: Path, header: Sequence[str]) -> None:
        first = _text([header])
        try:
            self._stream = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o666)
            before = os.read(self._stream, len(first))
            size = os.fstat(self._stream).st_size
            cut = size > 0 and os.pread(self._stream, 1, size - 1) != b"\n"
        except OSError as error:
            raise IdentError(
                f"{path}: cannot be written ({error.strerror}); name a folder that you may write"
            ) from None
        if before not in (b"", first):
            raise IdentError(
                f"{path}: has other columns than would be written; remove it, or name another "
                "folder"
            )
        os.write(self._stream, b"\n" if cut else b"" if before else first)

    def write(self, rows: Iterable[Sequence[object]]) -> None:
        """Appends rows, all at once."""
        os.write(self._stream, _text(rows))

    def close(self) -> None:
        """No more rows."""
        os.close(self._stream)


def _parameter_rows(found: Snapshot) -> list[tuple[object, ...]]:
    """A row a parameter, then the errors by joint, under `PARAMETERS`."""
    t, held = repr(found.t), found.held
    rows: list[tuple[object, ...]] = [
        (
            t, v.name, repr(v.value), "" if v.stderr is None else repr(v.stderr), v.unit,
            "held" if v.name in held else "identified" if v.identifiable else "prior",
        )
        for v in found.parameters
    ]  # fmt: skip
    for state, errors in (("all", found.errors), ("ahead", found.ahead)):
        rows += [(t, f"error.{name}", repr(e.rms), "", e.unit, state) for name, e in errors.items()]
    return rows


def _multiplier_rows(found: Forces) -> list[list[object]]:
    """A row a sample; a multiplier that is not determined has empty cells."""
    each = zip(found.t.tolist(), found.values.tolist(), found.stderr.tolist(), strict=True)
    return [[t, *("" if x != x else x for x in (*values, *errors))] for t, values, errors in each]


def _text(rows: Iterable[Sequence[object]]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode()
