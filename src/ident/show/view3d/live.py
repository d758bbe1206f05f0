"""The live page: experiments to choose, play, pause, time and speed."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from typing import Any

from ident.show.view3d.client import HOST, close_page, open_page
from ident.show.view3d.draw import SEE_THROUGH, aim, draw
from ident.show.view3d.setting import Setting
from ident.show.view3d.stage import Film

TICK = 1 / 30  # s between two pictures
SPEEDS = ("0.05×", "0.1×", "0.25×", "0.5×", "1×", "2×", "5×", "10×")


class Served:
    """The live page of a view, until it is stopped. Also a context: `with view.serve() as page`.

    Attributes:
        port: on 127.0.0.1; address: to open in a browser.
    """

    def __init__(self, setting: Setting, port: int = 0) -> None:
        self._setting = setting
        self._page = open_page(setting.title, port)
        self.port: int = self._page.get_port()
        self.address = f"http://{HOST}:{self.port}"
        self._end = threading.Event()
        self._film, self._time, self._speed = setting.films[0], float(setting.films[0].t[0]), 1.0
        self._playing = len(self._film) > 1
        self._stale = True
        aim(self._page, setting.camera, setting.stage.up)
        self._drawn = draw(
            self._page.scene,
            setting.stage,
            setting.scales,
            setting.camera,
            setting.loads,
        )
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
        return f"{self._setting.title}: {self.address}" + (" (ended)" * self._end.is_set())

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
                k = film.nearest(self._time)
                with self._page.atomic():
                    self._drawn.show(film, k)
                    if self._slider is not None and self._playing:
                        self._slider.value = round(float(film.t[k]), 4)

    def _panel(self) -> None:
        gui, films = self._page.gui, self._setting.films
        gui.main_panel.dock_right()  # beside the picture, not over it
        if len(films) > 1:
            self._choice(gui, films)
        if max(len(film) for film in films) > 1:
            self._controls(gui)
        self._checks(gui)
        if text := self._setting.legend:
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
