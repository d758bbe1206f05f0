"""Colours: of bodies, of the two ends of a closure, and of a residual."""

from __future__ import annotations

import numpy as np

from ident.show.view3d.shapes import Colour

BODIES: tuple[Colour, ...] = (
    (98, 132, 168),
    (143, 163, 104),
    (196, 154, 108),
    (126, 111, 156),
    (92, 152, 149),
    (178, 125, 134),
)
GROUND: Colour = (150, 150, 150)
ENDS: tuple[Colour, Colour] = ((200, 30, 60), (30, 80, 200))  # of a closure's a and b
MOMENTS: tuple[Colour, Colour] = ((235, 140, 20), (20, 150, 170))
UNKNOWN: Colour = (90, 90, 96)  # a joint of which no residual is known
MAP = "plasma"  # perceptually uniform, legible in grey and to the colour-blind


def body_colour(index: int) -> Colour:
    """Of the body at an index of the stage; 0 is the ground."""
    return GROUND if index == 0 else BODIES[(index - 1) % len(BODIES)]


def mapped(share: np.ndarray) -> np.ndarray:
    """Colours (…, 3) of 0 … 255 for shares (…); above 1 as 1, `UNKNOWN` for NaN."""
    from matplotlib import colormaps

    known = np.isfinite(share)
    rgb = colormaps[MAP](np.clip(np.where(known, share, 0.0), 0.0, 1.0))[..., :3]
    return np.where(known[..., None], np.round(255 * rgb), UNKNOWN).astype(np.uint8)


def css(colour: Colour) -> str:
    """The colour as style sheets write it."""
    return "#" + "".join(f"{int(part):02x}" for part in colour)


def css_ramp(steps: int = 9) -> str:
    """The residual's map from left to right, as style sheets write it."""
    found = mapped(np.linspace(0.0, 1.0, steps))
    return f"linear-gradient(to right, {', '.join(css(tuple(c)) for c in found)})"
