"""`View`, a moving mechanism: a block of reports, and a page of its own beside charts of a fit."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from markupsafe import Markup

from ident.display import renders
from ident.errors import IdentError, MechanismError
from ident.files import write_all
from ident.mechanism import Mechanism
from ident.show.html import Block, Page, Section
from ident.show.local import Place, Served
from ident.show.view3d.bodies import ENDS, Colour, parts_of, tied
from ident.show.view3d.scene import MOMENTS, MOST, WIDTH, DrawnMechanism, film_of, mapped

CLOSED = 1e-7  # [m | rad] |Φ| of a closure that nobody would call open
SHOWN = 6  # closures and notes that are listed
HEIGHT = 480  # of a notebook's frame [px]
SUFFIXES = (".html", ".htm")


def legend(view: View) -> Markup:
    """Return what colours and lengths mean, as an HTML fragment."""
    scales, lines = view.scales, []
    if scales.misfit > 0:
        ramp = ", ".join(_css(tuple(c)) for c in mapped(np.linspace(0.0, 1.0, 9)))
        lines.append(
            Markup(
                "joints: rms of the residual over {:g} s, in % of the rms torque<br>"
                '<span class="ramp" style="background:linear-gradient(to right, {})"></span>'
                "0 … {:.3g} %"
            ).format(WIDTH, ramp, 100 * scales.misfit)
        )
    for what, (a, b), largest, unit in (
        ("reaction forces λ", ENDS, scales.force, "N"),
        ("reaction moments λ", MOMENTS, scales.moment, "N m"),
    ):
        if largest > 0:
            words = Markup("{}, up to {:.3g} {}<br>{} on a &ensp; {} on b")
            lines.append(words.format(what, largest, unit, _dot(a), _dot(b)))
    if ties := [f"{c.name}: a on {c.a.link}, b on {c.b.link}" for c in tied(view.mechanism)]:
        gap = "closed" if scales.gap < CLOSED else f"open by up to {scales.gap:.2g}"
        words = Markup("closures {} a {} b, {}<br>{}")
        listed = Markup("<br>").join(_first(ties))
        lines.append(words.format(_dot(ENDS[0]), _dot(ENDS[1]), gap, listed))
    lines += [Markup("<i>{}</i>").format(note) for note in _first(view.notes)]
    return Markup("").join(Markup("<p>{}</p>").format(x) for x in lines)


def _first(names: Sequence[str]) -> list[str]:
    return [*names[:SHOWN], *["…"] * (len(names) > SHOWN)]


def _css(colour: Colour) -> str:
    return "#" + "".join(f"{int(part):02x}" for part in colour)


def _dot(colour: Colour) -> Markup:
    return Markup('<span style="color:{}">●</span>').format(_css(colour))


@dataclass(frozen=True, eq=False)
class View(DrawnMechanism):
    """A mechanism moving in 3-D.

    In a notebook it shows itself as a page, which needs no server and stays in the file.

    Attributes:
        mechanism, parts, films, marks: of `DrawnMechanism`.
        notes: what is shown otherwise than the files have it, or not at all.
        charts: below the mechanism on its page, with a cursor that both share.
    """

    notes: tuple[str, ...] = ()
    charts: tuple[Block, ...] = ()

    @property
    def words(self) -> str:
        """Text alternative, for readers who cannot see it."""
        moving = " moving; move over a chart of time, or the slider, and it follows"
        return f"{self.mechanism.name} in 3-D{moving if self.moments > 1 else ''}"

    @property
    def legend(self) -> Markup:
        """What colours and lengths mean."""
        return legend(self)

    @property
    def moments(self) -> int:
        """Number of moments in a recording."""
        return sum(map(len, self.films))

    @cached_property
    def html(self) -> str:
        """A page with the mechanism and its charts: no server, no network."""
        title = f"{self.mechanism.name} in 3-D"
        # one section, in which the mechanism stays in view
        return Page(title, "", (Section("Machine", (self, *self.charts)),)).html().decode()

    def write(self, path: str | os.PathLike[str]) -> Path:
        """Write the page, whole or not at all.

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
        """Serve the page on 127.0.0.1 until `.stop()`.

        Args:
            port: 0 takes a free one.

        Raises:
            IdentError: if the port is taken or there is none such.
        """
        return Place(port).serve(self.html, lambda _: None)

    def __str__(self) -> str:
        lines = [
            f"view of {self.mechanism.name}: {len(self.mechanism.bodies.links)} bodies, "
            f"{len(self.films)} film(s) of {self.moments} pictures in all; "
            ".serve() opens it, .write('view.html') keeps it"
        ]
        return "\n".join([*lines, *(f"  note: {note}" for note in self.notes)])

    __repr__ = __str__

    def _repr_html_(self) -> str:
        frame = Markup(
            '<iframe srcdoc="{}" title="{} in 3-D" width="100%" height="{}" '
            'style="border:1px solid #ddd"></iframe>'
        )
        return str(frame.format(self.html, self.mechanism.name, HEIGHT))


@renders(Mechanism, "view")
def view_of(
    mechanism: Mechanism,
    experiments: Sequence[Any] = (),
    predictions: Sequence[Any] = (),
    most: int = MOST,
) -> View:
    """Return the mechanism moving along experiments; without any, standing as assembled.

    Args:
        mechanism: the mechanism.
        experiments: of a motion.
        predictions: for each, whose reactions are arrows and whose residuals are colours.
        most: moments of all of them.
    """
    notes: list[str] = []
    if not experiments:
        try:
            q = mechanism.assembled
        except MechanismError as error:  # a picture helps to see why
            q = mechanism.start
            notes.append(str(error))
        experiments = [SimpleNamespace(name="as assembled", t=np.zeros(1), q=q[None])]
    parts, more = parts_of(mechanism, experiments[0].q[0])
    nowhere = [c.name for c in mechanism.closures if not c.frames]
    if nowhere and predictions:
        more.append(
            f"{', '.join(nowhere)}: λ acts along coordinates, at no place: no arrow is drawn"
        )
    each = max(2, most // len(experiments))
    every = predictions or [None] * len(experiments)
    films = tuple(film_of(mechanism, e, p, each) for e, p in zip(experiments, every, strict=True))
    return View(mechanism, parts, films, notes=(*notes, *more))
