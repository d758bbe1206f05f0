"""Viser's page with a mechanism in it, live or recorded, and the noun `View` that shows itself.

The browser part comes with viser, so nothing is fetched; its offer to share the page through a
server elsewhere is refused.
"""

from __future__ import annotations

import contextlib
import html
import os
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from rich import get_console

from ident.errors import IdentError
from ident.files import write_all
from ident.show.local import Place
from ident.show.view3d.bodies import ENDS, OPACITY, Colour, tied
from ident.show.view3d.draw import MOMENTS, Drawing, DrawnMechanism, mapped
from ident.show.view3d.film import Film, frames, nearest

CLOSED = 1e-7  # [m | rad] |Φ| of a closure that nobody would call open
SHOWN = 6  # closures and notes that are listed
RATE, MOST, SHORTEST = 30.0, 600, 150  # frames of a recording: in a second, at most, at least
PAUSE = 0.5  # s between two films, in which the last picture stays
TICK = 1 / 30  # s between two pictures of the live page
SPEEDS = ("0.05×", "0.1×", "0.25×", "0.5×", "1×", "2×", "5×", "10×")
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
                'joints: residual, {}<br><span style="display:block;height:9px;border-radius:2px;'
                'background:linear-gradient(to right, {})"></span><span style="display:flex;'
                'justify-content:space-between"><span>0</span><span>{:.3g} %</span></span>'
            ).format(scales.unit, ramp, 100 * scales.misfit)
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
    films, title = recorded(view.films), view.mechanism.name
    with open_page(title, Place()) as page:
        drawing = Drawing(page, view)
        if sum(len(film) for film in films) > 1:
            drawing.title = page.scene.add_label(
                "/time", "", position=_above(view), anchor="bottom-center"
            )
        drawing.show(films[0], 0)
        tape = page.get_scene_serializer()
        for film in films:
            for k in range(len(film)):
                drawing.show(film, k)
                if k + 1 < len(film):
                    tape.insert_sleep(float(film.t[k + 1] - film.t[k]))
            if len(film) > 1 or len(films) > 1:
                tape.insert_sleep(PAUSE)
        document = tape.as_html()
    head = f"<title>{html.escape(title)}</title>"
    document = document.replace("<title>Viser</title>", head, 1).replace("Viser client", "ident", 1)
    # legible in whatever encoding a notebook is exported to
    panel = PANEL.format(title, legend(view)).encode("ascii", "xmlcharrefreplace").decode("ascii")
    end = document.rindex("</body>")
    return document[:end] + panel + NOTICE + document[end:]


def recorded(films: Sequence[Film]) -> list[Film]:
    """Return what a recording has of films: fewer moments than a live page shows."""
    most, least = (max(2, number // max(len(films), 1)) for number in (MOST, SHORTEST))
    return [film.at(frames(film.t, RATE, most, least)) for film in films]


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
        return sum(len(film) for film in recorded(self.films))

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
        """The live page, with controls, on 127.0.0.1 until `.stop()`.

        Args:
            port: 0 takes a free one.

        Raises:
            IdentError: if the port is taken or there is none such, or viser is not installed.
        """
        return Served(self, port)

    def __str__(self) -> str:
        length = sum(len(film) for film in self.films)
        lines = [
            f"view of {self.mechanism.name}: {len(self.mechanism.bodies.links)} bodies, "
            f"{len(self.films)} film(s) of {length} pictures in all; "
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


class Served:
    """The live page of a view, until it is stopped. Also a context: `with view.serve() as page`.

    Attributes:
        port: on 127.0.0.1; address: to open in a browser.
    """

    def __init__(self, view: View, port: int = 0) -> None:
        place = Place(port)
        self.port, self.address = place.port, place.address
        self._name, self._films = view.mechanism.name, view.films
        self._served = open_page(self._name, place)
        self._page = self._served.__enter__()
        self._end = threading.Event()
        self._film, self._time, self._speed = view.films[0], float(view.films[0].t[0]), 1.0
        self._playing, self._stale = len(self._film) > 1, True
        self._drawing = Drawing(self._page, view)
        self._slider: Any = None
        self._panel(legend(view))
        self._drawing.show(self._film, 0)
        self._player = threading.Thread(target=self._play, name="ident view", daemon=True)
        self._player.start()

    def wait(self) -> None:
        """Until somebody stops it."""
        while not self._end.wait(3600.0):
            pass

    def stop(self) -> None:
        """Close the page; once is enough."""
        if not self._end.is_set():
            self._end.set()
            self._player.join(timeout=5.0)
            self._served.__exit__(None, None, None)

    def __enter__(self) -> Served:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def __repr__(self) -> str:
        return f"{self._name}: {self.address}" + (" (ended)" * self._end.is_set())

    def _play(self) -> None:
        before = time.monotonic()
        while not self._end.wait(TICK):
            now = time.monotonic()
            film = self._film
            if self._playing and self._page.get_clients():  # nobody misses the beginning
                self._time += self._speed * (now - before)
                if self._time > film.t[-1]:
                    self._time = float(film.t[0])
                self._stale = True
            before = now
            if self._stale:
                self._stale = False
                k = int(nearest(film.t, np.array([self._time]))[0])
                with self._page.atomic():
                    self._drawing.show(film, k)
                    if self._slider is not None and self._playing:
                        self._slider.value = round(float(film.t[k]), 4)

    def _panel(self, text: Markup) -> None:
        """Add what a user can choose, beside the picture and not over it."""
        gui, drawing = self._page.gui, self._drawing
        gui.main_panel.dock_right()
        names = [f"{i + 1}. {film.name}" for i, film in enumerate(self._films)]
        if len(names) > 1:
            choice = gui.add_dropdown("Log", names, initial_value=names[0])
            choice.on_update(lambda _: self._choose(self._films[names.index(choice.value)]))
        if max(map(len, self._films)) > 1:
            self._controls(gui)

        def hide(label: str, shown: bool, handles: Sequence[Any]) -> None:
            box = gui.add_checkbox(label, initial_value=shown)

            @box.on_update
            def _(_event: Any) -> None:
                for each in handles:
                    each.visible = box.value

        hide("Names", False, drawing.names)
        see = gui.add_checkbox("See through bodies", initial_value=True)

        @see.on_update
        def _(_event: Any) -> None:
            for body in drawing.bodies:
                body.opacity = OPACITY if see.value else None

        if drawing.arrows:
            hide("Reactions", True, drawing.arrows)
        if text:
            gui.add_html(f'<div style="padding:0 1em;font-size:.85em">{text}</div>')

    def _choose(self, film: Film) -> None:
        self._film, self._time, self._stale = film, float(film.t[0]), True
        if self._slider is not None:
            self._slider.min, self._slider.max = _ends(film)
            self._slider.value = self._slider.min

    def _controls(self, gui: Any) -> None:
        low, high = _ends(self._film)
        button = gui.add_button("Pause" if self._playing else "Play")
        self._slider = gui.add_slider(
            "Time [s]", min=low, max=high, step=1e-4, initial_value=round(self._time, 4)
        )
        speed = gui.add_dropdown("Speed", SPEEDS, initial_value="1×")

        @button.on_click
        def _(_event: Any) -> None:
            self._playing = not self._playing
            button.label = "Pause" if self._playing else "Play"

        @self._slider.on_update
        def _(event: Any) -> None:
            if event.client is not None:  # a hand, not the player
                self._playing, button.label = False, "Play"
                self._time, self._stale = float(self._slider.value), True

        @speed.on_update
        def _(_event: Any) -> None:
            self._speed = float(speed.value.rstrip("×"))


def _ends(film: Film) -> tuple[float, float]:
    low, high = (round(float(t), 4) for t in (film.t[0], film.t[-1]))
    return low, max(high, low + 1e-4)
