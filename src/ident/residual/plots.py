"""Pictures of residuals: measured and predicted, the parts of the sum, maps against signals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from ident.chart import MEASURED, RESIDUAL, Chart, Level, Line, Panel, Points
from ident.residual.failure import Failure
from ident.residual.predict import Prediction
from ident.residual.residual import RIGID, Residual, Trace

LABEL = 28  # characters of a name in a picture
BINS = 30  # of the mean that is drawn through a cloud
OWN = ("q", "v", "a", "load")  # of a joint, against which its residual is drawn


def plot_predictions(
    predictions: Mapping[str, list[Prediction]], units: Sequence[str], experiment: int = 0
) -> Chart:
    """Measured torque and every model's prediction, with residuals below, per joint."""
    names = list(predictions)
    one = predictions[names[0]][experiment]
    rows = []
    for u, joint in enumerate(one.joints):
        above = [Line(one.t, _only(one, one.measured[:, u]), "measured", MEASURED, 2.2)]
        below = []
        for i, name in enumerate(names):
            p = predictions[name][experiment]
            label = "predicted" if len(names) == 1 else short(name)
            above.append(Line(one.t, _only(p, p.predicted[:, u]), label, i, 1.1))
            colour = RESIDUAL if len(names) == 1 else i
            left = "difference" if len(names) == 1 else ""
            below.append(Line(one.t, _only(p, p.residual[:, u]), left, colour, 0.8))
        rows.append((Panel(tuple(above), "t [s]", f"{joint} [{units[u]}]"),))
        rows.append((Panel((Level(), *below), "t [s]", "difference", height=1.5),))
    words = f"Measured and predicted torque of every joint over time, {one.name}"
    return Chart(words, tuple(rows), shared_x=True, timed=True)


def _only(p: Prediction, x: np.ndarray) -> np.ndarray:
    """With gaps where samples take no part."""
    return np.where(p.usable, x, np.nan)


def plot_parts(residuals: Mapping[str, Residual], experiment: int = 0) -> Chart:
    """Measured torque and the parts that add up to the predicted one: a row a joint, a column a
    model.
    """
    first = next(iter(residuals.values()))
    colours: dict[str, int] = {}
    rows = []
    for u, joint in enumerate(first.joints):
        row: list[Panel] = []
        for name, residual in residuals.items():
            trace = residual.traces[min(experiment, len(residual.traces) - 1)]
            title = f"{short(name)}, {short(trace.name)}" if u == 0 and len(residuals) > 1 else ""
            label = f"{joint} [{first.units[u]}]" if not row else ""
            row.append(Panel(_summands(trace, u, colours), "t [s]", label, title))
        rows.append(tuple(row))
    words = "The sum taken apart: rigid bodies, effects and what is left, over time"
    wide = max(9.0, 6.0 * len(residuals))
    return Chart(words, tuple(rows), shared_x=True, shared_y=True, width=wide, timed=True)


def _summands(trace: Trace, u: int, colours: dict[str, int]) -> tuple[Line, ...]:
    """Of one joint; effects of a kind have one colour."""
    lines = [Line(trace.t, _broken(trace, trace.measured[:, u]), "measured", MEASURED, 2.2)]
    for part, values in trace.parts.items():
        x, kind = values[:, u], part.split(":")[0]
        if part == RIGID or np.abs(x).max() > 0:
            colour = colours.setdefault(kind, len(colours))
            lines.append(Line(trace.t, _broken(trace, x), kind, colour))
    lines.append(Line(trace.t, _broken(trace, trace.residual[:, u]), "residual", RESIDUAL, 0.8))
    return tuple(lines)


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


def short(name: str) -> str:
    """The end of a path, or the beginning of a list of effects."""
    if len(name) <= LABEL:
        return name
    return f"…{name[-LABEL:]}" if "/" in name else f"{name[:LABEL]}…"
