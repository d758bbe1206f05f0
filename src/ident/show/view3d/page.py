"""Viser's page with a stage in it, live or recorded; the only file that imports viser.

The browser part comes with the package, so nothing is fetched. The server is bound to this machine
alone; its offer to share the page through a server elsewhere is refused.
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
from rich import get_console

from ident.errors import IdentError
from ident.files import write_all
from ident.show.local import Place
from ident.show.view3d import Film, frames, nearest
from ident.show.view3d.draw import ENDS, MOMENTS, SEE_THROUGH, FilmedStage, aim, css, css_ramp, draw


def open_page(title: str, place: Place) -> Any:
    """Return a viser server at a place of this machine."""
    try:
        import viser
    except ImportError:
        raise IdentError(
            "the 3-D view needs the package viser, which is not installed; pip install viser"
        ) from None

    class LocalServer(viser.ViserServer):  # type: ignore[misc, unused-ignore]
        def request_share_url(self, verbose: bool = True) -> str | None:
            return None  # it would open a tunnel to the outside

    with _quiet(), place.of_viser():  # it announces itself on standard output
        page = LocalServer(label=title, verbose=False)
    page.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
    return page


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Without what viser announces through rich, in notebooks too."""
    console = get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before


def close_page(page: Any) -> None:
    """End the server of `open_page`."""
    with _quiet():
        page.stop()


CLOSED = 1e-7  # [m | rad] |Φ| of a closure that nobody would call open
SHOWN = 6  # closures and notes that are listed


def legend(view: View) -> str:
    """Return what colours and lengths mean, as an HTML fragment, every name escaped."""
    stage, scales, notes, lines = view.stage, view.scales, view.notes, []
    if scales.misfit > 0:
        lines.append(
            "joints: residual, " + html.escape(scales.unit) + "<br>"
            f'<span style="display:block;height:9px;border-radius:2px;background:{css_ramp()}">'
            '</span><span style="display:flex;justify-content:space-between"><span>0</span>'
            f"<span>{100 * scales.misfit:.3g} %</span></span>"
        )
    for what, colours, largest, unit in (
        ("reaction forces λ", ENDS, scales.force, "N"),
        ("reaction moments λ", MOMENTS, scales.moment, "N m"),
    ):
        if largest > 0:
            lines.append(
                f"{what}, up to {largest:.3g} {unit}<br>{_dot(colours[0])} on a &ensp; "
                f"{_dot(colours[1])} on b"
            )
    if stage.ties:
        ties = [f"{tie.name}: a on {tie.a}, b on {tie.b}" for tie in stage.ties[:SHOWN]]
        ties += ["…"] * (len(stage.ties) > SHOWN)
        open_ = "closed" if scales.gap < CLOSED else f"open by up to {scales.gap:.2g}"
        lines.append(
            f"closures {_dot(ENDS[0])} a {_dot(ENDS[1])} b, {open_}<br>"
            + "<br>".join(html.escape(tie) for tie in ties)
        )
    said = [html.escape(note) for note in notes[:SHOWN]] + ["…"] * (len(notes) > SHOWN)
    lines += [f"<i>{note}</i>" for note in said]
    return "".join(f'<div style="margin:.45em 0">{line}</div>' for line in lines)


NOTICE = (
    "<!-- The player in this page is viser's (Apache License 2.0; copyright its authors), built "
    "with three.js, React and Mantine (MIT License; copyright their authors). -->"
)


def overlaid(page: str, title: str, text: str) -> str:
    """Return a recording's HTML document with its title and the legend `text` in a corner."""
    head = f"<title>{html.escape(title)}</title>"
    page = page.replace("<title>Viser</title>", head, 1).replace("Viser client", "ident", 1)
    panel = (
        '<details open style="position:fixed;top:10px;right:64px;z-index:3;max-width:17em;'
        "max-height:70vh;overflow:auto;padding:.5em .8em;border-radius:6px;color:#222;"
        "background:rgba(255,255,255,.85);box-shadow:0 0 4px rgba(0,0,0,.2);"
        'font:12px/1.35 system-ui,sans-serif"><summary style="cursor:pointer">'
        f"<b>{html.escape(title)}</b></summary>{text}</details>"
    )
    # legible in whatever encoding a notebook is exported to
    panel = panel.encode("ascii", "xmlcharrefreplace").decode("ascii")
    end = page.rindex("</body>")
    return page[:end] + panel + NOTICE + page[end:]


def _dot(colour: tuple[int, int, int]) -> str:
    return f'<span style="color:{css(colour)}">●</span>'


RATE = 30.0  # frames a second of motion
MOST, LEAST = 600, 150  # frames of a recording, over all films
PAUSE = 0.5  # s between two films, in which the last picture stays


def recording(view: View) -> str:
    """Return the page (HTML) that plays all films of a view, one after the other."""
    films, title = recorded(view.films), view.stage.name
    page = open_page(title, Place())
    try:
        aim(page, view)
        drawn = draw(page.scene, view)
        if sum(len(film) for film in films) > 1:
            drawn.title = page.scene.add_label(
                "/time", "", position=_above(view), anchor="bottom-center"
            )
        drawn.show(films[0], 0)
        tape = page.get_scene_serializer()
        for film in films:
            for k in range(len(film)):
                drawn.show(film, k)
                if k + 1 < len(film):
                    tape.insert_sleep(float(film.t[k + 1] - film.t[k]))
            if len(film) > 1 or len(films) > 1:
                tape.insert_sleep(PAUSE)
        document = tape.as_html()
    finally:
        close_page(page)
    return overlaid(document, title, legend(view))


def recorded(films: Sequence[Film]) -> list[Film]:
    """Return what a recording has of films: fewer moments than a live page shows."""
    most, least = (max(2, number // max(len(films), 1)) for number in (MOST, LEAST))
    return [film.at(frames(film.t, RATE, most, least)) for film in films]


def _above(view: View) -> np.ndarray:
    """Return a point (3,) [m] over the middle of the motion, out of its way."""
    camera = view.camera
    away = camera.position - camera.target
    over = np.cross(away, np.cross(view.stage.up, away))
    over /= np.linalg.norm(over)
    corners = np.array(np.meshgrid(*camera.box.T)).reshape(3, -1).T - camera.target
    return camera.target + (1.04 * float((corners @ over).max())) * over


HEIGHT = 480  # of a notebook's frame [px]
SUFFIXES = (".html", ".htm")


@dataclass(frozen=True, eq=False)
class View(FilmedStage):
    """A mechanism moving in 3-D.

    In a notebook it shows itself as a recording, which needs no server and stays in the file.

    Attributes:
        stage: bodies, joints and closures.
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


TICK = 1 / 30  # s between two pictures
SPEEDS = ("0.05×", "0.1×", "0.25×", "0.5×", "1×", "2×", "5×", "10×")


class Served:
    """The live page of a view, until it is stopped. Also a context: `with view.serve() as page`.

    Attributes:
        port: on 127.0.0.1; address: to open in a browser.
    """

    def __init__(self, view: View, port: int = 0) -> None:
        self._view = view
        place = Place(port)
        self.port, self.address = place.port, place.address
        self._page = open_page(view.stage.name, place)
        self._end = threading.Event()
        self._film, self._time, self._speed = view.films[0], float(view.films[0].t[0]), 1.0
        self._playing = len(self._film) > 1
        self._stale = True
        aim(self._page, view)
        self._drawn = draw(self._page.scene, view)
        self._slider: Any = None
        self._panel()
        self._drawn.show(self._film, 0)
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
            close_page(self._page)

    def __enter__(self) -> Served:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def __repr__(self) -> str:
        return f"{self._view.stage.name}: {self.address}" + (" (ended)" * self._end.is_set())

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
                    self._drawn.show(film, k)
                    if self._slider is not None and self._playing:
                        self._slider.value = round(float(film.t[k]), 4)

    def _panel(self) -> None:
        gui, films = self._page.gui, self._view.films
        gui.main_panel.dock_right()  # beside the picture, not over it
        if len(films) > 1:
            self._choice(gui, films)
        if max(len(film) for film in films) > 1:
            self._controls(gui)
        self._checks(gui)
        if text := legend(self._view):
            gui.add_html(f'<div style="padding:0 1em;font-size:.85em">{text}</div>')

    def _choice(self, gui: Any, films: Sequence[Film]) -> None:
        names = [f"{i + 1}. {film.name}" for i, film in enumerate(films)]
        choice = gui.add_dropdown("Log", names, initial_value=names[0])

        @choice.on_update
        def _(_event: Any) -> None:
            self._film = films[names.index(choice.value)]
            self._time, self._stale = float(self._film.t[0]), True
            if self._slider is not None:
                self._slider.min, self._slider.max = _ends(self._film)
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

    def _checks(self, gui: Any) -> None:
        drawn = self._drawn
        names = gui.add_checkbox("Names", initial_value=False)
        see = gui.add_checkbox("See through bodies", initial_value=True)
        arrows = [*drawn.forces, *drawn.moments]

        @names.on_update
        def _(_event: Any) -> None:
            for label in drawn.names:
                label.visible = names.value

        @see.on_update
        def _(_event: Any) -> None:
            for mesh in drawn.meshes:
                mesh.opacity = SEE_THROUGH if see.value else None

        if arrows:
            reactions = gui.add_checkbox("Reactions", initial_value=True)

            @reactions.on_update
            def _(_event: Any) -> None:
                for each in arrows:
                    each.visible = reactions.value


def _ends(film: Film) -> tuple[float, float]:
    low, high = (round(float(t), 4) for t in (film.t[0], film.t[-1]))
    return low, max(high, low + 1e-4)
