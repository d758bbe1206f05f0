"""Residuals and comparisons of models: the sum taken apart, and where a model fails."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import takewhile
from typing import Any

import numpy as np

from ident.display import render, renders
from ident.errors import FitError, one_of
from ident.fit.identify import Comparison
from ident.fit.prediction import RIGID, Prediction, Trace
from ident.fit.residual import Failure, Residual, zero_of
from ident.fit.residual_maps import Dependence
from ident.fit.result import Fit
from ident.information.blocks import Error
from ident.show.charts import (
    BELOW,
    MEASURED,
    RAW,
    RESIDUAL,
    Chart,
    Colour,
    Level,
    Line,
    Panel,
    Points,
)
from ident.show.html import LOGS, Block, Choice, Option, Section, by_log, paragraph
from ident.show.html import table as html_table
from ident.show.sheet import Sheet
from ident.text import listed, percent, significant

ROUNDING = 1e-12  # of the measured torque: below, a part is nil
MOST = 3  # windows that are shown; all are in compare.json
LABEL = 28  # characters of a model's name in a chart or table
FILM = 400  # moments of the mechanism in a report
BINS = 30  # of the mean that is drawn through a cloud
FUNCTION = 0.5  # share of an effect's torque that means of a signal explain, from which it is its
OWN = ("q", "v", "a", "load")  # of a joint, against which its residual is drawn
SUM = "the sum taken apart, rms: rigid bodies + effects = predicted"
MAPS = (
    "Each dot is a row of the fit; the line is their mean. A model that lacks nothing leaves a "
    "flat band. R² is the share of the residual's variance that a signal explains, held out, "
    "beside those that were chosen before it; the largest is framed."
)
Models = Mapping[str, Residual]
Judged = tuple[str, Mapping[str, Error]]  # what the errors are, as `held-out error`; by joint


# --- text -----------------------------------------------------------------------------------------


def error_rows(named: Mapping[str, Mapping[str, Error]]) -> list[list[str]]:
    """Return one row a joint, two columns (rms, relative) for each set of errors."""
    titles = [title for title in named if named[title]]
    joints = dict.fromkeys(joint for title in titles for joint in named[title])
    rows = [["joint", *(cell for title in titles for cell in (title, ""))]]
    for joint in joints:
        errors = (named[title].get(joint) for title in titles)
        cells = (
            (f"{significant(e.rms)} {e.unit}", percent(e.relative)) if e else ("", "")
            for e in errors
        )
        rows.append([joint, *(cell for pair in cells for cell in pair)])
    return rows


def parts_rows(residual: Residual) -> list[list[str]]:
    """Return one row a joint, the rms of each part; effects of one kind act as one."""
    kinds: dict[str, list[str]] = {}
    for name in residual.traces[0].parts:
        kinds.setdefault(name.split(":")[0], []).append(name)
    total = {kind: residual.rms_together(names) for kind, names in kinds.items()}
    measured = residual.parts["measured"]
    gravity = {"(gravity)": residual.parts["gravity"]}
    total = {"measured": measured, RIGID: total.pop(RIGID), **gravity, **total}
    total["residual"] = residual.parts["residual"]
    columns = [["joint", *residual.joints], ["unit", *residual.units]]
    for name, values in total.items():
        nil = values < ROUNDING * measured
        columns.append([name, *(significant(x) for x in np.where(nil, 0.0, values))])
    return [list(row) for row in zip(*columns, strict=True)]


def details(failure: Failure, several: bool = True) -> str:
    """Return on what one joint's residual depends, and when it is worst."""
    signals = "; ".join(str(each) for each in failure.depends_on)
    if not signals and not failure.white:
        signals = "no single signal that was tried; but it is correlated in time"
    windows = (f"{x} of {x.experiment}" if several else str(x) for x in failure.worst[:MOST])
    found = {"depends on": signals, "worst in": "" if failure.white else ", ".join(windows)}
    return "; ".join(f"{key} {words}" for key, words in found.items() if words)


def judged_of(fit: Fit) -> Judged:
    """Return the errors of a fit's card: those held out in time, where there are any."""
    return ("held-out error", fit.held_out) if fit.held_out else ("error in the fit", fit.train)


@renders(Failure, "text")
def failure_text(failure: Failure, several: bool = True, judged: Judged | None = None) -> str:
    """Return how a model fails in one joint, with its error as it is judged, else in these rows."""
    white = "no structure found" if failure.white else "has structure"
    what, errors = judged or ("residual", {})
    error = errors.get(failure.joint, failure)
    size = f"{significant(error.rms)} {failure.unit} ({percent(error.relative)})"
    first = f"{failure.joint}: {what} {size}, {100 * failure.share:.0f} % of the misfit; {white}"
    return "; ".join(filter(None, (first, details(failure, several))))


def where_lines(residual: Residual, judged: Judged | None = None) -> list[str]:
    """Return where a model fails, a sentence a joint."""
    several = len(residual.traces) > 1
    return [failure_text(failure, several, judged) for failure in residual.where]


@renders(Residual, "sheet")
def residual_sheet(residual: Residual) -> Sheet:
    """Return the parts of the sum and where the model fails."""
    logs = ", ".join(trace.name for trace in residual.traces)
    title = f"residual of {residual.name} on {logs}{below(residual)}: {residual.rows} rows"
    return Sheet(
        title, tables={SUM: parts_rows(residual)}, lines=["where it fails", *where_lines(residual)]
    )


def below(residual: Residual) -> str:
    """Return ` below 8 Hz` of a filtered residual."""
    cut = residual.motion.band.cutoff
    return f" below {cut:.3g} Hz" if cut else ""


# --- charts ---------------------------------------------------------------------------------------


def time_label(zero: float) -> str:
    """Return the label of an axis of time that is counted from `zero` [s]."""
    return f"t − {zero:.3f} [s]" if zero else "t [s]"


def short(name: str) -> str:
    """Return the end of a path, or the beginning of a list of effects."""
    if len(name) <= LABEL:
        return name
    return f"…{name[-LABEL:]}" if "/" in name else f"{name[:LABEL]}…"


def told_apart(names: Iterable[str]) -> dict[str, str]:
    """Return names of models as they are shown: of paths only the parts in which they differ.

    >>> told_apart(["a/old/fit.json", "a/new/fit.json"])
    {'a/old/fit.json': 'old', 'a/new/fit.json': 'new'}
    """
    paths = {name: name.split("/") for name in names}
    if len(paths) < 2:
        return {name: short(name) for name in paths}
    head = _common(paths.values())
    tail = _common([x[head:][::-1] for x in paths.values()])
    own = {name: x[head : len(x) - tail] or x[-1:] for name, x in paths.items()}
    return {name: short("/".join(x)) for name, x in own.items()}


def _common(paths: Iterable[Sequence[str]]) -> int:
    """Return with how many equal parts all begin."""
    columns = zip(*paths, strict=False)
    return sum(1 for _ in takewhile(lambda parts: len(set(parts)) == 1, columns))


def plot_predictions(
    predictions: Mapping[str, list[Prediction]],
    residuals: Models,
    experiment: int = 0,
    first: str = "",
    prior: Sequence[Prediction] = (),
) -> Chart:
    """Draw measured torque and every model's prediction, with residuals below, per joint.

    Args:
        predictions, residuals: by model, unfiltered and filtered; of one model alone the unfiltered
            residual is a pale band.
        experiment: number of the log.
        first: joint that is drawn first, as the others are in the mechanism's order.
        prior: what the URDF predicts.
    """
    if (given := len(next(iter(predictions.values())))) <= experiment:
        raise FitError(f"experiment {experiment}; valid: 0 to {given - 1}, one a log")
    models = {name: each[experiment] for name, each in predictions.items()}
    shown, one = told_apart(models), next(iter(models.values()))
    zero, alone = zero_of(one.t), len(models) == 1
    t, clock = one.t - zero, time_label(zero)
    units, rows = next(iter(residuals.values())).units, []
    for u, joint in sorted(enumerate(one.joints), key=lambda pair: pair[1] != first):

        def line(
            p: Prediction, of: str, label: str, colour: Colour, width: float, u: int = u
        ) -> Line:
            return Line(t, np.where(p.usable, getattr(p, of)[:, u], np.nan), label, colour, width)

        above = [line(one, "measured", "measured", MEASURED, BELOW)]
        above += [line(p, "predicted", "the URDF alone", 5, 1.0) for p in prior[experiment:][:1]]
        below = [line(one, "residual", "difference, unfiltered", RAW, 0.8)] if alone else []
        for i, (name, p) in enumerate(models.items()):
            trace = residuals[name].traces[experiment]
            above.append(line(p, "predicted", "predicted" if alone else shown[name], i, 1.1))
            label, colour = ("difference", RESIDUAL) if alone else ("", i)
            y = broken(trace, trace.residual[:, u])
            below.append(Line(trace.t - zero, y, label, colour, 1.3))
        rows.append((Panel(tuple(above), clock, f"{joint} [{units[u]}]"),))
        rows.append((Panel((Level(), *below), clock, f"difference [{units[u]}]", height=1.5),))
    words = f"Measured and predicted torque of every joint over time, {one.name}"
    return Chart(words, tuple(rows), shared_x=True, clock=one.name)


def broken(trace: Trace, y: np.ndarray) -> np.ndarray:
    """Return values (n,) at the rows of a trace, broken where rows are left out."""
    return np.where(np.diff(trace.segment, prepend=trace.segment[:1]) > 0, np.nan, y)


def plot_parts(residuals: Models, experiment: int = 0) -> Chart:
    """Draw measured torque and the parts of the predicted one: a row a joint, a column a model."""
    first, shown = next(iter(residuals.values())), told_apart(residuals)
    number = min(experiment, len(first.traces) - 1)
    log = first.traces[number].name
    colours: dict[str, int] = {}
    rows: list[tuple[Panel, ...]] = []
    for u, joint in enumerate(first.joints):
        row: list[Panel] = []
        for name, residual in residuals.items():
            trace = residual.traces[number]
            parts = {key: x[:, u] for key, x in trace.parts.items()}
            whole, measured = np.sum(list(parts.values()), axis=0), trace.measured[:, u]
            series: list[tuple[np.ndarray, str, Colour, float]] = []
            series.append((measured, "measured", MEASURED, BELOW))
            for key, x in parts.items():
                if key == RIGID or np.abs(x).max() > 0:
                    kind = key.split(":")[0]
                    series.append((x, kind, colours.setdefault(kind, len(colours)), 1.2))
            series.append((measured - whole, "residual", RESIDUAL, 0.8))
            zero = residual.zero(trace)
            lines = (Line(trace.t - zero, broken(trace, y), a, b, c) for y, a, b, c in series)
            title = shown[name] if not rows and len(residuals) > 1 else ""
            label = "" if row else f"{joint} [{first.units[u]}]"
            row.append(Panel(tuple(lines), time_label(zero), label, title))
        rows.append(tuple(row))
    words = "The sum taken apart: rigid bodies, effects and what is left, over time"
    width = max(9.0, 6.0 * len(residuals))
    return Chart(f"{words}, {log}", tuple(rows), shared_x=True, width=width, clock=log)


def plot_maps(residuals: Models, joint: str, effect: str = "") -> Chart:
    """Draw a joint's residual and its mean against t, q, v, a and load, a row a model.

    If it depends most on a signal of another joint, against that too; the most important is framed.
    With the label of an `effect` of the last model, that is the one of which its torque is a
    function, and the means of it are drawn through the points of the first model, against time and
    in the frame.
    """
    models = list(residuals.values())
    scores = [_scores(residual, joint) for residual in models]
    if effect:  # what is left beside it is noise, or is described elsewhere
        scores[1:] = [{} for _ in models[1:]]
    names = ["t", *(f"{kind}.{joint}" for kind in OWN)]
    foreign = [(x.r2, name) for each in scores for name, x in each.items() if name not in names]
    names += [max(foreign)[1]] if foreign else []
    own_signal = _signal_of(models[-1], joint, effect, names) if effect else ""
    if own_signal and own_signal not in names:
        names[len(OWN) + 1 :] = [own_signal]  # in the place of another joint's
    scores = [{} for _ in models] if own_signal else scores  # one measure is enough
    shown, framed = told_apart(residuals), list[str]()
    rows: list[tuple[Panel, ...]] = []
    for title, residual, score in zip(residuals, models, scores, strict=True):
        most = next((name for name in score if name in names), "")
        most = own_signal if own_signal and not rows else most
        if most in score:
            model = f"{shown[title]}, " * (len(models) > 1)
            framed.append(f"{score[most].signal} ({model}R² {score[most].r2:.2f})")
        curve = models[-1] if effect and not rows else None
        own = {"t", most} if most else {*names}  # signals of which the effect is a function
        curves = {x: curve for x in names if x in own}
        row = [_map(residual, joint, x, score, x == most, curves.get(x), effect) for x in names]
        unit = f"{joint} [{residual.units[residual.joints.index(joint)]}]"
        label = unit if len(residuals) == 1 else f"{shown[title]}\n{unit}"
        rows.append((replace(row[0], y=label), *row[1:]))
    words = f"Residual of {joint} against time, its position, speed, acceleration and load"
    if own_signal:
        words += f"; framed: {own_signal}, on which the effect depends"
    elif framed:
        words += f"; framed: {listed(framed)}, on which it depends most"
    if effect:
        words += f"; the line: {effect}"
    return Chart(words, tuple(rows), shared_y=True, width=2.6 * len(names))


def _signal_of(residual: Residual, joint: str, effect: str, names: Sequence[str]) -> str:
    """Return the signal in its law, of its own joints, that means in bins show best in the torque
    of an effect; of these names where it has none; none where the torque is a function of no one.
    """
    if not all(effect in trace.parts for trace in residual.traces):
        return ""
    every = residual.model.mechanism.effects
    mine = next((each for each in every if each.label == effect), None)
    law, joints = (mine.equation.partition(";")[0], mine.joints) if mine else ("", ())
    size = law.replace("sign(v)", "")  # of the torque; the direction alone tells little
    kinds = [kind for kind in OWN if re.search(rf"\b{kind}\b", size)]
    kinds = kinds or [kind for kind in OWN if re.search(rf"\b{kind}\b", law)]
    known = {kind: residual.joints if kind == "load" else residual.signals for kind in kinds}
    own = [f"{kind}.{each}" for kind in kinds for each in joints if each in known[kind]]
    u = residual.joints.index(joint)
    y = np.concatenate([trace.parts[effect][:, u] for trace in residual.traces])
    y = y - y.mean()
    shares: dict[str, float] = {}
    for name in own or names[1:]:  # time is one of which everything is a function
        count, total, at, _ = _means(np.concatenate(residual.signal(name)[0]), y)
        rest = y - (total / np.maximum(count, 1))[at]
        shares[name] = 1 - float(rest @ rest) / max(float(y @ y), 1e-300)
    best = max(shares, key=lambda name: shares[name])
    return best if own or shares[best] > FUNCTION else ""


def _means(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return counts and sums of y in bins of x, the bin of each row, and the bins' edges."""
    edges = np.linspace(x.min(), x.max(), BINS + 1)
    at = np.digitize(x, edges[1:-1])
    count, total = (np.bincount(at, weights, BINS) for weights in (None, y))
    return count, total, at, edges


def _scores(residual: Residual, joint: str) -> dict[str, Dependence]:
    """Return on what a residual depends, the largest R² first, by the signal in whose map it is
    drawn (sign(v) in v's).
    """
    found: dict[str, Dependence] = {}
    for each in residual.failure(joint).depends_on:
        found.setdefault(each.signal.replace("sign(v)", "v"), each)
    return found


def _map(
    residual: Residual, joint: str, name: str, scores: Mapping[str, Dependence], marked: bool,
    model: Residual | None, effect: str,
) -> Panel:  # fmt: skip
    """Draw points, one colour an experiment, and means in bins: theirs, or those of an effect."""
    u = residual.joints.index(joint)
    x, unit = residual.signal(name)
    if name == "t":
        x = [each - residual.zero(trace) for each, trace in zip(x, residual.traces, strict=True)]
    r = [trace.residual[:, u] for trace in residual.traces]
    clouds = [Points(xs, rs, colour=i) for i, (xs, rs) in enumerate(zip(x, r, strict=True))]
    label, colour = "mean", "mean"
    if model is not None and all(effect in trace.parts for trace in model.traces):
        label, colour = "the effect itself", RESIDUAL
        r = [trace.parts[effect][:, u] for trace in model.traces]
    whole, torque = np.concatenate(x), np.concatenate(r)
    own = name.removesuffix(f".{joint}")
    title = f"R² {scores[name].r2:.2f}" if name in scores else ""
    if title and scores[name].signal != name:
        title = f"sign(v) {title}"
    lines, either = [], np.full(len(torque), True)
    both = colour == RESIDUAL and own == "load"  # directions, of a torque against either
    for part in (torque > 0, torque <= 0) if both else (either,):
        if part.any():
            count, total, _, edges = _means(whole[part], torque[part])
            known = count >= 3
            middle = (edges[1:] + edges[:-1])[known] / 2
            lines.append(Line(middle, total[known] / count[known], label, colour, 1.8))
    return Panel(
        (Level(), *clouds, *lines),
        f"{own} [{unit}]" if unit else own,
        title=title,
        marked=marked,
        height=2.4,
    )


def _models(x: Fit | Comparison) -> Models:
    return x.residuals if isinstance(x, Comparison) else {x.name: x.residual}


@renders(Fit, "plot")
@renders(Comparison, "plot")
def plot(x: Fit | Comparison, experiment: int = 0) -> Chart:
    """Draw measured torque and every model's prediction, with residuals below, per joint."""
    if isinstance(x, Comparison):
        return plot_predictions(x.predictions, x.residuals, experiment)
    return plot_predictions({x.name: x.predictions}, _models(x), experiment)


@renders(Fit, "plot_parts")
@renders(Comparison, "plot_parts")
def plot_parts_of(x: Fit | Comparison, experiment: int = 0) -> Chart:
    """Draw the sum taken apart: rigid bodies, effects and what is left, per joint."""
    return plot_parts(_models(x), experiment)


@renders(Fit, "plot_maps")
@renders(Comparison, "plot_maps")
def plot_maps_of(x: Fit | Comparison, joint: str | None = None) -> Chart:
    """Draw a joint's residual against its signals; by default where the last model fails most.

    Raises:
        FitError: if the joint is not an independent one.
    """
    last = list(_models(x).values())[-1]
    joint = last.where[0].joint if joint is None else joint
    if joint not in last.joints:
        raise FitError(f"no residual of joint '{joint}'; {one_of(joint, last.joints)}")
    return plot_maps(_models(x), joint)


# --- sections of reports --------------------------------------------------------------------------


def errors_section(rows: Sequence[Sequence[str]], *more: Block) -> Section:
    """Return the error of the predicted torque, by joint."""
    caption = "Error of the predicted torque: rms, and relative to the measured torque"
    pairs = [
        [row[0], *(f"{a}  {b}".strip() for a, b in zip(row[1::2], row[2::2], strict=True))]
        for row in rows
    ]
    return Section("Error of the predicted torque", (html_table(pairs, caption), *more))


def residual_sections(
    predictions: Mapping[str, list[Prediction]],
    residuals: Models,
    judged: Mapping[str, Judged],
    first: str = "",
    prior: Sequence[Prediction] = (),
) -> tuple[Section, ...]:
    """Return measured against predicted, where the models fail, and the sum taken apart.

    Args:
        predictions, residuals: by model.
        judged: their errors.
        first: joint that comes first; default: the one in which the last model fails most.
        prior: what the URDF predicts.
    """
    last = list(residuals.values())[-1]
    first = first or last.where[0].joint
    logs = [trace.name for trace in last.traces]
    shown = told_apart(residuals)
    machine = view_of_fit(last, list(predictions.values())[-1], {first: first})
    options = []
    for failure in sorted(last.where, key=lambda each: each.joint != first):
        said = [
            paragraph(
                before + failure_text(each.failure(failure.joint), len(logs) > 1, judged[name])
            )
            for name, each in residuals.items()
            for before in [f"{shown[name]}, " * (len(shown) > 1)]
        ]
        options.append(Option(failure.joint, (*said, plot_maps(residuals, failure.joint))))
    parts: list[Block] = [html_table(*each[::-1]) for each in all_parts(residuals).items()]
    parts += by_log(logs, lambda i: plot_parts(residuals, i))
    torques = by_log(logs, lambda i: plot_predictions(predictions, residuals, i, first, prior))
    return (
        Section("Measured against predicted", (machine, *torques)),
        Section("Residual maps", (paragraph(MAPS), Choice("Of which joint", tuple(options)))),
        Section("The sum taken apart", tuple(parts)),
    )


def view_of_fit(
    residual: Residual,
    predictions: Sequence[Prediction],
    marks: Mapping[str, str],
    most: int = FILM,
) -> Any:
    """Return the mechanism in 3-D, joints coloured by the residual, with words beside joints."""
    e = residual.motion.experiments[:LOGS]
    view = render(residual.model.mechanism, "view", e, predictions[:LOGS], most)
    return replace(view, marks=marks)


@renders(Residual, "view")
def view_page(residual: Residual, predictions: Sequence[Prediction]) -> Any:
    """Return the mechanism in 3-D above charts of its torques, which share a cursor."""
    worst = residual.where[0].joint
    name, logs = residual.name, [trace.name for trace in residual.traces]
    charts = by_log(
        logs, lambda i: plot_predictions({name: [*predictions]}, {name: residual}, i, worst)
    )
    return replace(view_of_fit(residual, predictions, {worst: worst}, 2 * FILM), charts=charts)


def all_parts(residuals: Models) -> dict[str, list[list[str]]]:
    """Return the tables of the parts of the sum, of several models with their names."""
    shown = told_apart(residuals)
    return {
        SUM if len(shown) == 1 else f"{shown[name]}: {SUM}": parts_rows(residual)
        for name, residual in residuals.items()
    }
