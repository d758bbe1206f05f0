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
from ident.threads import on_one_thread

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

AFTER = 0.5  # s of work before a notebook gets a bar
EVERY = 0.2  # s between two changes of it
P = ParamSpec("P")
R = TypeVar("R")


def watched(verb: Callable[P, R]) -> Callable[P, R]:
    """Give a verb that is called without `progress` a bar, in a notebook or a terminal; linear
    algebra has one thread.
    """

    @wraps(verb)
    @on_one_thread
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
        with notebook_bar() as on_progress:
            yield on_progress
    elif sys.stderr is not None and sys.stderr.isatty():
        with terminal_bar() as (_, on_progress):
            yield on_progress
    else:
        yield None


@contextmanager
def terminal_bar() -> Iterator[tuple[Bar, Progress]]:
    """Show a bar on standard error while something long runs; nothing where that is no terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    with Bar(
        TextColumn("{task.description}", markup=False),
        BarColumn(), TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
        disable=not sys.stderr.isatty(),
        redirect_stdout=False,  # to where the user sends it, not to the bar's terminal
        redirect_stderr=False,
    ) as bar:  # fmt: skip
        task = bar.add_task("", total=1.0)
        yield bar, lambda what, share: bar.update(task, description=what, completed=share)


@contextmanager
def notebook_bar() -> Iterator[Progress]:
    """Show a bar below a notebook's cell after some work; it needs no widget, leaves nothing."""
    from IPython.display import HTML, display

    start = time.monotonic()
    handle, due = None, start + AFTER

    def on_progress(what: str, share: float) -> None:
        nonlocal handle, due
        now = time.monotonic()
        if now < due:
            return
        spent, due = now - start, now + EVERY
        remaining = f", {spent * (1 - share) / share:.0f} s left" if share > 0 else ""
        words = escape(f"{what}: {100 * share:.0f} %, {spent:.0f} s{remaining}")
        bar = HTML(f'<progress value="{share:.4f}"></progress> {words}')
        if handle is None:
            handle = display(bar, display_id=True)
        else:
            handle.update(bar)

    try:
        yield on_progress
    finally:
        if handle is not None:
            handle.update({"text/plain": ""}, raw=True)
