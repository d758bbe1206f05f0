"""The legend: what colours and lengths mean, as HTML in which nothing of a file is markup."""

from __future__ import annotations

import html
from collections.abc import Sequence

from ident.show.view3d.colours import ENDS, MOMENTS, css, css_ramp
from ident.show.view3d.scales import Scales
from ident.show.view3d.stage import Film, Stage

CLOSED = 1e-7  # [m | rad] |Φ| of a closure that nobody would call open
SHOWN = 6  # closures and notes that are listed


def legend(stage: Stage, films: Sequence[Film], scales: Scales, notes: Sequence[str]) -> str:
    """The legend of a view as an HTML fragment, styles included, every name escaped."""
    lines = []
    if scales.misfit > 0:
        lines.append(
            "joints: residual, " + html.escape(scales.unit) + "<br>"
            f'<span style="display:block;height:9px;border-radius:2px;background:{css_ramp()}">'
            '</span><span style="display:flex;justify-content:space-between"><span>0</span>'
            f"<span>{100 * scales.misfit:.3g} %</span></span>"
        )
    for what, colours, largest, unit in (
        ("reaction forces λ", ENDS, scales.force, "N"),
        ("reaction moments λ", MOMENTS, scales.moment, "N m"),
    ):
        if largest > 0:
            lines.append(
                f"{what}, up to {largest:.3g} {unit}<br>{_dot(colours[0])} on a &ensp; "
                f"{_dot(colours[1])} on b"
            )
    if stage.ties:
        ties = [f"{tie.name}: a on {tie.a}, b on {tie.b}" for tie in stage.ties[:SHOWN]]
        ties += ["…"] * (len(stage.ties) > SHOWN)
        open_ = "closed" if scales.gap < CLOSED else f"open by up to {scales.gap:.2g}"
        lines.append(
            f"closures {_dot(ENDS[0])} a {_dot(ENDS[1])} b, {open_}<br>"
            + "<br>".join(html.escape(tie) for tie in ties)
        )
    said = [html.escape(note) for note in notes[:SHOWN]] + ["…"] * (len(notes) > SHOWN)
    lines += [f"<i>{note}</i>" for note in said]
    return "".join(f'<div style="margin:.45em 0">{line}</div>' for line in lines)


NOTICE = (
    "<!-- The player in this page is viser's (Apache License 2.0; copyright its authors), built "
    "with three.js, React and Mantine (MIT License; copyright their authors). -->"
)


def overlaid(page: str, title: str, text: str) -> str:
    """A recording's page with its title and the legend in a corner.

    Args:
        page: HTML document; title: plain text; text: an HTML fragment.
    """
    head = f"<title>{html.escape(title)}</title>"
    page = page.replace("<title>Viser</title>", head, 1).replace("Viser client", "ident", 1)
    panel = (
        '<details open style="position:fixed;top:10px;right:64px;z-index:3;max-width:17em;'
        "max-height:70vh;overflow:auto;padding:.5em .8em;border-radius:6px;color:#222;"
        "background:rgba(255,255,255,.85);box-shadow:0 0 4px rgba(0,0,0,.2);"
        'font:12px/1.35 system-ui,sans-serif"><summary style="cursor:pointer">'
        f"<b>{html.escape(title)}</b></summary>{text}</details>"
    )
    # legible in whatever encoding a notebook is exported to
    panel = panel.encode("ascii", "xmlcharrefreplace").decode("ascii")
    end = page.rindex("</body>")
    return page[:end] + panel + NOTICE + page[end:]


def _dot(colour: tuple[int, int, int]) -> str:
    return f'<span style="color:{css(colour)}">●</span>'
