"""What is to be looked at: one joint, all joints, the ladder, numbers, the verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from ident.explore.exploration import Exploration
from ident.explore.plots import plot_all, plot_joint, plot_ladder
from ident.explore.rows import beside_verdict
from ident.explore.rung import Rung
from ident.explore.tables import body_rows, effect_rows
from ident.show.html import code, items, paragraph, table

VIEWS = ("Joint", "All joints", "Ladder", "Numbers", "Verdict")
UNJUDGED = (
    "Not judged yet. What is announced is a fall of error, and a falling error is no proof of a "
    "cause. `Judge it` weighs every effect against what logs without it show by chance, and says "
    "what this data cannot tell apart."
)


@dataclass(frozen=True, eq=False)
class Drawn:
    """Charts and HTML, from above."""

    pieces: tuple[tuple[str, Any], ...]

    def panes(self) -> list[Any]:
        """As Panel shows them."""
        import panel

        from ident.explore.parts import CSS, LiveChart

        wide = {"sizing_mode": "stretch_width"}
        return [
            panel.pane.HTML(piece, stylesheets=[CSS], **wide)
            if kind == "html"
            else LiveChart(
                data=piece.live().data(), words=piece.words, height=piece.live().height, **wide
            )
            for kind, piece in self.pieces
        ]


def drawn(e: Exploration, view: str, joint: str) -> Drawn:
    """The pieces of one view; the work of it is done here, away from the page.

    Args:
        e: what has been tried.
        view: one of `VIEWS`.
        joint: an independent one, for the view of it.
    """
    before = e.rungs[-2] if len(e.rungs) > 1 else e.now
    if view == "Joint":
        charts = plot_joint(before, e.now, joint)
        return _charts(charts, items([*e.now.risen(before), *depends(e.now, joint)]))
    if view == "All joints":
        return _charts([plot_all(e.now)])
    if view == "Ladder":
        return _charts([plot_ladder(e.rungs)], items(remarks(e.rungs)))
    if view == "Numbers":
        return Drawn((("html", numbers(e.now)),))
    d = e.now.diagnosis
    if d is None:
        return Drawn((("html", str(paragraph(UNJUDGED))),))
    beside = beside_verdict(e.candidates, d)
    return Drawn((("html", f"{paragraph(beside) if beside else ''}{code(str(d))}"),))


def _charts(charts: Sequence[Any], words: Any = "") -> Drawn:
    pieces = [("html", str(words))] if words else []
    return Drawn((*pieces, *(("chart", chart) for chart in charts)))


def depends(rung: Rung, joint: str) -> list[str]:
    """On what a joint's residual depends, in words."""
    failure = next(each for each in rung.fit.residual.where if each.joint == joint)
    if failure.white:
        return [f"what is left of {joint} alone cannot be told from noise in a log of this length"]
    found = [f"the residual of {joint} depends on {each}" for each in failure.depends_on]
    return found or [f"the residual of {joint} depends on no single signal, and is no noise"]


def remarks(rungs: Sequence[Rung]) -> list[str]:
    """Joints whose error a step has made larger, and why that can be."""
    return [text for a, b in pairwise(rungs) for text in b.risen(a)]


def numbers(rung: Rung) -> str:
    """Parameters ± standard error, and what a person should know before trusting them."""
    fit = rung.fit
    parts = []
    if fit.mechanism.effects:
        parts.append(table(effect_rows(fit), "Effects"))
    rows = body_rows(fit)
    if len(rows) > 1:
        parts.append(table(rows, "Identified parameters of bodies"))
    if fit.warnings:
        parts += [paragraph("Notes:"), items(fit.warnings)]
    return "\n".join(map(str, parts)) or str(paragraph("Nothing is identified by itself."))
