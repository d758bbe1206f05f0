"""One run: one draw of the noise, and every estimator on it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ident.errors import IdentError
from ident.fit import Fit
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.montecarlo.estimators import Estimator
from ident.montecarlo.noise import noisy, random_of
from ident.montecarlo.truth import Truth, rms


@dataclass(frozen=True, eq=False)
class Plan:
    """All that a run needs to know.

    Attributes:
        mechanism: its unknowns are identified; log: gets the noise.
        estimators: to be tried on the same noise.
        truth: what they are compared with.
        columns: of the log, that get noise; seed: of all noise.
    """

    mechanism: Mechanism
    log: Log
    estimators: tuple[Estimator, ...]
    truth: Truth
    columns: tuple[str, ...]
    seed: int

    def log_of(self, snr: float, run: int) -> Log:
        """The noisy log of a run."""
        return noisy(self.log, snr, self.columns, random_of(self.seed, snr, run))


@dataclass(frozen=True)
class Outcome:
    """What an estimator made of one run.

    Attributes:
        estimator: its name; snr: [dB]; run: its number.
        values, stderrs: in the order of the truth's; NaN where the run does not determine one.
        errors: of the multipliers, root mean squares; NaN where none is known.
        failure: why there is no fit; empty where there is one.
    """

    estimator: str
    snr: float
    run: int
    values: tuple[float, ...] = ()
    stderrs: tuple[float, ...] = ()
    errors: tuple[float, ...] = ()
    failure: str = ""


def outcomes(plan: Plan, snr: float, run: int) -> Iterator[Outcome]:
    """Of every estimator."""
    log = plan.log_of(snr, run)
    for estimator in plan.estimators:
        try:
            fit = estimator.find(plan.mechanism, log)
            values, stderrs = found(fit, list(plan.truth.values))
            errors = multiplier_errors(fit, plan.truth)
        except (IdentError, np.linalg.LinAlgError) as error:
            yield Outcome(estimator.name, snr, run, failure=str(error) or type(error).__name__)
            continue
        yield Outcome(estimator.name, snr, run, values, stderrs, errors)


def found(fit: Fit, names: Sequence[str]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Values and standard errors by name; NaN for what this fit does not determine."""
    values, stderrs = [], []
    for name in names:
        try:
            one = fit[name]
        except KeyError:  # with noise the data may tell other combinations
            one = None
        known = one is not None and getattr(one, "identifiable", True)
        values.append(one.value if one is not None and known else np.nan)
        error = one.stderr if one is not None and known else None
        stderrs.append(np.nan if error is None else error)
    return tuple(map(float, values)), tuple(map(float, stderrs))


def multiplier_errors(fit: Fit, truth: Truth) -> tuple[float, ...]:
    """Root mean square of identified − true over time, of each multiplier."""
    if not truth.multipliers:
        return ()
    t, values = fit.multipliers[0]
    return tuple(map(float, rms(truth.off(t, values))))
