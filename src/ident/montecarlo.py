"""Monte Carlo studies: how noise of a log changes parameters, estimator beside estimator."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.interpolate import interp1d

from ident.display import Displayed, Progress, render
from ident.errors import FitError, check_whole, line_of, one_of
from ident.files import Written
from ident.fit import Fit, identify
from ident.fit.values import BaseValue, Value
from ident.lazy import lazy
from ident.log import Log, read_log
from ident.mechanism.causes import CalibrationError, causes_of
from ident.mechanism.mechanism import Mechanism, Multipliers
from ident.motion import Motion, complete
from ident.pool import Workers
from ident.simulate.integrate import AnyLog
from ident.simulate.inverse import CHANNELS as USUAL
from ident.simulate.inverse import noisy, noisy_columns, random_of
from ident.simulate.misread import misread as read_wrongly

if TYPE_CHECKING:
    import polars as pl
else:
    pl = lazy("polars")

SAMPLES = 5  # range: between the paper's hat functions without a basis: 5 ms of its 1 ms samples

Estimate = Callable[[Mechanism, Log], Fit]


@dataclass(frozen=True)
class Estimator:
    """A function from a log to a fit, with a name."""

    name: str  # in tables and charts
    find: Estimate  # (mechanism, log) → fit
    words: str = ""  # description in one line


def with_free_multipliers(mechanism: Mechanism, log: Log, **options: Any) -> Fit:
    """Return the fit of a completed log with `options` of `identify` and free multipliers."""
    model = mechanism.with_same_kinematics(multipliers=Multipliers())
    return identify(model, complete(model, log), **options)


def _paper(mechanism: Mechanism, log: Log, spacing: float | None = None) -> Fit:
    """Return the fit of all channels as logged, λ in hats beside the parameters (eq. 8)."""
    basis = mechanism.multipliers
    if spacing is not None or basis.degree <= 0:
        basis = Multipliers("linear", spacing or SAMPLES * float(np.median(np.diff(log.t))))
    model = mechanism.with_same_kinematics(multipliers=basis)
    motion = complete(model, log, smoothing=None, cutoff=None)
    return identify(model, motion, estimator="least-squares")


def paper(spacing: float | None = None) -> Estimator:
    """Return the paper's method (sect. 2, eq. 8).

    Args:
        spacing: of the hat functions [s]; None: the mechanism's own time basis, else 5 samples.

    Raises:
        FitError: for a spacing that is no positive number.
    """
    if spacing is not None and not (np.isfinite(spacing) and spacing > 0):
        raise FitError(f"spacing {spacing!r} s of the hats; valid: above 0, as 0.005")
    words = "channels as logged, multipliers in a time basis, plain least squares"
    return Estimator("paper", partial(_paper, spacing=spacing), words)


ESTIMATORS: Mapping[str, Estimator] = {"paper": paper()} | {
    name: Estimator(name, partial(with_free_multipliers, **options), words)
    for name, options, words in (
        ("default", {}, "smoothing and filter; one step of the likelihood where noise matters"),
        ("least-squares", {"estimator": "least-squares"}, "smoothing and filter, least squares"),
        ("likelihood", {"estimator": "likelihood"}, "torques and motion weighed together"),
        ("consistent", {"consistent": True}, "default, bodies and friction possible"),
    )
}
"""The project's own estimators by name."""


def estimators_of(given: Sequence[str | Estimator | Estimate]) -> tuple[Estimator, ...]:
    """Return estimators given by name, as they are, or as functions; refuse all else."""
    estimators: dict[str, Estimator] = {}
    for estimator in [given] if isinstance(given, str | Estimator) or callable(given) else given:
        if callable(estimator):
            words = (estimator.__doc__ or "").strip().partition("\n")[0]
            estimator = Estimator(
                getattr(estimator, "__name__", type(estimator).__name__), estimator, words
            )
        estimator = (
            ESTIMATORS.get(estimator, estimator) if isinstance(estimator, str) else estimator
        )
        if not isinstance(estimator, Estimator):
            raise FitError(
                f"estimator {estimator!r}: cannot be called; {one_of(str(estimator), ESTIMATORS)}"
            )
        if estimator.name in estimators:
            raise FitError(
                f"estimator '{estimator.name}' is given twice; give each a name of its own"
            )
        estimators[estimator.name] = estimator
    if not estimators:
        raise FitError(f"no estimator given; valid: {', '.join(ESTIMATORS)}, or one of your own")
    return tuple(estimators.values())


SUMS = {"force": "N", "moment": "N m"}  # root sums of squares over all multipliers of a unit
ENDS = 0.02  # range: share of the log at either end where errors of the multipliers do not count

TrialRows = tuple[list[tuple[Any, ...]], list[tuple[Any, ...]], list[tuple[Any, ...]]]
"""Rows of `MonteCarlo.samples`, `errors` and `failures`."""


@dataclass(frozen=True, eq=False)
class Truth:
    """True values, given or identified from the log without noise."""

    # values, units: by name of parameters, effects' parameters and base parameters
    values: Mapping[str, float]
    units: Mapping[str, str]
    multipliers: tuple[str, ...]  # their names
    multiplier_units: tuple[str, ...]  # [N | N m]
    t: np.ndarray  # (n,) [s]
    reactions: np.ndarray  # (n, m), NaN where nothing is known
    words: tuple[str, ...]  # sources of values and reactions

    def errors(self, fit: Fit) -> tuple[float, ...]:
        """Return the rms of identified − true multipliers over time, 2 % at the ends left out."""
        t, values = fit.multipliers[0]
        known = interp1d(self.t, self.reactions, axis=0, bounds_error=False)(t)
        margin = ENDS * (t[-1] - t[0])
        inside = (t >= t[0] + margin) & (t <= t[-1] - margin)
        return tuple(map(float, rms_of(np.where(inside[:, None], values - known, np.nan))))


def rms_of(x: np.ndarray) -> np.ndarray:
    """Return the root mean square (m,) of x (n, m) over the samples that are known."""
    count = np.isfinite(x).sum(axis=0)
    total = np.nansum(x**2, axis=0)
    return np.sqrt(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def truth_of(
    mechanism: Mechanism,
    log: Log,
    given: Mapping[str, float] | None = None,
    reactions: Log | None = None,
) -> Truth:
    """Identify the log itself with free multipliers; given values replace the identified ones."""
    fit = with_free_multipliers(mechanism, log)
    # everything that the data determine
    effects = [v for e in fit.effects for v in e.parameters if v.name in fit.columns.names]
    known: list[Value | BaseValue] = [v for v in (*fit.parameters, *effects) if v.identifiable]
    known += [v for v in fit.base_parameters if " " in v.name]
    values, units = {v.name: v.value for v in known}, {v.name: v.unit for v in known}
    if not values:
        raise FitError(
            f"{log.name}: identifies nothing of {mechanism.name}, so noise harms nothing"
        )
    for name, value in (given or {}).items():
        if name not in values:
            raise FitError(f"truth of '{name}'; {one_of(name, values)}")
        if not isinstance(value, int | float | np.number) or not np.isfinite(value):
            raise FitError(f"truth of '{name}' {value!r}; valid: a number, finite")
        values[name] = float(value)
    names, kinds = mechanism.kinematics.multipliers, mechanism.kinematics.units
    label = f"{log.name} as it is" + (", with free multipliers" if names else "")
    words = [f"parameters: of {label}" + (f"; as given: {', '.join(given)}" if given else "")]
    t, true = fit.multipliers[0]
    if reactions is not None:
        compared = fit.compare_multipliers(reactions)
        t, true = compared.t, compared.known
    if names:
        words.append(f"multipliers: of {label if reactions is None else reactions.name}")
    return Truth(values, units, names, kinds, t, true, tuple(words))


@dataclass(frozen=True, eq=False)
class TrialPlan:
    """Everything that the runs of one log have in common."""

    mechanism: Mechanism  # its unknowns are identified
    log: Log  # gets the noise
    estimators: tuple[Estimator, ...]  # applied to the same noise
    truth: Truth  # compared with them
    columns: tuple[str, ...]  # of the log, that get noise
    seed: int  # of all noise
    misread: bool = False  # whether errors of the calibration are drawn from their priors too

    @cached_property
    def motion(self) -> Motion:
        """The completed log, without further noise."""
        return complete(self.mechanism, [self.log])

    def log_of(self, snr: float, run: int) -> Log:
        """Return the noisy log of a run, the calibration's errors being the same at every ratio."""
        log = read_wrongly(self.log, self.causes, self.errors_of(run)) if self.misread else self.log
        return noisy(log, snr, self.columns, random_of(self.seed, snr, run))

    @cached_property
    def causes(self) -> tuple[CalibrationError, ...]:
        """What may be wrong with the sensors."""
        logged = [n.partition(".")[2] for n in self.log.columns if n.startswith("q.")]
        spacing = float(np.median(np.diff(self.log.t)))
        return tuple(causes_of(self.mechanism, logged, 1 / spacing))

    def errors_of(self, run: int) -> dict[str, float]:
        """Return the errors of a run by cause, in prior scales."""
        random = np.random.default_rng([self.seed, run])
        return {cause.name: float(random.standard_normal()) for cause in self.causes}

    def rows(self, task: tuple[float, int]) -> TrialRows:
        """Apply every estimator to one draw of the noise: at an SNR [dB], of a number."""
        snr, run = task
        log, truth = self.log_of(snr, run), self.truth
        samples, errors, failures = [], [], []
        for estimator in self.estimators:
            key = (estimator.name, snr, run)
            try:
                fit = estimator.find(self.mechanism, log)
                values = []
                for name, true in truth.values.items():
                    value = stderr = np.nan  # with noise the data may determine other combinations
                    with suppress(KeyError):
                        one = fit[name]
                        if getattr(one, "identifiable", True):
                            value, stderr = one.value, np.nan if one.stderr is None else one.stderr
                    values.append(
                        (*key, name, float(value), float(stderr), true, truth.units[name])
                    )
                rms = truth.errors(fit)
            except Exception as error:  # of whatever estimator
                failures.append((*key, line_of(error)))
                continue
            samples += values
            every = [*zip(truth.multipliers, rms, truth.multiplier_units, strict=True)]
            errors += [(*key, *error) for error in every]
            for name, unit in SUMS.items():
                same = [x for _, x, its in every if its == unit and np.isfinite(x)]
                errors += [(*key, name, float(np.linalg.norm(same)), unit)] if same else []
        return samples, errors, failures


Z95 = 1.96  # level: standard errors: the central 95 % of a normal distribution
RUN = {"estimator": pl.String, "snr": pl.Float64, "run": pl.Int64}
PARAMETER = {"parameter": pl.String, "value": pl.Float64, "stderr": pl.Float64,
             "truth": pl.Float64, "unit": pl.String}  # fmt: skip
MULTIPLIER = {"multiplier": pl.String, "rms": pl.Float64, "unit": pl.String}


@dataclass(frozen=True, eq=False, repr=False)
class MonteCarlo(Displayed, Written):
    """Identifications of one log with ever new noise. Made by `ident.monte_carlo`.

    Attributes:
        plan: mechanism, log, estimators, truth and seed of all runs.
        snr: signal-to-noise ratios [dB], highest first; runs: draws of the noise at each.
        samples: one row an estimator, SNR, run and parameter: `value`, `stderr`, null where that
            run does not determine it, with `truth` and `unit`.
        errors: one row an estimator, SNR, run and multiplier: `rms` error over time, 2 % at either
            end left out, and `unit`; `force` and `moment` are the root sum of squares over all
            multipliers of that unit.
        failures: one row a run that ended in an error: estimator, SNR, run, `error`.
    """

    plan: TrialPlan
    snr: tuple[float, ...]
    runs: int
    samples: pl.DataFrame
    errors: pl.DataFrame
    failures: pl.DataFrame

    @cached_property
    def table(self) -> pl.DataFrame:
        """Statistics by estimator, SNR and parameter.

        Columns: `runs` that determine it, `mean`, `bias` (mean − truth), `bias_stderr` (of it,
        std / √runs), `std`, `rms` (of value − truth), `stderr` (mean of those that the fits claim),
        `coverage` (share of runs whose value ± 1.96 stderr holds the truth), `truth`, `unit`.
        """
        value, truth, stderr = pl.col("value"), pl.col("truth"), pl.col("stderr")
        off = value - truth
        return self.samples.group_by("estimator", "snr", "parameter", maintain_order=True).agg(
            value.count().alias("runs"),
            value.mean().alias("mean"),
            off.mean().alias("bias"),
            (value.std() / value.count().sqrt()).alias("bias_stderr"),
            value.std().alias("std"),
            (off**2).mean().sqrt().alias("rms"),
            stderr.mean().alias("stderr"),
            (off.abs() <= Z95 * stderr).mean().alias("coverage"),
            truth.first(),
            pl.col("unit").first(),
        )

    @cached_property
    def multipliers(self) -> pl.DataFrame:
        """Statistics by estimator, SNR and multiplier.

        Columns: `runs`, `mean` and `std` of the rms errors, `size` (rms of the true one), `unit`.
        """
        truth, rms = self.plan.truth, pl.col("rms")
        rms_true, units = rms_of(truth.reactions), np.array(truth.multiplier_units)
        sizes = dict(zip(truth.multipliers, rms_true, strict=True))
        sizes |= {s: float(np.sqrt(np.nansum(rms_true[units == u] ** 2))) for s, u in SUMS.items()}
        size = pl.col("multiplier").replace_strict(sizes, return_dtype=pl.Float64)
        return (
            self.errors.group_by("estimator", "snr", "multiplier", maintain_order=True)
            .agg(
                rms.count().alias("runs"),
                rms.mean().alias("mean"),
                rms.std().alias("std"),
                pl.col("unit").first(),
            )
            .with_columns(size.alias("size"))
            .filter(pl.col("runs") > 0)
        )

    @property
    def estimators(self) -> tuple[str, ...]:
        """Names."""
        return tuple(estimator.name for estimator in self.plan.estimators)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names."""
        return tuple(self.plan.truth.values)

    @property
    def notes(self) -> tuple[str, ...]:
        """Runs that failed or did not determine a parameter."""
        notes, failed, of = [], {}, f"of {self.runs} runs"
        for (name, snr), frame in self.failures.group_by("estimator", "snr", maintain_order=True):
            failed[name, snr] = n = frame.height
            notes.append(f"{name} at {snr:g} dB: {n} {of} failed; the first: {frame['error'][0]}")
        for name, snr, parameter, runs, *_ in self.table.iter_rows():
            if (less := self.runs - failed.get((name, snr), 0) - runs) > 0:
                notes.append(f"{name} at {snr:g} dB: {less} {of} do not determine {parameter}")
        return tuple(notes)

    def plot(self, parameters: Sequence[str] | None = None) -> Any:
        """Draw box plots over SNR, estimators side by side: parameters, errors of multipliers.

        Args:
            parameters: names; default: all, but not more than 12.

        Raises:
            FitError: for an unknown parameter.
        """
        for name in parameters or ():
            if name not in self.parameters:
                raise FitError(f"parameter '{name}'; {one_of(name, self.parameters)}")
        return render(self, "plot", parameters)


def monte_carlo(
    mechanism: Mechanism,
    log: AnyLog,
    *,
    snr: float | Sequence[float] = (60, 50, 40, 30),
    runs: int = 100,
    estimators: Sequence[str | Estimator | Estimate] = ("paper", "default"),
    truth: Mapping[str, float] | None = None,
    reactions: AnyLog | None = None,
    channels: Sequence[str] = USUAL,
    seed: int = 0,
    misread: bool = False,
    jobs: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> MonteCarlo:
    """Identify the same log with ever new white noise (the paper's Figs. 4, 7, 8).

    Args:
        mechanism: with what is unknown.
        log: without noise, best of a simulation.
        snr: signal-to-noise ratios [dB] of every channel, power of the mean included.
        runs: draws of the noise at each.
        estimators: names (`ident.montecarlo.ESTIMATORS`), an `Estimator`, or functions
            (mechanism, log) -> Fit; all meet the same noise.
        truth: true values by name; others are those of the log as it is.
        reactions: a log of the true multipliers, columns named as they are; else those of the log
            as it is.
        channels: which get noise: `q`, `v`, `a`, `tau`, `wrench`.
        seed: of all noise; the same seed, the same runs, in whatever number of processes.
        misread: whether each run's sensors have errors drawn from the priors of the mechanism's
            calibration, with which it is identified too; lengths are exact, as another length is
            another machine. Without it the calibration is exact: noise alone is studied.
        jobs: processes; None: one a core; 1: this one alone.
        scheduler: address of a Dask scheduler whose workers make the runs, in place of processes.
        progress: called with (what is being done, share done).

    Returns:
        Every run's values, standard errors and errors of the multipliers, and their statistics;
        after Ctrl-C those of the runs that are done. Runs that end in an error are kept, with it,
        in `failures`.

    Raises:
        FitError: for an SNR, a number or an estimator that is none, or an unknown truth.
        LogError: if the log cannot be read or has no channel that gets noise.
    """
    check_whole("runs", runs, 1)
    check_whole("seed", seed)
    values = np.atleast_1d(np.asarray(snr, dtype=object))
    bad = [x for x in values if not (isinstance(x, int | float | np.number) and np.isfinite(x))]
    if bad or not len(values):
        given = f"SNR {bad[0]!r}" if bad else "no SNR given"
        raise FitError(f"{given}; valid: numbers of dB, as snr=(60, 40, 30)")
    ratios = tuple(sorted(set(map(float, values)), reverse=True))  # each once
    applied = estimators_of(estimators)
    log = log if isinstance(log, Log) else read_log(log, mechanism.sources)
    columns = noisy_columns(log, channels)
    if reactions is not None and not isinstance(reactions, Log):
        reactions = read_log(reactions)
    exact = mechanism.with_calibration("exact")
    known = truth_of(exact, log, truth, reactions)
    studied = mechanism.with_calibration("length=exact") if misread else exact
    plan = TrialPlan(studied, log, applied, known, columns, int(seed), misread)
    workers = Workers(jobs, scheduler, False, progress)
    tasks = [(ratio, run) for run in range(runs) for ratio in ratios]
    names = [f"run {run} at {ratio:g} dB" for ratio, run in tasks]
    done = workers.run(TrialPlan.rows, tasks, plan, names, "runs")
    rows: TrialRows = ([], [], [])
    count = 0
    try:
        for name, (task, results) in zip(names, done, strict=True):
            if results is None:  # the process died
                results = [], [], [(one.name, *task, workers.broken[name]) for one in applied]
            for collected, new in zip(rows, results, strict=True):
                collected += new
            count += 1
    except KeyboardInterrupt:  # what is done at every ratio
        runs = count // len(ratios)
        if not runs:
            raise
    order = pl.col("snr"), pl.col("run")
    types = (RUN | PARAMETER, RUN | MULTIPLIER, RUN | {"error": pl.String})
    frames = (
        pl.DataFrame(frame, schema=kinds, orient="row")
        .fill_nan(None)
        .filter(order[1] < runs)
        .sort(*order, descending=[True, False], maintain_order=True)
        for frame, kinds in zip(rows, types, strict=True)
    )
    return MonteCarlo(plan, ratios, runs, *frames)
