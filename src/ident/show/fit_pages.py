"""Fits, residuals and comparisons as charts, HTML, 3-D view, reports and files."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from ident.display import render, renders
from ident.errors import FitError, one_of
from ident.fit.compare import Comparison
from ident.fit.files import write_fit, write_urdf
from ident.fit.multipliers import Reactions, identifiable_multipliers
from ident.fit.prediction import RIGID, Prediction, Trace
from ident.fit.residual import Residual, zero_of
from ident.fit.result import Fit
from ident.fit.values import Value
from ident.information.blocks import Error
from ident.mechanism.mechanism import Mechanism
from ident.show.charts import MEASURED, PRIOR, RESIDUAL, Chart, Dots, Level, Line, Panel, Points
from ident.show.fit import binding, error_rows, failure_lines, parts_table, reactions, value_tables
from ident.show.html import (
    Block,
    Choice,
    Option,
    Page,
    Section,
    code,
    folded,
    headed,
    in_frame,
    items,
    paragraph,
    strong,
)
from ident.show.html import table as html_table
from ident.show.motion import made_of, understood
from ident.text import percent

SCHEMA = "ident.compare/1"
MOST = 60  # parameters in one chart
LABEL = 28  # characters of a name in a chart
BINS = 30  # of the mean that is drawn through a cloud
OWN = ("q", "v", "a", "load")  # of a joint, against which its residual is drawn
ROWS = 4  # of panels in one chart: what a window shows
LOGS = 12  # whose curves are in a report
MAPS = (
    "Each dot is a row of the fit; the dark line is the mean. A model that lacks nothing leaves a "
    "flat band. What the residual depends on most is framed."
)
STRUCTURE = (
    "What is left in {} has structure: the model may lack something, and ± is what noise alone "
    "would do to a complete model. `ident diagnose` says what could be missing."
)
LAMBDA = "The reaction forces that the closures need for this motion; they rest on the model."


# --- charts and sections of residuals -------------------------------------------------------------


def plot_predictions(
    predictions: Mapping[str, list[Prediction]], units: Sequence[str], experiment: int = 0
) -> Chart:
    """Draw measured torque and every model's prediction, with residuals below, per joint."""
    names = list(predictions)
    one = predictions[names[0]][experiment]
    zero = zero_of(one.t)
    t, clock = one.t - zero, time_label(zero)
    rows = []
    for u, joint in enumerate(one.joints):
        above = [Line(t, _only(one, one.measured[:, u]), "measured", MEASURED, 2.2)]
        below = []
        for i, name in enumerate(names):
            p = predictions[name][experiment]
            label = "predicted" if len(names) == 1 else short(name)
            above.append(Line(t, _only(p, p.predicted[:, u]), label, i, 1.1))
            colour = RESIDUAL if len(names) == 1 else i
            left = "difference" if len(names) == 1 else ""
            below.append(Line(t, _only(p, p.residual[:, u]), left, colour, 0.8))
        rows.append((Panel(tuple(above), clock, f"{joint} [{units[u]}]"),))
        rows.append((Panel((Level(), *below), clock, "difference", height=1.5),))
    words = f"Measured and predicted torque of every joint over time, {one.name}"
    return Chart(words, tuple(rows), shared_x=True, clock=one.name)


def _only(p: Prediction, x: np.ndarray) -> np.ndarray:
    """Return x with gaps where samples take no part."""
    return np.where(p.usable, x, np.nan)


def plot_parts(residuals: Mapping[str, Residual], experiment: int = 0) -> Chart:
    """Draw measured torque and the parts of the predicted one: a row a joint, a column a model."""
    return _apart(residuals, experiment, _parts, "The sum taken apart: rigid bodies, effects")


def plot_own(residuals: Mapping[str, Residual], experiment: int = 0) -> Chart:
    """Draw what acts, with closures, in each joint's own row of the generalised forces:
    rigid bodies, effects and closure forces add up to the joint's torque.
    """
    return _apart(residuals, experiment, _own, "Each joint by itself: rigid bodies, closure forces")


def _parts(trace: Trace) -> tuple[np.ndarray, str, Mapping[str, np.ndarray]]:
    return trace.measured, "measured", trace.parts


def _own(trace: Trace) -> tuple[np.ndarray, str, Mapping[str, np.ndarray]]:
    total = sum(trace.own.values(), np.zeros_like(trace.measured))
    return total, "torque of the joint", trace.own


def _apart(
    residuals: Mapping[str, Residual],
    experiment: int,
    of: Callable[[Trace], tuple[np.ndarray, str, Mapping[str, np.ndarray]]],
    words: str,
) -> Chart:
    first = next(iter(residuals.values()))
    colours: dict[str, int] = {}
    rows = []
    for u, joint in enumerate(first.joints):
        row: list[Panel] = []
        for name, residual in residuals.items():
            trace = residual.traces[min(experiment, len(residual.traces) - 1)]
            zero, (total, label, parts) = residual.zero(trace), of(trace)
            title = f"{short(name)}, {short(trace.name)}" if u == 0 and len(residuals) > 1 else ""
            t, left = trace.t - zero, total - sum(parts.values(), np.zeros_like(total))
            lines = [Line(t, _broken(trace, total[:, u]), label, MEASURED, 2.2)]
            for part, values in parts.items():
                x, kind = values[:, u], part.split(":")[0]
                if part == RIGID or np.abs(x).max() > 0:
                    colour = colours.setdefault(kind, len(colours))
                    lines.append(Line(t, _broken(trace, x), kind, colour))
            if of is _parts:
                lines.append(Line(t, _broken(trace, left[:, u]), "residual", RESIDUAL, 0.8))
            y = "" if row else f"{joint} [{first.units[u]}]"
            row.append(Panel(tuple(lines), time_label(zero), y, title))
        rows.append(tuple(row))
    one = first.traces[min(experiment, len(first.traces) - 1)].name
    wide = max(9.0, 6.0 * len(residuals))
    said = f"{words} and what is left, over time, {one}" if of is _parts else f"{words}, {one}"
    return Chart(said, tuple(rows), shared_x=True, shared_y=True, width=wide, clock=one)


def _broken(trace: Trace, x: np.ndarray) -> np.ndarray:
    """Return x with a gap where rows do not follow each other."""
    return np.where(np.concatenate([[False], np.diff(trace.segment) > 0]), np.nan, x)


def plot_maps(residuals: Mapping[str, Residual], joint: str) -> Chart:
    """Draw a joint's residual and its mean against t, q, v, a and load, a row a model.

    If it depends most on a signal of another joint, against that too; the most important is framed.
    """
    first = next(iter(residuals.values()))
    names = ["t", *(f"{kind}.{joint}" for kind in OWN)]
    names += [name for name in [_foreign(residuals, joint)] if name]
    u = first.joints.index(joint)
    rows = []
    for title, residual in residuals.items():
        said = _dependences(residual, joint)
        most = next((name for name in said if _drawn(name) in names), None)
        row = [
            _map(residual, u, name, said, marked=most is not None and _drawn(most) == name)
            for name in names
        ]
        left = f"{joint} [{residual.units[u]}]"
        label = left if len(residuals) == 1 else f"{short(title)}\n{left}"
        rows.append((replace(row[0], y=label), *row[1:]))
    words = f"Residual of {joint} against time, its position, speed, acceleration and load"
    marked = [name for row in rows for panel, name in zip(row, names, strict=True) if panel.marked]
    if marked:
        words += f"; framed: {', '.join(dict.fromkeys(marked))}, on which it depends most"
    return Chart(words, tuple(rows), shared_y=True, width=2.6 * len(names))


def _map(residual: Residual, u: int, name: str, said: Mapping[str, float], marked: bool) -> Panel:
    """Draw points, one colour an experiment, and their mean in bins."""
    x, unit = residual.signal(name)
    if name == "t":
        x = [each - residual.zero(trace) for each, trace in zip(x, residual.traces, strict=True)]
    r = [trace.residual[:, u] for trace in residual.traces]
    clouds = [Points(xs, rs, colour=i) for i, (xs, rs) in enumerate(zip(x, r, strict=True))]
    own = name.removesuffix(f".{residual.joints[u]}")
    r2 = max((value for key, value in said.items() if _drawn(key) == name), default=0.0)
    return Panel(
        (Level(), *clouds, _mean(np.concatenate(x), np.concatenate(r))),
        f"{own} [{unit}]" if unit else own, title=f"R² {r2:.2f}" if r2 else "",
        marked=marked, height=2.4,
    )  # fmt: skip


def _mean(x: np.ndarray, r: np.ndarray) -> Line:
    edges = np.linspace(x.min(), x.max(), BINS + 1)
    at = np.digitize(x, edges[1:-1])
    count, total = (np.bincount(at, w, BINS) for w in (None, r))
    middle = np.array([(low + high) / 2 for low, high in pairwise(edges)])
    known = count >= 3
    return Line(middle[known], total[known] / count[known], "mean", "mean", 1.8)


def _dependences(residual: Residual, joint: str) -> dict[str, float]:
    """Return R² of the signals on which a joint's residual depends, the most important first."""
    failure = next((each for each in residual.where if each.joint == joint), None)
    return {each.signal: each.r2 for each in failure.depends_on} if failure else {}


def _drawn(signal: str) -> str:
    """Return in whose map a signal is drawn: sign(v) in that of v."""
    return signal.replace("sign(v)", "v")


def _foreign(residuals: Mapping[str, Residual], joint: str) -> str | None:
    """Return the most important signal of another joint on which some model's residual depends."""
    found = [
        (r2, signal)
        for residual in residuals.values()
        for signal, r2 in _dependences(residual, joint).items()
        if signal != "t" and not signal.endswith(f".{joint}")
    ]
    return max(found)[1] if found else None


def time_label(zero: float) -> str:
    """Return the label of an axis of time that is counted from `zero` [s]."""
    return f"t − {zero:.3f} [s]" if zero else "t [s]"


def short(name: str) -> str:
    """Return the end of a path, or the beginning of a list of effects."""
    if len(name) <= LABEL:
        return name
    return f"…{name[-LABEL:]}" if "/" in name else f"{name[:LABEL]}…"


def errors_section(named: Mapping[str, Mapping[str, Error]], words: str = "") -> Section:
    """Return the error of the predicted torque, by joint."""
    said = (paragraph(words),) if words else ()
    rows = error_rows(named)
    shown = html_table(
        rows, "Error of the predicted torque: rms, and relative to the measured torque"
    )
    return Section("Error of the predicted torque", (*said, shown))


def torques_section(predictions: Mapping[str, list[Prediction]], units: Sequence[str]) -> Section:
    """Return measured against predicted, per joint, log by log."""
    names = [p.name for p in next(iter(predictions.values()))]
    return Section(
        "Measured against predicted",
        by_log(names, lambda i: plot_predictions(predictions, units, i)),
    )


def by_log(names: Sequence[str], draw: Callable[[int], Chart]) -> tuple[Block, ...]:
    """Return a chart, or of several logs a choice between theirs."""
    if len(names) == 1:
        return draw(0).pieces(ROWS)
    options = tuple(Option(name, draw(i).pieces(ROWS)) for i, name in enumerate(names[:LOGS]))
    choice = Choice("Which log", options)
    if len(names) <= LOGS:
        return (choice,)
    return paragraph(f"The first {LOGS} of {len(names)} logs are drawn."), choice


def maps_section(residuals: Mapping[str, Residual]) -> Section:
    """Return where the last model fails, with maps: a choice between joints, the worst first."""
    last = list(residuals.values())[-1]
    options = []
    for failure in last.where:
        blocks = (items(failure_lines(failure, len(last.traces) > 1)),)
        options.append(Option(failure.joint, (*blocks, plot_maps(residuals, failure.joint))))
    choice = Choice("Of which joint", tuple(options))
    return Section("Residual maps", (paragraph(MAPS), choice))


def parts_section(residuals: Mapping[str, Residual]) -> Section:
    """Return the sum taken apart: rigid bodies, effects, closure forces."""
    first = next(iter(residuals.values()))
    blocks: list[Block] = []
    for name, residual in residuals.items():
        lines = "\n".join(parts_table(residual, "")).strip()
        blocks += [paragraph(name)] if len(residuals) > 1 else []
        blocks.append(code(lines))
    names = [trace.name for trace in first.traces]
    blocks += by_log(names, lambda i: plot_parts(residuals, i))
    if first.own:
        blocks += by_log(names, lambda i: plot_own(residuals, i))
    return Section("The sum taken apart", tuple(blocks))


# --- fits -----------------------------------------------------------------------------------------


@renders(Reactions, "plot")
def plot_reactions(x: Reactions) -> Chart:
    """Draw λ(t) identified over λ(t) known."""
    return plot_multipliers(x.mechanism, *x.identified, (x.t, x.known), x.log)


def _residuals(x: Fit | Comparison) -> Mapping[str, Residual]:
    return x.residuals if isinstance(x, Comparison) else {x.name: x.residual}


@renders(Fit, "plot")
def plot(fit: Fit, experiment: int = 0) -> Chart:
    """Draw measured and predicted torque of every independent joint, and what is left."""
    return plot_predictions({fit.name: fit.predictions}, fit.problem.units, experiment)


@renders(Comparison, "plot")
def plot_comparison(c: Comparison, experiment: int = 0) -> Chart:
    """Draw measured torque and every model's prediction, with residuals below, per joint."""
    return plot_predictions(c.predictions, c.units, experiment)


@renders(Fit, "plot_parts")
@renders(Comparison, "plot_parts")
def plot_parts_of(x: Fit | Comparison, experiment: int = 0) -> Chart:
    """Draw the sum taken apart: rigid bodies, effects and what is left, per joint."""
    return plot_parts(_residuals(x), experiment)


@renders(Fit, "plot_maps")
@renders(Comparison, "plot_maps")
def plot_maps_of(x: Fit | Comparison, joint: str | None = None) -> Chart:
    """Draw a joint's residual against its signals; by default where the last model fails most.

    Raises:
        FitError: if the joint is not an independent one.
    """
    residuals = _residuals(x)
    last = list(residuals.values())[-1]
    joint = last.where[0].joint if joint is None else joint
    if joint not in last.joints:
        raise FitError(f"no residual of joint '{joint}'; {one_of(joint, last.joints)}")
    return plot_maps(residuals, joint)


@renders(Fit, "plot_parameters")
def plot_fit_parameters(fit: Fit) -> Chart:
    """Draw identified parameters and effects with their 95 % intervals, beside the prior.

    Raises:
        FitError: if there are none.
    """
    own = [value for effect in fit.effects for value in effect.parameters]
    chart = plot_parameters([*own, *(v for v in fit.parameters if v.identifiable)])
    if chart is None:
        raise FitError(f"{fit.mechanism.name}: nothing was identified by itself")
    return chart


@renders(Fit, "plot_multipliers")
def plot_fit_multipliers(fit: Fit, experiment: int = 0) -> Chart:
    """Draw λ(t), the reaction forces of the closures.

    Raises:
        FitError: of a mechanism without closures.
    """
    t, values = fit.multipliers[experiment]
    if not values.shape[1]:
        raise FitError(f"{fit.mechanism.name}: has no closures, so no multipliers")
    log = fit.motion.experiments[experiment].name
    return plot_multipliers(fit.mechanism, t, values, log=log)


@renders(Fit, "view")
def view(fit: Fit) -> Any:
    """Return the mechanism in 3-D: reaction forces as arrows, joints coloured by residual."""
    return render(fit.mechanism, "view", fit.motion.experiments, fit.predictions)


@renders(Fit, "folder")
def folder(fit: Fit, path: str | Path) -> list[Path]:
    """Write a fit with its report into a folder."""
    return write_fit(fit, path)


@renders(Fit, "urdf")
def urdf(fit: Fit, path: str | Path) -> Path:
    """Write the identified URDF."""
    return write_urdf(fit, path)


@renders(Fit, "html")
def html(fit: Fit) -> str:
    """Return the tables for Jupyter: errors, effects, parameters, warnings."""
    blocks = [strong(headline(fit)), *_errors(fit).blocks, *_parameters(fit)]
    if fit.warnings:
        blocks.append(folded(f"Notes: {len(fit.warnings)}", items(fit.warnings)))
    return in_frame(block for block in blocks if isinstance(block, Markup))


def plot_multipliers(
    mechanism: Mechanism,
    t: np.ndarray,
    values: np.ndarray,
    reference: tuple[np.ndarray, np.ndarray] | None = None,
    log: str = "",
) -> Chart:
    """Draw λ(t) (n, m) of a log, beside known reactions (t, (n, m)) where there are any."""
    zero = zero_of(t)
    names, units = mechanism.kinematics.multipliers, mechanism.kinematics.units
    rows = []
    for i, (name, unit) in enumerate(zip(names, units, strict=True)):
        if not np.isfinite(values[:, i]).any():
            continue
        lines = []
        if reference is not None:
            lines.append(Line(reference[0] - zero, reference[1][:, i], "known", MEASURED, 2.4))
        lines.append(Line(t - zero, values[:, i], "identified", 0))
        rows.append((Panel(tuple(lines), time_label(zero), f"{name} [{unit}]", height=1.8),))
    if not rows:
        rows = [(Panel((), "t [s]", title="this motion determines none of them"),)]
    words = "Multipliers λ over time, the reaction forces of the closures"
    return Chart(words, tuple(rows), shared_x=True, clock=log)


def plot_parameters(values: Sequence[Value]) -> Chart | None:
    """Draw values ± 1.96 standard errors beside the prior, a panel a unit; None of no values."""
    known = [v for v in values if v.stderr is not None and np.isfinite(v.stderr)]
    shown = known[:MOST]
    units = list(dict.fromkeys(v.unit for v in shown))
    rows = [(_unit_panel(unit, [v for v in shown if v.unit == unit]),) for unit in units]
    words = "Identified values with their 95 % intervals, beside what was assumed before"
    if len(known) > MOST:
        words += f"; the first {MOST} of {len(known)}, all are in the tables"
    return Chart(words, tuple(rows)) if rows else None


def _unit_panel(unit: str, values: Sequence[Value]) -> Panel:
    at, none = np.arange(len(values), dtype=float), np.zeros(len(values))
    prior, found = (np.array([getattr(v, key) for v in values]) for key in ("prior", "value"))
    reach = np.array([1.96 * (v.stderr or 0.0) for v in values])
    marks = (Dots(at, prior, none, "prior", PRIOR), Dots(at, found, reach, "identified", 0))
    names = tuple(v.name for v in values)
    return Panel(marks, f"[{unit}]", y_names=names, height=0.7 + 0.22 * len(values))


@renders(Fit, "report")
def report_html(fit: Fit, known: Reactions | None = None, more: Sequence[Section] = ()) -> bytes:
    """Return the report of a fit, with further sections before its parameters."""
    sections = (
        *misfit(fit),
        *more,
        *found(fit, known),
        understood(fit.mechanism, fit.motion),
        made_of(fit.mechanism, fit.motion),
    )
    return Page(f"{fit.mechanism.name}: identification", headline(fit), sections).html()


def headline(fit: Fit) -> str:
    """Return how well it predicts, in one line."""
    errors = fit.held_out or fit.train
    known = {name: e.relative for name, e in errors.items() if e.relative is not None}
    if not known:
        return "No torque was measured that could be compared."
    best, worst = min(known, key=lambda n: known[n]), max(known, key=lambda n: known[n])
    what = "held out" if fit.held_out else "in the data that were fitted"
    if best == worst:
        return f"The predicted torque of {best} is off by {percent(known[best])}, {what}."
    return (
        f"The predicted torque is off by {percent(known[best])} ({best}) to "
        f"{percent(known[worst])} ({worst}), {what}."
    )


def _errors(fit: Fit) -> Section:
    errors = {"train": fit.train, "held out": fit.held_out, **fit.validation}
    cut = fit.motion.band.cutoff
    if not cut:
        return errors_section(errors)
    errors["unfiltered"] = fit.unfiltered
    words = f"Below {cut:.3g} Hz, where the fit was made; unfiltered: with all noise in it."
    return errors_section(errors, words)


def misfit(fit: Fit) -> tuple[Section, ...]:
    """Return warnings, errors, measured against predicted, where it fails, the sum taken apart."""
    residuals = {fit.name: fit.residual}
    notes = [each for each in fit.warnings if each not in fit.motion.notes]  # those stand elsewhere
    rough = [failure.joint for failure in fit.residual.where if not failure.white]
    if rough:
        notes.append(STRUCTURE.format(", ".join(rough)))
    return (
        Section("Warnings", (items(notes),) if notes else ()),
        _errors(fit),
        torques_section({fit.name: fit.predictions}, fit.problem.units),
        maps_section(residuals),
        parts_section(residuals),
    )


def found(fit: Fit, known: Reactions | None = None) -> tuple[Section, ...]:
    """Return parameters and multipliers."""
    return (
        Section("Parameters", _parameters(fit)),
        Section("Multipliers", _lambda(fit, known)),
    )


def _parameters(fit: Fit) -> tuple[Block, ...]:
    blocks: list[Block] = []
    effects = [value for effect in fit.effects for value in effect.parameters]
    own = [value for value in fit.parameters if value.identifiable]
    if (chart := plot_parameters([*effects, *own])) is not None:
        blocks.append(chart)
    blocks += [html_table(rows, title) for title, rows in value_tables(fit, 120).items()]
    if fit.binding is not None:
        blocks.append(paragraph(binding(fit.binding)))
    return tuple(blocks)


def _lambda(fit: Fit, known: Reactions | None) -> tuple[Block, ...]:
    if not fit.mechanism.kinematics.multipliers:
        return ()
    blocks: list[Block] = [paragraph(LAMBDA)]
    notes = [each for each in fit.warnings if each.startswith("multipliers ")]
    blocks += [paragraph(each, "warning") for each in notes]
    if known is not None:
        blocks += [headed("Against known reactions"), code(reactions(known)), plot_reactions(known)]
    names = [e.name for e in fit.motion.experiments]
    if known is None or len(names) > 1:
        blocks += by_log(names, fit.plot_multipliers)
    return tuple(blocks)


# --- comparisons ----------------------------------------------------------------------------------


@renders(Comparison, "html")
def comparison_html(c: Comparison) -> str:
    """Return the change of the error, a table of errors, and where each model fails."""
    where = [
        folded(f"Where {name} fails", *(items(failure_lines(f, True)) for f in each.where))
        for name, each in c.residuals.items()
    ]
    errors = html_table(error_rows(c.errors), "Error of the predicted torque")
    return in_frame([strong(comparison_headline(c)), errors, *where])


def comparison_headline(c: Comparison) -> str:
    """Return the models, and how far the error falls from the first to the last, in one line."""
    first, *_, last = (*c.residuals.values(), *c.residuals.values())
    names = " and ".join(c.residuals)
    if first is last:
        return f"{names} on {', '.join(trace.name for trace in first.traces)}"
    falls = {j: 1 - last.errors[j].rms / e.rms for j, e in first.errors.items() if e.rms > 0}
    if not falls:
        return names
    best, worst = max(falls, key=lambda j: falls[j]), min(falls, key=lambda j: falls[j])
    return (
        f"From {first.name} to {last.name} the error changes by {-100 * falls[best]:+.3g} % "
        f"({best}) to {-100 * falls[worst]:+.3g} % ({worst})."
    )


@renders(Comparison, "files")
def comparison_files(c: Comparison) -> dict[str, bytes]:
    """Return report.html and compare.json."""
    return {"report.html": comparison_page(c), "compare.json": comparison_json(c)}


def comparison_page(comparison: Comparison) -> bytes:
    """One file that opens without a network."""
    residuals = comparison.residuals
    first = next(iter(residuals.values()))
    mechanism, motion = first.model.mechanism, first.motion
    fitted = [
        html_table(error_rows(errors), f"{name} as it was fitted")
        for name, errors in comparison.fitted.items()
        if any(errors.values())
    ]
    missed = errors_section(comparison.errors)
    sections = (
        Section(missed.title, (*missed.blocks, *fitted)),
        torques_section(comparison.predictions, comparison.units),
        maps_section(residuals),
        parts_section(residuals),
        Section("Parameters", _compared_parameters(residuals)),
        Section("Multipliers", _compared_multipliers(comparison)),
        understood(mechanism, motion),
        made_of(mechanism, motion, [Path(name) for name in residuals if Path(name).is_file()]),
    )
    title = f"{mechanism.name}: model against measurement"
    return Page(title, comparison_headline(comparison), sections).html()


def _compared_parameters(residuals: Mapping[str, Residual]) -> tuple[Block, ...]:
    """Effects' values, then what was unknown of the bodies, model beside model."""
    models = [residual.model for residual in residuals.values()]
    values = [dict(model.point.values) for model in models]
    effects = list(dict.fromkeys(name for own in values for name in own))
    blocks: list[Block] = []
    if effects:
        rows = [["effect", *residuals]]
        for name in effects:
            rows.append([name, *(f"{own[name]:.5g}" if name in own else "–" for own in values)])
        blocks.append(html_table(rows, "Effects"))
    mechanism = models[0].mechanism
    at = {name: i for i, name in enumerate(mechanism.bodies.names)}
    unknown = [name for name in mechanism.unknown if name in at]
    if unknown:
        rows = [["parameter about the joint", "prior", *residuals]]
        for name in unknown:
            own = (f"{model.point.pi[at[name]]:.5g}" for model in models)
            rows.append([name, f"{mechanism.prior[at[name]]:.5g}", *own])
        blocks.append(
            html_table(rows, "Unknown parameters of the bodies; fit.json has standard errors")
        )
    return tuple(blocks)


def _compared_multipliers(comparison: Comparison) -> tuple[Block, ...]:
    """λ of every model, log by log."""
    first = next(iter(comparison.residuals.values()))
    kinematics = first.model.mechanism.kinematics
    if not kinematics.multipliers:
        return ()
    known = identifiable_multipliers(first.model.mechanism, first.motion)
    names = [e.name for e in first.motion.experiments]

    def draw(i: int) -> Chart:
        rows = []
        for k in np.flatnonzero(known):
            label = f"{kinematics.multipliers[k]} [{kinematics.units[k]}]"
            lines = []
            for colour, (model, predictions) in enumerate(comparison.predictions.items()):
                p = predictions[i]
                zero, y = zero_of(p.t), np.where(p.usable, p.multipliers[:, k], np.nan)
                lines.append(Line(p.t - zero, y, short(model), colour))
            rows.append((Panel(tuple(lines), time_label(zero), label, height=1.8),))
        words = "Multipliers λ over time, the reaction forces of the closures, of every model"
        return Chart(words, tuple(rows), shared_x=True, clock=names[i])

    return by_log(names, draw) if known.any() else ()


def comparison_json(comparison: Comparison) -> bytes:
    """The same as data."""
    models = {
        name: {
            "error": _errors_json(residual.errors),
            "fitted": {k: _errors_json(errors) for k, errors in comparison.fitted[name].items()},
            "parts": _parts_json(residual.parts, residual),
            "own_row": _parts_json(residual.own, residual),
            "where": [failure.json for failure in residual.where],
        }
        for name, residual in comparison.residuals.items()
    }
    first = next(iter(comparison.residuals.values()))
    content = {
        "schema": SCHEMA,
        "logs": [trace.name for trace in first.traces],
        "cutoff": first.motion.band.cutoff,
        "rows": first.rows,
        "models": models,
    }
    return json.dumps(content, indent=1, ensure_ascii=False).encode() + b"\n"


def _errors_json(errors: Mapping[str, Error]) -> dict[str, Any]:
    return {
        joint: {"rms": e.rms, "relative": e.relative, "unit": e.unit} for joint, e in errors.items()
    }


def _parts_json(parts: Mapping[str, np.ndarray], residual: Residual) -> dict[str, Any]:
    """rms by part, then joint; null where a joint has no row of its own."""
    return {
        name: {
            joint: None if np.isnan(x) else float(x)
            for joint, x in zip(residual.joints, values, strict=True)
        }
        for name, values in parts.items()
    }
