"""`monitor`."""

from __future__ import annotations

import contextlib
import csv
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np

from ident.cli.app import notes, progress, result, wrote
from ident.cli.options import Paths, RunOptions, argument, flag, output_folder, setting
from ident.display import part
from ident.errors import FitError, IdentError, LogError, missing_file
from ident.files import write_all

if TYPE_CHECKING:
    from ident.fit import Fit
    from ident.log.pieces import CsvLines
    from ident.show.streams import MonitorHistory
    from ident.streams.monitor import Alarm
    from ident.streams.online import Online, Snapshot

MOST_NOTED = 20  # lines that are left out, of which each is noted; then they are counted
RECORDED = 1.0  # [s] between two records of parameters, where nothing is printed
PARAMETERS = ("t", "quantity", "value", "stderr", "unit", "state")
ALARMS = ("onset", "detected", "named", "verdict", "suspects", "evidence", "text")


def monitor(
    model: RunOptions,
    log: str = argument("A .csv file, or - for standard input.", "LOG", default=...),
    like: Paths = setting("Logs of normal running; what differs raises an alarm.", "LOG"),
    forget: float | None = setting("An equation counts e times less after that.", "S"),
    every: float | None = setting(
        "Seconds between two lines of parameters. Default: a line where something changes.",
        "S",
        min=0.0,
    ),
    follow_: bool = flag("Wait for more at the end of the file.", "--follow"),
    page: bool = flag("Show it in a browser too, until Ctrl-C.", "--page"),
    port: int = setting("Port of the page; 0 is a free one.", "N", default=0, min=0, max=65535),
    out: Path | None = setting("Append to .csv files there; write report.html.", "DIR"),
) -> None:
    """Identify a machine while it runs; say when it changes.

    Reads a CSV file, or standard input, line by line, until it ends, Ctrl-C or SIGTERM. --page
    shows parameters with bands, reaction forces and alarms on 127.0.0.1 while they come.
    """
    from ident.fit import identify
    from ident.log.pieces import follow
    from ident.streams.online import Online

    output_folder(out)
    mechanism = model.load(None if log == "-" else [Path(log)], like)
    fit, watch, silent = None, None, "alarms need logs of normal running (--like)"
    if log != "-" and not Path(log).is_file():
        why = "is a folder" if Path(log).is_dir() else missing_file(Path(log))
        raise LogError(f"{log}: {why}; name a CSV file, or - for standard input")
    if like:
        with progress() as on_progress:
            begin, rest = part(on_progress, 0.0, 0.3), part(on_progress, 0.3, 1.0)
            motion = model.motion(mechanism, like, begin)
            fit = identify(mechanism, motion, progress=rest)
        notes(fit.warnings)
        try:
            watch, silent = Watch(fit), ""
            notes(str(watch.monitor).splitlines()[:3])
        except FitError as error:
            silent = f"alarms are not possible: {error}"
            notes([silent])
        if watch is not None and len(like) == 1:
            alone = f"alarms rest on {like[0].name} alone: other motions than this one will raise "
            notes([f"{alone}more false alarms than stated; give several logs (--like A --like B)"])
    treatment = replace(model, poses=False).treatment  # what is followed moves
    online = Online(mechanism, like=fit, forget=forget, **treatment)
    from ident.show.streams import MonitorHistory

    request = model.request(None if log == "-" else [Path(log)], like=like, out=out)
    history = MonitorHistory(mechanism, silent, request)
    with contextlib.ExitStack() as ends:
        if page:
            from ident.show.local import live_page

            title = f"{mechanism.name}: monitor"
            result(ends.enter_context(live_page(title, port, history.live)))
        session = ends.enter_context(Session(online, watch, out, every, history))
        interrupted = ends.enter_context(_until_interrupted())
        for lines in follow(None if log == "-" else Path(log), grow=follow_, stop=interrupted):
            session.take(lines)
        if not online.samples:
            name = "standard input" if log == "-" else log
            raise LogError(
                f"{name}: no sample came; a header line (t, q.<joint>, tau.<joint>, …) and rows of "
                "numbers are needed"
            )
        snapshot = session.end()
        if out is not None:
            wrote(write_all(out, {"report.html": history.report()}))
        result(f"{snapshot}\n{history.next_text()}")
        if page and not interrupted():
            notes(["the page is available until Ctrl-C"])
            while not interrupted():
                time.sleep(0.2)
    if not all(alarm.from_start for alarm in session.raised):
        mean = "parameters of all samples are a mean of before and after the alarm: --forget S, or "
        notes([f"{mean}a new start, tells what they are now"])


class Watch:
    """A monitor of logs that differ from the one that was fitted, and the stream of its rows."""

    def __init__(self, fit: Fit) -> None:
        from ident.equations.filter import STANDING
        from ident.streams.monitor import Monitor
        from ident.streams.stream import Stream

        self.monitor = Monitor.of(fit, fit.motion)
        watched = self.monitor.watched
        mechanism, columns, point = watched.mechanism, watched.columns, watched.point
        latency = self.monitor.seconds / 2  # alarms come by intervals
        self._stream = Stream(mechanism, columns, fit.motion, point, latency, STANDING)

    def alarms(self, samples: Mapping[str, np.ndarray] | None) -> list[Alarm]:
        """Return the alarms that further samples raise; None: those that still wait."""
        try:
            made = self._stream.flush(True) if samples is None else self._stream.push(samples)
        except LogError:  # of one sample, which is left out
            made = []
        alarms = [alarm for rows in made for alarm in self.monitor.absorb(rows)]
        return alarms if samples is not None else [*alarms, *self.monitor.finish()]


class Session(contextlib.ExitStack):
    """Lines of a log, one by one: printed every so many seconds of the log, and recorded in the
    history and in parameters.csv, multipliers.csv and alarms.csv of a folder, if there is one.
    """

    def __init__(
        self,
        online: Online,
        watch: Watch | None,
        folder: Path | None,
        every: float | None,
        history: MonitorHistory | None = None,
    ) -> None:
        super().__init__()
        self._online, self._watch, self._history = online, watch, history
        self._every, self._lines = RECORDED if every is None else every, every is not None
        self._due, self._left_out = -float("inf"), 0
        self._waiting = 0  # line of the sample that may wait for its successor
        self.raised: list[Alarm] = []
        self._noted, self._waiting_findings = set[str](), list[str]()
        self._tables: dict[str, Any] = {}
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            headers: dict[str, Sequence[str]] = {"parameters": PARAMETERS, "alarms": ALARMS}
            if names := online.mechanism.kinematics.multipliers:
                headers["multipliers"] = ("t", *names, *(f"{name}.stderr" for name in names))
            for name, header in headers.items():
                stream = self.enter_context(_appended(folder / f"{name}.csv", header))
                self._tables[name] = csv.writer(stream, lineterminator="\n")

    def take(self, lines: CsvLines) -> None:
        """Take lines of the log that came together."""
        for number, why in lines.bad:
            self._leave_out(number, why)
        source = self._online.mechanism.columns.get("t")
        t = lines.columns.get(source.column if source else "t", np.zeros(len(lines)))
        t = t if source is None else source.scale * t + source.offset
        start = 0
        while start < len(lines):  # a printed line ends a part
            due = t[start:] >= self._due if self._online.warm else np.zeros(1)
            stop = start + int(due.argmax()) + 1 if due.any() else len(lines)
            self._take(lines.part(slice(start, stop)))
            start = stop

    def _take(self, lines: CsvLines) -> None:
        online = self._online
        try:
            online.update(lines.columns)
            left_out = online.left_out
        except LogError as error:
            left_out = [(0, str(error))]
        for row, why in left_out:  # a negative one has waited since the lines before
            self._leave_out(int(lines.numbers[row]) if row >= 0 else self._waiting, why)
        rows = set(range(len(lines))) - {row for row, _ in left_out}
        self._waiting = int(lines.numbers[max(rows)]) if rows else self._waiting
        self._note(online.findings)
        self._record_forces()
        self._warn(lines.columns)
        if online.warm and online.t >= self._due:
            self._due = online.t + self._every
            with contextlib.suppress(FitError):  # no equation yet, so soon
                snapshot = self._snapshot(online.snapshot())
                if self._lines:
                    result(snapshot.line)

    def _leave_out(self, number: int, why: str) -> None:
        self._left_out += 1
        if self._left_out <= MOST_NOTED:
            notes([f"line {number} is left out: {why}"])
        elif self._left_out == MOST_NOTED + 1:
            notes(["further lines are left out, without a note"])

    def end(self) -> Snapshot:
        """Return the last snapshot, after the last alarms."""
        self._warn(None)
        snapshot = self._snapshot(self._online.finish())
        self._note(self._online.findings)
        if not self.raised:  # an alarm says what has changed, which these only see
            notes(self._waiting_findings)
        return snapshot

    def _note(self, findings: Sequence[object]) -> None:
        """Note findings, each once; of a machine that is watched at the end, without an alarm."""
        new = [x for x in map(str, findings) if x not in self._noted]
        self._noted.update(new)
        if self._watch:
            self._waiting_findings += new
        else:
            notes(new)

    def _snapshot(self, snapshot: Snapshot) -> Snapshot:
        self._record_forces()
        rows: list[tuple[object, ...]] = []
        for v in snapshot.parameters:
            state = "identified" if v.identifiable else "prior"
            state = "held" if v.name in snapshot.held else state
            rows.append((snapshot.t, v.name, v.value, v.stderr, v.unit, state))
        for name, e in snapshot.errors.items():
            rows.append((snapshot.t, f"error.{name}", e.rms, None, e.unit, "all"))
        self._record("parameters", rows)
        if self._history is not None:
            monitor = self._watch.monitor if self._watch else None
            both = (monitor.errors, monitor.usual_errors) if monitor else ({}, {})
            self._history.add(snapshot, None, *both)
        return snapshot

    def _record_forces(self) -> None:
        """Record a row a sample; a multiplier that is not determined has empty cells."""
        if (forces := self._online.multipliers) is None:
            return
        rows = np.column_stack([forces.t, forces.values, forces.stderr]).tolist()
        self._record("multipliers", [["" if x != x else x for x in row] for row in rows])
        if self._history is not None:
            self._history.add_forces(forces)

    def _warn(self, samples: Mapping[str, np.ndarray] | None) -> None:
        for x in self._watch.alarms(samples) if self._watch else ():
            self.raised.append(x)
            if self._history is not None:
                self._history.alarms.append(x)
            result(f"alarm: {x.headline}")
            suspects = " ".join(x.suspects)
            row = (x.onset, x.detected, x.named, x.verdict, suspects, x.evidence, x.headline)
            self._record("alarms", [row])

    def _record(self, name: str, rows: Sequence[Sequence[object]]) -> None:
        if name in self._tables:
            self._tables[name].writerows(rows)


@contextlib.contextmanager
def _until_interrupted() -> Iterator[Callable[[], bool]]:
    """Yield whether Ctrl-C or SIGTERM has asked for an end."""
    stop = threading.Event()
    before = {s: signal.signal(s, lambda *_: stop.set()) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop.is_set
    finally:
        for signal_number, handler in before.items():
            signal.signal(signal_number, handler)


def _appended(path: Path, header: Sequence[str]) -> TextIO:
    """Open a CSV file to which whole lines are appended, begun with its header."""
    try:
        stream = path.open("a+", encoding="utf-8", newline="", buffering=1)
        stream.seek(0)
        before = stream.readline().rstrip("\r\n")
    except OSError as error:
        why = f"cannot be written ({error.strerror}); name a folder that you may write"
        raise IdentError(f"{path}: {why}") from None
    if before not in ("", ",".join(header)):
        stream.close()
        raise IdentError(
            f"{path}: has other columns than would be written; remove it, or name another folder"
        )
    if not before:
        stream.write(",".join(header) + "\n")
    return stream
