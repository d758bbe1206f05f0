"""Pictures as nouns: what they show is said once, and drawn still (Matplotlib) or live (Bokeh)."""

from ident.chart.chart import Chart, Panel
from ident.chart.marks import Bars, Boxes, Dots, Level, Line, Points
from ident.chart.palette import MEASURED, PRIOR, RESIDUAL

__all__ = [
    "MEASURED",
    "PRIOR",
    "RESIDUAL",
    "Bars",
    "Boxes",
    "Chart",
    "Dots",
    "Level",
    "Line",
    "Panel",
    "Points",
]
