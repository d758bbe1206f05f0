"""The noun that a fit is: parameters ± standard error, multipliers, errors, statistics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ident.display import render
from ident.effects import Effect
from ident.effects.effect import Estimates
from ident.equations.problem import Problem
from ident.equations.unknowns import Columns, Point
from ident.errors import FitError, IdentError, one_of
from ident.faults.channel_fits import SMALL
from ident.faults.data_checks import FAR, DataChecks, Health
from ident.faults.search import NUMBERED
from ident.finding import Finding
from ident.fit.calibration import Budget, budget_of
from ident.fit.calibration_rows import FitRows, ReducedRows, WhitenedRows
from ident.fit.consistency import Binding, PossibleBodies
from ident.fit.findings import severity, unexcited
from ident.fit.least_bodies import LeastBodies
from ident.fit.likelihood import Likelihood
from ident.fit.prediction import (
    MultiplierErrors,
    Prediction,
    Reactions,
    identifiable_multipliers,
    multiplier_errors,
    predict,
)
from ident.fit.residual import Charted, Residual, residual_of
from ident.fit.residual_maps import Periods, period_of
from ident.fit.values import (
    BaseValue,
    Changes,
    Correlation,
    EffectValues,
    Model,
    ParameterValues,
    Value,
    with_noise,
)
from ident.information.blocks import Error, Information, Squares
from ident.information.chance import prior_covariance
from ident.information.estimate import Estimate
from ident.information.evidence import EXPLAINED_BELOW
from ident.lazy import lazy
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import Covariance
from ident.motion import Motion

if TYPE_CHECKING:
    import polars as pl
else:
    pl = lazy("polars")

LONG = 40  # shown: characters of a name that tells where each effect is
EXACT_FIT = 1e-6  # numerics: relative error below which a residual is rounding and interpolation


@dataclass(frozen=True, eq=False, repr=False)
class Fit(Charted):
    """The result of an identification, and what it rests on. Made by `ident.identify`.

    Attributes:
        problem: the equations: mechanism, motion, unknowns, all rows as triangles.
        estimate: solution, base, weights.
        scatter: covariance (n_ind, n_ind) of the base parameters by the residual's own scatter.
        train, held_out, validation: errors by joint; validation by log, then joint.
        floors: rms that noise of the sensors makes, by validation log, then joint [N m | N].
        validated_on: motion of the validation logs; None where these were read in portions.
        bias: (n_ind,) that noise of the motion may make of the base parameters; in `scatter`.
        findings: what a person should know before trusting the numbers; `warnings` as text.
        binding: of a consistent fit, where it touches its limits and what that costs.
        likelihood: where the noise of the motion counts, how it was weighed.
        earlier: a fit of an earlier log, of which `changes` tells what is different now.
    """

    problem: Problem
    estimate: Estimate
    scatter: np.ndarray
    train: Mapping[str, Error]
    held_out: Mapping[str, Error]
    validation: Mapping[str, Mapping[str, Error]] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    binding: Binding | None = None
    likelihood: Likelihood | None = None
    earlier: Model | None = None
    floors: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    validated_on: Motion | None = None
    bias: np.ndarray | None = None

    @property
    def mechanism(self) -> Mechanism:
        """The fitted mechanism, with its effects."""
        return self.problem.mechanism

    @property
    def motion(self) -> Motion:
        """The data."""
        return self.problem.motion

    @property
    def columns(self) -> Columns:
        """The unknowns."""
        return self.problem.columns

    @property
    def information(self) -> Information:
        """All rows as triangles, for statistics and further models."""
        return self.problem.information

    @cached_property
    def point(self) -> Point:
        """Values of all parameters, known ones and shapes included."""
        return self.problem.point_at(self.estimate.x)

    @property
    def errors(self) -> Mapping[str, Mapping[str, Error]]:
        """`train`, `held out`, and those of each validation log; by joint."""
        return {"train": self.train, "held out": self.held_out, **self.validation}

    @property
    def command_errors(self) -> dict[str, Error]:
        """Errors [rad | m] of the commands that servos would need in place of theirs, by joint:
        those of their torques, held out if they are known, over kp and the gain that the log has
        (`kp.<joint>`); empty without servos.
        """
        errors = dict[str, Error]()
        for joint, drive in self.mechanism.drives.items():
            kp = self.point.values.get(f"{drive.kind}.{joint}.kp", 0.0)
            e = (self.held_out or self.train).get(joint)
            if e is not None and kp > 0 and (gain := self._gain_in_residual(joint, drive)) > 0:
                errors[joint] = Error(e.rms / (kp * gain), None, self.mechanism.joint(joint).unit)
        return errors

    def _gain_in_residual(self, joint: str, drive: Effect) -> float:
        """Return the gain of the firmware by which the residual of a joint becomes that of its
        command, rms(r) / rms(r / gain) of rows where the drive has one; 1 where none is logged.
        """
        column = f"{drive.scale}.{joint}"
        logged = {e.name: e for e in self.motion.experiments if column in e.extra}
        if not logged:
            return 1.0
        u = self.residual.joints.index(joint)
        torque = command = 0.0
        for trace in self.residual.traces:
            e = logged.get(trace.name)
            gain = np.ones(len(trace.t)) if e is None else np.interp(trace.t, e.t, e.extra[column])
            rows = trace.moving[:, u] & (gain > 0)
            torque += float(np.sum(trace.residual[rows, u] ** 2))
            command += float(np.sum((trace.residual[rows, u] / gain[rows]) ** 2))
        return float(np.sqrt(torque / command)) if command else 0.0

    @property
    def relative(self) -> dict[str, float]:
        """Relative error by joint, fitted or held out, the larger."""
        both = (self.train, self.held_out)
        return {
            joint: max(e[joint].relative or 0.0 for e in both if joint in e) for joint in self.train
        }

    @property
    def error_table(self) -> pl.DataFrame:
        """The errors as a data frame, one row a joint and kind of error.

        Columns: `error` (as `errors`), `joint`, `rms` and `noise` (what the sensors' noise alone
        would leave) in `unit`, `relative`, `relative_with_standstill`.
        """
        rows = []
        for kind, errors in self.errors.items():
            for joint, e in errors.items():
                sizes = e.rms, self.noise_on(kind)[joint], e.unit, e.relative
                rows.append((kind, joint, *sizes, e.with_standstill.relative))
        texts = dict.fromkeys(("error", "joint", "unit"), pl.String)
        names = ("error", "joint", "rms", "noise", "unit", "relative", "relative_with_standstill")
        schema = {name: texts.get(name, pl.Float64) for name in names}
        return pl.DataFrame(rows, schema, orient="row")

    @property
    def parameter_table(self) -> pl.DataFrame:
        """The unknown parameters, bodies' then effects', as a data frame of `Value`'s fields."""
        effects = (value for effect in self.effects for value in effect.parameters)
        unknown = [
            value for value in (*self.parameters, *effects) if value.name in self.columns.index
        ]
        kinds = {"str": pl.String, "bool": pl.Boolean}  # others are numbers
        schema = {entry.name: kinds.get(str(entry.type), pl.Float64) for entry in fields(Value)}
        return pl.DataFrame([asdict(value) for value in unknown], schema)

    @cached_property
    def noise(self) -> dict[str, float]:
        """By joint, the rms that noise of the sensors alone would leave of its torque [N m | N]."""
        return self.residual.noise

    def noise_on(self, log: str) -> Mapping[str, float]:
        """Return the same for a validation log, of its own sensors; read in portions, the fit's."""
        if log not in self.floors:
            return self.noise
        more = self.residual.noise_over_white
        return {joint: x * more.get(joint, 1.0) for joint, x in self.floors[log].items()}

    @cached_property
    def checks(self) -> DataChecks:
        """What may be wrong with the data, as questions to the equations."""
        return DataChecks.of(self.problem, self.estimate, self.relative)

    @cached_property
    def health(self) -> Health:
        """Errors in the logged data: wrong signs, units, columns, clocks, gravity, …"""
        return self.checks.health()

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """Errors in the data, then all other findings, to be read before numbers are trusted."""
        return tuple(map(str, self.all_findings))

    @cached_property
    def all_findings(self) -> tuple[Finding, ...]:
        """Errors in the data, torques that the model leaves unexplained, then all others."""
        again = [self.repeated.finding(self.motion.duration)] if self.repeated else []
        of_budget = [] if self.untrusted else self._budget[1]
        doubts = *self.poor, *self.checks.reversals(), *of_budget
        written = self.possible.findings if self.possible else []
        rest = sorted((*self.findings, *written, *again), key=severity)
        return (*self.health.findings, *doubts, *rest)

    @cached_property
    def poor(self) -> tuple[Finding, ...]:
        """Torques that the model leaves unexplained."""
        return tuple(self.checks.poor(self.noise, self.residual.errors_away_from_reversals))

    @property
    def untrusted(self) -> bool:
        """Whether so much is unexplained that values are not to be trusted, whatever their errors,
        nor what they show of the sensors.
        """
        return any(finding.threshold in (FAR, EXPLAINED_BELOW) for finding in self.poor)

    @cached_property
    def possible(self) -> PossibleBodies | None:
        """The possible bodies nearest to those found; None where these are possible themselves."""
        if self.binding is not None:
            return None
        return PossibleBodies.of(self.problem, self.estimate, self.findings)

    @cached_property
    def least_bodies(self) -> LeastBodies | None:
        """What identified.urdf adds to bodies that move without mass; None if none do."""
        nearest, pi = self.possible, self.dynamic_parameters
        if nearest is not None:
            pi = self.columns.dynamic_parameters(self.mechanism, nearest.x)
        return LeastBodies.of(self.mechanism, pi, self.motion.experiments)

    @cached_property
    def repeated(self) -> Periods | None:
        """What a repeated motion repeats of the residual; None where it is no more than chance."""
        motion, joints = self.motion, self.mechanism.joint_index
        places = np.array([joints[name] for name in motion.independent])
        if all((error.relative or 0.0) < EXACT_FIT for error in self.train.values()) or not any(
            period_of(e, places, motion.band.motion) for e in motion.experiments
        ):
            return None
        again = self.residual.periods
        return again if again and max(again.rho.values()) >= again.chance else None

    @cached_property
    def without_faults(self) -> np.ndarray:
        """Covariance (n_ind, n_ind) of the base parameters of the residual's scatter, wider by what
        a repeated motion repeats, and of the bias of rows at reversals and of torques at limits.
        """
        return self._with(self.checks.moved_at_reversals)

    @cached_property
    def noise_covariance(self) -> np.ndarray:
        """Covariance (n_ind, n_ind) of least squares by noise: `without_faults`, or, where `health`
        names faults, the same with their bias in place of that of such rows.

        By it are judged an effect in one log, and what has changed on a machine: errors of its
        calibration are the same in all logs of it.
        """
        good = max(self.relative.values(), default=0.0) < SMALL  # no fault is named
        return self.without_faults if good else self._with(self.checks.bias)

    def _with(self, change: np.ndarray) -> np.ndarray:
        """Covariance with a bias of the unknowns (k,)."""
        again, bias = self.repeated, self.estimate.base.combined(change)
        wider = 1.0 if again is None else again.variance(self.motion.duration)
        return self.scatter * wider + np.outer(bias, bias) + self.checks.at_limits

    @cached_property
    def budget(self) -> Budget | None:
        """What errors of the calibration do to the base parameters; None where it is exact."""
        return self._budget[0]

    @cached_property
    def _budget(self) -> tuple[Budget | None, list[Finding]]:
        """The budget, and what the data say against it or why there is none."""
        if self.mechanism.calibration.exact or not self.rank:
            return None, []
        if self.known_errors is not None:  # of an earlier fit, as the same sensors log them
            return None, []
        rows: FitRows = (
            ReducedRows(self.problem, self.checks.table)
            if self.likelihood is None
            else WhitenedRows(self.problem, self.likelihood, self.likelihood.linear)
        )
        try:
            budget = budget_of(rows, self.estimate)
        except (IdentError, np.linalg.LinAlgError) as error:
            text = f"errors of the calibration are not in the standard errors: {error}"
            return None, [Finding("no budget", text, "give --calibrated exact if it is")]
        return budget, [] if budget is None else [*budget.findings()]

    @cached_property
    def calibrated(self) -> Estimate:
        """The estimate in which errors of the calibration are fitted within their priors: the best
        values of the machine. `estimate` predicts the torques as its sensors log them. Within
        limits (`binding`) it is that one, and calibration only widens the errors.
        """
        if self.budget is None or self.binding:
            return self.estimate
        x = self.estimate.x.copy()
        x[self.estimate.base.independent] += self.budget.shift
        return self.estimate.at(x)

    @cached_property
    def _by_noise(self) -> np.ndarray:
        """What noise makes of the covariance of the calibrated estimate (n_ind, n_ind)."""
        if self.budget is None or self.binding:
            return self.noise_covariance
        good = max(self.relative.values(), default=0.0) < SMALL
        # a small delay or gain that is named is in the estimate already
        held_by_prior = self.budget.believed and all(
            trial.fault.kind in NUMBERED for trial in self.checks.faults[0]
        )
        of_faults = not (good or held_by_prior)
        change = self.checks.bias if of_faults else self.checks.moved_at_reversals
        bias = self.estimate.base.combined(change)
        wider, again = 1.0, self.repeated
        if again is not None:  # of what is left, the rest is the same in each period
            wider = again.with_less(self.budget.remaining).variance(self.motion.duration)
        fixed = prior_covariance(self.estimate, self.problem.plausible)
        if self.bias is not None:
            fixed = fixed + np.diag(self.bias**2)
        return self.budget.noise * wider + fixed + np.outer(bias, bias) + self.checks.at_limits

    @cached_property
    def _by_calibration(self) -> np.ndarray:
        """(n_ind, causes) change of the values by one standard deviation of each cause."""
        if self.budget is None:
            return np.zeros((self.rank, 0))
        return self.budget.propagated if self.binding else self.budget.parts

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance (n_ind, n_ind) of the base parameters, by noise and calibration."""
        parts = self._by_calibration
        return self._by_noise + parts @ parts.T if parts.size else self._by_noise

    def shares(self, name: str) -> dict[str, float]:
        """Return the share of each cause, and of `noise`, in the variance of a parameter.

        Args:
            name: of a parameter, an effect's parameter or a base parameter that is determined.

        Raises:
            KeyError: if there is none of that name, with the nearest one.
        """
        self[name]
        gradient = self._three[0].gradient(name, self.mechanism)
        if gradient is None or not np.isfinite(self.covariance).all():
            return {}
        if self.budget is None:
            return {"noise": 1.0}
        return self.budget.shares(gradient, self._by_noise, self._by_calibration)

    @property
    def known_errors(self) -> Covariance | None:
        """Errors of the values that the fit knows from an earlier one; None where it knows none."""
        known = self.mechanism.covariance
        return known and known.without(self.columns.names)

    def _values(self, cov: np.ndarray, logged: bool = False) -> ParameterValues:
        """Return values with a covariance, of the calibrated estimate or as they are `logged`."""
        at = set(self.binding.at_bound if self.binding else ())
        at |= {self.columns.names[place] for place in self.estimate.at_limit}
        estimate = self.estimate if logged else self.calibrated
        return ParameterValues(self.columns, estimate, cov, at)

    @cached_property
    def _three(self) -> tuple[ParameterValues, ParameterValues, ParameterValues]:
        """Values with all errors, with those of noise, and as they are logged."""
        return (
            self._values(self.covariance), self._values(self._by_noise),
            self._values(self.noise_covariance, logged=True),
        )  # fmt: skip

    @cached_property
    def parameters(self) -> tuple[Value, ...]:
        """Unknown dynamic parameters in Γ's order."""
        return with_noise(*(values.rigid(self.mechanism) for values in self._three))

    @cached_property
    def base_parameters(self) -> tuple[BaseValue, ...]:
        """The combinations that this motion and this mechanism can identify."""
        return with_noise(*(values.base for values in self._three))

    def since(self, earlier: Model) -> Fit:
        """Return the fit with `changes` from an earlier fit, or from its fit.json (`read_fit`)."""
        if not hasattr(earlier, "base_parameters"):
            raise FitError(
                f"since needs a fit, given: {type(earlier).__name__}; write "
                "fit.since(ident.read_fit(folder, mechanism))"
            )
        return replace(self, earlier=earlier)

    @cached_property
    def changes(self) -> Changes | None:
        """What is different from the earlier fit; None where there is none."""
        if self.earlier is None:
            return None
        return Changes.of(self.earlier, self._values(self.noise_covariance, logged=True))

    @cached_property
    def effects(self) -> tuple[EffectValues, ...]:
        """The effects with their parameters."""
        prior = self.earlier.point.values if self.earlier else None
        every = (values.effects(self.point, prior, self._columns) for values in self._three)
        return tuple(
            replace(effect, parameters=with_noise(*(x.parameters for x in (effect, *others))))
            for effect, *others in zip(*every, strict=True)
        )

    def effects_with(self, covariance: np.ndarray) -> tuple[EffectValues, ...]:
        """Return the effects with their parameters as they are logged, of a covariance of these
        (n_ind, n_ind).
        """
        prior = self.earlier.point.values if self.earlier else None
        return self._values(covariance, logged=True).effects(self.point, prior, self._columns)

    @property
    def _columns(self) -> set[str]:
        return {name for log in self.motion.logs for name in log.columns}

    @cached_property
    def logged_effects(self) -> tuple[EffectValues, ...]:
        """The effects as they are logged, with errors of noise alone: what one log can show."""
        return self.effects_with(self.noise_covariance)

    @cached_property
    def correlation(self) -> Correlation:
        """Correlation of the errors of the base parameters."""
        return self._values(self.covariance).correlation()

    @cached_property
    def unexcited(self) -> Finding | None:
        """Parameters that another motion would determine, and the joints that hardly move."""
        return unexcited(self.problem, self.estimate)

    @property
    def name(self) -> str:
        """Name in comparisons: the effects in it, or only their kinds where these are many."""
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
        """Condition number of the base parameters' columns, scaled to equal length."""
        return self.estimate.base.condition_number

    @property
    def dynamic_parameters(self) -> np.ndarray:
        """All bodies' ten parameters (10 · bodies,), known, identified or prior, in Γ's order."""
        return self.point.pi

    @property
    def effect_solution(self) -> list[tuple[Effect, np.ndarray]]:
        """Every effect with the values (parameters,) of its unknowns and shapes."""
        values = self.point.values
        return [
            (effect, np.array([values.get(name, np.nan) for name in effect.names]))
            for effect in self.mechanism.effects
        ]

    @property
    def found(self) -> dict[str, Estimates]:
        """Values and standard errors of all effects' parameters: by label, then short name."""
        return {
            effect_values.effect.label: {v.name.rpartition(".")[2]: (v.value, v.stderr)
                                for v in effect_values.parameters}
            for effect_values in self.logged_effects
        }  # fmt: skip

    def __getitem__(self, name: str) -> Value | BaseValue:
        """Return a parameter, effect's parameter or base parameter by its name.

        Raises:
            KeyError: with the nearest name.
        """
        values = [*self.parameters, *(v for effect in self.effects for v in effect.parameters)]
        plain_values = {value.name: value for value in values}
        by_name = {value.name: value for value in self.base_parameters} | plain_values
        if name not in by_name:
            raise KeyError(f"no parameter '{name}'; {one_of(name, plain_values)}")
        return by_name[name]

    @cached_property
    def residual(self) -> Residual:
        """Residual at the rows of the regression, its parts, and where the model fails."""
        return residual_of(self)

    def predict(self, motion: Motion | None = None) -> list[Prediction]:
        """Return torques, the sum taken apart and multipliers, for this motion or another one."""
        return predict(self.mechanism, self.motion if motion is None else motion, self.point)

    @cached_property
    def predictions(self) -> list[Prediction]:
        """Prediction of every experiment of the fitted motion."""
        return self.predict()

    @cached_property
    def multipliers(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """λ(t) of each experiment: (t (n,), λ (n, m)); NaN where a multiplier is not determined.

        Where torques and motion were weighed together, on the motion that both agree with.
        """
        determined = identifiable_multipliers(self.mechanism, self.motion)
        if self.problem.bands:
            m = len(determined)
            values = [(e.t, np.full((len(e), m), np.nan)) for e in self.motion.experiments]
        else:
            of_likelihood = self.likelihood and self.predict(self.likelihood.motion)
            values = [
                (p.t, np.where(p.usable[:, None], p.multipliers, np.nan))
                for p in of_likelihood or self.predictions
            ]
        for band in self.problem.bands:  # λ(t) = B(t) a, where a run of samples extends
            t, series = values[band.experiment]
            a = band.elimination.back_substitute(self.estimate.x)
            series[band.segment] = band.basis.evaluate(a, t[band.segment])
        return [(t, np.where(determined, series, np.nan)) for t, series in values]

    @cached_property
    def multiplier_errors(self) -> MultiplierErrors:
        """What errors of the values, and priors that no torque corrects, leave open of λ."""
        return multiplier_errors(self.problem, self.estimate, self.covariance)

    @cached_property
    def unfiltered(self) -> dict[str, Error]:
        """Errors at full rate, with all that the filter keeps out of the fit: noise, vibration."""
        zero = Squares.zero(len(self.motion.independent))
        total = sum((p.squares for p in self.predictions), zero)
        return total.errors(self.motion.independent, self.problem.units)

    @property
    def rows(self) -> int:
        """Rows of the regression a coordinate, after filtering and decimation."""
        return self.information.rows // max(self.information.d, 1)

    def compare_multipliers(self, reactions: Log) -> Reactions:
        """Compare the first experiment's multipliers with a log of known reactions on its clock.

        Args:
            reactions: columns named as the multipliers are, [N | N m].

        Raises:
            FitError: if no column is a multiplier of this mechanism.
        """
        names = self.mechanism.kinematics.multipliers
        if not any(name in reactions for name in names):
            column = next(iter(reactions.columns), "t")
            raise FitError(f"{reactions.name}: no column is a multiplier; {one_of(column, names)}")
        log, (t, values) = self.motion.experiments[0].name, self.multipliers[0]
        interpolated = [np.interp(reactions.t, t, x, left=np.nan, right=np.nan) for x in values.T]
        none = np.full(len(reactions.t), np.nan)
        known = np.stack([reactions.columns.get(name, none) for name in names], axis=1)
        off = np.stack(interpolated, axis=1) - known
        return Reactions(self.mechanism, log, (t, values), reactions.t, known, off)

    def plot_parameters(self) -> Any:
        """Chart of identified parameters and effects with 95 % intervals, beside the prior."""
        return render(self, "plot_parameters")

    def plot_multipliers(self, experiment: int = 0) -> Any:
        """Chart of λ(t), the reaction forces of the closures, in one experiment."""
        return render(self, "plot_multipliers", experiment)

    def view(self) -> Any:
        """3-D view: reaction forces as arrows, joints coloured by their residual."""
        return render(self, "view")

    def write(self, folder: str | Path) -> list[Path]:
        """Write fit.json, multipliers.csv, identified.urdf, report.html, … to a `folder`."""
        return list(render(self, "folder", folder))

    def write_urdf(self, path: str | Path) -> Path:
        """Write the URDF with the identified inertias to `path`, which is returned."""
        return Path(render(self, "urdf", path))

    def export(self, to: str, **options: Any) -> Any:
        """Return the identified machine for a simulator or a controller.

        Args:
            to: mjcf, urdf, sdf, drake, usd, c, fmu, or a target of another package.
            options: those of `ident.export`, as `like`, `step`, `out`, `log`.
        """
        return render(self, "export", to, **options)
