"""The noun that a fit is: parameters ± standard error, multipliers, errors, statistics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from markupsafe import Markup

from ident.display import render
from ident.effects import Effect
from ident.equations.columns import Columns
from ident.equations.point import Point
from ident.errors import FitError, one_of
from ident.fit.accumulate import Cell
from ident.fit.banded import Band, multipliers_of
from ident.fit.binding import Binding
from ident.fit.correlation import Correlation
from ident.fit.essential import Essential, essential
from ident.fit.estimate import FLOOR, Estimate
from ident.fit.noisy import Likelihood
from ident.fit.output import write_fit, write_urdf
from ident.fit.plots import plot_multipliers, plot_parameters
from ident.fit.reach import identifiable_multipliers
from ident.fit.regression import Regression
from ident.fit.report import shown_blocks
from ident.fit.summary import summary
from ident.fit.unexcited import Unexcited, unexcited
from ident.fit.values import (
    BaseValue,
    EffectValues,
    Value,
    base_values,
    effect_values,
    rigid_values,
)
from ident.mechanism.mechanism import Mechanism
from ident.motion import Motion
from ident.residual import Residual, residual_of
from ident.residual.error import Error, Squares
from ident.residual.plots import plot_maps, plot_parts, plot_predictions
from ident.residual.predict import Prediction, predict
from ident.show.charts import Chart
from ident.show.html import Shown
from ident.show.view3d import View

LONG = 40  # characters of a name that tells where each effect is


@dataclass(frozen=True, eq=False)
class Fit(Shown):
    """What identification found, and what it rests on. Made by `ident.identify`.

    Attributes:
        mechanism, motion: what was fitted to what.
        columns: the unknowns.
        cells: triangular factors of all rows, for statistics and further models.
        estimate: solution, base, weights; covariance: (n_ind, n_ind) of the base parameters.
        train, held_out, validation: errors by joint; validation by log, then joint.
        warnings: what a person should know before trusting the numbers.
        bands: where the multipliers have a time basis, the way back to them.
        left: where the motion is an excerpt, what is left of the stack of all samples.
        point: values of all parameters, known ones and shapes included.
        binding: of a consistent fit, where it touches its limits and what that costs.
        likelihood: where the noise of the motion counts, how it was weighed.
    """

    mechanism: Mechanism
    motion: Motion
    columns: Columns
    cells: Sequence[Cell]
    estimate: Estimate
    covariance: np.ndarray
    train: Mapping[str, Error]
    held_out: Mapping[str, Error]
    validation: Mapping[str, Mapping[str, Error]] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    bands: Sequence[Band] = ()
    point: Point = field(kw_only=True)
    binding: Binding | None = None
    likelihood: Likelihood | None = None
    left: Sequence[Cell] = ()

    @cached_property
    def parameters(self) -> tuple[Value, ...]:
        """Unknown dynamic parameters in Γ's order."""
        values = rigid_values(self.mechanism, self.columns, self.estimate, self.covariance)
        return tuple(map(self._marked, values))

    @cached_property
    def base_parameters(self) -> tuple[BaseValue, ...]:
        """The combinations that this motion and this mechanism can identify."""
        return base_values(self.columns, self.estimate, self.covariance)

    @cached_property
    def effects(self) -> tuple[EffectValues, ...]:
        """The effects with their parameters."""
        found = effect_values(self.columns, self.estimate, self.covariance, self.point)
        return tuple(
            replace(each, parameters=tuple(map(self._marked, each.parameters))) for each in found
        )

    def _marked(self, value: Value) -> Value:
        """With what bounds do to it."""
        bound = self.binding is not None and value.name in self.binding.at_bound
        return replace(value, at_bound=True) if bound else value

    @cached_property
    def regression(self) -> Regression:
        """The rows that errors are counted in, as factors."""
        return Regression(
            self.mechanism, self.motion, self.point, self.columns, self.cells, self.bands,
            left=self.left,
        )  # fmt: skip

    @cached_property
    def worth(self) -> np.ndarray:
        """(d,) what one row of each coordinate is weighed by in comparisons [N m | N]."""
        sigma, names = self.estimate.sigma, self.motion.independent
        if len(sigma) == len(names) and not self.regression.stacked:
            return sigma
        rms = np.array([self.train[name].rms for name in names])
        return np.maximum(rms, FLOOR * self.regression.torque) + 1e-300

    @cached_property
    def correlation(self) -> Correlation:
        """Of the errors of the base parameters."""
        return Correlation.of(self.columns, self.estimate, self.covariance)

    @cached_property
    def essential(self) -> Essential | None:
        """The base parameters that the model cannot do without; None for a log too short to say."""
        return essential(self)

    @cached_property
    def unexcited(self) -> Unexcited:
        """What this motion does not tell, why, and which motion would."""
        return unexcited(self)

    @property
    def name(self) -> str:
        """In comparisons: the effects in it, or only their kinds where these are many."""
        effects = self.mechanism.effects
        labels = ", ".join(effect.label for effect in effects)
        if len(labels) > LONG:
            labels = ", ".join(dict.fromkeys(effect.kind for effect in effects))
        return f"fit with {labels}" if labels else "fit 1"

    @property
    def rank(self) -> int:
        """Number of base parameters."""
        return self.estimate.base.rank

    @property
    def condition_number(self) -> float:
        """Of the columns of the base parameters, scaled to equal length."""
        return self.estimate.base.condition_number

    @cached_property
    def dynamic_parameters(self) -> np.ndarray:
        """All bodies' ten parameters (10 · bodies,), known, identified or prior, in Γ's order."""
        return self.point.pi

    @property
    def effect_solution(self) -> list[tuple[Effect, np.ndarray]]:
        """Every effect with the values (parameters,) of its unknowns and shapes."""
        return [(effect, self.point.all_of(effect)) for effect in self.mechanism.effects]

    def __getitem__(self, name: str) -> Value | BaseValue:
        """A parameter, effect's parameter or base parameter by its name.

        Raises:
            KeyError: with the nearest name.
        """
        own = {value.name: value for value in self.parameters}
        own |= {value.name: value for effect in self.effects for value in effect.parameters}
        combined = {value.name: value for value in self.base_parameters}
        if name in own:
            return own[name]
        if name in combined:
            return combined[name]
        raise KeyError(f"no parameter '{name}'; {one_of(name, own)}")

    def plot(self, experiment: int = 0) -> Chart:
        """Measured and predicted torque of every independent joint, and what is left.

        Args:
            experiment: its number, from 0.
        """
        units = [self.mechanism.joint(name).force_unit for name in self.motion.independent]
        return plot_predictions({self.name: self.predict()}, units, experiment)

    def plot_parts(self, experiment: int = 0) -> Chart:
        """The sum taken apart: rigid bodies, effects and what is left, per joint.

        Args:
            experiment: its number, from 0.
        """
        return plot_parts({self.name: self.residual}, experiment)

    def plot_maps(self, joint: str | None = None) -> Chart:
        """A joint's residual against t, q, v, a and load; by default where the model fails most.

        Raises:
            FitError: if the joint is not an independent one.
        """
        joint = self.residual.where[0].joint if joint is None else joint
        if joint not in self.residual.joints:
            raise FitError(f"no residual of joint '{joint}'; {one_of(joint, self.residual.joints)}")
        return plot_maps({self.name: self.residual}, joint)

    def plot_parameters(self) -> Chart:
        """Identified parameters and effects with their 95 % intervals, beside the prior.

        Raises:
            FitError: if there are none.
        """
        own = [value for effect in self.effects for value in effect.parameters]
        chart = plot_parameters([*own, *(v for v in self.parameters if v.identifiable)])
        if chart is None:
            raise FitError(f"{self.mechanism.name}: nothing was identified by itself")
        return chart

    def plot_multipliers(self, experiment: int = 0) -> Chart:
        """λ(t), the reaction forces of the closures.

        Args:
            experiment: its number, from 0.

        Raises:
            FitError: of a mechanism without closures.
        """
        t, values = self.multipliers[experiment]
        if not values.shape[1]:
            raise FitError(f"{self.mechanism.name}: has no closures, so no multipliers")
        log = self.motion.experiments[experiment].name
        return plot_multipliers(self.mechanism, t, values, log=log)

    def view(self) -> View:
        """The mechanism in 3-D: reaction forces as arrows, joints coloured by their residual."""
        return render(self.mechanism, "view", self.motion.experiments, self.predict())

    @cached_property
    def residual(self) -> Residual:
        """What is left at the rows of the regression, its parts, and where the model fails."""
        return residual_of(self)

    def predict(self, motion: Motion | None = None) -> list[Prediction]:
        """Torques, the sum taken apart and multipliers, for the fitted motion or another one."""
        motion = self.motion if motion is None else motion
        return predict(self.mechanism, motion, self.point)

    @cached_property
    def multipliers(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """λ(t) of each experiment: (t (n,), λ (n, m)); NaN where a multiplier is not determined.

        Where torques and motion were weighed together, on the motion that both agree with.
        """
        determined = identifiable_multipliers(self.mechanism, self.motion)
        if self.bands:
            x, m = self.estimate.solution.x, len(determined)
            values = multipliers_of(list(self.bands), self.motion, x, m)
            return [
                (e.t, np.where(determined, each, np.nan))
                for e, each in zip(self.motion.experiments, values, strict=True)
            ]
        return [
            (p.t, np.where(determined & p.usable[:, None], p.multipliers, np.nan))
            for p in self.predict(self.likelihood.motion if self.likelihood else None)
        ]

    @cached_property
    def unfiltered(self) -> dict[str, Error]:
        """Errors at full rate, with all that the filter keeps out of the fit: noise, vibration."""
        d = len(self.motion.independent)
        units = [self.mechanism.joint(name).force_unit for name in self.motion.independent]
        total = Squares(np.zeros(d), np.zeros(d), np.zeros(d))
        for p in self.predict():
            error, torque = p.residual[p.usable], p.measured[p.usable]
            rows = np.full(d, float(len(error)))
            total = total + Squares((error**2).sum(axis=0), (torque**2).sum(axis=0), rows)
        return total.errors(self.motion.independent, units)

    @cached_property
    def rows(self) -> int:
        """Rows of the regression a coordinate, after filtering and decimation."""
        d = len(self.motion.independent)
        return sum(cell.factor.rows + cell.rest.rows for cell in self.cells) // max(d, 1)

    def write(self, folder: str | Path) -> list[Path]:
        """fit.json, multipliers.csv, identified.urdf, report.html and identified/ in a folder."""
        return write_fit(self, folder)

    def write_urdf(self, path: str | Path) -> Path:
        """The URDF with the identified inertias into `path`, which is returned; else unchanged."""
        return write_urdf(self, path)

    def __str__(self) -> str:
        return "\n".join([summary(self), *(f"note: {note}" for note in self.warnings)])

    __repr__ = __str__

    def _blocks(self) -> tuple[Markup, ...]:
        return shown_blocks(self)
