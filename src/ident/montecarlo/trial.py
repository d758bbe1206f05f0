"""One trial: a draw of white noise on a log, and every estimator's fit beside the truth.

    x + σ ε,  ε ~ N(0, 1) a sample,    σ = rms(x) · 10^(−SNR / 20)

The signal's power includes its mean, as in MATLAB's awgn(x, snr, 'measured'); the paper gives its
ratios without a definition.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np

from ident.errors import FitError, LogError, line_of, one_of
from ident.fit import Fit, identify
from ident.fit.values import BaseValue, Value
from ident.log import Log
from ident.mechanism.mechanism import Mechanism, Multipliers
from ident.motion import complete

SAMPLES = 5  # between the paper's hat functions without a time basis: 5 ms of its 1 ms samples

Estimate = Callable[[Mechanism, Log], Fit]


@dataclass(frozen=True)
class Estimator:
    """A function from a log to a fit, with a name."""

    name: str  # in tables and charts
    find: Estimate  # (mechanism, log) → fit
    words: str = ""  # description in one line


def with_free_multipliers(mechanism: Mechanism, log: Log, **options: Any) -> Fit:
    """Return the fit of a completed log with `options` of `identify` and free multipliers."""
    model = with_basis(mechanism, Multipliers())
    return identify(model, complete(model, log), **options)


def _paper(mechanism: Mechanism, log: Log, spacing: float | None = None) -> Fit:
    """Return the fit of all channels as logged, λ in hat functions beside the parameters (eq. 8).

    Without a `spacing` [s] the hats are the mechanism's own time basis, else 5 samples wide.
    """
    basis = mechanism.multipliers
    if spacing is not None or basis.degree <= 0:
        basis = Multipliers("linear", spacing or SAMPLES * float(np.median(np.diff(log.t))))
    model = with_basis(mechanism, basis)
    motion = complete(model, log, smoothing=None, cutoff=None)
    return identify(model, motion, estimator="least-squares")


@lru_cache(maxsize=8)
def with_basis(mechanism: Mechanism, multipliers: Multipliers) -> Mechanism:
    """Return the mechanism with a basis of λ: one object for all runs, compiled only once."""
    if mechanism.multipliers == multipliers:
        return mechanism
    return replace(mechanism, multipliers=multipliers)


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


_OWN: tuple[tuple[str, dict[str, Any], str], ...] = (
    (
        "default",
        {},
        "smoothing and filter; noise of the motion in one step of the likelihood where it matters",
    ),
    ("least-squares", {"estimator": "least-squares"}, "smoothing and filter, least squares"),
    (
        "likelihood",
        {"estimator": "likelihood"},
        "torques and motion weighed together until nothing changes (--refine)",
    ),
    ("consistent", {"consistent": True}, "default, bodies and friction possible"),
)
ESTIMATORS: Mapping[str, Estimator] = {"paper": paper()} | {
    name: Estimator(name, partial(with_free_multipliers, **options), words)
    for name, options, words in _OWN
}
"""The project's own estimators by name."""


def estimators_of(given: Sequence[str | Estimator | Estimate]) -> tuple[Estimator, ...]:
    """Return estimators given by name, as they are, or as functions with their own names.

    Refuses an empty list, an unknown name, an object that cannot be called, or a name twice.
    """
    if isinstance(given, str | Estimator) or callable(given):
        given = [given]
    estimators: dict[str, Estimator] = {}
    for each in given:
        if isinstance(each, str):
            if each not in ESTIMATORS:
                raise FitError(f"estimator '{each}'; {one_of(each, ESTIMATORS)}")
            each = ESTIMATORS[each]
        elif not isinstance(each, Estimator):
            if not callable(each):
                raise FitError(
                    f"estimator {each!r}: cannot be called; valid: {', '.join(ESTIMATORS)}, an "
                    "Estimator, or a function (mechanism, log) -> Fit"
                )
            words = (each.__doc__ or "").strip().partition("\n")[0]
            each = Estimator(getattr(each, "__name__", type(each).__name__), each, words)
        if each.name in estimators:
            raise FitError(f"estimator '{each.name}' is given twice; give each a name of its own")
        estimators[each.name] = each
    if not estimators:
        raise FitError(f"no estimator given; valid: {', '.join(ESTIMATORS)}, or one of your own")
    return tuple(estimators.values())


CHANNELS = ("q", "v", "a", "tau", "wrench")
USUAL = CHANNELS[:4]
SUMS = {"force": "N", "moment": "N m"}  # root sums of squares over all multipliers of a unit
ENDS = 0.02  # share of the log at either end where errors of the multipliers do not count

TrialRows = tuple[list[tuple[Any, ...]], list[tuple[Any, ...]], list[tuple[Any, ...]]]
"""Rows of `MonteCarlo.samples`, `errors` and `failures`."""


def level(x: np.ndarray, snr: float) -> float:
    """Return the standard deviation σ of the noise of x (n,) at a signal-to-noise ratio [dB]."""
    power = float(np.mean(x[np.isfinite(x)] ** 2)) if np.isfinite(x).any() else 0.0
    return float(np.sqrt(power) * 10 ** (-snr / 20))


def noisy_columns(log: Log, channels: Sequence[str]) -> tuple[str, ...]:
    """Return the columns of a log that get noise; refuse an unknown channel, or a log of none."""
    for channel in channels:
        if channel not in CHANNELS:
            raise LogError(f"noise on '{channel}'; {one_of(channel, CHANNELS)}")
    columns = tuple(name for name in log.columns if name.partition(".")[0] in channels)
    if not columns:
        raise LogError(f"{log.name}: no column of {', '.join(channels)}, so there is no noise")
    return columns


def noisy(log: Log, snr: float, columns: Sequence[str], random: np.random.Generator) -> Log:
    """Return the log with noise on some columns; empty cells stay empty."""
    series = dict(log.columns)
    for name in columns:
        x = series[name]
        series[name] = x + level(x, snr) * random.standard_normal(len(x))
    return Log(log.name, series, log.t, log.repairs)


def random_of(seed: int, snr: float, run: int) -> np.random.Generator:
    """Return the generator of one run's noise, which depends on these three numbers alone."""
    decibels = round(1000 * snr)
    key = (2 * abs(decibels) + (decibels < 0), run)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


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
        if not self.multipliers:
            return ()
        t, values = fit.multipliers[0]
        known = np.stack(
            [np.interp(t, self.t, x, left=np.nan, right=np.nan) for x in self.reactions.T], axis=1
        )
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
        try:
            values[name] = float(value)
        except (TypeError, ValueError):
            values[name] = np.nan
        if not np.isfinite(values[name]):
            raise FitError(f"truth of '{name}' {value!r}; valid: a number, finite")
    kinematics = mechanism.kinematics
    names = kinematics.multipliers
    own = f"{log.name} as it is" + (", with free multipliers" if names else "")
    if given and len(given) == len(values):
        words = ["parameters: as given"]
    else:
        words = [f"parameters: of {own}" + (f"; as given: {', '.join(given)}" if given else "")]
    t, true = fit.multipliers[0]
    if reactions is not None:
        known_ones = fit.compare_multipliers(reactions)
        t, true = known_ones.t, known_ones.known
    if names:
        words.append(f"multipliers: of {own if reactions is None else reactions.name}")
    return Truth(values, units, names, kinematics.units, t, true, tuple(words))


@dataclass(frozen=True, eq=False)
class TrialPlan:
    """Everything that the runs of one log have in common."""

    mechanism: Mechanism  # its unknowns are identified
    log: Log  # gets the noise
    estimators: tuple[Estimator, ...]  # applied to the same noise
    truth: Truth  # compared with them
    columns: tuple[str, ...]  # of the log, that get noise
    seed: int  # of all noise

    def log_of(self, snr: float, run: int) -> Log:
        """Return the noisy log of a run."""
        return noisy(self.log, snr, self.columns, random_of(self.seed, snr, run))

    def rows(self, snr: float, run: int) -> TrialRows:
        """Apply every estimator to one draw of the noise."""
        log, truth = self.log_of(snr, run), self.truth
        samples, errors, failures = [], [], []
        for estimator in self.estimators:
            key = (estimator.name, snr, run)
            try:
                fit = estimator.find(self.mechanism, log)
                values = [
                    (*key, name, *_value_and_stderr(fit, name), true, truth.units[name])
                    for name, true in truth.values.items()
                ]
                every = list(
                    zip(truth.multipliers, truth.errors(fit), truth.multiplier_units, strict=True)
                )
            except Exception as error:  # of whatever estimator
                failures.append((*key, line_of(error)))
                continue
            samples += values
            errors += [(*key, *each) for each in every]
            for name, unit in SUMS.items():
                same = [rms for _, rms, its in every if its == unit and np.isfinite(rms)]
                errors += [(*key, name, float(np.linalg.norm(same)), unit)] if same else []
        return samples, errors, failures


def _value_and_stderr(fit: Fit, name: str) -> tuple[float, float]:
    """Return NaN for a value that this fit does not determine."""
    try:
        one = fit[name]
    except KeyError:  # with noise the data may determine other combinations
        return np.nan, np.nan
    if not getattr(one, "identifiable", True):
        return np.nan, np.nan
    return float(one.value), np.nan if one.stderr is None else float(one.stderr)
