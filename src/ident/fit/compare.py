"""The verb `compare`: models against measurement, joint by joint."""

from __future__ import annotations

import html
import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ident.errors import FitError
from ident.files import write_all
from ident.fit.accumulate import accumulate, coordinates
from ident.fit.fit import Fit
from ident.fit.predict import Prediction, predict
from ident.fit.saved import Saved
from ident.fit.score import Error, squares
from ident.fit.summary import error_rows, table
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.progress import Told


@dataclass(frozen=True, eq=False)
class Comparison:
    """Errors of one or several models on the same motion.

    Attributes:
        errors: by model, then joint.
        predictions: by model, one an experiment.
        units: of the independent joints' torques.
    """

    errors: Mapping[str, Mapping[str, Error]]
    predictions: Mapping[str, list[Prediction]]
    units: tuple[str, ...]

    def __str__(self) -> str:
        lines = ["error of the predicted torque", *table(error_rows(self.errors))]
        first, last = next(iter(self.errors)), list(self.errors)[-1]
        if first != last:
            falls = [
                f"{joint} {100 * (1 - self.errors[last][joint].rms / error.rms):.3g} %"
                for joint, error in self.errors[first].items()
                if error.rms > 0
            ]
            lines.append(f"error falls from {first} to {last}: {', '.join(falls)}")
        return "\n".join(lines)

    __repr__ = __str__

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(str(self))}</pre>"

    def plot(self, experiment: int = 0) -> Figure:
        """Measured torque and every model's prediction, with residuals below, per joint."""
        names = list(self.predictions)
        one = self.predictions[names[0]][experiment]
        d = len(one.joints)
        figure = Figure(figsize=(9, 1.2 + 3.0 * d), layout="constrained")
        axes = figure.subplots(2 * d, 1, sharex=True, squeeze=False)[:, 0]
        some = slice(None, None, max(1, len(one.t) // 4000))
        for u, joint in enumerate(one.joints):
            above, below = axes[2 * u], axes[2 * u + 1]
            above.plot(one.t[some], one.measured[some, u], color="0.6", lw=1.2, label="measured")
            for i, name in enumerate(names):
                p = self.predictions[name][experiment]
                above.plot(p.t[some], p.predicted[some, u], color=f"C{i}", lw=0.9, label=name)
                below.plot(p.t[some], p.residual[some, u], color=f"C{i}", lw=0.7)
            above.set_ylabel(f"{joint} [{self.units[u]}]")
            below.set_ylabel("difference")
            above.grid(alpha=0.3)
            below.grid(alpha=0.3)
        axes[0].legend(loc="upper right", ncols=len(names) + 1, fontsize="small")
        axes[-1].set_xlabel("t [s]")
        return figure

    def save(self, path: Path) -> None:
        """The plot of the first experiment as .png, .svg or .pdf, whole or not at all.

        Raises:
            FitError: for another suffix.
        """
        kind = path.suffix.lower().removeprefix(".")
        if kind not in ("png", "svg", "pdf"):
            raise FitError(f"{path}: give a name that ends in .png, .svg or .pdf")
        stream = io.BytesIO()
        self.plot().savefig(stream, format=kind, dpi=150)
        write_all(path.parent, {path.name: stream.getvalue()})


def compare(
    *models: Fit | Saved, motion: Motion | None = None, progress: Told | None = None
) -> Comparison:
    """Models against measurement on one motion.

    Args:
        models: fits, or fit.json files read back.
        motion: on which to compare; default: the one that the first fit was made from.
        progress: called with (what is being done, share done).

    Raises:
        FitError: if there is no model, or no motion to compare on.
    """
    if not models:
        raise FitError("nothing to compare; give one fit or several")
    if motion is None:
        first = models[0]
        if not isinstance(first, Fit):
            raise FitError("a fit read from a file has no motion; give motion=ident.complete(…)")
        motion = first.motion
    errors, predictions = {}, {}
    mechanism = models[0].mechanism
    for i, model in enumerate(models):
        name = _name(model, i, len(models))
        x = model.estimate.solution.x if isinstance(model, Fit) else model.x
        d = coordinates(model.mechanism, motion)
        cells = accumulate(model.mechanism, model.columns, motion, progress, model.point)
        units = [model.mechanism.joint(joint).force_unit for joint in motion.independent]
        errors[name] = squares(cells, x, d).errors(motion.independent, units)
        predictions[name] = predict(model.mechanism, motion, model.point)
    units = [mechanism.joint(joint).force_unit for joint in motion.independent]
    return Comparison(errors, predictions, tuple(units))


def _name(model: Fit | Saved, i: int, count: int) -> str:
    if isinstance(model, Saved):
        return model.name
    labels = ", ".join(effect.label for effect in model.mechanism.effects)
    return f"fit {i + 1}" if count > 1 or not labels else f"fit with {labels}"

