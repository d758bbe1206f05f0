"""`ident`: its commands, imported when one is run, and what it writes to the terminal.

Results go to standard output, notes, progress and errors to standard error.
"""

from __future__ import annotations

import atexit
import gc
import inspect
import io
import os
import shlex
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from contextvars import copy_context
from dataclasses import fields, is_dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, TextIO, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup

from ident.display import Progress, no_progress
from ident.errors import IdentError
from ident.files import LARGEST_LOG, json_line, most_bytes, version
from ident.text import merged

if TYPE_CHECKING:
    from rich.progress import Progress as Bar


_starting: list[str] = []  # the line that shows that a command has begun
_pending: list[str] = []  # notes that wait for the result
_steps: list[str] = []  # the present step of the command, for the line that Ctrl-C gets
_bars: list[Bar] = []  # the bar of progress that is shown
_written: list[Path] = []  # files that the command has written
_command: list[str] = [""]  # the command line


def command_line() -> str:
    """Return the command line that runs, for reports; empty where there is none."""
    return _command[0]


def go_on_by_resuming() -> None:
    """Let the command that goes on after Ctrl-C be the present one with --resume."""
    _command[0] += " --resume"


def starting(what: str) -> None:
    """Show in a terminal that a command has begun, until it writes or shows anything else: the
    libraries that it needs take a second or two to be imported.
    """
    if sys.stderr.isatty():
        _starting[:] = [what]
        sys.stderr.write(f"{_in_style(f'{what} …', sys.stderr, dim=True)}\r")
        sys.stderr.flush()


def _begun() -> None:
    """Erase the line that shows that a command has begun."""
    if _starting:
        _starting.clear()
        sys.stderr.write("\r\x1b[K")
        sys.stderr.flush()


def result(text: object, stream: TextIO | None = None) -> None:
    """Write a line as it is, at once, and without a bar of progress in it; a result goes to
    standard output, all else to standard error, the `stream` then.
    """
    _begun()
    for bar in _bars:
        bar.stop()
    stream = stream or sys.stdout
    stream.write(f"{text}\n")
    stream.flush()
    for bar in _bars:
        bar.start()


def styled(text: str, **style: Any) -> None:
    """Write a line to standard output, in a style where that is a terminal that may have one."""
    result(_in_style(text, sys.stdout, **style))


def _in_style(text: str, stream: TextIO, **style: Any) -> str:
    unstyled = os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb"
    return text if unstyled or not stream.isatty() else typer.style(text, **style)


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
    pending, _pending[:] = [*_pending], []
    for note in merged([*pending, *lines]):
        result(f"note: {note}", sys.stderr)


def notes_later(lines: Iterable[str]) -> None:
    """Hold notes back until the next ones, which follow the result, or the end of the command."""
    _pending.extend(lines)


def wrote(paths: Iterable[Path]) -> None:
    """Note the files that were written, those of one folder in one line."""
    folders: dict[Path, list[str]] = {}
    for path in paths:
        _written.append(path)
        folders.setdefault(path.parent, []).append(path.name)
    top = min(folders, key=lambda folder: len(folder.parts), default=Path())
    inside = [folder for folder in folders if folder != top and top in folder.parents]
    for folder, names in folders.items():
        if folder in inside:
            continue
        below = [f"{item.relative_to(top)}/" for item in inside] if folder == top else []
        result(
            f"note: wrote {folder / names[0]}{''.join(f', {x}' for x in [*names[1:], *below])}",
            sys.stderr,
        )


def conclude(
    outcome: object,
    written: Iterable[Path] = (),
    remarks: Iterable[str] = (),
    *,
    verbose: bool = True,
) -> None:
    """Write a result, a mapping as one line of JSON, then what files were written, and notes; of
    several notes the first one and their number, where they are not all wanted.
    """
    result(json_line(outcome) if isinstance(outcome, Mapping) else outcome)
    wrote(written)
    every = merged([*_pending, *remarks])
    if not verbose and len(every) > 1:
        _pending.clear()
        every = [f"{len(every)} notes, the first: {every[0]}; --verbose shows them"]
    notes(every)


def fail(why: object) -> NoReturn:
    """Write the one line that bad input gets, and end the command with status 1."""
    result(f"error: {' '.join(str(why).split())}", sys.stderr)
    sys.exit(1)


@contextmanager
def progress() -> Iterator[Progress]:
    """Show a bar on standard error while something long runs; nothing where that is no terminal."""
    show: Progress = no_progress
    _begun()
    with ExitStack() as stack:
        if sys.stderr.isatty():
            from ident.show.progress import terminal_bar

            bar, show = stack.enter_context(terminal_bar())
            _bars[:] = [bar]

        def on_progress(what: str, share: float) -> None:
            _steps[:] = [what]
            show(what, share)

        yield on_progress
    _steps.clear()
    _bars.clear()


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
    "export": ("export", "Write it for a simulator or controller; prove it by replay."),
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
    for parameter in inspect.signature(function).parameters.values():
        inner, types = [parameter], hints
        if group := groups.get(parameter.name):
            types = get_type_hints(group, include_extras=True)
            inner = [*inspect.signature(group).parameters.values()]
        keyword = parameter.KEYWORD_ONLY
        parameters += [item.replace(kind=keyword, annotation=types[item.name]) for item in inner]

    def command(**values: Any) -> None:
        for name, group in groups.items():
            values[name] = group(**{field.name: values.pop(field.name) for field in fields(group)})
        for state in (_pending, _steps, _bars, _written):
            state.clear()
        context = copy_context()
        # 130 and 141 are what a shell reports of a program that ends by SIGINT or SIGPIPE
        try:
            try:
                starting(f"{function.__name__}: starting")
                context.run(function, **values)
            finally:
                notes(())  # those that are held back
        except KeyboardInterrupt:
            during = "".join(f" while {step}" for step in _steps)
            files = ", ".join(map(str, _written))
            text = (
                f"interrupted{during}; {f'complete: {files}' if files else 'no file was written'}"
            )
            if again := command_line():
                how = "go on" if "--resume" in again.split() else "begin again"
                text += f"; {how} with: {again}"
            result(text, sys.stderr)
            sys.exit(130)
        except BrokenPipeError:
            close_pipe()
            sys.exit(141)

    command.__doc__ = function.__doc__
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {element.name: element.annotation for element in parameters}
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
    # as the process ends, a search for what may be freed takes a tenth of a short command
    atexit.register(gc.freeze)
    for stream in (sys.stdout, sys.stderr):  # a terminal that cannot show ² gets an escape
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    _command[0] = shlex.join(["ident", *sys.argv[1:]])
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
