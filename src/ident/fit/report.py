"""report.html: one file that opens without a network."""

from __future__ import annotations

import html
import io
from collections.abc import Sequence
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from ident.fit.plots import plot_multipliers, plot_torques
from ident.fit.summary import error_rows, rounded, shortened, shown

if TYPE_CHECKING:
    from ident.fit.fit import Fit
    from ident.fit.reactions import Reactions

LAMBDA = "multipliers over time"
STYLE = """
:root { color-scheme: light dark; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
table { border-collapse: collapse; margin: 0.5rem 0 1.5rem; }
th, td { padding: 0.15rem 0.8rem; text-align: right; border-bottom: 1px solid #8884; }
th:first-child, td:first-child { text-align: left; }
pre { white-space: pre-wrap; }
figure { margin: 0; background: white; } figure svg { max-width: 100%; height: auto; }
"""


def report_html(fit: Fit, reactions: Reactions | None = None) -> str:
    """The report of a fit: errors, measured against predicted, parameters, multipliers, notes."""
    joints = [fit.mechanism.joint(name).force_unit for name in fit.motion.independent]
    errors = {"train": fit.train, "held out": fit.held_out, **fit.validation}
    if fit.motion.band.cutoff:
        errors["unfiltered"] = fit.unfiltered
    parts = [
        f"<h1>{text(fit.mechanism.name)}</h1>",
        f"<pre>{text(fit.motion.summary)}</pre>",
        "<h2>Error of the predicted torque</h2>",
        table_html(error_rows(errors)),
        "<h2>Measured and predicted</h2>",
    ]
    for prediction in fit.predict():
        parts += [
            f"<h3>{text(prediction.name)}</h3>",
            figure_html(
                plot_torques(prediction, joints), "measured and predicted torque of every joint"
            ),
        ]
    if fit.effects:
        rows = [["effect", "value", "unit"]]
        rows += [[v.name, shown(v), v.unit] for e in fit.effects for v in e.parameters]
        parts += ["<h2>Effects</h2>", table_html(rows)]
    own = [value for value in fit.parameters if value.identifiable]
    if own:
        rows = [["parameter", "value", "prior", "unit"]]
        rows += [[v.name, shown(v), f"{v.prior:.5g}", v.unit] for v in own]
        parts += ["<h2>Identified parameters</h2>", table_html(rows)]
    combined = [value for value in fit.base_parameters if " " in value.name]
    if combined:
        rows = [["base parameter", "value", "unit"]]
        rows += [[shortened(v.name, 120), rounded(v.value, v.stderr), v.unit] for v in combined]
        parts += ["<h2>Base parameters</h2>", table_html(rows)]
    if fit.binding is not None:
        parts.append(f"<p>{text(str(fit.binding))}</p>")
    if fit.mechanism.kinematics.multipliers:
        parts.append("<h2>Multipliers</h2>")
        if reactions is not None:
            parts += [f"<pre>{text(str(reactions))}</pre>", figure_html(reactions.plot(), LAMBDA)]
        for t, values in fit.multipliers[1 if reactions else 0 :]:
            parts.append(figure_html(plot_multipliers(fit.mechanism, t, values), LAMBDA))
    if fit.warnings:
        items = "".join(f"<li>{text(warning)}</li>" for warning in fit.warnings)
        parts += ["<h2>Notes</h2>", f"<ul>{items}</ul>"]
    return page(f"{fit.mechanism.name}: identification", parts)


def page(title: str, parts: Sequence[str]) -> str:
    """A self-contained page of these pieces of HTML."""
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{text(title)}</title>'
        f"<style>{STYLE}</style></head><body>\n" + "\n".join(parts) + "\n</body></html>\n"
    )


def text(words: str) -> str:
    """Words that may hold any character."""
    return html.escape(words)


def table_html(rows: list[list[str]]) -> str:
    """A table whose first row is its head."""
    head = "".join(f"<th>{text(cell)}</th>" for cell in rows[0])
    body = "".join(
        "<tr>" + "".join(f"<td>{text(cell)}</td>" for cell in row) + "</tr>" for row in rows[1:]
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def figure_html(figure: Figure, label: str) -> str:
    """A picture inside the page, with words for who cannot see it."""
    stream = io.StringIO()
    figure.savefig(stream, format="svg", metadata={"Date": None})
    drawing = stream.getvalue()
    drawing = drawing[drawing.index("<svg") :]
    return f'<figure role="img" aria-label="{text(label)}">{drawing}</figure>'
