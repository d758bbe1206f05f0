"""`ident`: its commands, imported when one is run, and what it writes to the terminal.

Results go to standard output, notes, progress and errors to standard error.
"""

from __future__ import annotations

import inspect
import io
import os
import shlex
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import copy_context
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, get_type_hints

import typer
from rich.console import Console
from rich.text import Text
from typer.core import TyperCommand, TyperGroup

from ident.display import Progress, running
from ident.errors import IdentError
from ident.files import LARGEST_LOG, json_line, most_bytes, version
from ident.show.progress import terminal_bar
from ident.text import merged

if TYPE_CHECKING:
    from rich.progress import Progress as Bar


class Piped(Console):
    """A console whose reader may leave: rich ends with status 1 then, a shell's tools with 141."""

    def on_broken_pipe(self) -> None:
        """Leave what happens to `ended_quietly`."""
        raise BrokenPipeError


errors = Piped(stderr=True, highlight=False, soft_wrap=True)
_starting: list[str] = []  # the line that shows that a command has begun
_steps: list[str] = []  # the present step of the command, for the line that Ctrl-C gets
_bars: list[Bar] = []  # the bar of progress that is shown
_resumed: list[bool] = []  # whether the command can go on later
_written: list[Path] = []  # files that the command has written
_held: list[str] = []  # notes that wait for the result


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
    for bar in _bars:
        bar.stop()
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()
    for bar in _bars:
        bar.start()


def styled(text: str, style: str) -> None:
    """Write a line to standard output, in a style where that is a terminal."""
    _begun()
    Piped(highlight=False, soft_wrap=True).print(Text(text, style))


def close_pipe() -> None:
    """Let output lead nowhere, since its reader, `head` perhaps, has closed it."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def notes(lines: Iterable[str]) -> None:
    """Write notes to standard error, one line each, first those that were held back; several of one
    kind are one line.
    """
    held, _held[:] = [*_held], []
    for each in merged([*held, *lines]):
        remark(f"note: {each}")


def notes_later(lines: Iterable[str]) -> None:
    """Hold notes back until the next ones, which follow the result, or the end of the command."""
    _held.extend(lines)


def wrote(paths: Iterable[Path]) -> None:
    """Note the files that were written."""
    for path in paths:
        _written.append(path)
        remark(f"note: wrote {path}")


def conclude(found: object, written: Iterable[Path] = (), remarks: Iterable[str] = ()) -> None:
    """Write a result, a mapping as one line of JSON, then what files were written, and notes."""
    result(json_line(found) if isinstance(found, Mapping) else found)
    wrote(written)
    notes(remarks)


def fail(why: object) -> NoReturn:
    """Write the one line that bad input gets, and end the command with status 1."""
    remark(f"error: {' '.join(str(why).split())}")
    sys.exit(1)


def interrupted() -> str:
    """Return one line for Ctrl-C: which step was left, and which files are complete."""
    files = "finished rounds are saved" if _resumed else "no file was written"
    files = f"complete: {', '.join(map(str, _written))}" if _written else files
    again = running.get()
    if _resumed:
        files += f"; go on with: {again}{' --resume' * ('--resume' not in again)}"
    elif again:
        files += f"; begin again with: {again}"
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
    for state in (_starting, _steps, _bars, _written, _resumed, _held):
        state.clear()
    try:
        try:
            yield
        finally:
            notes(())  # those that are held back
    except KeyboardInterrupt:
        remark(interrupted())
        sys.exit(130)
    except BrokenPipeError:
        close_pipe()
        sys.exit(141)


TYPED: dict[str, Any] = {  # what every command has of Typer
    "pretty_exceptions_enable": False,
    "rich_markup_mode": None,
    "context_settings": {"help_option_names": ["-h", "--help"]},
}
COMMANDS = {  # in which module of this package, and the first line of its docstring
    "check": ("logs", "Show what was understood, and what could be identified."),
    "identify": ("logs", "Identify parameters, effects and multipliers from logs."),
    "compare": ("logs", "Compare models with measurements, joint by joint."),
    "diagnose": ("logs", "Find where the model fails, and which effect is missing."),
    "grow": ("logs", "Add the best effect, refit, and repeat until none is missing."),
    "add": ("model", "Write effects into mechanism.toml."),
    "effects": ("model", "List the library of effects."),
    "simulate": ("model", "Simulate a log of the model itself."),
    "excite": ("model", "Plan a periodic motion that determines most, within limits."),
    "explore": ("logs", "Add effects by hand, in a browser; watch the error fall."),
    "montecarlo": ("model", "Study what noise does to the estimates: bias and spread."),
    "monitor": ("monitor", "Identify a machine while it runs; say when it changes."),
    "view": ("model", "Show the moving mechanism in 3-D, in a browser."),
    "demo": ("demo", "Show how a hidden effect is found, step by step."),
}


@cache
def command_of(name: str) -> Any:
    """The command itself, with its arguments and options."""
    function = getattr(import_module(f"ident.cli.{COMMANDS[name][0]}"), name)
    alone = typer.Typer(add_completion=False, **TYPED)
    alone.command(name)(flat(function))
    return typer.main.get_command(alone)


def flat(function: Callable[..., None]) -> Callable[..., None]:
    """Return a command whose options are those of a function and of its groups of options.

    A parameter that is annotated with a dataclass is a group: its fields become parameters.
    """
    hints = get_type_hints(function, include_extras=True)
    groups: dict[str, Any] = {name: hint for name, hint in hints.items() if is_dataclass(hint)}
    parameters = []
    for own in inspect.signature(function).parameters.values():
        inner = [(own.name, own.default, hints[own.name])]
        if group := groups.get(own.name):
            annotations = get_type_hints(group, include_extras=True)
            inner = [(f.name, f.default, annotations[f.name]) for f in fields(group)]
        parameters += [
            inspect.Parameter(
                name, own.KEYWORD_ONLY, annotation=hint,
                default=own.empty if default is MISSING else default,
            )
            for name, default, hint in inner
        ]  # fmt: skip

    def command(**values: Any) -> None:
        for name, group in groups.items():
            values[name] = group(**{each.name: values.pop(each.name) for each in fields(group)})
        with ended_quietly():
            starting(f"{function.__name__}: starting")
            copy_context().run(function, **values)

    command.__doc__ = function.__doc__
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {each.name: each.annotation for each in parameters}
    return command


class Late(TyperCommand):
    """Stands for a command until it is run, or its own help or options are asked for."""

    def make_context(self, info_name: str | None, args: list[str], *rest: Any, **more: Any) -> Any:
        """The context of the command that it stands for."""
        return command_of(str(self.name)).make_context(info_name, args, *rest, **more)


class Commands(TyperGroup):
    """All of them by name."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        for name, (_, line) in COMMANDS.items():
            self.add_command(Late(name, help=line, rich_markup_mode=None))


app = typer.Typer(
    name="ident",
    cls=Commands,
    help="Find out what is true of a mechanism from logged data.",
    no_args_is_help=True,
    **TYPED,
)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"ident {version()}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
    largest_log: Annotated[
        float | None,
        typer.Option(
            metavar="GB",
            help="Memory that the numbers of one log may take. Default: 4",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Find out what is true of a mechanism from logged data."""
    if largest_log is not None:
        os.environ[LARGEST_LOG] = str(largest_log)
        most_bytes()


def main() -> None:
    """Run a command; bad input is one line on standard error and status 1."""
    for stream in (sys.stdout, sys.stderr):  # a terminal that cannot show ² gets an escape
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    running.set(shlex.join(["ident", *sys.argv[1:]]))  # for reports
    try:
        app()
    except IdentError as error:
        fail(error)
    except OSError as error:
        fail(f"{error.filename or 'the system'}: {error.strerror or error}; check this path")
    except MemoryError:
        fail("not enough memory; give shorter logs, or read them in portions: --stream")
    except Exception as error:
        if "IDENT_TRACEBACK" in os.environ:
            raise
        *_, last = traceback.extract_tb(error.__traceback__)
        fail(
            f"a fault of ident, not of yours: {type(error).__name__} in {last.name}, "
            f"{last.filename}:{last.lineno}: {error}; IDENT_TRACEBACK=1 shows where it came from"
        )


if __name__ == "__main__":
    main()
