"""A mechanism moving in 3-D: what is shown, as plain arrays, and the pages that show it."""

from ident.view.rotation import rotations, wxyz
from ident.view.shapes import Shape, box, capsule, cylinder, ellipsoid, sphere
from ident.view.stage import Body, Film, Loads, Pivot, Stage, Tie
from ident.view.timing import frames, running_rms
from ident.view.view import View

__all__ = [
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
