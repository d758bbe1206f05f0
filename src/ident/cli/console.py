"""Terminal output: results to standard output, notes and progress to standard error."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from rich.console import Console
from rich.text import Text

from ident.files import json_line
from ident.progress import Progress, running
from ident.show.progress import terminal_bar

if TYPE_CHECKING:
    from rich.progress import Progress as Bar


class Piped(Console):
    """A console whose reader may leave: rich ends with status 1 then, a shell's tools with 141."""

    def on_broken_pipe(self) -> None:
        """Leave what happens to `ended_quietly`."""
        raise BrokenPipeError


errors = Piped(stderr=True, highlight=False, soft_wrap=True)
NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?![\w.])")
_starting: list[str] = []  # the line that shows that a command has begun
_steps: list[str] = []  # the present step of the command, for the line that Ctrl-C gets
_bars: list[Bar] = []  # the bar of progress that is shown
_resumed: list[bool] = []  # whether the command can go on later
_written: list[Path] = []  # files that the command has written


def starting(what: str) -> None:
    """Show in a terminal that a command has begun, until it writes or shows anything else: the
    libraries that it needs take a second or two to be imported.
    """
    if errors.is_terminal:
        _starting[:] = [what]
        errors.print(f"{what} …", style="dim", end="\r", markup=False, emoji=False)


def _begun() -> None:
    """Erase the line that shows that a command has begun."""
    if _starting:
        _starting.clear()
        errors.file.write("\r\x1b[K")
        errors.file.flush()


def remark(text: str) -> None:
    """Write a line to standard error."""
    _begun()
    errors.print(text, markup=False, emoji=False)


def result(text: object) -> None:
    """Write a result to standard output, as it is, at once, and without a bar of progress in it."""
    _begun()
    bar = _bars[-1] if _bars else None
    if bar is not None:
        bar.stop()
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()
    if bar is not None:
        bar.start()


def styled(text: str, style: str) -> None:
    """Write a line to standard output, in a style where that is a terminal."""
    _begun()
    Piped(highlight=False, soft_wrap=True).print(Text(text, style))


def result_json(content: Mapping[str, Any]) -> None:
    """Write a result as one line of JSON."""
    result(json_line(content))


def close_pipe() -> None:
    """Let output lead nowhere, since its reader, `head` perhaps, has closed it."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def notes(lines: Iterable[str]) -> None:
    """Write notes to standard error, one line each; several of one kind are one line."""
    for each in merged(lines):
        remark(f"note: {each}")


def merged(lines: Iterable[str]) -> list[str]:
    """Join lines that differ in a name before the colon and in numbers only, which become ranges.

    >>> merged(["a.csv: 9 samples are left out", "b.csv: 12 samples are left out", "x"])
    ['a.csv … b.csv (2): 9 to 12 samples are left out', 'x']
    """
    kinds: dict[str, list[tuple[str, str]]] = {}
    for line in dict.fromkeys(lines):
        log, colon, rest = line.partition(": ")
        if not colon or " " in log:
            log, rest = "", line
        kinds.setdefault(NUMBER.sub("#", rest) if log else line, []).append((log, rest))
    return [_one(kind) for kind in kinds.values()]


def _one(kind: list[tuple[str, str]]) -> str:
    logs, texts = list(dict.fromkeys(log for log, _ in kind)), [text for _, text in kind]
    numbers = zip(*map(NUMBER.findall, texts), strict=True)
    columns = (sorted(each, key=float) for each in numbers)
    ranges = (f"{c[0]} to {c[-1]}" if c[0] != c[-1] else c[0] for c in columns)
    text = NUMBER.sub(lambda _: next(ranges), texts[0])
    if len(logs) > 1:
        return f"{logs[0]} … {logs[-1]} ({len(logs)}): {text}"
    return f"{logs[0]}: {text}" if logs[0] else text


def wrote(paths: Iterable[Path]) -> None:
    """Note the files that were written."""
    for path in paths:
        _written.append(path)
        remark(f"note: wrote {path}")


def fail(why: object) -> NoReturn:
    """Write the one line that bad input gets, and end the command with status 1."""
    remark(f"error: {' '.join(str(why).split())}")
    sys.exit(1)


def interrupted() -> str:
    """Return one line for Ctrl-C: which step was left, and which files are complete."""
    files = f"complete: {', '.join(map(str, _written))}" if _written else "no file was written"
    if _resumed:
        again = running.get() + " --resume" * ("--resume" not in running.get())
        files += f"; go on with: {again}"
    return f"interrupted{''.join(f' while {step}' for step in _steps)}; {files}"


def can_resume(now: bool) -> None:
    """State whether the command can go on where it is, if Ctrl-C ends it."""
    _resumed[:] = [True] * now


@contextmanager
def progress() -> Iterator[Progress]:
    """Show a bar on standard error while something long runs; nothing where that is no terminal."""
    _begun()
    with terminal_bar(errors) as (bar, show):

        def on_progress(what: str, share: float) -> None:
            _steps[:] = [what]
            show(what, share)

        _bars[:] = [bar]
        yield on_progress
    _steps.clear()
    _bars.clear()


@contextmanager
def ended_quietly() -> Iterator[None]:
    """End a command with one line after Ctrl-C (status 130), without one where nobody reads (141).

    These are the statuses that a shell reports of a program that ends by the signal.
    """
    for state in (_starting, _steps, _bars, _written, _resumed):
        state.clear()
    try:
        yield
    except KeyboardInterrupt:
        remark(interrupted())
        sys.exit(130)
    except BrokenPipeError:
        close_pipe()
        sys.exit(141)
