"""Presentation: how every noun is shown as text, HTML, chart and 3-D view. On top of the kernel."""

from importlib import import_module

from ident.display import Displayed, render, renderer, renders

MODULES = {
    "comparison": ("Changes", "Comparison"),
    "diagnosis": ("Diagnosis",),
    "diagnosis_report": ("Diagnosis", "Health"),
    "experiment": ("Diagnosis",),
    "fit": (
        "Binding", "Correlation", "Fit", "Likelihood", "Reactions",
    ),
    "ladder": ("History", "Step"),
    "motion": ("Log", "Mechanism", "Motion"),
    "residual": ("Comparison", "Failure", "Fit", "Residual"),
    "simulate": ("Excitation", "MonteCarlo", "Replay", "Run"),
    "view": ("Mechanism",),
    "streams": (
        "Alarm", "Cause", "Forces", "Gathered", "LogComparison", "Monitor", "ParameterChange",
        "Snapshot", "Verdicts",
    ),
}  # fmt: skip
"""The classes that each module of this package renders."""


def load(name: str) -> None:
    """Import the module that registers the renderers of a class, if there is one."""
    for module, names in MODULES.items():
        if name in names:
            import_module(f"ident.show.{module}")


@renders(Displayed, "text")
def text(noun: Displayed) -> str:
    """Return the text of a noun that is described by a sheet."""
    return str(render(noun, "sheet").text())


@renders(Displayed, "html")
def html(noun: Displayed) -> str:
    """Return the tables of a noun that is described by a sheet, of another one its text."""
    from html import escape

    if renderer(noun, "sheet"):
        return str(render(noun, "sheet").html())
    return f"<pre>{escape(str(noun))}</pre>"
