"""Fits, residuals and comparisons as text."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping

import numpy as np

from ident.display import renders
from ident.equations.unknowns import Columns
from ident.fit.compare import Comparison
from ident.fit.consistency import Binding
from ident.fit.essential import Essential
from ident.fit.findings import Finding
from ident.fit.likelihood import Likelihood
from ident.fit.multipliers import Reactions
from ident.fit.prediction import CLOSURES, DRIVES, RIGID, WRENCHES
from ident.fit.problem import information_of
from ident.fit.residual import Failure, Residual
from ident.fit.result import Fit
from ident.fit.shapes import initial
from ident.fit.unexcited import Lost, Unexcited, excitation
from ident.fit.values import STRONG, Correlation, Value, absorbed_by, base_names
from ident.information.blocks import Error
from ident.information.estimate import estimate
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.motion.closures import LoopSolver
from ident.text import percent, rounded, shortened, table

WIDTH = 100  # characters of a line in a terminal
TITLE, ABREAST = 32, 2  # characters of a model's name in a table, and models side by side
ROUNDING = 1e-12  # of the measured torque: below, a part is nil
WINDOWS, REGIMES = 3, 3  # that are printed; all are in compare.json
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


def value_tables(fit: Fit, most: int = 72) -> dict[str, list[list[str]]]:
    """Return tables of effects, parameters and combinations of `most` characters, by caption."""
    effects = [value for effect in fit.effects for value in effect.parameters]
    own = [value for value in fit.parameters if value.identifiable]
    combined = [value for value in fit.base_parameters if " " in value.name]
    tables = {
        "Effects": [["effect", "value", "unit"], *([v.name, shown(v), v.unit] for v in effects)],
        "Identified parameters": [
            ["parameter", "value", "prior", "unit"],
            *([v.name, shown(v), f"{v.prior:.5g}", v.unit] for v in own),
        ],
        "Combinations that only together can be identified": [
            ["base parameter", "value", "unit"],
            *([shortened(v.name, most), rounded(v.value, v.stderr), v.unit] for v in combined),
        ],
    }
    return {title: rows for title, rows in tables.items() if len(rows) > 1}


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
    for rows in value_tables(fit).values():
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


# --- residuals and comparisons --------------------------------------------------------------------


@renders(Residual, "text")
def residual_text(residual: Residual) -> str:
    """Return the parts of the sum and where the model fails."""
    return "\n".join(
        [residual_headline(residual), *parts_table(residual), "", *where_text(residual)]
    )


@renders(Failure, "text")
def text_of_failure(failure: Failure) -> str:
    """Return how a model fails in one joint."""
    return "\n".join(failure_text(failure, several=True))


def error_rows(named: Mapping[str, Mapping[str, Error]]) -> list[list[str]]:
    """Return one row a joint, two columns (rms, relative) for each set of errors."""
    titles = [title for title in named if named[title]]
    joints = list(dict.fromkeys(joint for title in titles for joint in named[title]))
    rows = [["joint", *(cell for title in titles for cell in (title, ""))]]
    for joint in joints:
        row = [joint]
        for title in titles:
            e = named[title].get(joint)
            row += ["", ""] if e is None else [f"{e.rms:.3g} {e.unit}", percent(e.relative)]
        rows.append(row)
    return rows


def errors_text(residuals: Mapping[str, Residual]) -> list[str]:
    """Return errors of several models on one motion, side by side, and how far they fall."""
    names = list(residuals)
    first, last = residuals[names[0]], residuals[names[-1]]
    cut = first.motion.band.cutoff
    logs = ", ".join(trace.name for trace in first.traces)
    lines = _filled(
        f"error of the predicted torque{f' below {cut:.3g} Hz' if cut else ''} on {logs}"
    )
    short = {name: name if len(name) <= TITLE else f"…{name[-TITLE:]}" for name in names}
    for i in range(0, len(names), ABREAST):
        some = {short[name]: residuals[name].errors for name in names[i : i + ABREAST]}
        lines += table(error_rows(some))
    if first is not last:
        falls = [
            f"{joint} {100 * (1 - last.errors[joint].rms / error.rms):.3g} %"
            for joint, error in first.errors.items()
            if error.rms > 0
        ]
        lines += _filled(f"error falls from {first.name} to {last.name}: {', '.join(falls)}")
    return lines


def _filled(text: str) -> list[str]:
    return textwrap.wrap(text, WIDTH, subsequent_indent="  ", break_on_hyphens=False)


def residual_headline(residual: Residual) -> str:
    """Return the model, logs and rows of a residual."""
    logs = ", ".join(trace.name for trace in residual.traces)
    cut = residual.motion.band.cutoff
    below = f" below {cut:.3g} Hz" if cut else ""
    text = f"residual of {residual.name} on {logs}{below}: {residual.rows} rows"
    return "\n".join(_filled(text))


def by_kind(parts: Mapping[str, np.ndarray], residual: Residual) -> dict[str, list[str]]:
    """Return the parts that one column shows: effects of one kind act on a joint as one."""
    kinds: dict[str, list[str]] = {}
    for name in parts:
        fixed = name in (RIGID, WRENCHES, DRIVES, CLOSURES)
        kinds.setdefault(name if fixed else name.split(":")[0], []).append(name)
    return kinds


def parts_table(residual: Residual, indent: str = "  ") -> list[str]:
    """Return the rms of the measured torque, of each part and of the residual, by joint."""
    kinds = by_kind(residual.traces[0].parts, residual)
    rms = residual.parts
    columns = {"measured": rms["measured"]}
    for kind, names in kinds.items():
        columns[kind] = residual.rms_together("parts", names)
        if kind == RIGID:
            columns["(gravity)"] = rms["gravity"]
    columns["residual"] = rms["residual"]
    lines = ["", "the sum taken apart, rms: rigid bodies + effects = predicted"]
    lines += _by_joint(residual, columns, indent)
    if residual.own:
        columns = {
            kind: residual.rms_together("own", names)
            for kind, names in by_kind(residual.traces[0].own, residual).items()
        }
        columns = {k: x for k, x in columns.items() if k != DRIVES or np.nanmax(x) > 0}
        lines += [
            "",
            "the joint's own row, rms: rigid bodies + effects + closure forces = its torque",
        ]
        lines += _by_joint(residual, columns, indent)
    return lines


def _by_joint(residual: Residual, columns: Mapping[str, np.ndarray], indent: str) -> list[str]:
    """Return one row a joint; more columns than fit go into a second table below."""
    names, lines = list(columns), []
    first = max(len(joint) for joint in residual.joints) + 8
    while names:
        width = first
        some: list[str] = []
        while names and (not some or width + max(len(names[0]), 7) + 2 <= WIDTH):
            width += max(len(names[0]), 7) + 2
            some.append(names.pop(0))
        rows = [["joint", "", *some]]
        for u, joint in enumerate(residual.joints):
            cells = [_number(columns[name][u], residual.parts["measured"][u]) for name in some]
            rows.append([joint, residual.units[u], *cells])
        lines += table(rows, indent)
    return lines


def _number(x: float, beside: float) -> str:
    if np.isnan(x):
        return "–"
    return "0" if x < ROUNDING * beside else f"{x:.3g}"


def where_text(residual: Residual, indent: str = "  ") -> list[str]:
    """Return where the model fails, joint by joint."""
    lines = ["where it fails"]
    several = len(residual.traces) > 1
    for failure in residual.where:
        lines += [f"{indent}{line}" for line in failure_text(failure, several)]
    return lines


def failure_text(failure: Failure, several: bool) -> list[str]:
    """Return how much one joint fails, on what that depends, in which regimes and when."""
    first, *rest = _sentences(failure, several)
    return [first[1], *(line for head, text in rest for line in _wrapped(head, text))]


def failure_lines(failure: Failure, several: bool) -> list[str]:
    """Return the same, a sentence a line."""
    return [" ".join(each).strip() for each in _sentences(failure, several)]


def _sentences(failure: Failure, several: bool) -> list[tuple[str, str]]:
    white = "indistinguishable from noise" if failure.white else "has structure"
    first = (
        f"{failure.joint}: {failure.rms:.3g} {failure.unit} ({percent(failure.relative)}), "
        f"{100 * failure.share:.0f} % of the misfit; {white}"
    )
    found = [("", first)]
    if failure.depends_on:
        found.append(("depends on", "; ".join(str(each) for each in failure.depends_on)))
    elif not failure.white:
        found.append(
            ("depends on", "no single signal that was tried; but it is correlated in time")
        )
    if regimes := failure.stands_out[:REGIMES]:
        found.append(("larger at", ", ".join(str(each) for each in regimes)))
    if failure.worst and not failure.white:
        windows = [
            f"{each}" + (f" of {each.experiment}" if several else "")
            for each in failure.worst[:WINDOWS]
        ]
        found.append(("worst in", ", ".join(windows)))
    return found


def _wrapped(head: str, text: str) -> list[str]:
    indent = " " * 15
    lines = textwrap.wrap(text, WIDTH - 2 - len(indent), break_on_hyphens=False)
    return [f"   {head:<12}{lines[0]}", *(indent + line for line in lines[1:])]


@renders(Comparison, "text")
def comparison_text(c: Comparison) -> str:
    """Return errors, the parts of the sum, and where each model fails."""
    lines = [c.summary]
    for name, residual in c.residuals.items():
        lines += ["", name] if len(c.residuals) > 1 else []
        lines += [*parts_table(residual), "", *where_text(residual)]
    return "\n".join(lines)


@renders(Comparison, "summary")
def comparison_summary(c: Comparison) -> str:
    """Return errors on this motion, those of the fits, and how far the error falls."""
    lines = errors_text(c.residuals)
    for name, errors in c.fitted.items():
        if any(errors.values()):
            lines += ["", f"errors of {name} as it was fitted", *table(error_rows(errors))]
    return "\n".join(lines)


# --- what a motion determines ---------------------------------------------------------------------


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
