"""A mechanism moving in 3-D: what is shown, as plain arrays, and the pages that show it."""

from ident.show.view3d.stage import (
    Body,
    Film,
    Loads,
    Pivot,
    Shape,
    Stage,
    Tie,
    box,
    capsule,
    cylinder,
    ellipsoid,
    frames,
    rotations,
    running_rms,
    sphere,
    wxyz,
)
from ident.show.view3d.view import SUFFIXES, View

__all__ = [
    "SUFFIXES",
    "Body",
    "Film",
    "Loads",
    "Pivot",
    "Shape",
    "Stage",
    "Tie",
    "View",
    "box",
    "capsule",
    "cylinder",
    "ellipsoid",
    "frames",
    "rotations",
    "running_rms",
    "sphere",
    "wxyz",
]
