"""A recording of viser's scene with a mechanism in it, and the noun `View` that shows itself.

The browser part comes with viser, so nothing is fetched; its offer to share the page through a
server elsewhere is refused.
"""

from __future__ import annotations

import contextlib
import html
import os
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from markupsafe import Markup
from rich import get_console

from ident.display import renders
from ident.errors import IdentError, MechanismError
from ident.files import write_all
from ident.mechanism import Mechanism
from ident.show.local import Place
from ident.show.view3d.bodies import ENDS, Colour, parts_of, tied
from ident.show.view3d.draw import MOMENTS, Drawing, DrawnMechanism, mapped
from ident.show.view3d.film import MOST, WIDTH, film_of

CLOSED = 1e-7  # [m | rad] |Φ| of a closure that nobody would call open
SHOWN = 6  # closures and notes that are listed
PAUSE = 0.5  # s between two films, in which the last picture stays
HEIGHT = 480  # of a notebook's frame [px]
SUFFIXES = (".html", ".htm")
NOTICE = (
    "<!-- The player in this page is viser's (Apache License 2.0; copyright its authors), built "
    "with three.js, React and Mantine (MIT License; copyright their authors). -->"
)
PANEL = Markup(
    '<details open style="position:fixed;top:10px;right:64px;z-index:3;max-width:17em;'
    "max-height:70vh;overflow:auto;padding:.5em .8em;border-radius:6px;color:#222;"
    "background:rgba(255,255,255,.85);box-shadow:0 0 4px rgba(0,0,0,.2);"
    'font:12px/1.35 system-ui,sans-serif"><summary style="cursor:pointer">'
    "<b>{}</b></summary>{}</details>"
)


@contextlib.contextmanager
def open_page(title: str, place: Place) -> Iterator[Any]:
    """Serve a page of viser at a place of this machine inside this context."""
    try:
        import viser
    except ImportError:
        raise IdentError(
            "the 3-D view needs the package viser, which is not installed; pip install viser"
        ) from None

    class LocalServer(viser.ViserServer):  # type: ignore[misc, unused-ignore]
        def request_share_url(self, verbose: bool = True) -> str | None:
            return None  # it would open a tunnel to the outside

    with _quiet(), place.of_viser():
        page = LocalServer(label=title, verbose=False)
    page.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
    try:
        yield page
    finally:
        with _quiet():
            page.stop()


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Silence what viser announces on standard output, where only results belong."""
    console = get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before


def legend(view: View) -> Markup:
    """Return what colours and lengths mean, as an HTML fragment."""
    scales, lines = view.scales, []
    if scales.misfit > 0:
        ramp = ", ".join(_css(tuple(c)) for c in mapped(np.linspace(0.0, 1.0, 9)))
        lines.append(
            Markup(
                "joints: rms of the residual over {:g} s, in % of the rms torque<br>"
                '<span style="display:block;height:9px;border-radius:2px;'
                'background:linear-gradient(to right, {})"></span><span style="display:flex;'
                'justify-content:space-between"><span>0</span><span>{:.3g} %</span></span>'
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
    return Markup("").join(Markup('<div style="margin:.45em 0">{}</div>').format(x) for x in lines)


def _first(names: Sequence[str]) -> list[str]:
    return [*names[:SHOWN], *["…"] * (len(names) > SHOWN)]


def _css(colour: Colour) -> str:
    return "#" + "".join(f"{int(part):02x}" for part in colour)


def _dot(colour: Colour) -> Markup:
    return Markup('<span style="color:{}">●</span>').format(_css(colour))


def recording(view: View) -> str:
    """Return the page (HTML) that plays all films of a view, one after the other."""
    films, title = view.films, view.mechanism.name
    with open_page(title, Place()) as page:
        label = None
        if view.moments > 1:
            at = _above(view)
            label = page.scene.add_label("/time", "", position=at, anchor="bottom-center")
        drawing = Drawing(page, view, label)
        drawing.show(films[0], 0)
        tape = page.get_scene_serializer()
        for film in films:
            for k in range(len(film)):
                drawing.show(film, k)
                if k + 1 < len(film):
                    tape.insert_sleep(float(film.t[k + 1] - film.t[k]))
            if view.moments > 1:
                tape.insert_sleep(PAUSE)
        document = tape.as_html()
    head = f"<title>{html.escape(title)}</title>"
    document = document.replace("<title>Viser</title>", head, 1).replace("Viser client", "ident", 1)
    # legible in whatever encoding a notebook is exported to
    panel = PANEL.format(title, legend(view)).encode("ascii", "xmlcharrefreplace").decode("ascii")
    end = document.rindex("</body>")
    return document[:end] + panel + NOTICE + document[end:]


def _above(view: View) -> np.ndarray:
    """Return a point (3,) [m] over the middle of the motion, out of its way."""
    camera = view.camera
    away = camera.position - camera.target
    over = np.cross(away, np.cross(camera.up, away))
    over /= np.linalg.norm(over)
    corners = np.array(np.meshgrid(*camera.box.T)).reshape(3, -1).T - camera.target
    return camera.target + (1.04 * float((corners @ over).max())) * over


@dataclass(frozen=True, eq=False)
class View(DrawnMechanism):
    """A mechanism moving in 3-D.

    In a notebook it shows itself as a recording, which needs no server and stays in the file.

    Attributes:
        mechanism: what is shown.
        parts: its shapes.
        films: their motion, one an experiment.
        notes: what is shown otherwise than the files have it, or not at all.
    """

    notes: tuple[str, ...] = ()

    @property
    def moments(self) -> int:
        """Number of moments in a recording."""
        return sum(map(len, self.films))

    @cached_property
    def html(self) -> str:
        """A page that plays the films by itself: no server, no network.

        Raises:
            IdentError: if viser is not installed.
        """
        return recording(self)

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
        """Serve the page on 127.0.0.1 until `.stop()`.

        Args:
            port: 0 takes a free one.

        Raises:
            IdentError: if the port is taken or there is none such, or viser is not installed.
        """
        return Served(self, port)

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
    mechanism: Mechanism, experiments: Sequence[Any] = (), predictions: Sequence[Any] = ()
) -> View:
    """Return the mechanism moving along experiments; without any, standing as assembled.

    Args:
        mechanism: the mechanism.
        experiments: of a motion.
        predictions: for each, whose reactions are arrows and whose residuals are colours.
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
    most = max(2, MOST // len(experiments))
    every = predictions or [None] * len(experiments)
    films = tuple(film_of(mechanism, e, p, most) for e, p in zip(experiments, every, strict=True))
    return View(mechanism, parts, films, (*notes, *more))


class Served:
    """The page of a view on this machine, until it is stopped; also a context.

    Attributes:
        port: on 127.0.0.1; address: to open in a browser.
    """

    def __init__(self, view: View, port: int = 0) -> None:
        place = Place(port)
        self.port, self.address = place.port, place.address
        self._name, self._end = view.mechanism.name, threading.Event()
        self._shut = place.serve(view.html, lambda _: None)

    def wait(self) -> None:
        """Until somebody stops it."""
        while not self._end.wait(3600.0):
            pass

    def stop(self) -> None:
        """Close the page; once is enough."""
        if not self._end.is_set():
            self._end.set()
            self._shut()

    def __enter__(self) -> Served:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def __repr__(self) -> str:
        return f"{self._name}: {self.address}" + (" (ended)" * self._end.is_set())
