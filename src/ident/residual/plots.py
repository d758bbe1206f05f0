"""Pictures of residuals: measured and predicted, the parts of the sum, maps against signals."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ident.fit.predict import Prediction
from ident.residual.residual import RIGID, Residual, Trace

POINTS = 4000  # of a curve or a cloud; more would not be seen
LABEL = 28  # characters of a name in a picture
BINS = 30  # of the mean that is drawn through a cloud


def plot_predictions(
    predictions: Mapping[str, list[Prediction]], units: tuple[str, ...], experiment: int = 0
) -> Figure:
    """Measured torque and every model's prediction, with residuals below, per joint."""
    names = list(predictions)
    one = predictions[names[0]][experiment]
    d = len(one.joints)
    figure = Figure(figsize=(9, 1.2 + 3.0 * d), layout="constrained")
    axes = figure.subplots(2 * d, 1, sharex=True, squeeze=False)[:, 0]
    some = _thin(len(one.t))
    for u, joint in enumerate(one.joints):
        above, below = axes[2 * u], axes[2 * u + 1]
        above.plot(one.t[some], one.measured[some, u], color="0.6", lw=1.2, label="measured")
        for i, name in enumerate(names):
            p = predictions[name][experiment]
            label = _short(name)
            above.plot(p.t[some], p.predicted[some, u], color=f"C{i}", lw=0.9, label=label)
            below.plot(p.t[some], p.residual[some, u], color=f"C{i}", lw=0.7)
        above.set_ylabel(f"{joint} [{units[u]}]")
        below.set_ylabel("difference")
        above.grid(alpha=0.3)
        below.grid(alpha=0.3)
    axes[0].legend(loc="upper right", ncols=len(names) + 1, fontsize="small")
    axes[-1].set_xlabel("t [s]")
    return figure


def plot_parts(residuals: Mapping[str, Residual], experiment: int = 0) -> Figure:
    """Measured torque and the parts that add up to the predicted one: a row a joint, a column a
    model.
    """
    first = next(iter(residuals.values()))
    d, m = len(first.joints), len(residuals)
    figure = Figure(figsize=(max(9, 6 * m), 1.2 + 2.2 * d), layout="constrained")
    axes = figure.subplots(d, m, sharex=True, sharey="row", squeeze=False)
    shown: dict[str, str] = {}
    for column, (name, residual) in enumerate(residuals.items()):
        trace = residual.traces[min(experiment, len(residual.traces) - 1)]
        labels = list(trace.parts)
        for u, joint in enumerate(residual.joints):
            axis = axes[u, column]
            _curve(axis, trace, trace.measured[:, u], "0.6", 2.5, "measured")
            for label in labels:
                x = trace.parts[label][:, u]
                if label == RIGID or np.abs(x).max() > 0:
                    kind = label.split(":")[0]
                    color = shown.setdefault(kind, f"C{len(shown) % 10}")
                    _curve(axis, trace, x, color, 1.0, kind)
            _curve(axis, trace, trace.residual[:, u], "k", 0.6, "residual")
            axis.grid(alpha=0.3)
            if column == 0:
                axis.set_ylabel(f"{joint} [{residual.units[u]}]")
        axes[0, column].set_title(f"{_short(name)}, {_short(trace.name)}", fontsize="small")
        axes[-1, column].set_xlabel("t [s]")
    handles = {
        label: handle
        for axis in axes.flat
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        handles.values(), handles.keys(), loc="outside upper center", ncols=6, fontsize="small"
    )
    return figure


def plot_maps(residuals: Mapping[str, Residual], joint: str) -> Figure:
    """A joint's residual against its t, q, v, a and load, a row a model, and its mean; and against
    what it depends on most, where that is another joint's.
    """
    first = next(iter(residuals.values()))
    names = ["t", *(f"{kind}.{joint}" for kind in ("q", "v", "a", "load"))]
    names += [name for name in [_foreign(residuals, joint)] if name]
    figure = Figure(figsize=(2.6 * len(names), 0.8 + 2.4 * len(residuals)), layout="constrained")
    axes = figure.subplots(len(residuals), len(names), sharey=True, squeeze=False)
    u = first.joints.index(joint)
    for row, (title, residual) in enumerate(residuals.items()):
        r = [trace.residual[:, u] for trace in residual.traces]
        for axis, name in zip(axes[row], names, strict=True):
            x, unit = residual.signal(name)
            _cloud(axis, x, r)
            axis.grid(alpha=0.3)
            own = name.removesuffix(f".{joint}")
            axis.set_xlabel(f"{own} [{unit}]" if unit else own)
        axes[row, 0].set_ylabel(f"{_short(title)}\n{joint} [{residual.units[u]}]", fontsize="small")
    return figure


def _foreign(residuals: Mapping[str, Residual], joint: str) -> str | None:
    """The most important signal of another joint on which the residual of some model depends."""
    found = [
        (each.r2, each.signal)
        for residual in residuals.values()
        for failure in residual.where
        if failure.joint == joint
        for each in failure.depends_on
        if each.signal != "t" and not each.signal.endswith(f".{joint}")
    ]
    return max(found)[1] if found else None


def _short(name: str) -> str:
    """The end of a path, or the beginning of a list of effects."""
    if len(name) <= LABEL:
        return name
    return f"…{name[-LABEL:]}" if "/" in name else f"{name[:LABEL]}…"


def _thin(n: int) -> slice:
    return slice(None, None, max(1, n // POINTS))


def _curve(axis: Axes, trace: Trace, x: np.ndarray, color: str, width: float, label: str) -> None:
    """A series, broken where rows do not follow each other."""
    some = _thin(len(x))
    broken = np.concatenate([[False], np.diff(trace.segment[some]) > 0])
    axis.plot(trace.t[some], np.where(broken, np.nan, x[some]), color=color, lw=width, label=label)


def _cloud(axis: Axes, x: list[np.ndarray], r: list[np.ndarray]) -> None:
    """Points, one colour an experiment, and their mean in bins of x."""
    for number, (xs, rs) in enumerate(zip(x, r, strict=True)):
        some = _thin(len(xs) * len(x))
        axis.scatter(xs[some], rs[some], s=2, color=f"C{number}", alpha=0.4, lw=0, rasterized=True)
    every, left = np.concatenate(x), np.concatenate(r)
    edges = np.linspace(every.min(), every.max(), BINS + 1)
    at = np.digitize(every, edges[1:-1])
    count, total = (np.bincount(at, w, BINS) for w in (None, left))
    middle = np.array([(low + high) / 2 for low, high in pairwise(edges)])
    known = count >= 3
    axis.plot(middle[known], total[known] / count[known], color="k", lw=1.2)
    axis.axhline(0, color="0.5", lw=0.6)
