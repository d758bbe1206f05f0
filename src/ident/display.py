"""What the kernel knows of presentation: callbacks of progress, and a registry of renderers.

A noun derives from `Displayed` and asks for a form by name: `text`, `html`, `plot`, `view`, …
The package `ident.show` answers: the modules of it register one function for each noun and form.
They are imported at the first use, so that no kernel module imports a plotting library.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ident.threads import on_one_thread

Progress = Callable[[str, float], None]
"""Called with the name of the present step and the share of it that is done, 0 to 1."""


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


@on_one_thread
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
