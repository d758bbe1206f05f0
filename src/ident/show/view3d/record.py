"""A recording: one page with viser's player and the films in it, which needs no server."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.show.view3d.client import close_page, open_page
from ident.show.view3d.draw import aim, draw
from ident.show.view3d.setting import Setting
from ident.show.view3d.stage import Film
from ident.show.view3d.timing import frames
from ident.show.view3d.words import overlaid

RATE = 30.0  # frames a second of motion
MOST, LEAST = 600, 150  # frames of a recording, over all films
PAUSE = 0.5  # s between two films, in which the last picture stays


def recording(setting: Setting) -> str:
    """The page (HTML) that plays all films of a setting, one after the other."""
    films = kept(setting.films)
    page = open_page(setting.title)
    try:
        aim(page, setting.camera, setting.stage.up)
        drawn = draw(
            page.scene,
            setting.stage,
            setting.scales,
            setting.camera,
            setting.loads,
        )
        if sum(len(film) for film in films) > 1:
            drawn.title = page.scene.add_label(
                "/time", "", position=_above(setting), anchor="bottom-center"
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
    return overlaid(document, setting.title, setting.legend)


def kept(films: Sequence[Film]) -> list[Film]:
    """What of some films a recording holds: fewer moments than a live page shows."""
    most, least = (max(2, number // max(len(films), 1)) for number in (MOST, LEAST))
    return [film.at(frames(film.t, RATE, most, least)) for film in films]


def _above(setting: Setting) -> np.ndarray:
    """Over the middle of the motion, out of its way."""
    camera, up = setting.camera, setting.stage.up
    away = camera.position - camera.target
    right = np.cross(up, away)
    over = np.cross(away, right)
    over /= np.linalg.norm(over)
    corners = np.array(np.meshgrid(*camera.box.T)).reshape(3, -1).T - camera.target
    return camera.target + (1.04 * float((corners @ over).max())) * over
