"""Debian's browser, drawing in software, which can reach nothing but this machine."""

from __future__ import annotations

import io
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

PATIENCE = 60.0  # s, for a picture drawn in software on a busy machine


@dataclass
class Looked:
    """A page as it was seen.

    The picture (h, w, 3), its words, the place of the drawing in it (x, y, width, height), what
    went wrong, what was fetched from where.
    """

    picture: np.ndarray = field(default_factory=lambda: np.zeros((1, 1, 3)))
    words: str = ""
    drawing: tuple[float, float, float, float] = (0, 0, 0, 0)
    faults: list[str] = field(default_factory=list)
    fetched: set[str] = field(default_factory=set)

    def like(self, colour: tuple[int, int, int], angle: float = 12.0) -> np.ndarray:
        """Pixels (k, 2) of the drawing, x then y, of a colour's hue, whatever the light."""
        rgb = self.picture.astype(float)
        tint = rgb - rgb.mean(axis=-1, keepdims=True)
        wanted = np.array(colour, float) - np.mean(colour)
        size = np.linalg.norm(tint, axis=-1)
        with np.errstate(invalid="ignore"):
            cosine = tint @ wanted / (size * np.linalg.norm(wanted))
        y, x = np.nonzero((size > 20) & (cosine > np.cos(np.radians(angle))))
        found, (left, top, width, height) = np.stack([x, y], axis=1), self.drawing
        inside = (x >= left) & (x < left + width) & (y >= top) & (y < top + height)
        return found[inside]

    def near(self, colour: tuple[int, int, int]) -> int:
        """How many pixels are `like` a colour."""
        return len(self.like(colour))


@pytest.fixture
def look(browser) -> Callable[..., Looked]:
    """`look(address, until)`: the page as soon as `until(looked)` holds, or after a minute.

    `do(page)` is what a user does first.
    """
    from PIL import Image

    def seen(
        address: str, until: Callable[[Looked], bool], do: Callable[[Any], None] | None = None
    ) -> Looked:
        context = browser.new_context(
            viewport={"width": 640, "height": 420}, offline=address.startswith("file:")
        )
        page, looked = context.new_page(), Looked()
        page.on("pageerror", lambda error: looked.faults.append(str(error)))
        page.on("console", lambda m: looked.faults.append(m.text) if m.type == "error" else None)
        page.on("request", lambda r: looked.fetched.add(urlsplit(r.url).scheme))
        page.on("websocket", lambda s: looked.fetched.add(urlsplit(s.url).netloc.split(":")[0]))
        try:
            page.goto(address)
            if do is not None:
                do(page)
            end = time.monotonic() + PATIENCE
            while time.monotonic() < end:
                page.wait_for_timeout(500)
                png = page.screenshot(timeout=1000 * PATIENCE)
                looked.picture = np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))
                looked.words = page.inner_text("body")
                if box := page.locator("canvas").first.bounding_box():
                    looked.drawing = (box["x"], box["y"], box["width"], box["height"])
                if until(looked):
                    break
        finally:
            context.close()
        return looked

    return seen
