"""Residuals and predictions as text, charts and sections of a report."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from ident.display import renders
from ident.fit.prediction import CLOSURES, DRIVES, RIGID, WRENCHES, Prediction, Trace
from ident.fit.residual import Failure, Residual, zero_of
from ident.information.blocks import Error
from ident.show.charts import MEASURED, RESIDUAL, Chart, Level, Line, Panel, Points
from ident.show.html import Block, Choice, Option, Section, code, items, paragraph
from ident.show.html import table as html_table
from ident.text import percent, table

WIDTH = 100  # characters of a line in a terminal
TITLE, ABREAST = 32, 2  # characters of a model's name in a table, and models side by side
ROUNDING = 1e-12  # of the measured torque: below, a part is nil
WINDOWS, REGIMES = 3, 3  # that are printed; all are in compare.json
LABEL = 28  # characters of a name in a chart
BINS = 30  # of the mean that is drawn through a cloud
OWN = ("q", "v", "a", "load")  # of a joint, against which its residual is drawn
ROWS = 4  # of panels in one chart: what a window shows
LOGS = 12  # whose curves are in a report
MAPS = (
    "Each dot is a row of the fit; the dark line is the mean. A model that lacks nothing leaves a "
    "flat band. What the residual depends on most is framed."
)


@renders(Residual, "text")
def text(residual: Residual) -> str:
    """Return the parts of the sum and where the model fails."""
    return "\n".join([headline(residual), *parts_table(residual), "", *where_text(residual)])


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


def headline(residual: Residual) -> str:
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
        columns[kind] = _together(residual, "parts", names)
        if kind == RIGID:
            columns["(gravity)"] = rms["gravity"]
    columns["residual"] = rms["residual"]
    lines = ["", "the sum taken apart, rms: rigid bodies + effects = predicted"]
    lines += _by_joint(residual, columns, indent)
    if residual.own:
        columns = {
            kind: _together(residual, "own", names)
            for kind, names in by_kind(residual.traces[0].own, residual).items()
        }
        columns = {k: x for k, x in columns.items() if k != DRIVES or np.nanmax(x) > 0}
        lines += [
            "",
            "the joint's own row, rms: rigid bodies + effects + closure forces = its torque",
        ]
        lines += _by_joint(residual, columns, indent)
    return lines


def _together(residual: Residual, which: str, names: Iterable[str]) -> np.ndarray:
    """Return the rms (d,) of the sum of some parts."""
    squares, rows = np.zeros(len(residual.joints)), 0
    for trace in residual.traces:
        parts = getattr(trace, which)
        squares = squares + (sum(parts[name] for name in names) ** 2).sum(axis=0)
        rows += len(trace)
    return np.asarray(np.sqrt(squares / max(rows, 1)))


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


@renders(Failure, "text")
def text_of_failure(failure: Failure) -> str:
    """Return how a model fails in one joint."""
    return "\n".join(failure_text(failure, several=True))


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


def errors(named: Mapping[str, Mapping[str, Error]], words: str = "") -> Section:
    """Return the error of the predicted torque, by joint."""
    said = (paragraph(words),) if words else ()
    rows = error_rows(named)
    shown = html_table(
        rows, "Error of the predicted torque: rms, and relative to the measured torque"
    )
    return Section("Error of the predicted torque", (*said, shown))


def torques(predictions: Mapping[str, list[Prediction]], units: Sequence[str]) -> Section:
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


def maps(residuals: Mapping[str, Residual]) -> Section:
    """Return where the last model fails, with maps: a choice between joints, the worst first."""
    last = list(residuals.values())[-1]
    options = []
    for failure in last.where:
        blocks = (items(failure_lines(failure, len(last.traces) > 1)),)
        options.append(Option(failure.joint, (*blocks, plot_maps(residuals, failure.joint))))
    choice = Choice("Of which joint", tuple(options))
    return Section("Residual maps", (paragraph(MAPS), choice))


def parts(residuals: Mapping[str, Residual]) -> Section:
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
