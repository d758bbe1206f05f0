"""Fits and what belongs to them as text, HTML, charts, 3-D view and report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from markupsafe import Markup

from ident.display import render, renders
from ident.equations.unknowns import Columns
from ident.errors import FitError, one_of
from ident.fit.consistency import Binding
from ident.fit.essential import Essential
from ident.fit.files import write_fit, write_urdf
from ident.fit.findings import Finding
from ident.fit.likelihood import Likelihood
from ident.fit.multipliers import Reactions
from ident.fit.problem import information_of
from ident.fit.result import Fit
from ident.fit.shapes import initial
from ident.fit.unexcited import Lost, Unexcited, excitation
from ident.fit.values import STRONG, Correlation, Value, absorbed_by, base_names
from ident.information.estimate import estimate
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.motion.closures import LoopSolver
from ident.show import residual as report
from ident.show.charts import MEASURED, PRIOR, Chart, Dots, Line, Panel
from ident.show.html import (
    Block,
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
from ident.show.residual import error_rows, plot_predictions, time_label, zero_of
from ident.show.view3d import View
from ident.text import percent, rounded, shortened, table

MOST = 60  # parameters in one chart
STRUCTURE = (
    "What is left in {} has structure: the model may lack something, and ± is what noise alone "
    "would do to a complete model. `ident diagnose` says what could be missing."
)
LAMBDA = "The reaction forces that the closures need for this motion; they rest on the model."
WHY = {
    "noise": "too little of it for a residual of this size",
    "same columns": "acts as {}",
    "unfelt": "no torque feels it in this motion",
}


@renders(Finding, "text")
def finding(x: Finding) -> str:
    """Return the meaning and the remedy of a finding."""
    return f"{x.meaning}; {x.remedy}" if x.remedy else x.meaning


@renders(Fit, "text")
def text(fit: Fit) -> str:
    """Return the summary and what to know before trusting it."""
    return "\n".join([summary(fit), *(f"note: {note}" for note in fit.warnings)])


def shown(value: Value) -> str:
    """Return a value as tables have it."""
    return rounded(value.value, value.stderr) + (", at bound" if value.at_bound else "")


def summary(fit: Fit) -> str:
    """Return errors, effects, parameters and statistics of a fit."""
    motion = fit.motion
    logs = ", ".join(motion.names)
    cut = motion.band.cutoff
    errors = {"train": fit.train, "held out": fit.held_out, **fit.validation}
    if cut:
        errors["unfiltered"] = fit.unfiltered
    lines = [
        f"fit of {fit.mechanism.name} to {logs}: {fit.rows} rows of {motion.samples} samples"
        + (f", zero-phase filter at {cut:.3g} Hz" if cut else ", unfiltered"),
        "",
        "error of the predicted torque" + (f" below {cut:.3g} Hz" if cut else ""),
        *table(error_rows(errors)),
    ]
    if fit.effects:
        rows = [["effect", "value", "unit"]]
        for effect in fit.effects:
            rows += [[v.name, shown(v), v.unit] for v in effect.parameters]
        lines += ["", *table(rows)]
    own = [value for value in fit.parameters if value.identifiable]
    if own:
        rows = [["parameter", "value", "prior", "unit"]]
        rows += [[v.name, shown(v), f"{v.prior:.5g}", v.unit] for v in own]
        lines += ["", *table(rows)]
    combined = [value for value in fit.base_parameters if " " in value.name]
    if combined:
        rows = [["base parameter", "value", "unit"]]
        rows += [[shortened(v.name), rounded(v.value, v.stderr), v.unit] for v in combined]
        lines += ["", *table(rows)]
    lines += _multipliers(fit)
    left = [value.name for value in fit.parameters if not value.identifiable]
    rest = f"; {len(left)} unknowns are not identifiable by themselves" if left else ""
    condition = f"condition number {fit.condition_number:.3g}"
    if len(fit.columns):
        lines += ["", f"rank {fit.rank} of {len(fit.columns)} unknowns, {condition}{rest}"]
    if fit.likelihood is not None:
        lines.append(likelihood(fit.likelihood))
    if fit.essential is not None:
        lines.append(essential_line(fit.essential))
    lines += correlation_notes(fit.correlation)
    if fit.binding is not None:
        lines.append(binding(fit.binding))
    return "\n".join(lines)


def _multipliers(fit: Fit) -> list[str]:
    kinematics = fit.mechanism.kinematics
    if not kinematics.multipliers:
        return []
    values = np.concatenate([each for _, each in fit.multipliers])
    rows = [["multiplier", "rms", "largest", "unit"]]
    for i, (name, unit) in enumerate(zip(kinematics.multipliers, kinematics.units, strict=True)):
        x = values[np.isfinite(values[:, i]), i]
        size = [f"{np.sqrt(np.mean(x**2)):.4g}", f"{np.abs(x).max():.4g}"] if len(x) else ["–", "–"]
        rows.append([name, *size, unit])
    return ["", *table(rows)]


@renders(Likelihood, "text")
def likelihood(x: Likelihood) -> str:
    """Return how torques and motion were weighed together."""
    share = 100 * min(float(x.share.max(initial=0.0)), 1.0)
    done = f"{x.steps} step" + ("s" if x.steps > 1 else "")
    if x.steps > 1:
        done += ", converged" if x.settled else ", not converged"
    return (
        f"noise of the motion makes up to {share:.3g} % of the residual: torques and motion "
        f"were weighed together (maximum likelihood, {done})"
    )


@renders(Binding, "text")
def binding(x: Binding) -> str:
    """Return which limits hold a fit back, and what they cost."""
    if not x.active:
        return "physically consistent, without any limit holding it back"
    rises = [f"error {_signed(x.rise)}"]
    if x.held_out_rise is not None:
        rises.append(f"held-out error {_signed(x.held_out_rise)}")
    return f"physically consistent ({', '.join(rises)}); held back by: {'; '.join(x.active)}"


def _signed(rise: float) -> str:
    return f"{100 * rise:+.2g} %" if rise < 1 else f"{1 + rise:.2g}-fold"


@renders(Correlation, "text")
def correlation(x: Correlation) -> str:
    """Return the pairs of base parameters that are known only together."""
    strong_pairs = x.pairs()
    if not strong_pairs:
        most = x.pairs(0.0)[:1]
        rest = f"; the most: {_pair(most[0])}" if most else ""
        return f"no two base parameters are known only together (|r| < {STRONG}){rest}"
    return "\n".join(["known only together:", *(f"  {_pair(pair)}" for pair in strong_pairs)])


def correlation_notes(x: Correlation) -> list[str]:
    """Return a note where parameters are known only together."""
    pairs = x.pairs()
    more = f" and {len(pairs) - 4} more pairs" if len(pairs) > 4 else ""
    if not pairs:
        return []
    return [
        f"known only together (correlation of errors): {'; '.join(map(_pair, pairs[:4]))}{more}"
        ": their sum or difference is known better than each"
    ]


def _pair(pair: tuple[str, str, float]) -> str:
    return f"{pair[0]} and {pair[1]} ({pair[2]:+.3f})"


@renders(Essential, "line")
def essential_line(x: Essential) -> str:
    """Return the number of essential parameters in one line."""
    count = len(x.names) + len(x.dropped)
    if not x.dropped:
        return f"essential: all {count} base parameters"
    rise = x.dropped[-1].rise
    change = f"rises by more than {100 * rise:.2g} %" if rise > 0 else "rises"
    return (
        f"essential: {len(x.names)} of {count} base parameters; with the others at zero no "
        f"joint's held-out error {change}"
    )


@renders(Essential, "text")
def essential(x: Essential) -> str:
    """Return essential parameters, dropped ones, and errors of both models."""
    rows = [["dropped, in this order", "± / value", "held-out error"]]
    rows += [[d.name, f"{100 * d.relative:.3g} %", f"{100 * d.rise:+.2g} %"] for d in x.dropped]
    errors = [["joint", "full", "", "reduced", ""]]
    for joint, e in x.full.items():
        r = x.reduced[joint]
        both = (f"{e.rms:.3g} {e.unit}", percent(e.relative), f"{r.rms:.3g} {r.unit}")
        errors.append([joint, *both, percent(r.relative)])
    lines = [essential_line(x), *table([[name] for name in x.names])]
    return "\n".join([*lines, "", *table(rows), "", "held out", *table(errors)])


@renders(Unexcited, "text")
def unexcited(x: Unexcited) -> str:
    """Return what a motion does not determine, why, and which motion would."""
    if not x.lost:
        return "this motion tells all that a motion can tell"
    lines = ["this motion does not tell what another one would:"]
    lines += [f"  {e.name}: {WHY[e.why].format(', '.join(e.carriers[:3]))}" for e in x.lost]
    return "\n".join([*lines, *x.advice])


@renders(Unexcited, "advice")
def advice(x: Unexcited) -> list[str]:
    """Return one sentence for all unknowns that the same joints determine."""
    groups: dict[str, list[Lost]] = {}
    for each in x.lost:
        groups.setdefault(each.joints[0] if each.joints else "", []).append(each)
    found = []
    for joint, some in groups.items():
        names = ", ".join(each.name for each in some[:5])
        names += f" and {len(some) - 5} more" if len(some) > 5 else ""
        if not joint:
            found.append(
                f"to tell {names}: no swing of one joint beside this motion will do; move several "
                "at once, farther and faster"
            )
            continue
        far, fast, unit = x.moved[joint]
        size, top = x.swing[joint]
        found.append(
            f"to tell {names}: swing {joint} by ±{size:.2g} {unit} with up to {top:.2g} {unit}/s² "
            f"(it moved through {far:.2g} {unit} with up to {fast:.2g} {unit}/s²)"
        )
    return found


@renders(Reactions, "text")
def reactions(x: Reactions) -> str:
    """Return what identified multipliers miss known reactions by."""
    kinematics = x.mechanism.kinematics
    rows = [["multiplier", "rms of it", "rms error", "largest error"]]
    for i, (name, unit) in enumerate(zip(kinematics.multipliers, kinematics.units, strict=True)):
        if not np.isfinite(x.off[:, i]).any():
            continue
        size, rms = (float(np.sqrt(np.nanmean(y[:, i] ** 2))) for y in (x.known, x.off))
        worst = float(np.nanmax(np.abs(x.off[:, i])))
        rows.append([name, f"{size:.4g} {unit}", f"{rms:.3g} {unit}", f"{worst:.3g} {unit}"])
    return "\n".join(["multipliers against known reactions", *table(rows)])


@renders(Reactions, "plot")
def plot_reactions(x: Reactions) -> Chart:
    """Draw λ(t) identified over λ(t) known."""
    return plot_multipliers(x.mechanism, *x.identified, (x.t, x.known), x.log)


@renders(Fit, "plot")
def plot(fit: Fit, experiment: int = 0) -> Chart:
    """Draw measured and predicted torque of every independent joint, and what is left."""
    return plot_predictions({fit.name: fit.predictions}, fit.problem.units, experiment)


@renders(Fit, "plot_parts")
def plot_parts(fit: Fit, experiment: int = 0) -> Chart:
    """Draw the sum taken apart: rigid bodies, effects and what is left, per joint."""
    return report.plot_parts({fit.name: fit.residual}, experiment)


@renders(Fit, "plot_maps")
def plot_maps(fit: Fit, joint: str | None = None) -> Chart:
    """Draw a joint's residual against t, q, v, a and load; by default where the model fails most.

    Raises:
        FitError: if the joint is not an independent one.
    """
    joint = fit.residual.where[0].joint if joint is None else joint
    if joint not in fit.residual.joints:
        raise FitError(f"no residual of joint '{joint}'; {one_of(joint, fit.residual.joints)}")
    return report.plot_maps({fit.name: fit.residual}, joint)


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
def view(fit: Fit) -> View:
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
        return report.errors(errors)
    errors["unfiltered"] = fit.unfiltered
    words = f"Below {cut:.3g} Hz, where the fit was made; unfiltered: with all noise in it."
    return report.errors(errors, words)


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
        report.torques({fit.name: fit.predictions}, fit.problem.units),
        report.maps(residuals),
        report.parts(residuals),
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
    if effects:
        rows = [["effect", "value", "unit"], *([v.name, shown(v), v.unit] for v in effects)]
        blocks.append(html_table(rows, "Effects"))
    if own:
        rows = [["parameter", "value", "prior", "unit"]]
        rows += [[v.name, shown(v), f"{v.prior:.5g}", v.unit] for v in own]
        blocks.append(html_table(rows, "Identified parameters"))
    combined = [value for value in fit.base_parameters if " " in value.name]
    if combined:
        rows = [["base parameter", "value", "unit"]]
        rows += [[shortened(v.name, 120), rounded(v.value, v.stderr), v.unit] for v in combined]
        blocks.append(html_table(rows, "Combinations that only together can be identified"))
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
        blocks += report.by_log(names, fit.plot_multipliers)
    return tuple(blocks)


def describe(mechanism: Mechanism, motion: Motion | None = None) -> str:
    """Return joints with limits, assembled positions, and how far a motion moves them."""
    rows = [["joint", "", "lower", "upper", "assembled", "unit"]]
    if motion is not None:
        rows[0][-1:-1] = ["from", "to", "top speed"]
    names = tuple(joint.name for joint in mechanism.joints)
    assembled = LoopSolver(mechanism, names).coordinates(mechanism.assembled[None]).value[0]
    for i, joint in enumerate(mechanism.joints):
        state = "driven" if joint.name in mechanism.driven else "passive"
        if joint.name.startswith("closure."):
            state = "of a closure"
        row = [joint.name, state, f"{joint.lower:.4g}", f"{joint.upper:.4g}", f"{assembled[i]:.4g}"]
        if motion is not None:
            y = np.concatenate([e.y[:, i] for e in motion.experiments])
            speed = np.concatenate([e.yd[:, i] for e in motion.experiments])
            row += [f"{y.min():.4g}", f"{y.max():.4g}", f"{np.abs(speed).max():.3g}/s"]
        rows.append([*row, joint.unit])
    return "\n".join([str(mechanism), *table(rows)])


def channels(mechanism: Mechanism, motion: Motion) -> str:
    """Return what was done to every measured channel of the motion.

    Its estimated white noise, and the rms of measured less smoothed: equal
    where the channels agree with each other, the closures and the resolution of the splines.
    """
    units = ("{}", "{}/s", "{}/s²")
    rows = [["channel", "noise", "residual", "unit", "", "log"]]
    for e in motion.experiments:
        for channel in e.channels:
            letter, joint = channel.column.split(".", 1)
            unit = units["qva".index(letter)].format(mechanism.joint(joint).unit)
            left = f"{channel.residual:.3g}" if channel.spacing else "–"
            rows.append([channel.column, f"{channel.noise:.3g}", left, unit, channel.how, e.name])
    title = "what was measured of the motion: its white noise, and measured less smoothed (rms)"
    return "\n".join([title, *table(rows)])


def structure(mechanism: Mechanism, motion: Motion | None = None) -> str:
    """Return which base parameters a motion identifies, or could at best if none is given."""
    columns = Columns.of(mechanism)
    if not len(columns):
        return "nothing is unknown"
    what = "this motion identifies"
    if motion is None:
        motion, what = excitation(mechanism), "a motion can identify"
    information = information_of(mechanism, columns, motion, initial(mechanism, motion))
    ones = np.ones(information.d)
    found = estimate(information.totals, columns.prior, ones, sigma=ones)
    lines = [
        f"{what} {found.base.rank} base parameters of {len(columns)} unknowns "
        f"(condition number {found.base.condition_number:.3g}):"
    ]
    lines += [f"  {name}" for name in base_names(columns, found.base)]
    nothing = [name for name, carrier in absorbed_by(columns, found.base).items() if not carrier]
    if nothing:
        lines.append(f"no torque feels: {', '.join(nothing)}")
    return "\n".join(lines)
