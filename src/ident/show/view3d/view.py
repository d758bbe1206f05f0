"""The noun `View`: shown in notebooks, written as a page, or served."""

from __future__ import annotations

import html
import os
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from ident.errors import IdentError
from ident.files import write_all
from ident.show.view3d.page import Served, ViewSetup
from ident.show.view3d.stage import Film, Stage

HEIGHT = 480  # of a notebook's frame [px]
SUFFIXES = (".html", ".htm")


@dataclass(frozen=True, eq=False)
class View:
    """A mechanism moving in 3-D.

    In a notebook it shows itself as a recording, which needs no server and stays in the file.

    Attributes:
        stage: bodies, joints and closures.
        films: their motion, one an experiment.
        notes: what is shown otherwise than the files have it, or not at all.
    """

    stage: Stage
    films: tuple[Film, ...]
    notes: tuple[str, ...] = field(default=())

    @cached_property
    def scene(self) -> ViewSetup:
        """Camera, scales and legend."""
        return ViewSetup(self.stage.name, self.stage, self.films, self.notes)

    @property
    def moments(self) -> int:
        """Number of moments in a recording."""
        from ident.show.view3d.page import kept

        return sum(len(film) for film in kept(self.films))

    @cached_property
    def html(self) -> str:
        """A page that plays the films by itself: no server, no network.

        Raises:
            IdentError: if viser is not installed.
        """
        from ident.show.view3d.page import recording

        return recording(self.scene)

    def write(self, path: str | os.PathLike[str]) -> Path:
        """Write the page that plays the films, whole or not at all.

        Args:
            path: of the .html file.

        Raises:
            IdentError: for another suffix, or where it cannot be written.
        """
        path = Path(path)
        if path.suffix.lower() not in SUFFIXES:
            raise IdentError(
                f"{path}: unknown suffix '{path.suffix}'; valid: {', '.join(SUFFIXES)}"
            )
        return write_all(path.parent, {path.name: self.html.encode()})[0]

    def serve(self, port: int = 0) -> Served:
        """The live page, with controls, on 127.0.0.1 until `.stop()`.

        Args:
            port: 0 takes a free one.

        Raises:
            IdentError: if the port is taken or there is none such, or viser is not installed.
        """
        return Served(self.scene, port)

    def __str__(self) -> str:
        length = sum(len(film) for film in self.films)
        lines = [
            f"view of {self.stage.name}: {len(self.stage.bodies) - 1} bodies, "
            f"{len(self.films)} film(s) of {length} pictures in all; "
            ".serve() opens it, .write('view.html') keeps it"
        ]
        return "\n".join([*lines, *(f"  note: {note}" for note in self.notes)])

    __repr__ = __str__

    def _repr_html_(self) -> str:
        page = html.escape(self.html, quote=True)
        return (
            f'<iframe srcdoc="{page}" title="{html.escape(str(self.stage.name), quote=True)} in '
            f'3-D" width="100%" height="{HEIGHT}" style="border:1px solid #ddd"></iframe>'
        )
