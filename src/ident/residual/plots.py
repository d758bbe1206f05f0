"""Pictures of residuals: measured and predicted, the parts of the sum, maps against signals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from ident.residual.failure import Failure
from ident.residual.predict import Prediction
from ident.residual.residual import RIGID, Residual, Trace, zero_of
from ident.show.charts import MEASURED, RESIDUAL, Chart, Level, Line, Panel, Points

LABEL = 28  # characters of a name in a picture
BINS = 30  # of the mean that is drawn through a cloud
OWN = ("q", "v", "a", "load")  # of a joint, against which its residual is drawn


def plot_predictions(
    predictions: Mapping[str, list[Prediction]], units: Sequence[str], experiment: int = 0
) -> Chart:
    """Measured torque and every model's prediction, with residuals below, per joint."""
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
    """With gaps where samples take no part."""
    return np.where(p.usable, x, np.nan)


def plot_parts(residuals: Mapping[str, Residual], experiment: int = 0) -> Chart:
    """Measured torque and the parts that add up to the predicted one: a row a joint, a column a
    model.
    """
    return _apart(residuals, experiment, _parts, "The sum taken apart: rigid bodies, effects")


def plot_own(residuals: Mapping[str, Residual], experiment: int = 0) -> Chart:
    """Of a mechanism with closures, what acts in each joint's own row of the generalised forces:
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
    """With a gap where rows do not follow each other."""
    return np.where(np.concatenate([[False], np.diff(trace.segment) > 0]), np.nan, x)


def plot_maps(residuals: Mapping[str, Residual], joint: str) -> Chart:
    """A joint's residual against its t, q, v, a and load, a row a model, and its mean; and against
    what it depends on most, where that is another joint's. What it depends on most is framed.
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
    """Points, one colour an experiment, and their mean in bins."""
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


def _failure(residual: Residual, joint: str) -> Failure | None:
    return next((each for each in residual.where if each.joint == joint), None)


def _dependences(residual: Residual, joint: str) -> dict[str, float]:
    """R² of the signals on which a joint's residual depends, the most important first."""
    failure = _failure(residual, joint)
    return {each.signal: each.r2 for each in failure.depends_on} if failure else {}


def _drawn(signal: str) -> str:
    """In whose map a signal is seen: sign(v) in that of v."""
    return signal.replace("sign(v)", "v")


def _foreign(residuals: Mapping[str, Residual], joint: str) -> str | None:
    """The most important signal of another joint on which the residual of some model depends."""
    found = [
        (r2, signal)
        for residual in residuals.values()
        for signal, r2 in _dependences(residual, joint).items()
        if signal != "t" and not signal.endswith(f".{joint}")
    ]
    return max(found)[1] if found else None


def time_label(zero: float) -> str:
    """Of an axis of time that is counted from `zero` [s]."""
    return f"t − {zero:.3f} [s]" if zero else "t [s]"


def short(name: str) -> str:
    """The end of a path, or the beginning of a list of effects."""
    if len(name) <= LABEL:
        return name
    return f"…{name[-LABEL:]}" if "/" in name else f"{name[:LABEL]}…"
