"""What was exported, as text: what the target holds, what it cannot say, and the replay."""

from __future__ import annotations

from typing import Any

from ident.display import render, renders
from ident.export import Export, export
from ident.export.laws import Lost
from ident.fit.result import Fit
from ident.show.html import Sheet
from ident.text import significant


def _size(x: float, unit: str) -> str:
    return f"{significant(x, 2)} {unit}"


def _lost_rows(lost: tuple[Lost, ...]) -> list[list[str]]:
    rows = [["effect", "at", "lost, rms", "largest", "whole", "at a 5 Hz controller", "instead"]]
    for each in lost:
        torque, position = each.units
        place = "" if each.where in each.label else each.where
        rows.append([
            each.label, place, _size(each.torque, torque), _size(each.largest, torque),
            _size(each.before, torque), _size(each.position, position), each.nearest or "nothing",
        ])  # fmt: skip
    return rows


@renders(Export, "sheet")
def sheet(x: Export) -> Sheet:
    """Return what is held, what is lost with its size, notes and the replay's errors."""
    name = next(iter(x.files))
    held = x.translation.held
    title = f"{x.machine.name} as {x.target.title}: {name}, {len(x.machine.links)} joints"
    elements: dict[str, list[str]] = {}
    for label, element in held:
        elements.setdefault(element, []).append(label)
    facts = {element: ", ".join(labels) for element, labels in elements.items()}
    tables: dict[str, Any] = {}
    if x.lost:
        tables[f"what it cannot say, over {x.translation.motion}"] = _lost_rows(x.lost)
    lines = [] if x.lost else ["nothing of the model is lost"]
    if x.replays is not None:
        tables |= dict(render(x.replays, "sheet").tables)
    return Sheet(title, facts=facts, tables=tables, lines=lines)


@renders(Export, "json")
def export_json(x: Export) -> dict[str, Any]:
    """Return the same as numbers."""
    return {
        "schema": "ident.export/1",
        "target": x.target.name,
        "files": list(x.files),
        "held": [{"effect": label, "element": element} for label, element in x.held],
        "lost": [
            {
                "effect": each.label, "where": each.where, "torque": each.torque,
                "largest": each.largest, "whole": each.before, "position": each.position,
                "units": list(each.units), "instead": each.nearest,
            }
            for each in x.lost
        ],
        "notes": list(x.notes),
        **({} if x.replays is None else {"replay": render(x.replays, "json")}),
    }  # fmt: skip


@renders(Fit, "export")
def export_of(fit: Fit, to: str, **options: Any) -> Export:
    """Return an identified machine for a simulator or a controller."""
    return export(fit, to, **options)
