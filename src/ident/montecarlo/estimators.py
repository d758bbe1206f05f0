"""Estimators: functions from a mechanism and a log to a fit, with a name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np

from ident.errors import FitError, one_of
from ident.fit import Fit, identify
from ident.log import Log
from ident.mechanism.mechanism import Mechanism, Multipliers
from ident.motion import complete

SAMPLES = 5  # between the paper's hat functions without a time basis: 5 ms of its 1 ms samples

Estimate = Callable[[Mechanism, Log], Fit]


@dataclass(frozen=True)
class Estimator:
    """A function from a log to a fit, with a name.

    Attributes:
        name: in tables and charts.
        find: (mechanism, log) → fit.
        words: description in one line.
    """

    name: str
    find: Estimate
    words: str = ""


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
