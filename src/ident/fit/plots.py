"""Pictures of a fit, drawn by Matplotlib; the same functions serve Jupyter and the report."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from ident.errors import FitError
from ident.files import write_all
from ident.fit.predict import Prediction

if TYPE_CHECKING:
    from ident.mechanism.mechanism import Mechanism

POINTS = 4000  # a curve's; more would not be seen


def _thin(n: int) -> slice:
    return slice(None, None, max(1, n // POINTS))


def plot_torques(prediction: Prediction, units: list[str]) -> Figure:
    """Measured and predicted torque of every independent joint, with what is left."""
    d = len(prediction.joints)
    figure = Figure(figsize=(9, 1.2 + 2.1 * d), layout="constrained")
    axes = figure.subplots(d, 1, sharex=True, squeeze=False)[:, 0]
    some = _thin(len(prediction.t))
    t = prediction.t[some]
    usable = prediction.usable[some]
    for i, (axis, joint) in enumerate(zip(axes, prediction.joints, strict=True)):
        axis.plot(t, prediction.measured[some, i], color="0.6", lw=2.5, label="measured")
        axis.plot(
            t,
            np.where(usable, prediction.predicted[some, i], np.nan),
            color="C0",
            lw=1.0,
            label="predicted",
        )
        axis.plot(
            t,
            np.where(usable, prediction.residual[some, i], np.nan),
            color="C3",
            lw=0.7,
            label="difference",
        )
        axis.set_ylabel(f"{joint} [{units[i]}]")
        axis.grid(alpha=0.3)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
    axes[-1].set_xlabel("t [s]")
    return figure


def plot_multipliers(
    mechanism: Mechanism,
    t: np.ndarray,
    values: np.ndarray,
    reference: tuple[np.ndarray, np.ndarray] | None = None,
) -> Figure:
    """λ(t) (n, m), beside known reactions (t, (n, m)) where there are any."""
    names, units = mechanism.kinematics.multipliers, mechanism.kinematics.units
    shown = [i for i in range(len(names)) if np.isfinite(values[:, i]).any()]
    figure = Figure(figsize=(9, 1.2 + 1.8 * max(len(shown), 1)), layout="constrained")
    axes = figure.subplots(max(len(shown), 1), 1, sharex=True, squeeze=False)[:, 0]
    for axis, i in zip(axes, shown, strict=False):
        some = _thin(len(t))
        if reference is not None:
            axis.plot(reference[0], reference[1][:, i], color="0.6", lw=2.5, label="simulated")
        axis.plot(t[some], values[some, i], color="C0", lw=1.0, label="identified")
        axis.set_ylabel(f"{names[i]} [{units[i]}]")
        axis.grid(alpha=0.3)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    axes[-1].set_xlabel("t [s]")
    return figure


def save_figure(figure: Figure, path: str | Path) -> None:
    """A figure as .png, .svg or .pdf, whole or not at all.

    Raises:
        FitError: for another suffix.
    """
    path = Path(path)
    kind = path.suffix.lower().removeprefix(".")
    if kind not in ("png", "svg", "pdf"):
        raise FitError(f"{path}: give a name that ends in .png, .svg or .pdf")
    stream = io.BytesIO()
    figure.savefig(stream, format=kind, dpi=150)
    write_all(path.parent, {path.name: stream.getvalue()})
