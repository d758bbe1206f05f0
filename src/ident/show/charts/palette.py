"""Colours that are legible on white and on black; FAINT is for what is to stand back."""

from __future__ import annotations

MEASURED, RESIDUAL, PRIOR, FAINT = "measured", "residual", "prior", "faint"

ROLES = {
    MEASURED: "#8f959e",
    PRIOR: "#8f959e",
    RESIDUAL: "#d1495b",
    FAINT: "#b9bec6",
    "mean": "#6b3fa0",
}
SERIES = (
    "#2b7bd1",  # blue
    "#d9730d",  # orange
    "#2a9d5c",  # green
    "#9a62d0",  # violet
    "#1598a5",  # teal
    "#a8763e",  # brown
    "#d6589f",  # pink
    "#8b8b1a",  # olive
    "#5c6bc0",  # indigo
    "#c0563f",  # brick
)

Colour = int | str


def colour(c: Colour) -> str:
    """Of a role by its name, or of a series by its number."""
    return ROLES[c] if isinstance(c, str) else SERIES[c % len(SERIES)]
