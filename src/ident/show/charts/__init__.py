"""Pictures as nouns: what they show is said once, and drawn still (Matplotlib) or live (Bokeh)."""

from ident.show.charts.chart import Chart, Panel
from ident.show.charts.marks import Bars, Boxes, Dots, Level, Line, Mark, Points
from ident.show.charts.palette import FAINT, MEASURED, PRIOR, RESIDUAL, Colour

__all__ = [
    "FAINT",
    "MEASURED",
    "PRIOR",
    "RESIDUAL",
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
