"""What the kernel knows of presentation: callbacks of progress, and a registry of renderers.

A noun derives from `Displayed` and asks for a form by name: `text`, `html`, `plot`, `view`, …
The package `ident.show` answers: the modules of it register one function for each noun and form.
They are imported at the first use, so that no kernel module imports a plotting library.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any

Progress = Callable[[str, float], None]
"""Called with the name of the present step and the share of it that is done, 0 to 1."""

running: ContextVar[str] = ContextVar("running", default="")
"""The command line, for reports; empty where there is none."""

folder: ContextVar[str] = ContextVar("folder", default="")
"""Where its files are written; empty where they are not."""


@contextmanager
def writing(place: str | Path) -> Iterator[None]:
    """Let commands in a result name the folder into which it is being written."""
    before = folder.set(str(place))
    try:
        yield
    finally:
        folder.reset(before)


acceptable: ContextVar[float | None] = ContextVar("acceptable", default=None)
"""Error, as a share of a joint's torque, that is good enough; None where none is stated."""


@dataclass(frozen=True)
class Inputs:
    """What a command line is given: the mechanism, logs, and options of the model as words.

    `like` are its logs of normal running, where it has any; `fit` is the folder of an earlier fit
    that is compared with the logs.
    """

    mechanism: str
    logs: tuple[str, ...]
    options: tuple[str, ...]
    like: tuple[str, ...] = ()
    fit: str = ""


inputs: ContextVar[Inputs | None] = ContextVar("inputs", default=None)
"""Those of the running command; None where there is none, or they do not describe its model."""


def no_progress(what: str, share: float) -> None:
    """Show nothing."""


def part(on_progress: Progress | None, start: float, end: float) -> Progress:
    """Report the progress of one part of the work as that of the whole, between two shares."""
    if on_progress is None:
        return no_progress
    return lambda what, share: on_progress(what, start + share * (end - start))


Renderer = Callable[..., Any]
_renderers: dict[tuple[type, str], Renderer] = {}
_load: Callable[[type], object] = lambda kind: None  # noqa: E731


def renders(noun: type, form: str) -> Callable[[Renderer], Renderer]:
    """Register the decorated function as the one that renders a class in a form."""

    def register(renderer: Renderer) -> Renderer:
        _renderers[noun, form] = renderer
        return renderer

    return register


def set_loader(load: Callable[[type], object]) -> None:
    """Set the function that imports the renderers of a class."""
    global _load
    _load = load


def renderer(noun: object, form: str) -> Renderer | None:
    """Return the renderer of a noun's class in a form, or that of the nearest base class."""
    for kind in type(noun).__mro__:
        if (kind, form) not in _renderers:
            _load(kind)
        if known := _renderers.get((kind, form)):
            return known
    return None


def render(noun: object, form: str, *args: Any, **options: Any) -> Any:
    """Return a noun in a form."""
    if known := renderer(noun, form):
        return known(noun, *args, **options)
    raise TypeError(f"{type(noun).__name__} has no form '{form}'")


class Displayed:
    """A noun with a text for terminals and tables for Jupyter. Dataclasses need `repr=False`."""

    def __str__(self) -> str:
        return str(render(self, "text"))

    __repr__ = __str__

    @property
    def summary(self) -> str:
        """The text without notes and details, of nouns that have one."""
        return str(render(self, "summary"))

    def _repr_html_(self) -> str:
        return str(render(self, "html"))


class Plotted(Displayed):
    """A noun that also has a chart."""

    def plot(self, *args: Any, **options: Any) -> Any:
        """Return the chart of this noun; its type and options are those of the renderer."""
        return render(self, "plot", *args, **options)
