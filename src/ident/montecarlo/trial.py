"""One trial: a draw of white noise on a log, and every estimator's fit beside the truth.

    x + σ ε,  ε ~ N(0, 1) a sample,    σ = rms(x) · 10^(−SNR / 20)

The signal's power includes its mean, as in MATLAB's awgn(x, snr, 'measured'); the paper gives its
ratios without a definition.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ident.errors import FitError, LogError, line_of, one_of
from ident.fit import Fit
from ident.fit.values import BaseValue, Value
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.montecarlo.estimators import Estimator, with_free_multipliers

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
        if not any(name in reactions for name in names):
            column = next(iter(reactions.columns), "t")
            raise FitError(f"{reactions.name}: no column is a multiplier; {one_of(column, names)}")
        t, nothing = reactions.t, np.full(len(reactions.t), np.nan)
        true = np.stack([reactions.columns.get(name, nothing) for name in names], axis=1)
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
