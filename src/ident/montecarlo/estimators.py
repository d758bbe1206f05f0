"""Estimators: how a log is completed and how the fit is made, as one callable with a name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np

from ident.errors import FitError, one_of
from ident.fit import Fit, identify
from ident.log import Log
from ident.mechanism.mechanism import Mechanism, Multipliers
from ident.motion import complete

SAMPLES = 5  # between the paper's hats, where the mechanism has no time basis: 5 ms of its 1 ms

Find = Callable[[Mechanism, Log], Fit]


@dataclass(frozen=True)
class Estimator:
    """A way from a log to a fit.

    Attributes:
        name: in tables and pictures.
        find: (mechanism, log) → fit.
        words: what it does, in a line.
    """

    name: str
    find: Find
    words: str = ""


@dataclass(frozen=True)
class Free:
    """`complete` as it comes, `identify` with free multipliers, whatever basis the mechanism has.

    Attributes:
        options: of `identify`.
    """

    options: Mapping[str, Any] = field(default_factory=dict)

    def __call__(self, mechanism: Mechanism, log: Log) -> Fit:
        """The fit of a log."""
        model = on_basis(mechanism, Multipliers())
        return identify(model, complete(model, log), **self.options)


@dataclass(frozen=True)
class Paper:
    """All channels as logged, unfiltered; multipliers in hats, solved with the parameters (eq. 8).

    Attributes:
        spacing: of the hats [s]; None: the mechanism's own time basis, else 5 samples.
    """

    spacing: float | None = None

    def __call__(self, mechanism: Mechanism, log: Log) -> Fit:
        """The fit of a log."""
        model = on_basis(mechanism, self.basis(mechanism, log))
        motion = complete(model, log, smoothing=None, cutoff=None)
        return identify(model, motion, estimator="least-squares")

    def basis(self, mechanism: Mechanism, log: Log) -> Multipliers:
        """Of λ(t)."""
        if self.spacing is not None:
            return Multipliers("linear", self.spacing)
        if mechanism.multipliers.degree > 0:
            return mechanism.multipliers
        return Multipliers("linear", SAMPLES * float(np.median(np.diff(log.t))))


def paper(spacing: float | None = None) -> Estimator:
    """The paper's method (sect. 2, eq. 8).

    Args:
        spacing: of the hats [s]; None: the mechanism's own time basis, else 5 samples.

    Raises:
        FitError: for a spacing that is no positive number.
    """
    if spacing is not None and not (np.isfinite(spacing) and spacing > 0):
        raise FitError(f"spacing {spacing!r} s of the hats; valid: above 0, as 0.005")
    words = "channels as logged, multipliers in a time basis, plain least squares"
    return Estimator("paper", Paper(spacing), words)


_ALL = (
    paper(),
    Estimator(
        "default",
        Free(),
        "smoothing and filter; noise of the motion in one step of the likelihood where it matters",
    ),
    Estimator(
        "least-squares", Free({"estimator": "least-squares"}), "smoothing and filter, least squares"
    ),
    Estimator(
        "likelihood",
        Free({"estimator": "likelihood"}),
        "torques and motion weighed together until nothing changes (--refine)",
    ),
    Estimator("consistent", Free({"consistent": True}), "default, bodies and friction possible"),
)

ESTIMATORS: Mapping[str, Estimator] = MappingProxyType({each.name: each for each in _ALL})
"""The project's own, by name."""


def chosen(given: Sequence[str | Estimator | Find]) -> tuple[Estimator, ...]:
    """Estimators by name, as they are, or of plain callables under their own names.

    Raises:
        FitError: for none, an unknown name, what cannot be called, or one name twice.
    """
    if isinstance(given, str) or callable(given) or isinstance(given, Estimator):
        given = [given]
    found = [_estimator(each) for each in given]
    names = [each.name for each in found]
    if not found:
        raise FitError(f"no estimator given; valid: {', '.join(ESTIMATORS)}, or one of your own")
    for name in names:
        if names.count(name) > 1:
            raise FitError(f"estimator '{name}' is given twice; give each a name of its own")
    return tuple(found)


def _estimator(given: str | Estimator | Find) -> Estimator:
    if isinstance(given, Estimator):
        return given
    if isinstance(given, str):
        if given not in ESTIMATORS:
            raise FitError(f"estimator '{given}'; {one_of(given, ESTIMATORS)}")
        return ESTIMATORS[given]
    if not callable(given):
        raise FitError(
            f"estimator {given!r}: cannot be called; valid: {', '.join(ESTIMATORS)}, an Estimator, "
            "or a function (mechanism, log) -> Fit"
        )
    words = (getattr(given, "__doc__", None) or "").strip().partition("\n")[0]
    return Estimator(getattr(given, "__name__", type(given).__name__), given, words)


@lru_cache(maxsize=8)
def on_basis(mechanism: Mechanism, multipliers: Multipliers) -> Mechanism:
    """With another basis of λ; one object for all runs, so that functions are compiled once."""
    if mechanism.multipliers == multipliers:
        return mechanism
    return replace(mechanism, multipliers=multipliers)
