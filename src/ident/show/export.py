"""What was exported, as text: what the target holds, what it cannot say, and the replay."""

from __future__ import annotations

from typing import Any

from ident.display import render, renders
from ident.errors import IdentError
from ident.export import Export, export
from ident.export.laws import Lost
from ident.fit.result import Fit
from ident.show.html import Section, Sheet
from ident.text import percent, significant

FILM = 400  # shown: moments of the moving machine


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


@renders(Export, "report")
def report(x: Export) -> bytes:
    """Return the page of a replay: the written machine's motion beside the measured one, and the
    machine with the simulator's as a ghost.

    Raises:
        IdentError: of an export without a replay.
    """
    from ident.show.html import report_page
    from ident.show.view import Ghosts

    if x.replays is None or x.motion is None:
        raise IdentError("a page shows a replay, and there is none; give a log to replay")
    replays, motion = x.replays, x.motion
    models = tuple(replays.runs)
    ghosts = {
        number: Ghosts(
            slice(0, len(runs[0].t)), [run.coordinates for run in runs], replays.window, models
        )
        for number, runs in enumerate(zip(*replays.runs.values(), strict=True))
    }
    machine = render(x.machine.mechanism, "view", motion.experiments, (), FILM, ghosts)
    worst = {
        name: max((e for run in logs for e in run.errors.values()), key=lambda e: e.relative or 0.0)
        for name, logs in replays.runs.items()
    }
    words = "; ".join(
        f"{name}: at most {percent(error.relative)} of the way ({significant(error.rms)} "
        f"{error.unit} rms)"
        for name, error in worst.items()
    )
    title = f"{x.machine.name} in {x.simulator}"
    head = f"Simulated against measured motion, restarted every {replays.window:g} s. {words}."
    sections = (render(replays, "section"), Section("What the file holds", sheet(x).blocks()))
    return report_page(title, head, sections, (render(replays, "plot"),), (machine,))


@renders(Fit, "export")
def export_of(fit: Fit, to: str, **options: Any) -> Export:
    """Return an identified machine for a simulator or a controller."""
    return export(fit, to, **options)
