"""Charts, report and files of a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ident.diagnosis.diagnosis import Diagnosis, Explanation
from ident.diagnosis.selection import Evidence
from ident.diagnosis.unobservable import name_of
from ident.display import renders
from ident.files import json_bytes, plain, write_all
from ident.fit.residual import Residual, residual_of
from ident.show.charts import (
    FAINT,
    MEASURED,
    RESIDUAL,
    Bars,
    Chart,
    Colour,
    Level,
    Line,
    Panel,
    Points,
)
from ident.show.diagnosis import (
    candidate_rows,
    card,
    errors_of,
    health_sheet,
    labels,
    mark,
    numbers,
    where_rows,
)
from ident.show.fit import fit_sections
from ident.show.html import (
    Block,
    Choice,
    Option,
    Page,
    Section,
    headed,
    items,
    paragraph,
    table,
)
from ident.show.laws import curve_json, law_blocks
from ident.show.residual import plot_maps, time_label
from ident.text import percent

SCHEMA = "ident.diagnosis/1"
BARS = 12
LOGS = 4  # whose residuals are drawn below each other
KINDS: dict[str, Colour] = {
    "named": 0,
    "not distinguishable from it": MEASURED,
    "credible": 1,
    "not credible": FAINT,
}
MARKS = "* named; = this data cannot tell it from the one named."
FALLS = (
    "The chart and the column `gain` count all joints, weighed, on rows away from reversals, ± one "
    "standard error over stretches of time; `fall` is that of all rows. chance: the largest gain "
    "of all candidates where nothing is missing; visible: how much of its torque no other "
    "parameter could take over."
)
ADDED = (
    "Each point is a row of the fit. What is really this effect lies along the line; a bend or a "
    "loop is something else."
)


# --- charts ---------------------------------------------------------------------------------------


@renders(Diagnosis, "plot")
def plot_candidates(d: Diagnosis) -> Chart:
    """Draw the held-out gain of the best candidates ± standard error, and that of chance."""
    first = [each.evidence for i, each in enumerate(d.candidates) if mark(d, i) != " "]
    known = {each.effect.label for each in first}
    rest = [e for e in d.selection.first.evidence if e.effect.label not in known]
    shown = [*first, *rest][: max(BARS, len(first))]
    kinds: dict[str, list[int]] = {kind: [] for kind in KINDS}
    for i, e in enumerate(shown):
        own = "named" if i == 0 else "not distinguishable from it"
        kinds[own if i < len(first) else "credible" if e.credible else "not credible"].append(i)
    bars = []
    for kind, places in kinds.items():
        gains = 100 * np.array([shown[i].gain for i in places])
        scatter = 100 * np.array([_scatter(shown[i]) for i in places])
        if places:
            bars.append(Bars(np.array(places, float), gains, scatter, kind, KINDS[kind]))
    limit = Level(100 * d.selection.first.limit, upright=True)
    panel = Panel(
        (*bars, Level(0, upright=True), limit),
        "fall of the weighted sum of squares, held out, away from reversals [%]; line: chance",
        y_names=tuple(each.effect.label for each in shown),
        height=0.5 + 0.32 * max(len(shown), 1),
    )
    return Chart("How far each candidate lowers the held-out error", ((panel,),))


def _scatter(e: Evidence) -> float:
    """Return the standard error of a gain over the blocks of time."""
    blocks = e.refit.D
    total = blocks.sum()
    return float(abs(e.gain / total) * blocks.std(ddof=1) * len(blocks) ** 0.5) if total else 0.0


def plot_added(before: Residual, after: Residual, best: Explanation) -> Chart | None:
    """Draw what the model leaves against what the effect explains of it, everything refitted.

    The line has slope 1: an effect that is there lies along it, with no bend and no loops.
    None where the effect changes which rows there are.
    """
    u = before.joints.index(best.joint)
    pairs = list(zip(before.traces, after.traces, strict=False))
    if any(len(a) != len(b) for a, b in pairs):
        return None
    clouds = [
        Points(a.residual[:, u] - b.residual[:, u], a.residual[:, u], colour=i)
        for i, (a, b) in enumerate(pairs)
    ]
    unit, label = before.units[u], best.effect.label
    panel = Panel(
        (*clouds, Level(diagonal=True)),
        f"what {label} explains that nothing else does [{unit}]",
        f"residual of {best.joint} without it [{unit}]",
        height=4.0,
    )
    title = f"Residual of {best.joint} against what {label} explains of it"
    return Chart(title, ((panel,),), width=6.5)


def plot_before_after(before: Residual, after: Residual, best: Explanation) -> Chart:
    """Draw the residual of its joint over time, without it and with it, log below log."""
    u = before.joints.index(best.joint)
    axis = f"{best.joint} [{before.units[u]}]"
    rows = []
    for a, b in list(zip(before.traces, after.traces, strict=False))[:LOGS]:
        zero = before.zero(a)
        lines = (
            Line(a.t - zero, a.residual[:, u], "as it is", RESIDUAL, 1.0),
            Line(b.t - zero, b.residual[:, u], f"with {best.effect.label}", 0, 1.0),
        )
        title = a.name if len(before.traces) > 1 else ""
        rows.append((Panel((Level(), *lines), time_label(zero), axis, title),))
    title = f"Residual of {best.joint} over time, as it is and with {best.effect.label}"
    if len(before.traces) > LOGS:
        title += f"; the first {LOGS} of {len(before.traces)} logs"
    clock = before.traces[0].name if len(rows) == 1 else ""
    return Chart(title, tuple(rows), shared_x=True, clock=clock)


# --- report ---------------------------------------------------------------------------------------


def diagnosis_sections(d: Diagnosis) -> tuple[Section, ...]:
    """Return where it fails, the candidates, all of it in words, and the fit that was diagnosed."""
    where = table(where_rows(d), "Joint by joint: held-out error, and what noise would leave")
    title = {"missing": "What is missing", "nothing": "What adding an effect would do"}
    health = health_sheet(d.health)
    hidden, idle = (
        items(f"{each.effect.label}: {each.why}" for each in found) if found else None
        for found in (d.invisible, d.unsupported)
    )
    return (
        Section("Where it fails", (where,)),
        Section(title.get(d.verdict, "What comes nearest"), _candidates(d)),
        Section("In words", tuple(paragraph(each) for each in d.text.split("\n\n"))),
        Section("Curve and formula", law_blocks(d)),
        Section("Invisible in this data", (hidden,) if hidden else ()),
        Section("In the model, but not supported", (idle,) if idle else ()),
        Section("Health of the data", health.blocks()),
        *fit_sections(d.fit),
    )


def _candidates(d: Diagnosis) -> tuple[Block, ...]:
    """Return all of them beside each other; each that is refitted, before and after; all joints."""
    if not d.candidates:
        return ()
    rows = candidate_rows(d)
    columns = ["parameters", *(numbers(each.parameters) for each in d.candidates)]
    shown = [[*row, cell] for row, cell in zip(rows, columns, strict=True)]
    options = tuple(_option(d, i) for i, each in enumerate(d.candidates) if each.fit is not None)
    drawn = (headed("Its residual before and after"), Choice("Which candidate", options))
    errors = errors_of(d)
    matrix = [["", *errors], ["as it is", *(f"{e.rms:.3g} {e.unit}" for e in errors.values())]]
    for i, each in enumerate(d.candidates):
        cells = (f"{each.after[joint].rms:.3g}" for joint in errors)
        matrix.append([f"{mark(d, i)} {each.effect.label}".strip(), *cells])
    matrix.append(["noise alone", *(f"{d.floor[joint]:.3g}" for joint in errors)])
    return (
        *((paragraph(MARKS),) if d.best else ()),
        plot_candidates(d),
        paragraph(FALLS),
        table(shown, "Candidates; errors are held out in time"),
        *(drawn if options else ()),
        table(matrix, "Held-out error of every joint, with each of them"),
    )


def _option(d: Diagnosis, i: int) -> Option:
    """Return what one candidate that was refitted would do."""
    each = d.candidates[i]
    assert each.fit is not None
    before, after = d.fit.residual, residual_of(each.fit)
    label, unit = each.effect.label, each.after[each.joint].unit
    lines = [
        type(each.effect).summary(),
        f"held-out error of {each.joint}: {percent(each.error_before)} → "
        f"{percent(each.error_after)}; noise alone would leave {d.floor[each.joint]:.2g} {unit}",
        numbers(each.parameters),
    ]
    if each.rivals:
        lines.append(f"not distinguishable from it in this data: {labels(each.rivals, 'or')}")
    maps = plot_maps({"as it is": before, f"with {label}": after}, each.joint)
    blocks: list[Block] = [headed(f"With {label}"), items(lines)]
    blocks += [plot_before_after(before, after, each), maps]
    if added := plot_added(before, after, each):
        blocks += [headed(f"{label} alone, all else taken off"), paragraph(ADDED), added]
    return Option(f"{mark(d, i)} {label}".strip(), tuple(blocks))


# --- files ----------------------------------------------------------------------------------------


@renders(Diagnosis, "files")
def write_diagnosis(
    d: Diagnosis,
    folder: str | Path,
    more: Mapping[str, bytes] | None = None,
    sections: Sequence[Section] = (),
) -> list[Path]:
    """Write diagnosis.json, report.html, and a file for each curve and law.

    Args:
        d: what to write.
        folder: made if it is not there.
        more: further files by name.
        sections: at the beginning of the report.

    Raises:
        IdentError: if the folder cannot be written.
    """
    title = f"{d.fit.mechanism.name}: diagnosis"
    report = Page(title, card(d), (*sections, *diagnosis_sections(d))).html()
    return write_all(Path(folder), {**diagnosis_files(d), **(more or {}), "report.html": report})


def diagnosis_files(d: Diagnosis) -> dict[str, bytes]:
    """Return diagnosis.json, and a file for each curve and law."""
    files = {"diagnosis.json": json_bytes(diagnosis_json(d))}
    files |= {each.file: each.code.encode() for each in d.laws}
    return files | {each.file: each.csv.encode() for each in d.curves}


@renders(Diagnosis, "json")
def diagnosis_json(d: Diagnosis) -> dict[str, Any]:
    """Return the content of diagnosis.json; what is not finite is None."""
    first, last = d.selection.first, d.selection.last
    gains = sorted(first.gains.items(), key=lambda item: -item[1][0])
    limits = {each.effect.label: first.limit_of(each) for each in first.contest.candidates}
    decision = {
        "alpha": d.decision.alpha,
        "material": d.decision.material,
        "rival_se": d.decision.rival_se,
        "quantile": first.limit,
        "candidates": [
            {"effect": label, "gain": gain, "quantile": limits[label], "visible": visible}
            for label, (gain, visible) in gains
        ],
    }
    together = [
        {
            **name_of(m.effect),
            "gain": m.gain,
            "quantile": last.limit,
            "curve": m.curve.label if m.curve else None,
            "impossible": m.impossible.label if m.impossible else None,
            "law": m.law.label if m.law else None,
        }
        for m in d.selection.members
    ]
    content: dict[str, Any] = plain(
        {
            "schema": SCHEMA,
            "mechanism": d.fit.mechanism.name,
            "logs": [e.name for e in d.fit.motion.experiments],
            "effects": [name_of(effect) for effect in d.fit.mechanism.effects],
            "verdict": d.verdict,
            "decision": decision,
            "where": [{**each.json, "floor": d.floor[each.joint]} for each in d.where],
            "candidates": [each.json() for each in d.candidates],
            "best": None if d.best is None else name_of(d.best),
            "together": together,
            "left": [{"curve": curve.label, "gain": gain} for curve, gain in last.curves],
            "invisible": [each.json() for each in d.invisible],
            "unsupported": [each.json() for each in d.unsupported],
            "curves": [curve_json(d, each) for each in d.curves],
            "laws": [each.json() for each in d.laws],
            "health": d.health.json(),
            "judged": sum(not each.curve for each in first.contest.candidates),
            "next_experiment": d.next_experiment,
            "text": d.text,
        }
    )
    return content
