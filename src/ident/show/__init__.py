"""Presentation: how every noun is shown as text, HTML, chart and 3-D view. On top of the kernel."""

from importlib import import_module

from ident.display import Displayed, renders

MODULES = {
    "diagnosis": ("Health", "Step"),
    "diagnosis_report": ("Diagnosis", "History"),
    "excite": ("Excitation",),
    "fit": (
        "Binding", "Comparison", "Correlation", "Essential", "Failure", "Finding", "Fit",
        "Likelihood", "Reactions", "Residual", "Unexcited",
    ),
    "log": ("Log",),
    "mechanism": ("Mechanism",),
    "montecarlo": ("MonteCarlo", "Studies"),
    "motion": ("Motion",),
    "simulate": ("Replay", "Run"),
    "streams": (
        "Alarm", "Cause", "Forces", "Gathered", "LogComparison", "Monitor", "ParameterChange",
        "Snapshot", "Verdicts",
    ),
}  # fmt: skip
"""The classes that each module of this package renders."""
TEXTS = ("text", "summary", "line", "advice", "where")  # forms that need neither charts nor HTML


def load(name: str, form: str) -> None:
    """Import the module that registers the renderer of a class in a form, if there is one."""
    for module, names in MODULES.items():
        if name in names:
            import_module(f"ident.show.{module}")
            if module == "fit" and form not in TEXTS:
                import_module("ident.show.fit_pages")


@renders(Displayed, "html")
def preformatted(noun: Displayed) -> str:
    """Return the text of a noun as preformatted HTML, for nouns without tables of their own."""
    from html import escape

    return f"<pre>{escape(str(noun))}</pre>"
