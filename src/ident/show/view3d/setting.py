"""A stage with its films, and what follows from both: camera, scales and legend."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from ident.show.view3d.camera import Camera, framed
from ident.show.view3d.scales import Scales, scales
from ident.show.view3d.stage import Film, Loads, Stage
from ident.show.view3d.words import legend


@dataclass(frozen=True, eq=False)
class Setting:
    """A stage with its films, and what follows from both."""

    title: str
    stage: Stage
    films: tuple[Film, ...]
    notes: tuple[str, ...] = ()

    @cached_property
    def camera(self) -> Camera:
        """That sees all films."""
        return framed(self.stage, self.films)

    @cached_property
    def scales(self) -> Scales:
        """Of all films."""
        return scales(self.films, self.stage.size)

    @property
    def loads(self) -> Loads | None:
        """Of the first film that has any."""
        return next((film.loads for film in self.films if film.loads is not None), None)

    @property
    def legend(self) -> str:
        """What colours and lengths mean (HTML)."""
        return legend(self.stage, self.films, self.scales, self.notes)
