"""Charts described once as plain data, drawn still by Matplotlib and live by BokehJS."""

from ident.show.charts.chart import SUFFIXES, Chart
from ident.show.charts.marks import (
    FAINT,
    MEASURED,
    PRIOR,
    RESIDUAL,
    Bars,
    Boxes,
    Colour,
    Dots,
    Level,
    Line,
    Mark,
    Panel,
    Points,
)

__all__ = [
    "FAINT",
    "MEASURED",
    "PRIOR",
    "RESIDUAL",
    "SUFFIXES",
    "Bars",
    "Boxes",
    "Chart",
    "Colour",
    "Dots",
    "Level",
    "Line",
    "Mark",
    "Panel",
    "Points",
]
