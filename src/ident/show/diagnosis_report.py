"""Charts and report.html of a diagnosis and of a grown model."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ident.diagnosis.diagnosis import Diagnosis, Explanation, Invisible, Unsupported
from ident.diagnosis.grow import History
from ident.diagnosis.selection import Evidence
from ident.display import renders
from ident.errors import IdentError
from ident.files import write_all
from ident.fit import Fit
from ident.fit.files import fit_json, multipliers_csv
from ident.fit.residual import Residual, residual_of
from ident.information.blocks import Error
from ident.mechanism import Mechanism
from ident.mechanism.write import folder_files
from ident.show import experiment  # noqa: F401 (it renders the next experiment)
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
    changed,
    diagnosis_json,
    error_matrix,
    labels,
    mark,
    numbers,
    tied,
    verdict_line,
    where_rows,
)
from ident.show.fit_pages import found, misfit, plot_maps, time_label
from ident.show.html import (
    Block,
    Choice,
    Option,
    Page,
    Section,
    code,
    headed,
    items,
    paragraph,
    table,
)
from ident.show.motion import made_of, understood
from ident.text import percent

BARS = 12
LOGS = 4  # whose residuals are drawn below each other
MOST = 8  # candidates whose residuals are drawn
KINDS: dict[str, Colour] = {
    "named": 0,
    "not to be told from it": MEASURED,
    "credible": 1,
    "not credible": FAINT,
}
TITLES = {
    "missing": "What is missing",
    "nothing": "What adding an effect would do",
    "unexplained": "What comes nearest",
    "undecided": "What comes nearest",
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


# --- charts ------------------------------------------------------------------------------------


@renders(Diagnosis, "plot")
def plot_candidates(d: Diagnosis) -> Chart:
    """Held-out gain of the best candidates ± standard error; grey: not to be told from the best."""
    first = [each.evidence for each in d.candidates if mark(d, d.candidates.index(each)) != " "]
    known = {each.effect.label for each in first}
    rest = [e for e in d.selection.first.evidence if e.effect.label not in known]
    shown = [*first, *rest][: max(BARS, len(first))]
    kinds = [_kind(i, len(first), each) for i, each in enumerate(shown)]
    gains = 100 * np.array([_gain(each) for each in shown]).reshape(-1, 2)
    bars = []
    for kind, colour in KINDS.items():
        at = np.array([i for i, own in enumerate(kinds) if own == kind], dtype=int)
        if len(at):
            bars.append(Bars(at.astype(float), gains[at, 0], gains[at, 1], kind, colour))
    limit = Level(100 * d.selection.first.limit, upright=True)
    panel = Panel(
        (*bars, Level(0, upright=True), limit),
        "fall of the weighted sum of squares, held out, away from reversals [%]; line: chance",
        y_names=tuple(each.effect.label for each in shown),
        height=0.5 + 0.32 * max(len(shown), 1),
    )
    return Chart("How far each candidate lowers the held-out error", ((panel,),))


def _kind(i: int, first: int, each: Evidence) -> str:
    named, rival, credible, other = KINDS
    if i < first:
        return rival if i else named
    return credible if each.credible else other


def _gain(e: Evidence) -> tuple[float, float]:
    """Share of the held-out squares, and its standard error over the blocks."""
    total = float(e.refit.D.sum())
    if total == 0:
        return 0.0, 0.0
    error = float(e.refit.D.std(ddof=1) * np.sqrt(len(e.refit.D)))
    return e.gain, abs(e.gain / total) * error


def plot_added(before: Residual, after: Residual, best: Explanation) -> Chart | None:
    """What the model leaves against what the effect explains of it, everything refitted.

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
    """The residual of its joint over time, without it and with it, log below log."""
    u, unit = before.joints.index(best.joint), before.units[before.joints.index(best.joint)]
    rows = []
    for a, b in list(zip(before.traces, after.traces, strict=False))[:LOGS]:
        zero = before.zero(a)
        lines = (
            Line(a.t - zero, a.residual[:, u], "as it is", RESIDUAL, 1.0),
            Line(b.t - zero, b.residual[:, u], f"with {best.effect.label}", 0, 1.0),
        )
        title = a.name if len(before.traces) > 1 else ""
        rows.append((Panel((Level(), *lines), time_label(zero), f"{best.joint} [{unit}]", title),))
    title = f"Residual of {best.joint} over time, as it is and with {best.effect.label}"
    if len(before.traces) > LOGS:
        title += f"; the first {LOGS} of {len(before.traces)} logs"
    clock = before.traces[0].name if len(rows) == 1 else ""
    return Chart(title, tuple(rows), shared_x=True, clock=clock)


@renders(History, "plot")
def plot_ladder(history: History) -> Chart:
    """Held-out error of every joint against the rungs."""
    names = [changed(step) for step in history.steps]
    return plot_rungs(names, [step.errors for step in history.steps])


def plot_rungs(names: Sequence[str], errors: Sequence[Mapping[str, Error]]) -> Chart:
    """Held-out error of every joint against models one after the other."""
    at = np.arange(len(names), dtype=float)
    lines = []
    for i, joint in enumerate(errors[0]):
        y = [each[joint].relative or 0.0 for each in errors]
        if all(y):  # else there is no torque to be relative to
            lines.append(Line(at, 100 * np.array(y), joint, i, 1.6, dotted=True))
    panel = Panel(
        tuple(lines), "", "held-out error [%]", logarithmic=True, height=4.0,
        x_names=tuple(names),
    )  # fmt: skip
    return Chart("Held-out error of every joint, rung by rung", ((panel,),))


# --- report.html -------------------------------------------------------------------------------


def diagnosis_html(d: Diagnosis, first: Sequence[Section] = ()) -> bytes:
    """The page of a diagnosis, after further sections."""
    sections = (*first, *diagnosed(d), *_basis(d))
    return Page(f"{d.fit.mechanism.name}: diagnosis", _capital(verdict_line(d)), sections).html()


def history_html(history: History) -> bytes:
    """The page of a grown model: the ladder, the last diagnosis, the last fit."""
    d, added = history.diagnosis, [effect.label for effect in history.added]
    ladder = Section(
        "The error falls",
        (
            paragraph(f"Added: {', '.join(added) or 'nothing'}."),
            plot_ladder(history),
            table(history.table(), "Held-out error, rung by rung", tied=False),
        ),
    )
    title = f"{history.mechanism.name}: grown model"
    return Page(title, _capital(verdict_line(d)), (ladder, *diagnosed(d), *_basis(d))).html()


def _basis(d: Diagnosis) -> tuple[Section, ...]:
    """The fit that was diagnosed, and what it was made of."""
    mechanism, motion = d.fit.mechanism, d.fit.motion
    return (
        *misfit(d.fit),
        *found(d.fit),
        understood(mechanism, motion),
        made_of(mechanism, motion),
    )


def diagnosed(d: Diagnosis) -> tuple[Section, ...]:
    """Verdict, candidates, what is invisible or unsupported, the data's health."""
    words = tuple(paragraph(each) for each in d.text.split("\n\n"))
    where = table(where_rows(d), "Joint by joint: held-out error, and what noise would leave")
    suggestion: tuple[Block, ...] = ()
    if d.suggestion is not None:
        suggestion = (paragraph(str(d.suggestion)), code(d.suggestion.code))
    return (
        Section("Where it fails", (where,)),
        Section(TITLES[d.verdict], _candidates(d)),
        Section("In words", words),
        Section("Suggested expression", suggestion),
        Section("Invisible in this data", _reasons(d.invisible)),
        Section("In the model, but not supported", _reasons(d.unsupported)),
        Section("Health of the data", (code(str(d.health)),)),
    )


def _capital(words: str) -> str:
    return f"{words[:1].upper()}{words[1:]}."


def _reasons(hidden: Sequence[Invisible | Unsupported]) -> tuple[Block, ...]:
    """Effects with what is to be said of them, one line each."""
    return (items(f"{each.effect.label}: {each.why}" for each in hidden),) if hidden else ()


def _candidates(d: Diagnosis) -> tuple[Block, ...]:
    """All of them beside each other; each that is refitted, before and after; all joints."""
    if not d.candidates:
        return ()
    first, *rows = candidate_rows(d)
    shown = [[*first, "parameters"]]
    shown += [
        [*row, tied(numbers(each.parameters))] for row, each in zip(rows, d.candidates, strict=True)
    ]
    marked = any(mark(d, i).strip() for i in range(len(d.candidates)))
    options = tuple(
        _option(d, i, each) for i, each in enumerate(d.candidates[:MOST]) if each.fit is not None
    )
    drawn = (headed("Its residual before and after"), Choice("Which candidate", options))
    return (
        *((paragraph(MARKS),) if marked else ()),
        plot_candidates(d),
        paragraph(FALLS),
        table(shown, "Candidates; errors are held out in time"),
        *(drawn if options else ()),
        table(error_matrix(d), "Held-out error of every joint, with each of them"),
    )


def _option(d: Diagnosis, i: int, each: Explanation) -> Option:
    """What one candidate would do."""
    assert each.fit is not None
    before, after = d.fit.residual, residual_of(each.fit)
    label = each.effect.label
    both = {"as it is": before, f"with {label}": after}
    said = [
        type(each.effect).summary(),
        f"held-out error of {each.joint}: {percent(each.error_before)} → "
        f"{percent(each.error_after)}; noise alone would leave {d.floor[each.joint]:.2g} "
        f"{before.units[before.joints.index(each.joint)]}",
        numbers(each.parameters),
    ]
    if each.rivals:
        said.append(f"not to be told from it by this data: {labels(each.rivals, 'or')}")
    charts = (plot_before_after(before, after, each), plot_maps(both, each.joint))
    added = plot_added(before, after, each)
    last: tuple[Block, ...] = ()
    if added is not None:
        last = (headed(f"{label} alone, all else taken off"), paragraph(ADDED), added)
    name = f"{mark(d, i)} {label}".strip()
    return Option(name, (headed(f"With {label}"), items(said), *charts, *last))


# --- files -------------------------------------------------------------------------------------


@renders(Diagnosis, "files")
def write_diagnosis(
    d: Diagnosis,
    folder: str | Path,
    more: Mapping[str, bytes] | None = None,
    sections: Sequence[Section] = (),
) -> list[Path]:
    """diagnosis.json, report.html, and suggestion.py where there is a suggestion.

    Args:
        d: what to write.
        folder: made if it is not there.
        more: further files by name.
        sections: at the beginning of the report.

    Raises:
        IdentError: if the folder cannot be written.
    """
    report = diagnosis_html(d, sections)
    return write_all(Path(folder), {**_data(d), **(more or {}), "report.html": report})


@renders(History, "files")
def write_history(history: History, folder: str | Path) -> list[Path]:
    """The grown mechanism's folder, with the last fit, diagnosis and a report of the ladder.

    Unknown parameters stay unknown in it: values are in fit.json.

    Raises:
        IdentError: if it is the folder of the mechanism itself, or cannot be written.
    """
    refuse_own(history.mechanism, Path(folder))
    data = {**_data(history.diagnosis), "report.html": history_html(history)}
    return write_all(Path(folder), model_files(history.fit) | data)


def model_files(fit: Fit) -> dict[str, bytes]:
    """The folder of a fit's mechanism, unknown what was unknown, with fit.json and multipliers."""
    mechanism = fit.mechanism
    effects = [(effect, effect.values) for effect in mechanism.effects]
    files = folder_files(mechanism, mechanism.urdf.read_bytes(), effects, unknown=None)
    return files | {"fit.json": _json(fit_json(fit)), "multipliers.csv": multipliers_csv(fit)}


def refuse_own(mechanism: Mechanism, folder: Path) -> None:
    """Refuse to replace what a person wrote by what a program has grown.

    Raises:
        IdentError: if `folder` holds the mechanism's own files.
    """
    own = [path for path in (mechanism.toml, mechanism.urdf) if path is not None]
    for path in own:
        if path.parent.resolve() == folder.resolve():
            raise IdentError(
                f"{folder}: holds {path.name} of the mechanism itself, which is not overwritten; "
                "name another folder, or change it with `ident add`"
            )


def _data(d: Diagnosis) -> dict[str, bytes]:
    files = {"diagnosis.json": _json(diagnosis_json(d))}
    if d.suggestion is not None:
        files["suggestion.py"] = d.suggestion.code.encode()
    return files


def _json(content: Mapping[str, Any]) -> bytes:
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False).encode() + b"\n"
