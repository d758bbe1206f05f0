"""Fits as text, tables, charts, 3-D view and report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Protocol

import numpy as np

from ident.assess.assessment import Assessment
from ident.assess.fit import assess_fit, increase_of
from ident.display import renders
from ident.errors import FitError
from ident.faults.data_checks import Health
from ident.fit.calibration import Budget
from ident.fit.consistency import Binding
from ident.fit.files import residual_before, write_fit, write_urdf
from ident.fit.likelihood import Likelihood
from ident.fit.prediction import Reactions
from ident.fit.result import Fit
from ident.fit.values import STRONG, BaseValue, Correlation, Value
from ident.request import PYTHON, Request
from ident.show.body import body_words
from ident.show.card import Card, card_of
from ident.show.charts import PRIOR, Chart, Dots, Panel
from ident.show.comparison import change_tables, changes_line, plot_forces
from ident.show.headline import error_words, headline
from ident.show.html import Block, Section, Sheet, by_log, folded, items, paragraph, report_page
from ident.show.html import table as html_table
from ident.show.motion import made_of, understood
from ident.show.residual import compared, error_rows, errors_section, residual_sections
from ident.text import listed, percent, rounded, shortened, shortlist, significant, two_digits

SHORT_FOREST = 6  # shown: rows of values, its head among them, beside two charts
MOST_CHARTED = 60  # parameters in one chart
LAMBDA = "The reaction forces that the closures need for this motion; they rest on the model."
TOGETHER = "Combinations that only together can be identified"
Rows = list[list[str]]


# --- what belongs to a fit ------------------------------------------------------------------------


@renders(Likelihood, "text")
def likelihood(x: Likelihood) -> str:
    """Return how torques and motion were weighed together."""
    share = 100 * min(float(x.share.max(initial=0.0)), 1.0)
    done = "1 step"
    if x.steps > 1:
        done = f"{x.steps} steps, {'' if x.settled else 'not '}converged"
    return (
        f"noise of the motion makes up to {share:.3g} % of the residual: torques and motion "
        f"were weighed together (maximum likelihood, {done})"
    )


@renders(Binding, "text")
def binding(x: Binding) -> str:
    """Return which limits hold a fit back, and what they cost."""
    if not x.active:
        return "physically consistent, without any limit holding it back"
    rises = {"error": x.rise, "held-out error": x.held_out_rise}
    costs = ", ".join(
        f"{name} {100 * rise:+.2g} %" if rise < 1 else f"{name} {two_digits(1 + rise)}-fold"
        for name, rise in rises.items() if rise is not None
    )  # fmt: skip
    return f"physically consistent ({costs}); held back by: {'; '.join(x.active)}"


@renders(Correlation, "text")
def correlation(x: Correlation) -> str:
    """Return the pairs of base parameters that are known only together."""
    lines = _pairs(x) or [f"none (|r| < {STRONG})"]
    return "\n  ".join(["base parameters that are known only together:", *lines])


def _pairs(x: Correlation) -> list[str]:
    return [f"{first} and {second} ({r:+.3f})" for first, second, r in x.pairs(STRONG)]


@renders(Reactions, "sheet")
def reactions(x: Reactions) -> Sheet:
    """Return what identified multipliers miss known reactions by."""
    kinematics = x.mechanism.kinematics
    rows = [["multiplier", "rms of it", "rms error", "largest error"]]
    for i, (name, unit) in enumerate(zip(kinematics.multipliers, kinematics.units, strict=True)):
        if np.isfinite(x.off[:, i]).any():
            size, rms = (float(np.sqrt(np.nanmean(y[:, i] ** 2))) for y in (x.known, x.off))
            worst = float(np.nanmax(np.abs(x.off[:, i])))
            sizes = significant(size, 4), significant(rms), significant(worst)
            rows.append([name, *(f"{siz} {unit}" for siz in sizes)])
    return Sheet("", tables={"multipliers against known reactions": rows})


@renders(Reactions, "plot")
def plot_reactions(x: Reactions) -> Chart:
    """Draw λ(t) identified over λ(t) known."""
    kinematics = x.mechanism.kinematics
    series = {"known": (x.t, x.known), "identified": x.identified}
    return plot_forces(kinematics.multipliers, kinematics.units, series, x.log)


@renders(Health, "sheet")
def health_sheet(h: Health) -> Sheet:
    """Return the findings, each with its number and threshold."""
    result = "nothing is wrong" if h.good else f"{len(h.findings)} finding(s)"
    return Sheet(f"health of the data: {result}", lines=[f"! {finding}" for finding in h.findings])


# --- the fit --------------------------------------------------------------------------------------


def error_table(fit: Fit) -> tuple[str, Rows]:
    """Return a caption, and errors in training, held out, on other logs, unfiltered, at rest."""
    errors, cut, judged = dict(fit.errors), fit.motion.band.cutoff, fit.held_out or fit.train
    if cut:
        errors["unfiltered"] = fit.unfiltered
    errors_at_rest = {joint: item.with_standstill for joint, item in judged.items()}
    if commands := fit.command_errors:
        errors["in its command"] = commands
    if still := any(element.rms != judged[joint].rms for joint, element in errors_at_rest.items()):
        errors["at standstill too"] = errors_at_rest
    caption = "error of the predicted torque" + (f" below {cut:.3g} Hz" if cut else "")
    return caption + ", in motion" * still, error_rows(errors)


def value_tables(fit: Fit, most: int = 60) -> dict[str, Rows]:
    """Return tables of effects, parameters and combinations of `most` characters, by caption."""
    priors = fit.estimate.base.combined(fit.problem.prior)
    combined = [(v, x) for v, x in zip(fit.base_parameters, priors, strict=True) if " " in v.name]
    effects = [value for effect in fit.effects for value in effect.parameters]
    own_values = [value for value in fit.parameters if value.identifiable]
    words = {
        name: parameter.negative
        for item in fit.effects
        for name, parameter in zip(item.effect.names, item.effect.parameters, strict=True)
    }

    def shown(v: Value) -> str:
        return rounded(v.value, v.stderr) + (", at bound" if v.at_bound else "")

    head, cells = error_columns(fit)

    def unit(v: Value) -> str:
        return f"{v.unit}, {words[v.name]}" if v.value < 0 and words.get(v.name) else v.unit

    tables = {
        "Effects": [
            ["effect", "value", *head, "unit"],
            *([v.name, shown(v), *cells(v), unit(v)] for v in effects),
        ],
        "Identified parameters": [
            ["parameter", "value", *head, "prior", "unit"],
            *([v.name, shown(v), *cells(v), significant(v.prior, 5), v.unit] for v in own_values),
        ],
        TOGETHER: [
            ["base parameter", "value", *head, "prior", "unit"],
            *(
                [
                    shortened(v.name, most),
                    rounded(v.value, v.stderr),
                    *cells(v),
                    significant(x, 4),
                    v.unit,
                ]
                for v, x in combined
            ),
        ],
        "Multipliers": _multiplier_rows(fit),
    }
    return {title: rows for title, rows in tables.items() if len(rows) > 1}


class Budgeted(Protocol):
    """Values with errors of which causes make shares."""

    @property
    def budget(self) -> Budget | None:
        """The error budget; None where the calibration is exact."""

    def shares(self, name: str) -> dict[str, float]:
        """Return the share of each cause in the variance of a value, the largest first."""


def error_columns(fit: Budgeted) -> tuple[list[str], Callable[[Value | BaseValue], list[str]]]:
    """Return heads of the columns on what errors are made of, and their cells for a value; none
    where the calibration is exact, so that all of an error is noise.
    """
    if fit.budget is None:
        return [], lambda value: []

    def cells(value: Value | BaseValue) -> list[str]:
        if not value.stderr or not np.isfinite(value.stderr):
            return ["–", "–"]
        cause, share = next(iter(fit.shares(value.name).items()), ("–", 0.0))
        return [two_digits(value.stderr_noise or 0.0), f"{cause}, {100 * share:.0f} %"]

    return ["± noise", "most of ±"], cells


def calibration_line(fit: Fit) -> str:
    """Return which cause makes most of the errors, by the parameter that it makes worst; empty
    where noise does, or the calibration is exact.
    """
    if fit.budget is None:
        return ""
    effects = (value for effect in fit.effects for value in effect.parameters)
    known = [v for v in (*fit.parameters, *effects) if v.identifiable and v.stderr and v.value]
    worst: dict[str, list[tuple[float, Value, float]]] = {}
    for value in known:
        cause, share = next(iter(fit.shares(value.name).items()), ("noise", 1.0))
        error = (value.stderr or 0.0) / abs(value.value)
        worst.setdefault(cause, []).append((error if error < 1 else 0.0, value, share))
    worst.pop("noise", None)
    if not worst:
        return ""
    cause = max(worst, key=lambda name: len(worst[name]))
    error, value, share = max(worst[cause], key=lambda entry: entry[0] * entry[2])
    if not error:
        return ""
    of_it = percent(error * share**0.5)
    return (
        f"{value.name} ± {percent(error)}, of it ± {of_it} from the {cause.removeprefix('the ')}"
        f", which makes most of the error of {len(worst[cause])} of {len(known)} parameters: "
        "calibrate it, or state how good it is (--calibrated)"
    )


def body_lines(fit: Fit) -> list[str]:
    """Return mass and centre of each payload, of which the tables have all ten parameters."""
    words = ((effect.effect.label, body_words(effect.parameters)) for effect in fit.effects)
    return [f"{label}: {body}" for label, body in words if body]


def _multiplier_rows(fit: Fit) -> Rows:
    errors, kinematics = fit.multiplier_errors, fit.mechanism.kinematics
    rows = [["multiplier", "rms", "±", "largest", "unit"]]
    if errors.resting:
        rows[0] += ["if priors are wrong, ± up to", "which no torque shows"]
    values = np.concatenate([item for _, item in fit.multipliers])
    names = zip(kinematics.multipliers, kinematics.units, values.T, strict=True)
    for i, (name, unit, y) in enumerate(names):
        x = y[np.isfinite(y)]
        sizes = [significant(f(x**2) ** 0.5, 4) for f in (np.mean, np.max) if len(x)]
        rms, most = sizes or ["–", "–"]
        error = significant(float(errors.by_values[i]), 2) if len(x) else ""
        row = [name, rms, error, most, unit]
        if errors.resting:
            on = errors.resting.get(name, []) if len(x) else []
            row += [significant(float(errors.by_priors[i]), 2) if on else "", shortlist(on, 2)]
        rows.append(row)
    return rows


@renders(Fit, "sheet")
def sheet(fit: Fit, request: Request = PYTHON) -> Sheet:
    """Return errors, effects, parameters, statistics, and what to know before trusting them."""
    caption, errors = error_table(fit)
    cut = fit.motion.band.cutoff
    lines = []
    if len(fit.columns):
        own_values = sum(not value.identifiable for value in fit.parameters)
        rest = f"; {own_values} unknowns are not identifiable by themselves" if own_values else ""
        condition = f"condition number {significant(fit.condition_number)}"
        lines.append(f"rank {fit.rank} of {len(fit.columns)} unknowns, {condition}{rest}")
    lines += [str(x) for x in (fit.likelihood, fit.binding) if x is not None]
    lines += body_lines(fit)
    if calibrate := calibration_line(fit):
        lines.append(calibrate)
    if pairs := _pairs(fit.correlation):
        lines.append(
            f"known only together (correlation of errors): {shortlist(pairs)}: their sum or "
            "difference is known better than each"
        )
    line = (
        f"fit of {fit.mechanism.name} to {', '.join(fit.motion.names)}: {fit.rows} rows of "
        f"{fit.motion.samples} samples, "
        + (f"zero-phase filter at {cut:.3g} Hz" if cut else "unfiltered")
    )
    tables = {**change_tables(fit.changes), caption: errors, **value_tables(fit)}
    return Sheet(card(fit, request), line, tables=tables, lines=lines, notes=fit.warnings)


def card(fit: Fit, request: Request = PYTHON) -> Card:
    """Return how well a fit predicts, better than the model before or not, and what next."""
    a, sentences = assess_fit(fit, acceptable=request.acceptable), list[str]()
    wrong = doubts_words(fit, a)
    if fit.changes is not None:
        line = f"{a.subject}: {changes_line(fit.changes, a.changed)}"
        sentences += [f"{_capital(error_words(a))}.", *wrong]
    elif a.spoilt and a.errors:
        line, *wrong = wrong
        sentences += [*wrong, f"{_capital(error_words(a))}."]
    else:
        line, sentences = headline(a), wrong
    if a.untrusted and not a.spoilt:
        sentences.append(
            "Its parameters are not to be trusted, whatever their ±: an effect is missing, or "
            "data, a length or a known body are wrong."
        )
    increase = increase_of(fit)
    if increase.joints and not increase.in_fit:  # in its own rows the fit is better
        names = listed(
            f"{j} ({percent(fit.train[j].relative)} in the fit)" for j in increase.joints
        )
        sentences.append(f"Held out, the error of the identified numbers is larger in {names}.")
    return card_of(a, request, line=line, sentences=sentences)


def doubts_words(fit: Fit, a: Assessment) -> list[str]:
    """Return what looks wrong in the data of a fit, in sentences."""
    faults = {*fit.health.faults}
    texts = {"magnitude": "The size looks wrong of"}
    return [
        f"The data look wrong: {finding}."
        if finding in faults
        else f"{texts.get(finding.code, 'The sign looks wrong of')} {finding}."
        for finding in a.doubts
    ]


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def summary(fit: Fit, request: Request = PYTHON) -> str:
    """Return errors, effects, parameters and statistics of a fit."""
    return sheet(fit, request).summary()


@renders(Fit, "plot_parameters")
def plot_parameters(fit: Fit) -> Chart:
    """Draw identified values ± 1.96 standard errors beside the prior; a FitError without any."""
    own_values = [value for effect in fit.effects for value in effect.parameters]
    own_values += [value for value in fit.parameters if value.identifiable]
    known = [v for v in own_values if v.stderr and np.isfinite(v.stderr)]  # 0: of what was given
    if not known:
        raise FitError(f"{fit.mechanism.name}: nothing was identified by itself")
    words = "Identified values with their 95 % intervals, beside what was assumed before"
    if len(known) > MOST_CHARTED:
        words += f"; the first {MOST_CHARTED} of {len(known)}, all are in the tables"
    rows = []
    for unit in dict.fromkeys(v.unit for v in known[:MOST_CHARTED]):
        values = [v for v in known[:MOST_CHARTED] if v.unit == unit]
        at = np.arange(len(values), dtype=float)
        prior, result = (np.array([getattr(v, key) for v in values]) for key in ("prior", "value"))
        half = np.array([1.96 * (v.stderr or 0.0) for v in values])
        marks = Dots(at, prior, 0 * at, "prior", PRIOR), Dots(at, result, half, "identified", 0)
        names = tuple(v.name for v in values)
        rows.append((Panel(marks, f"[{unit}]", y_names=names, height=0.7 + 0.22 * len(values)),))
    return Chart(words, tuple(rows))


@renders(Fit, "plot_multipliers")
def plot_multipliers(fit: Fit, experiment: int = 0) -> Chart:
    """Draw λ(t), the reaction forces of the closures; a FitError without closures."""
    kinematics = fit.mechanism.kinematics
    if not kinematics.multipliers:
        raise FitError(f"{fit.mechanism.name}: has no closures, so no multipliers")
    log = fit.motion.experiments[experiment].name
    series = {"identified": fit.multipliers[experiment]}
    return plot_forces(kinematics.multipliers, kinematics.units, series, log)


renders(Fit, "folder")(write_fit)
renders(Fit, "urdf")(write_urdf)


# --- the report -----------------------------------------------------------------------------------


@renders(Fit, "report")
def report(
    fit: Fit,
    known: Reactions | None = None,
    more: Sequence[Section] = (),
    request: Request = PYTHON,
) -> bytes:
    """Return the report of a fit, with further sections after those of its residual."""
    from ident.show.front import first_screen, forest  # pages only: it is slow to import

    sections = fit_sections(fit, known, more, request=request)
    before = residual_before(fit) if len(fit.columns) else fit.residual
    screen = first_screen(before, fit.residual)
    values = forest(fit)
    short = values.count("<tr>") <= SHORT_FOREST  # leaves room for what the residual depends on
    front = [*(screen.front if short else screen.front[:1]), values]
    title = f"{fit.mechanism.name}: identification"
    return report_page(title, card(fit, request), sections, front, machine=screen.machine)


@renders(Fit, "view")
def view(fit: Fit) -> object:
    """Return the page of a fit in 3-D, with a ghost of the model as it was before."""
    from ident.show.front import view_of_one  # pages only: it is slow to import

    return view_of_one(fit)


def fit_sections(
    fit: Fit,
    known: Reactions | None = None,
    more: Sequence[Section] = (),
    first: str = "",
    request: Request = PYTHON,
) -> tuple[Section, ...]:
    """Return warnings, parameters, errors, where it fails, multipliers, and what went in.

    `first`: joint that comes first.
    """
    notes = [
        warning for warning in fit.warnings if warning not in fit.motion.notes
    ]  # those stand elsewhere
    prior = residual_before(fit).predictions if len(fit.columns) else ()
    changed = [
        html_table(*change_table[::-1]) for change_table in change_tables(fit.changes, 120).items()
    ]
    return (
        Section("What has changed", changed),
        Section("Warnings", [items(notes)] if notes else []),
        Section("Parameters", _parameters(fit) if len(fit.columns) else ()),
        errors_section(error_table(fit)[1]),
        *residual_sections(compared(fit), first, prior),
        *more,
        Section("Multipliers", _multipliers(fit, known)),
        understood(fit.mechanism, fit.motion),
        made_of(fit.mechanism, fit.motion, command=request.command),
    )


def _parameters(fit: Fit) -> list[Block]:
    blocks: list[Block] = []
    with suppress(FitError):  # nothing was identified by itself
        blocks.append(plot_parameters(fit))
    blocks += [paragraph(body_line) for body_line in body_lines(fit)]
    tables = value_tables(fit, 120)
    tables.pop("Multipliers", None)
    together = tables.pop(TOGETHER, None)
    blocks += [html_table(rows, title) for title, rows in tables.items()]
    blocks += [folded(TOGETHER, html_table(together, ""))] if together else []
    return blocks + ([paragraph(binding(fit.binding))] if fit.binding else [])


def _multipliers(fit: Fit, known: Reactions | None) -> list[Block]:
    if not fit.mechanism.kinematics.multipliers:
        return []
    blocks: list[Block] = [paragraph(LAMBDA)]
    if known is not None:
        blocks += [*reactions(known).blocks(), plot_reactions(known)]
    names = [e.name for e in fit.motion.experiments]
    if known is None or len(names) > 1:
        blocks += by_log(names, fit.plot_multipliers)
    return blocks
