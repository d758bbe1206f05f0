"""The verb `compare`: models against measurement, joint by joint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from markupsafe import Markup

from ident.compare.report import comparison_html, comparison_json
from ident.errors import FitError, one_of
from ident.files import write_all
from ident.fit.fit import Fit
from ident.fit.saved import Saved
from ident.motion import Motion
from ident.progress import Progress
from ident.residual.error import Error, error_rows
from ident.residual.failure import Failure
from ident.residual.gather import residual_of
from ident.residual.plots import plot_maps, plot_parts, plot_predictions
from ident.residual.predict import Prediction, predict
from ident.residual.residual import Residual
from ident.residual.tables import errors_text, failure_lines, parts_table, where_text
from ident.show.charts import Chart
from ident.show.html import Shown, folded, items, strong
from ident.show.html import table as html_table
from ident.text import table


@dataclass(frozen=True, eq=False)
class Comparison(Shown):
    """One or several models on the same motion. Made by `ident.compare`.

    Attributes:
        residuals: by model, what it leaves and the parts of what it explains.
        fitted: by model, the errors of its own fit: `train`, `held out`, and logs it was validated
            on; by joint.
    """

    residuals: Mapping[str, Residual]
    fitted: Mapping[str, Mapping[str, Mapping[str, Error]]]

    @property
    def errors(self) -> dict[str, dict[str, Error]]:
        """On this motion, by model, then joint."""
        return {name: residual.errors for name, residual in self.residuals.items()}

    @property
    def where(self) -> dict[str, tuple[Failure, ...]]:
        """By model, where it fails, the joint with the largest share first."""
        return {name: residual.where for name, residual in self.residuals.items()}

    @cached_property
    def predictions(self) -> dict[str, list[Prediction]]:
        """By model, one an experiment, at full rate and unfiltered."""
        return {
            name: predict(r.model.mechanism, r.motion, r.model.point)
            for name, r in self.residuals.items()
        }

    @property
    def units(self) -> tuple[str, ...]:
        """Of the independent joints' torques."""
        return next(iter(self.residuals.values())).units

    @property
    def headline(self) -> str:
        """The models, and how far the error falls from the first to the last, in one line."""
        first, *_, last = (*self.residuals.values(), *self.residuals.values())
        names = " and ".join(self.residuals)
        if first is last:
            return f"{names} on {', '.join(trace.name for trace in first.traces)}"
        falls = {j: 1 - last.errors[j].rms / e.rms for j, e in first.errors.items() if e.rms > 0}
        if not falls:
            return names
        best, worst = max(falls, key=lambda j: falls[j]), min(falls, key=lambda j: falls[j])
        return (
            f"From {first.name} to {last.name} the error changes by {-100 * falls[best]:+.3g} % "
            f"({best}) to {-100 * falls[worst]:+.3g} % ({worst})."
        )

    @property
    def summary(self) -> str:
        """Errors on this motion, those of the fits, and how far the error falls."""
        lines = errors_text(self.residuals)
        for name, errors in self.fitted.items():
            if any(errors.values()):
                lines += ["", f"errors of {name} as it was fitted", *table(error_rows(errors))]
        return "\n".join(lines)

    def __str__(self) -> str:
        lines = [self.summary]
        for name, residual in self.residuals.items():
            lines += ["", name] if len(self.residuals) > 1 else []
            lines += [*parts_table(residual), "", *where_text(residual)]
        return "\n".join(lines)

    __repr__ = __str__

    def _blocks(self) -> tuple[Markup, ...]:
        rows = error_rows({name: each.errors for name, each in self.residuals.items()})
        where = [
            folded(f"Where {name} fails", *(items(failure_lines(f, True)) for f in each.where))
            for name, each in self.residuals.items()
        ]
        return strong(self.headline), html_table(rows, "Error of the predicted torque"), *where

    def plot(self, experiment: int = 0) -> Chart:
        """Measured torque and every model's prediction, with residuals below, per joint.

        Args:
            experiment: its number, from 0.
        """
        return plot_predictions(self.predictions, self.units, experiment)

    def plot_parts(self, experiment: int = 0) -> Chart:
        """Rigid bodies, each kind of effect and the residual over time, per joint and model.

        Args:
            experiment: its number, from 0.
        """
        return plot_parts(self.residuals, experiment)

    def plot_maps(self, joint: str | None = None) -> Chart:
        """A joint's residual against t, q, v, a and load; by default the last model's worst joint.

        Raises:
            FitError: if the joint is not an independent one.
        """
        last = list(self.residuals.values())[-1]
        joint = last.where[0].joint if joint is None else joint
        if joint not in last.joints:
            raise FitError(f"no residual of joint '{joint}'; {one_of(joint, last.joints)}")
        return plot_maps(self.residuals, joint)

    def save(self, path: Path) -> None:
        """The plot of the first experiment as .png, .svg, .pdf or .html, whole or not at all.

        Args:
            path: of the file, whose suffix decides.

        Raises:
            IdentError: for another suffix.
        """
        self.plot().save(path)

    def write(self, folder: str | Path) -> list[Path]:
        """report.html, with all pictures in it, and compare.json.

        Raises:
            IdentError: if the folder cannot be written; then no file of it has changed.
        """
        files = {"report.html": comparison_html(self), "compare.json": comparison_json(self)}
        return write_all(Path(folder), files)


def compare(
    *models: Fit | Saved, motion: Motion | None = None, progress: Progress | None = None
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
    if motion is None and isinstance(models[0], Fit):
        motion = models[0].motion
    residuals, fitted = {}, {}
    for i, model in enumerate(models):
        name = f"fit {i + 1}" if isinstance(model, Fit) and len(models) > 1 else ""
        residual = residual_of(model, motion, name=name)
        residuals[residual.name] = residual
        fitted[residual.name] = _fitted(model)
        if progress:
            progress(f"where {residual.name} fails", (i + 0.5) / len(models))
    return Comparison(residuals, fitted)


def _fitted(model: Fit | Saved) -> dict[str, Mapping[str, Error]]:
    if isinstance(model, Saved):
        return dict(model.errors)
    return {"train": model.train, "held out": model.held_out, **model.validation}
