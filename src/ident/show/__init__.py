"""Presentation: how every noun is shown as text, HTML, chart and 3-D view. On top of the kernel."""

from importlib import import_module

from ident.display import Displayed, renders

MODULES: dict[str, str] = {
    "Comparison": "compare",
    "Log": "log",
    "Mechanism": "mechanism",
    "Excitation": "excite",
    "Diagnosis": "diagnosis_report",
    "Health": "diagnosis",
    "History": "diagnosis_report",
    "Step": "diagnosis",
    "Alarm": "streams",
    "Cause": "streams",
    "Forces": "streams",
    "Gathered": "streams",
    "LogComparison": "streams",
    "Monitor": "streams",
    "ParameterChange": "streams",
    "Snapshot": "streams",
    "Verdicts": "streams",
    "Binding": "fit",
    "Correlation": "fit",
    "Essential": "fit",
    "Failure": "residual",
    "Finding": "fit",
    "Fit": "fit",
    "Likelihood": "fit",
    "MonteCarlo": "montecarlo",
    "Motion": "motion",
    "Run": "simulate",
    "Replay": "simulate",
    "Reactions": "fit",
    "Residual": "residual",
    "Studies": "montecarlo",
    "Unexcited": "fit",
}
"""The module of this package that renders a class, by the name of the class."""


def load(name: str) -> None:
    """Import the module that registers the renderers of a class, if there is one."""
    if module := MODULES.get(name):
        import_module(f"ident.show.{module}")


@renders(Displayed, "html")
def preformatted(noun: Displayed) -> str:
    """Return the text of a noun as preformatted HTML, for nouns without tables of their own."""
    from html import escape

    return f"<pre>{escape(str(noun))}</pre>"
