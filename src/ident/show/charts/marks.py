"""What is drawn in a panel. Positions along an axis with names are 0, 1, 2, …"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.show.charts.palette import MEASURED, Colour


@dataclass(frozen=True, eq=False)
class Line:
    """y (n,) over x (n,), which increases; a NaN in y breaks the line."""

    x: np.ndarray
    y: np.ndarray
    label: str = ""
    colour: Colour = 0
    width: float = 1.2
    dotted: bool = False  # with a dot at every value


@dataclass(frozen=True, eq=False)
class Points:
    """A cloud of y (n,) over x (n,)."""

    x: np.ndarray
    y: np.ndarray
    label: str = ""
    colour: Colour = 0


@dataclass(frozen=True, eq=False)
class Bars:
    """Horizontal bars of values (n,) ± errors (n,) at the rows `at` (n,)."""

    at: np.ndarray
    values: np.ndarray
    errors: np.ndarray
    label: str = ""
    colour: Colour = 0


@dataclass(frozen=True, eq=False)
class Dots:
    """Values (n,) ± errors (n,) at the rows `at` (n,)."""

    at: np.ndarray
    values: np.ndarray
    errors: np.ndarray
    label: str = ""
    colour: Colour = 0


@dataclass(frozen=True, eq=False)
class Boxes:
    """Of samples: 5, 25, 50, 75, 95 % quantiles (n, 5) at the columns `at` (n,), `width` wide."""

    at: np.ndarray
    quantiles: np.ndarray
    width: float
    label: str = ""
    colour: Colour = 0


@dataclass(frozen=True)
class Level:
    """A straight line across the panel at a value of y, or of x if `upright`; or y = x."""

    value: float = 0.0
    upright: bool = False
    diagonal: bool = False
    label: str = ""
    colour: Colour = MEASURED
    dashed: bool = False


Mark = Line | Points | Bars | Dots | Boxes | Level
