"""What the command line writes where: results to standard output, all else to standard error."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import NoReturn

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from ident.progress import Told

errors = Console(stderr=True, highlight=False, soft_wrap=True)


def result(text: object) -> None:
    """A result, to standard output, as it is."""
    sys.stdout.write(f"{text}\n")


def notes(said: Iterable[str]) -> None:
    """What a person should know, one line each, to standard error."""
    for line in dict.fromkeys(said):
        errors.print(f"note: {line}", markup=False, emoji=False)


def fail(why: object) -> NoReturn:
    """The one line that bad input gets; ends the command with status 1."""
    errors.print(f"error: {' '.join(str(why).split())}", markup=False, emoji=False)
    sys.exit(1)


@contextmanager
def progress() -> Iterator[Told]:
    """A bar on standard error while something long runs; nothing where that is no terminal."""
    with progress_and_results() as (told, _):
        yield told


@contextmanager
def progress_and_results() -> Iterator[tuple[Told, Callable[[object], None]]]:
    """The bar, and `result` for what is known before all is done; the bar makes way for it."""
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(
        *columns,
        console=errors,
        transient=True,
        disable=not errors.is_terminal,
        redirect_stdout=False,  # to where the user sends it, not to the bar's terminal
        redirect_stderr=False,
    ) as bar:
        task = bar.add_task("", total=1.0)

        def told(what: str, share: float) -> None:
            bar.update(task, description=what, completed=share)

        def shown(text: object) -> None:
            bar.stop()
            result(text)
            sys.stdout.flush()
            bar.start()

        yield told, shown
