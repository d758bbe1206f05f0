"""Presentation: how every noun is shown as text, HTML, chart and 3-D view. On top of the kernel."""

from importlib import import_module

from ident.display import Displayed, render, renderer, renders

MODULES = {
    "assess": ("ladder",),
    "diagnosis": ("diagnosis", "diagnosis_report", "experiment", "ladder"),
    "excite": ("simulate",),
    "export": ("export",),
    "faults": ("fit",),
    "fit": ("comparison", "export", "fit", "residual"),
    "log": ("motion",),
    "mechanism": ("motion", "view"),
    "montecarlo": ("simulate",),
    "motion": ("motion",),
    "show": ("html",),
    "simulate": ("simulate",),
    "streams": ("streams",),
}
"""The modules of this package that render the classes of each other one."""


def load(kind: type) -> None:
    """Import the modules that register the renderers of a class."""
    package = kind.__module__.removeprefix("ident.").partition(".")[0]
    for module in MODULES.get(package, ()):
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
