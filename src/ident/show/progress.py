"""A bar of progress in a notebook or a terminal, for verbs and commands that take long."""

from __future__ import annotations

import multiprocessing
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from html import escape
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from ident.display import Progress

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress as Bar

AFTER = 0.5  # s of work before a notebook gets a bar
EVERY = 0.2  # s between two changes of it
P = ParamSpec("P")
R = TypeVar("R")


def watched(verb: Callable[P, R]) -> Callable[P, R]:
    """Give a verb that is called without `display` a bar, in a notebook or a terminal.

    Called in a worker process, or with standard error in a file, it shows nothing.
    """

    @wraps(verb)
    def shown(*args: P.args, **options: P.kwargs) -> R:
        given: dict[str, Any] = dict(options)
        if given.get("progress") is not None:
            return verb(*args, **options)
        with _shown() as given["progress"]:
            return verb(*args, **given)

    shown.__module__ = "ident.public"  # where it is found again by its name
    return shown


@contextmanager
def _shown() -> Iterator[Progress | None]:
    """Show a bar where somebody sees it, else nothing."""
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    if multiprocessing.current_process().name != "MainProcess":
        yield None
    elif hasattr(shell, "kernel"):
        bar = NotebookBar()
        try:
            yield bar
        finally:
            bar.end()
    elif sys.stderr is not None and sys.stderr.isatty():
        from rich.console import Console

        with terminal_bar(Console(stderr=True)) as (_, on_progress):
            yield on_progress
    else:
        yield None


@contextmanager
def terminal_bar(console: Console) -> Iterator[tuple[Bar, Progress]]:
    """Show a bar in a terminal while something long runs; nothing where that is no terminal."""
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    with Bar(
        TextColumn("{task.description}", markup=False),
        BarColumn(), TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
        redirect_stdout=False,  # to where the user sends it, not to the bar's terminal
        redirect_stderr=False,
    ) as bar:  # fmt: skip
        task = bar.add_task("", total=1.0)
        yield bar, lambda what, share: bar.update(task, description=what, completed=share)


class NotebookBar:
    """A bar below the cell of a notebook, with the present step and the time left; needs no widget.

    It comes after some work, and leaves nothing.
    """

    def __init__(self) -> None:
        self._start = self._last = time.monotonic()
        self._handle: Any = None

    def __call__(self, what: str, share: float) -> None:
        """Show a step and the share of the whole work that is done."""
        now = time.monotonic()
        spent = now - self._start
        if spent < AFTER or (self._handle is not None and now - self._last < EVERY):
            return
        self._last = now
        left = f", {spent * (1 - share) / share:.0f} s left" if share > 0 else ""
        words = escape(f"{what}: {100 * share:.0f} %, {spent:.0f} s{left}")
        bar = f'<progress value="{share:.4f}" max="1"></progress> {words}'
        self._show({"text/html": bar, "text/plain": ""})

    def end(self) -> None:
        """Remove it."""
        if self._handle is not None:
            self._show({"text/plain": ""})

    def _show(self, data: dict[str, str]) -> None:
        from IPython.display import display

        if self._handle is None:
            self._handle = display(data, raw=True, display_id=True)
        else:
            self._handle.update(data, raw=True)
