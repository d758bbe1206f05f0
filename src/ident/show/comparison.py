"""Models side by side: first lines, tables, report and compare.json; what has changed since an
earlier fit; forces of one or several models.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ident.assess.assessment import Assessment
from ident.assess.comparison import assess_comparison, errors_that_count, fitted_errors
from ident.assess.errors import largest_change
from ident.display import Plotted, render, renders
from ident.effects.library import named
from ident.files import json_bytes
from ident.fit.identify import Comparison
from ident.fit.prediction import identifiable_multipliers
from ident.fit.residual import zero_of
from ident.fit.result import Fit
from ident.fit.values import Change, Changes
from ident.information.blocks import Error
from ident.request import PYTHON, Request, Step, with_noun
from ident.show.card import Card, card_of
from ident.show.charts import BELOW, MEASURED, Chart, Line, Panel
from ident.show.headline import error_words, good_enough_words, share_words
from ident.show.html import Block, Section, Sheet, by_log, report_page, table
from ident.show.motion import made_of, understood
from ident.show.residual import (
    Models,
    all_parts,
    below,
    error_rows,
    errors_section,
    failure_text,
    residual_sections,
    short,
    time_label,
    told_apart,
)
from ident.text import WIDTH, listed, places, rounded, shortened, shortlist, significant, two_digits

SCHEMA = "ident.compare/1"
COEFFICIENT = re.compile(r"(?<= )[\d.]+(?:e[+-]\d+)?(?= )")
OTHER = "is this a log of this machine, with its load and units?"


@renders(Comparison, "sheet")
def comparison_sheet(c: Comparison, request: Request = PYTHON) -> Sheet:
    """Return how far the error falls, errors, the parts of the sum, and where each model fails."""
    first, shown = next(iter(c.residuals.values())), told_apart(c.residuals)
    tables: dict[str, list[list[str]]] = {}
    for i in range(0, len(shown), 2):  # as many as a terminal has room for
        names = dict(list(_error_columns(c).items())[i : i + 2])
        title = f"error of the predicted torque{below(first)}"
        tables[title if not tables else ", ".join(names)] = error_rows(names)
    lines = ["where it fails"]
    for name, residual in c.residuals.items():
        before, several = f"{shown[name]}, " * (len(shown) > 1), len(residual.traces) > 1
        counted, noise = errors_that_count(c, name), residual.noise
        texts = (failure_text(x, several, counted, noise[x.joint]) for x in residual.where)
        lines += [before + text for text in texts]
        lines += [f"note: {before}{finding}" for finding in c.findings.get(name, ())]
    return Sheet(comparison_card(c, request), tables=tables | all_parts(c.residuals), lines=lines)


def comparison_card(c: Comparison, request: Request = PYTHON) -> Card:
    """Return what has changed since the fit, or from the first model to the last, and how far the
    error falls.
    """
    names = told_apart(c.residuals)
    a = assess_comparison(c, names=names, acceptable=request.acceptable)
    alone, last = len(c.residuals) == 1, [*c.residuals][-1]
    line, sentences = comparison_line(a), list[str]()
    request = with_noun(request, "better" if not alone and a.verdict == "falls" else "fit")
    if alone and a.other_machine:
        sentences.append(f"Much of the torque is not explained: {OTHER}")
    good = good_enough_words(a.good_enough)
    of_last = f"Of {names[last]}: {good}" if good and not alone else good
    columns = list(_error_columns(c))
    change = f"of {columns[0]} → of {columns[-1]}" if not alone else " → ".join(a.compared)
    top = card_of(a, request, line=line)
    sure = " ".join([of_last, *sentences]).strip()
    return replace(top, sure=sure, change=change if any(a.compared) else "")


def comparison_line(a: Assessment) -> str:
    """Return in one line whether something has changed, and the error then and now."""
    now = share_words(a.now) if a.now else ""
    if a.verdict in ("changed", "unchanged"):
        then = f" ({share_words(a.before)} where it was fitted)" if a.before else ""
        here = f"the error is {now} of the torque here{then}" if now else error_words(a)
        if a.verdict == "changed":
            others = [x.joint for x in a.errors if x.rises and x.joint not in a.changed]
            more = f", less surely in {places(others)}" if others else ""
            line = f"{a.subject}: changed since it was fitted in {places(a.changed)}{more}; {here}"
        elif a.before:
            line = f"{a.subject}: no sign of a change; {here}"
        else:
            line = f"{a.subject}: {here}"
        if a.unmeasured_before:
            blind = listed(a.unmeasured_before)
            line += f"; without a measured torque when it was fitted: {blind}"
        return f"{line}."
    rises = [error.joint for error in a.errors if error.rises]
    falls = [item.joint for item in a.errors if item.falls]
    ways = {"it falls": falls, "it rises": rises}
    parts = [f"{way} in {places(joints)}" for way, joints in ways.items() if joints]
    return (
        f"{a.subject}: {error_words(a)}; {' and '.join(parts) or 'it is the same in all joints'}."
    )


def _error_columns(c: Comparison) -> dict[str, Mapping[str, Error]]:
    """Return the errors of every model, by its name and what they are."""
    columns = dict[str, Mapping[str, Error]]()
    for name, shown in told_apart(c.residuals).items():
        what, errors = errors_that_count(c, name)
        how = {"held-out error": ", held out", "error in the fit": ", in the fit"}.get(what, "")
        columns[shown + how] = errors
    return columns


@renders(Comparison, "view")
def view(c: Comparison) -> Any:
    """Return the mechanism in 3-D beside charts of its torques, with ghosts of the models."""
    from ident.show.front import view_page  # pages only: it is slow to import

    return view_page(c)


@renders(Comparison, "files")
def comparison_files(
    c: Comparison, replay: Plotted | None = None, request: Request = PYTHON
) -> dict[str, bytes]:
    """Return report.html and compare.json, with the simulated motions if they are given."""
    from ident.show.front import first_screen  # pages only: it is slow to import

    residuals = c.residuals
    first, last = (list(residuals.values())[i] for i in (0, -1))
    mechanism, motion = first.model.mechanism, first.motion
    changed = "" if first is last else largest_change(first.errors, last.errors)[0]
    files = [Path(name) for name in residuals if Path(name).is_file()]
    sections = (
        errors_section(error_rows(_error_columns(c))),
        Section("Parameters", _parameters(residuals)),
        *residual_sections(c, changed),
        *([render(replay, "section")] if replay else []),
        Section("Multipliers", _multipliers(c)),
        understood(mechanism, motion),
        made_of(mechanism, motion, files, request.command),
    )
    title = f"{mechanism.name}: model against measurement"
    screen, top = first_screen(first, last, changed), comparison_card(c, request)
    report = report_page(title, top, sections, screen.front, machine=screen.machine)
    return {"report.html": report, "compare.json": json_bytes(comparison_json(c, replay))}


def _parameters(residuals: Models) -> tuple[Block, ...]:
    """Return values ± standard errors, model beside model: effects, then base parameters."""
    models, names = (
        [residual.model for residual in residuals.values()],
        told_apart(residuals).values(),
    )
    shown: dict[str, str] = {}  # the first name of combinations that differ by rounding
    result = [
        {
            shown.setdefault(rounded_name(base_parameter.name), base_parameter.name): base_parameter
            for base_parameter in model.base_parameters
        }
        for model in models
    ]
    values = [dict(model.point.values) for model in models]
    rigid = set(models[0].mechanism.bodies.names)
    effects = dict.fromkeys(name for value in values for name in value if name not in rigid)
    bodies = dict.fromkeys(name for item in result for name in item if name not in effects)

    def row(name: str) -> list[str]:
        cells, unit = [], ""
        for base, value in zip(result, values, strict=True):
            known = significant(value[name], 5) if name in value else "–"
            cells.append(rounded(base[name].value, base[name].stderr) if name in base else known)
            unit = base[name].unit if name in base else unit
        return [shortened(name, WIDTH), *cells, unit]

    head, titles = ["parameter", *names, "unit"], ("Effects", "Base parameters of the bodies")
    return tuple(
        table([head, *map(row, effect)], f"{title}; a value without ± is known or is a shape")
        for title, effect in zip(titles, (effects, bodies), strict=True)
        if effect
    )


def rounded_name(name: str) -> str:
    """Return the name of a combination with three digits of its coefficients."""
    return COEFFICIENT.sub(lambda number: f"{float(number[0]):.3g}", name)


def _multipliers(c: Comparison) -> tuple[Block, ...]:
    first = next(iter(c.residuals.values()))
    mechanism, shown = first.model.mechanism, told_apart(c.predictions)
    known = identifiable_multipliers(mechanism, first.motion)
    kinematics = mechanism.kinematics
    names, units = (np.array(x)[known] for x in (kinematics.multipliers, kinematics.units))

    def draw(i: int) -> Chart:
        series = {}
        for name, predictions in c.predictions.items():
            p = predictions[i]
            values = np.where(p.usable[:, None], p.multipliers, np.nan)
            series[shown[name]] = (p.t, values[:, known])
        return plot_forces(names, units, series, first.motion.experiments[i].name)

    logs = [experiment.name for experiment in first.motion.experiments]
    return by_log(logs, draw) if np.any(known) else ()


def comparison_json(c: Comparison, replay: Plotted | None = None) -> dict[str, Any]:
    """Return the content of compare.json."""
    first = next(iter(c.residuals.values()))
    models = {
        name: {
            "error": residual.errors, "fitted": c.fitted[name],
            "changed": residual.increased_errors(fitted_errors(c, name)),
            "noise": residual.noise,
            "parts": {
                part: dict(zip(residual.joints, values, strict=True))
                for part, values in residual.parts.items()
            },
            "where": [failure.json for failure in residual.where],
            **({"findings": [vars(x) for x in c.findings[name]]} if name in c.findings else {}),
        }
        for name, residual in c.residuals.items()
    }  # fmt: skip
    return {
        "schema": SCHEMA, "logs": [trace.name for trace in first.traces],
        "cutoff": first.motion.band.cutoff, "rows": first.rows, "models": models,
        **({"replay": render(replay, "json")} if replay else {}),
    }  # fmt: skip


# --- since an earlier fit ------------------------------------------------------------------------


COUNTS = {2: "two", 3: "three", 4: "four", 5: "five"}


def changes_line(x: Changes, worse: Sequence[str] = ()) -> str:
    """Return what has changed since an earlier fit; `worse`: joints that it fits worse."""
    since, n = short(x.since), len(x.compared)
    if not n:
        return f"nothing can be compared with {since}: no parameter is determined by both logs."
    if not x.changed and worse:
        none = f"no parameter has changed since {since} beyond the errors of both"
        return f"{none}, but the model does not explain what is new in {listed(worse)}."
    if not x.changed:
        most = two_digits(abs(x.compared[0].z))
        return (
            f"nothing has changed since {since}: of {n} parameters none differs by more than "
            f"{x.least:.2g} standard errors, the most {most}."
        )
    words = changed_words(x)
    most = f" Most parameters have changed: {OTHER}" * (2 * len(x.changed) > n)
    if worse:  # what differs may stand in for a cause that the model does not have
        return (
            f"new since {since}: in {listed(worse)} an effect that the model does not contain. "
            f"Changed, perhaps only to make up for it: {listed(words)}.{most}"
        )
    count = COUNTS.get(len(words), str(len(words)))
    title = "one thing" if len(words) == 1 else f"{count} things"
    return f"{title} changed since {since}: {listed(words)}.{most}"


def changed_words(x: Changes) -> list[str]:
    """Return what has changed, the most significant first: bodies as one thing, effects by kind."""
    bodies = [c for c in x.changed if c.effect is None]
    by_kind: dict[str, list[Change]] = {}
    for change in x.changed:
        if change.effect is not None:
            by_kind.setdefault(change.effect.kind, []).append(change)
    things = [(abs(item[0].z), _kind_words(item)) for item in by_kind.values()]
    if bodies:
        things.append((abs(bodies[0].z), _bodies_words(bodies)))
    return [text for _, text in sorted(things, key=lambda thing: -thing[0])]


def _kind_words(changes: Sequence[Change]) -> str:
    """Return the change of effects of one kind, with the values of the first ones."""
    effects = {c.effect.label: c.effect for c in changes if c.effect is not None}
    several = len(effects) > 1
    sizes = [
        f"{c.effect.joints[0] if several and c.effect else ''} "
        f"{c.after.name.rpartition('.')[2]} {_then_now(c)} {c.after.unit}".strip()
        for c in changes
    ]
    return f"{named(effects.values())} ({shortlist(sizes, 3)})"


def fitted_anew(fit: Fit, request: Request = PYTHON) -> str:
    """Return what has changed since an earlier fit, for a diagnosis that fitted everything anew."""
    assert fit.changes is not None
    words = changes_line(fit.changes).rstrip(".")
    cause = f"; for the cause: {request.line(Step('diagnose'))}" * bool(fit.changes.changed)
    return f"all parameters were fitted anew; {words}{cause}"


def _bodies_words(changes: Sequence[Change]) -> str:
    """Return what has changed of bodies: one number, or the link that has part in all of them."""
    first = changes[0]
    if not changes[1:]:
        return f"{shortened(first.after.name, 60)} ({_then_now(first)} {first.after.unit})"
    links = [{name.rpartition(".")[0] for name in change.terms} for change in changes]
    common = sorted(set.intersection(*links))
    where = listed(common, "or") if common else places(sorted(set.union(*links)))
    grows = [c.after.value - c.before.value for c in changes if c.after.name.endswith(".m")]
    how = "something heavier" if grows and min(grows) > 0 else "the mass, or where it sits,"
    return f"{how} {'on' if grows and min(grows) > 0 else 'of'} {where}"


def _then_now(x: Change) -> str:
    """Return both values, and by how much they differ beyond what is the same in both logs: errors
    of the calibration are in the ± of a value, not in that of its change.
    """
    error = float(np.hypot(x.before.stderr, x.after.stderr))
    then, now = (rounded(item.value, error).partition(" ± ")[0] for item in (x.before, x.after))
    step = rounded(x.after.value - x.before.value, error)
    return f"{then} → {now}, by {'+' * (x.after.value > x.before.value)}{step}"


@renders(Changes, "sheet")
def changes_sheet(x: Changes) -> Sheet:
    """Return which parameters differ from those of an earlier fit."""
    line = changes_line(x)
    return Sheet(line[:1].upper() + line[1:], tables=change_tables(x))


def change_tables(x: Changes | None, most: int = 48) -> dict[str, list[list[str]]]:
    """Return the table of what has changed since an earlier fit, the most significant first."""
    if x is None or not x.changed:
        return {}
    rows = [["parameter", "then → now", "unit", "difference / its error"]]
    rows += [
        [shortened(c.after.name, most), _then_now(c), c.after.unit, f"{c.z:+.3g}"]
        for c in x.changed
    ]
    return {f"Changed since {short(x.since)}, beyond the errors of both": rows}


# --- forces --------------------------------------------------------------------------------------


def plot_forces(
    names: Sequence[str],
    units: Sequence[str],
    series: Mapping[str, tuple[np.ndarray, np.ndarray]],
    log: str = "",
) -> Chart:
    """Draw λ(t) of a log, a panel a multiplier with its unit.

    `series`: times (n,) [s] and values (n, m) [N | N m] by label; `known` is drawn in grey.
    """
    zero = zero_of(list(series.values())[-1][0])
    rows = []
    for i, (name, unit) in enumerate(zip(names, units, strict=True)):
        lines: list[Line] = []
        for label, (t, values) in series.items():
            y, known = values[:, i], label == "known"
            colour, width = MEASURED if known else len(lines), BELOW if known else 1.2
            lines.append(Line(t - zero, y, label, colour, width))
        if np.isfinite(lines[-1].y).any():
            label = f"{name} [{unit}]"
            rows.append((Panel(tuple(lines), time_label(zero), label, height=1.8),))
    if not rows:
        rows = [(Panel((), "t [s]", title="this motion determines none of them"),)]
    words = "Multipliers λ over time, the reaction forces of the closures"
    return Chart(words, tuple(rows), shared_x=True, clock=log)
