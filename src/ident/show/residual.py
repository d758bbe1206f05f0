"""Residuals and comparisons of models: the sum taken apart, and where a model fails."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import takewhile
from typing import Any

import numpy as np

from ident.assess.comparison import NamedErrors, errors_that_count
from ident.assess.errors import NOISY
from ident.display import render, renders
from ident.errors import FitError, one_of
from ident.fit.identify import Comparison
from ident.fit.prediction import RIGID, Prediction, Trace
from ident.fit.residual import Failure, Residual, zero_of
from ident.fit.residual_maps import Dependence
from ident.fit.result import Fit
from ident.information.blocks import Error
from ident.show.charts import (
    BEFORE,
    BELOW,
    MEASURED,
    NOW,
    RAW,
    RESIDUAL,
    Chart,
    Colour,
    Level,
    Line,
    Panel,
    Points,
)
from ident.show.html import LOGS, Block, Choice, Section, Sheet, by_log, paragraph
from ident.show.html import table as html_table
from ident.text import listed, percent, significant

NEGLIGIBLE_PART = 1e-12  # of the measured torque: below, a part is nil
MOST_WINDOWS_SHOWN = 3  # windows that are shown; all are in compare.json
LABEL = 28  # characters of a model's name in a chart or table
FILM = 400  # moments of the mechanism in a report
BINS = 30  # of the mean that is drawn through a cloud
# numerics: of the largest: what acts by less says little of the torque of a joint within a loop
LEAST_LEVER = 0.2
JOINT_SIGNALS = ("q", "v", "a", "load")  # of a joint, against which its residual is drawn
SUM = "the sum taken apart, rms: rigid bodies + effects = predicted"
MAPS = (
    "Each dot is a row of the fit; the line is their mean. A model that lacks nothing leaves a "
    "flat band. R² is the share of the residual's variance that a signal explains, held out, "
    "beside those that were chosen before it; the largest is framed."
)
Models = Mapping[str, Residual]


# --- text -----------------------------------------------------------------------------------------


def error_rows(named: Mapping[str, Mapping[str, Error]]) -> list[list[str]]:
    """Return one row a joint, two columns (rms, relative) for each set of errors."""
    titles = [title for title in named if named[title]]
    joints = dict.fromkeys(joint for title in titles for joint in named[title])
    rows = [["joint", *(cell for title in titles for cell in (title, ""))]]
    for joint in joints:
        first = named[titles[0]].get(joint)
        if first is not None and first.unmeasured:
            continue
        rows.append([joint])
        for title in titles:
            e = named[title].get(joint)
            rows[-1] += [f"{significant(e.rms)} {e.unit}", percent(e.relative)] if e else ["", ""]
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
        nil = values < NEGLIGIBLE_PART * measured
        columns.append([name, *(significant(x) for x in np.where(nil, 0.0, values))])
    return [list(row) for row in zip(*columns, strict=True)]


def errors_of_fit(fit: Fit) -> NamedErrors:
    """Return the errors of a fit's card: those held out in time, where there are any."""
    return ("held-out error", fit.held_out) if fit.held_out else ("error in the fit", fit.train)


@renders(Failure, "text")
def failure_text(
    failure: Failure, several: bool = True, counted: NamedErrors | None = None,
    noise: float = 0.0,
) -> str:  # fmt: skip
    """Return how a model fails in one joint: its error, on what that depends, when it is worst; of
    an error that is `noise` [N m | N] no more than that.
    """
    what, errors = counted or ("residual", {})
    error = errors.get(failure.joint, failure)
    size = f"{significant(error.rms)} {failure.unit} ({percent(error.relative)})"
    if error.rms <= NOISY * noise:
        return f"{failure.joint}: {what} {size}, noise of the sensors"
    white = "no structure found" if failure.white else "has structure"
    parts = [f"{failure.joint}: {what} {size}, {100 * failure.share:.0f} % of the misfit", white]
    if failure.depends_on:
        parts.append(f"depends on {'; '.join(map(str, failure.depends_on))}")
    elif not failure.white:
        parts.append("depends on no single signal that was tried; but it is correlated in time")
    if failure.worst and not failure.white:
        windows = (
            f"{x} of {x.experiment}" if several else str(x)
            for x in failure.worst[:MOST_WINDOWS_SHOWN]
        )
        parts.append(f"worst in {', '.join(windows)}")
    return "; ".join(parts)


@renders(Residual, "sheet")
def residual_sheet(residual: Residual) -> Sheet:
    """Return the parts of the sum and where the model fails."""
    logs = ", ".join(trace.name for trace in residual.traces)
    title = f"residual of {residual.name} on {logs}{below(residual)}: {residual.rows} rows"
    several = len(residual.traces) > 1
    lines = ["where it fails", *(failure_text(failure, several) for failure in residual.where)]
    return Sheet(title, tables={SUM: parts_rows(residual)}, lines=lines)


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
    differing = {name: x[head : len(x) - tail] or x[-1:] for name, x in paths.items()}
    return {name: short("/".join(x)) for name, x in differing.items()}


def _common(paths: Iterable[Sequence[str]]) -> int:
    """Return with how many equal parts all begin."""
    return len([*takewhile(lambda parts: len({*parts}) == 1, zip(*paths, strict=False))])


def compared(fit: Fit) -> Comparison:
    """Return a fit as a comparison of one model."""
    return Comparison({fit.name: fit.residual}, {fit.name: fit.errors})


@renders(Comparison, "plot")
def plot_predictions(
    c: Comparison, experiment: int = 0, first: str = "", prior: Sequence[Prediction] = ()
) -> Chart:
    """Draw measured torque and every model's prediction of a log, with residuals below, per joint.

    `first`: joint that is drawn first. `prior`: what the model predicted before.
    """
    shown, alone = told_apart(c.predictions), len(c.predictions) == 1
    if (given := len(next(iter(c.predictions.values())))) <= experiment:
        raise FitError(f"experiment {experiment}; valid: 0 to {given - 1}, one a log")
    models = {name: predictions[experiment] for name, predictions in c.predictions.items()}
    one = next(iter(models.values()))
    zero = zero_of(one.t)
    clock, rows = time_label(zero), []
    # the first and the last model have the colours of before and now; those between their own
    colours: list[Colour] = [BEFORE, *range(len(models) - 2), NOW][-len(models) :]

    def line(p: Prediction, y: np.ndarray, *style: Any) -> Line:
        return Line(one.t - zero, np.where(p.usable, y, np.nan), *style)

    for u, joint in sorted(enumerate(one.joints), key=lambda pair: pair[1] != first):
        above = [line(one, one.measured[:, u], "measured", MEASURED, BELOW)]
        for p in prior[experiment:][:1]:
            above.append(line(p, p.predicted[:, u], "before", BEFORE, 1.0))
        band = "difference" if alone else next(iter(shown.values()))
        below = [line(one, one.residual[:, u], f"{band}, unfiltered", RAW, 0.8)]
        for i, (name, p) in enumerate(models.items()):
            label, colour = shown[name], colours[i]
            if alone:
                label = "now" if prior else "predicted"
            above.append(line(p, p.predicted[:, u], label, colour, 1.1))
            label, colour = ("difference", RESIDUAL) if alone else ("", colour)
            for trace in c.residuals[name].traces:
                if trace.name == p.name:  # else it is too short for the filter
                    y = broken(trace, trace.residual[:, u])
                    below.append(Line(trace.t - zero, y, label, colour, 1.3))
        rows.append((Panel(tuple(above), clock, f"{joint} [{c.units[u]}]"),))
        rows.append((Panel((Level(), *below), clock, f"difference [{c.units[u]}]", height=1.5),))
    words = f"Measured and predicted torque of every joint over time, {one.name}"
    return Chart(words, tuple(rows), shared_x=True, clock=one.name)


def plot_joint(c: Comparison, joint: str, experiment: int = 0) -> Chart:
    """Draw measured torque and every model's prediction of one joint, with residuals below."""
    chart = plot_predictions(c, experiment, joint)
    words = chart.words.replace("every joint", joint)
    words += f": {listed([*c.residuals])}" * (len(c.residuals) > 1)
    return replace(chart, words=words, rows=chart.rows[:2])


def broken(trace: Trace, y: np.ndarray) -> np.ndarray:
    """Return values (n,) at the rows of a trace, broken where rows are left out."""
    return np.where(np.diff(trace.segment, prepend=trace.segment[:1]) > 0, np.nan, y)


@renders(Comparison, "plot_parts")
def plot_parts(c: Comparison, experiment: int = 0) -> Chart:
    """Draw measured torque and the parts of the predicted one: a row a joint, a column a model."""
    shown = told_apart(c.residuals)
    first = next(iter(c.residuals.values()))
    number = min(experiment, len(first.traces) - 1)
    log = first.traces[number].name
    colours: dict[str, int] = {}
    rows: list[tuple[Panel, ...]] = []
    for u, joint in enumerate(first.joints):
        row: list[Panel] = []
        for name, residual in c.residuals.items():
            trace = residual.traces[number]
            zero = residual.zero(trace)
            line, total = partial(Line, trace.t - zero), sum(trace.parts.values())
            lines = [line(broken(trace, trace.measured[:, u]), "measured", MEASURED, BELOW)]
            for key, x in trace.parts.items():
                if key == RIGID or np.abs(x[:, u]).max() > 0:
                    kind = key.split(":")[0]
                    colour = colours.setdefault(kind, len(colours))
                    lines.append(line(broken(trace, x[:, u]), kind, colour, 1.2))
            rest = broken(trace, (trace.measured - total)[:, u])
            lines.append(line(rest, "residual", RESIDUAL, 0.8))
            title = shown[name] if not rows and len(shown) > 1 else ""
            label = "" if row else f"{joint} [{first.units[u]}]"
            row.append(Panel(tuple(lines), time_label(zero), label, title))
        rows.append(tuple(row))
    words = "The sum taken apart: rigid bodies, effects and what is left, over time"
    width = max(9.0, 6.0 * len(shown))
    return Chart(f"{words}, {log}", tuple(rows), shared_x=True, width=width, clock=log)


@renders(Comparison, "plot_maps")
def plot_maps(c: Comparison, joint: str | None = None, effect: str = "") -> Chart:
    """Draw the residual of a joint, by default that in which the last model fails most.

    Against t, q, v, a, load, and the signal of another joint on which it depends most, if there is
    one, with its mean; a row a model, the most important framed. With the label of an `effect` of
    the last model, that is the one of which its torque is a function, and the torque is drawn
    through the points of the first model, in the frame and against time.

    Raises:
        FitError: if the joint is not an independent one.
    """
    residuals, last = c.residuals, list(c.residuals.values())[-1]
    joint = last.where[0].joint if joint is None else joint
    if joint not in last.joints:
        raise FitError(f"no residual of joint '{joint}'; {one_of(joint, last.joints)}")
    torque, of_effect = np.zeros(0), ""
    if effect:
        u = last.joints.index(joint)
        torque = np.concatenate([trace.parts[effect][:, u] for trace in last.traces])
        of_effect = _signal_of_effect(last, effect, torque)
    # one measure is enough, and what is left beside an effect is described elsewhere
    scores = [
        {} if of_effect or (effect and i) else _scores(model, joint)
        for i, model in enumerate(residuals.values())
    ]
    names = ["t", *(f"{kind}.{joint}" for kind in JOINT_SIGNALS)]
    other = [(x.r2, name) for model in scores for name, x in model.items() if name not in names]
    names += (
        [of_effect] if of_effect and of_effect not in names else [max(other)[1]] if other else []
    )
    shown, framed = told_apart(residuals), list[str]()
    rows: list[tuple[Panel, ...]] = []
    for (title, model), score in zip(residuals.items(), scores, strict=True):
        most = next((name for name in score if name in names), "" if rows else of_effect)
        if most in score:
            which = f"{shown[title]}, " * (len(residuals) > 1)
            framed.append(f"{score[most].signal} ({which}R² {score[most].r2:.2f})")
        through = (["t", most] if most else names) if effect and not rows else []
        drawn = dict.fromkeys(through, torque)
        row = [_map(model, joint, x, score, x == most, drawn.get(x)) for x in names]
        unit = f"{joint} [{model.units[model.joints.index(joint)]}]"
        label = unit if len(residuals) == 1 else f"{shown[title]}\n{unit}"
        rows.append((replace(row[0], y=label), *row[1:]))
    words = f"Residual of {joint} against time, its position, speed, acceleration and load"
    words += f"; framed: {of_effect}, on which the effect depends" * bool(of_effect)
    words += f"; framed: {listed(framed)}, on which it depends most" * bool(framed)
    words += f"; the line: {effect}" * bool(effect)
    return Chart(words, tuple(rows), shared_y=True, width=2.6 * len(names))


def plot_map(
    residual: Residual, now: Residual, joint: str, effect: str, height: float
) -> Chart | None:
    """Draw a joint's residual against the one signal that an effect of the model `now` depends on,
    with the effect's torque through the points; without an effect, against the signal that explains
    most, or nothing where none does.
    """
    scores = {} if effect else _scores(residual, joint)
    name, torque, levers = next(iter(scores), ""), None, None
    unit = residual.units[residual.joints.index(joint)]
    of_joint = joint
    if effect:
        u = now.joints.index(joint)
        torque = np.concatenate([trace.parts[effect][:, u] for trace in now.traces])
        if passive := _passive_joint(now, effect):  # in a loop: of the torque in that joint itself
            of_joint, levers = passive, _levers(now, passive, u)
            unit = now.model.mechanism.joint(passive).force_unit
            torque = torque / np.concatenate(levers)
        name = _signal_of_effect(now, effect, torque)
    if not name:
        return None
    panel = _map(residual, joint, name, scores, False, torque, levers)
    panel = replace(panel, y=f"residual of {of_joint} [{unit}]", height=height)
    words = f"Torque of {of_joint} that the model leaves, against {panel.x}; the line: its mean"
    if effect:
        words = f"Torque of {of_joint} that is missing without {effect}, against {panel.x}"
        words += f"; the line: {effect}"
    return Chart(words, ((panel,),), stretch=True)


def _passive_joint(residual: Residual, effect: str) -> str:
    """Return the only joint of an effect, if it is in a loop and no independent coordinate."""
    joints = next(x for x in residual.model.mechanism.effects if x.label == effect).joints
    in_loop = all(e.loop is not None for e in residual.motion.experiments)
    alone = len(joints) == 1 and joints[0] not in residual.joints
    known = residual.model.mechanism.joint_index
    return joints[0] if in_loop and alone and joints[0] in known else ""


def _levers(residual: Residual, joint: str, u: int) -> list[np.ndarray]:
    """Return by experiment W (n,) with which a torque in a joint acts on coordinate u, in the rows
    of the traces; NaN where it is near 0.
    """
    at, every = residual.model.mechanism.joint_index[joint], []
    for e, trace in zip(residual.motion.experiments, residual.traces, strict=True):
        rows = np.minimum(np.searchsorted(e.t, trace.t), len(e) - 1)
        every.append(e.leverage[rows, at, u])
    most = max(float(np.abs(W).max(initial=0.0)) for W in every)
    return [np.where(np.abs(W) > LEAST_LEVER * most, W, np.nan) for W in every]


def _signal_of_effect(residual: Residual, effect: str, torque: np.ndarray) -> str:
    """Return the signal in its law that means in bins show best in the torque of an effect."""
    own_effect = next(x for x in residual.model.mechanism.effects if x.label == effect)
    law = own_effect.equation.partition(";")[0]
    size = law.replace("sign(v)", "")  # of the torque; the direction alone tells little
    alternatives = (
        [kind for kind in JOINT_SIGNALS if re.search(rf"\b{kind}\b", x)] for x in (size, law)
    )
    kinds = next(filter(None, alternatives), [])
    known = {kind: residual.joints if kind == "load" else residual.signals for kind in kinds}
    signals = [
        f"{kind}.{name}" for kind in kinds for name in own_effect.joints if name in known[kind]
    ]

    def explained(name: str) -> float:
        known = np.isfinite(torque)
        _, mean, count = _means(np.concatenate(residual.signal(name)[0])[known], torque[known])
        return float(count @ mean**2)

    return max(signals, key=explained, default="")


def _means(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the middles of bins of x, the means of y in them, and their counts."""
    count, edges = np.histogram(x, BINS)
    total, _ = np.histogram(x, edges, weights=y)
    return (edges[1:] + edges[:-1]) / 2, total / np.maximum(count, 1), count


def _scores(residual: Residual, joint: str) -> dict[str, Dependence]:
    """Return on what a residual depends, the largest R² first, by the signal of its map."""
    by_signal: dict[str, Dependence] = {}
    for dependence in residual.failure(joint).depends_on:
        by_signal.setdefault(dependence.signal.replace("sign(v)", "v"), dependence)
    return by_signal


def _map(
    residual: Residual, joint: str, name: str, scores: Mapping[str, Dependence], marked: bool,
    torque: np.ndarray | None, levers: Sequence[np.ndarray] | None = None,
) -> Panel:  # fmt: skip
    """Draw points, one colour an experiment, and means in bins: theirs, or an effect's torque's;
    residuals are divided by `levers`, by experiment, and left out where these are not finite.
    """
    u = residual.joints.index(joint)
    x, unit = residual.signal(name)
    if name == "t":
        x = [times - residual.zero(trace) for times, trace in zip(x, residual.traces, strict=True)]
    r = [trace.residual[:, u] for trace in residual.traces]
    if levers is not None:
        known = [np.isfinite(W) for W in levers]
        r = [(rs / W)[use] for rs, W, use in zip(r, levers, known, strict=True)]
        x = [xs[use] for xs, use in zip(x, known, strict=True)]
        torque = torque if torque is None else torque[np.concatenate(known)]
    clouds = [Points(xs, rs, colour=i) for i, (xs, rs) in enumerate(zip(x, r, strict=True))]
    label = name.removesuffix(f".{joint}")
    title = f"R² {scores[name].r2:.2f}" if name in scores else ""
    if title and scores[name].signal != name:
        title = f"sign(v) {title}"
    every, y, style = np.concatenate(x), np.concatenate(r), ("mean", "mean")
    sides = [np.full(len(y), True)]
    if torque is not None:
        y, style = torque, ("the effect itself", NOW)
        if label == "load":  # against either direction
            sides = [side for side in (y > 0, y <= 0) if side.any()]
    lines = []
    for side in sides:
        middle, mean, count = _means(every[side], y[side])
        lines.append(Line(middle[count >= 3], mean[count >= 3], *style, 1.8))
    axis = f"{label} [{unit}]" if unit else label
    return Panel((Level(), *clouds, *lines), axis, title=title, marked=marked, height=2.4)


renders(Fit, "plot")(lambda fit, experiment=0: plot_predictions(compared(fit), experiment))
renders(Fit, "plot_parts")(lambda fit, experiment=0: plot_parts(compared(fit), experiment))
renders(Fit, "plot_maps")(lambda fit, joint=None: plot_maps(compared(fit), joint))


# --- sections of reports --------------------------------------------------------------------------


def errors_section(rows: Sequence[Sequence[str]]) -> Section:
    """Return the error of the predicted torque, by joint."""
    caption = "Error of the predicted torque: rms, and relative to the measured torque"
    pairs = [
        [row[0], *(f"{a}  {b}".strip() for a, b in zip(row[1::2], row[2::2], strict=True))]
        for row in rows
    ]
    return Section("Error of the predicted torque", (html_table(pairs, caption),))


def residual_sections(
    c: Comparison, first: str = "", prior: Sequence[Prediction] = ()
) -> tuple[Section, ...]:
    """Return measured against predicted, where the models fail, and the sum taken apart.

    `first`: joint that comes first, else the one in which the last model fails most.
    """
    last = list(c.residuals.values())[-1]
    first = first or last.where[0].joint
    logs = [trace.name for trace in last.traces]
    shown = told_apart(c.residuals)
    options: dict[str, list[Block]] = {}
    for failure in sorted(last.where, key=lambda failure: failure.joint != first):
        blocks: list[Block] = []
        for name, residual in c.residuals.items():
            own_failure = residual.failure(failure.joint)
            counted, floor = errors_that_count(c, name), residual.noise[own_failure.joint]
            text = failure_text(own_failure, len(logs) > 1, counted, floor)
            blocks.append(paragraph(f"{shown[name]}, {text}" if len(shown) > 1 else text))
        blocks.append(plot_maps(c, failure.joint))
        options[failure.joint] = blocks
    parts: list[Block] = [html_table(rows, title) for title, rows in all_parts(c.residuals).items()]
    parts += by_log(logs, lambda i: plot_parts(c, i))
    every = [experiment.name for experiment in last.motion.experiments]
    torques = by_log(every, lambda i: plot_predictions(c, i, first, prior))
    return (
        Section("Measured against predicted", torques),
        Section("Residual maps", (paragraph(MAPS), Choice("Of which joint", options))),
        Section("The sum taken apart", parts),
    )


def view_of_fit(
    residual: Residual,
    predictions: Sequence[Prediction],
    marks: Mapping[str, str],
    most: int = FILM,
    ghosts: Mapping[int, Any] | None = None,
) -> Any:
    """Return the mechanism in 3-D, joints coloured by the residual, with words beside joints, and
    with ghosts by the number of their log.
    """
    e = residual.motion.experiments[:LOGS]
    view = render(residual.model.mechanism, "view", e, predictions[:LOGS], most, ghosts)
    return replace(view, marks=marks)


def all_parts(residuals: Models) -> dict[str, list[list[str]]]:
    """Return the tables of the parts of the sum, of several models with their names."""
    shown = told_apart(residuals)
    return {
        SUM if len(shown) == 1 else f"{shown[name]}: {SUM}": parts_rows(residual)
        for name, residual in residuals.items()
    }
