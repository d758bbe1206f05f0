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
    for item in lost:
        torque, position = item.units
        place = "" if item.where in item.label else item.where
        rows.append([
            item.label, place, _size(item.torque, torque), _size(item.largest, torque),
            _size(item.before, torque), _size(item.position, position), item.nearest or "nothing",
        ])  # fmt: skip
    return rows


@renders(Export, "sheet")
def sheet(x: Export) -> Sheet:
    """Return what is held, what is lost with its size, notes and the replay's errors."""
    name = next(iter(x.files))
    fixed = x.translation.fixed
    title = f"{x.machine.name} as {x.target.title}: {name}, {len(x.machine.links)} joints"
    elements: dict[str, list[str]] = {}
    for label, element in fixed:
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
        "held": [{"effect": label, "element": element} for label, element in x.fixed],
        "lost": [
            {
                "effect": item.label, "where": item.where, "torque": item.torque,
                "largest": item.largest, "whole": item.before, "position": item.position,
                "units": list(item.units), "instead": item.nearest,
            }
            for item in x.lost
        ],
        "notes": list(x.notes),
        **({} if x.replays is None else {"replay": render(x.replays, "json")}),
    }  # fmt: skip


@renders(Fit, "export")
def export_of(fit: Fit, to: str, **options: Any) -> Export:
    """Return an identified machine for a simulator or a controller."""
    return export(fit, to, **options)
