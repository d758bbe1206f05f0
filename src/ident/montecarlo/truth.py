"""What estimates are compared with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ident.errors import FitError, one_of
from ident.fit import Fit
from ident.fit.values import BaseValue, Value
from ident.log import Log
from ident.mechanism.mechanism import Mechanism
from ident.montecarlo.estimators import Free

ENDS = 0.02  # share of the log at either end where errors of the multipliers do not count


@dataclass(frozen=True, eq=False)
class Truth:
    """True values, given or of the log without noise.

    Attributes:
        values, units: by name of parameters, effects' parameters and base parameters.
        multipliers: their names; multiplier_units: [N | N m].
        t: (n,) [s]; reactions: (n, m), NaN where nothing is known.
        words: where values and reactions are from.
    """

    values: Mapping[str, float]
    units: Mapping[str, str]
    multipliers: tuple[str, ...]
    multiplier_units: tuple[str, ...]
    t: np.ndarray
    reactions: np.ndarray
    words: tuple[str, ...]

    def off(self, t: np.ndarray, found: np.ndarray) -> np.ndarray:
        """found − true (n, m) at times t (n,), NaN outside what is known and near the ends."""
        known = np.stack(
            [np.interp(t, self.t, x, left=np.nan, right=np.nan) for x in self.reactions.T], axis=1
        )
        margin = ENDS * (t[-1] - t[0])
        inside = (t >= t[0] + margin) & (t <= t[-1] - margin)
        return np.where(inside[:, None], found - known, np.nan)

    def sizes(self) -> np.ndarray:
        """(m,) rms of the true multipliers; NaN of one that is not known."""
        return rms(self.reactions)


def rms(x: np.ndarray) -> np.ndarray:
    """(m,) root mean square over the samples (n, m) that are known."""
    count = np.isfinite(x).sum(axis=0)
    total = np.nansum(x**2, axis=0)
    return np.sqrt(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def truth_of(
    mechanism: Mechanism,
    log: Log,
    given: Mapping[str, float] | None = None,
    reactions: Log | None = None,
) -> Truth:
    """Values of the fit of the log itself, with free multipliers; those that are given instead.

    Raises:
        FitError: for a name that is no parameter, a value that is no number, reactions of which
            none is a multiplier, or a log that identifies nothing.
    """
    fit = Free()(mechanism, log)
    values, units = _identified(fit)
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
            raise FitError(f"truth of '{name}' {value!r}; valid: a number") from None
        if not np.isfinite(values[name]):
            raise FitError(f"truth of '{name}' {value!r}; valid: a finite number")
    kinematics = mechanism.kinematics
    own = f"{log.name} as it is" + (", with free multipliers" if kinematics.multipliers else "")
    if given and len(given) == len(values):
        words = ["parameters: as given"]
    else:
        words = [f"parameters: of {own}" + (f"; as given: {', '.join(given)}" if given else "")]
    t, found = fit.multipliers[0]
    if reactions is not None:
        t, found = reactions.t, _known(mechanism, reactions)
    if kinematics.multipliers:
        words.append(f"multipliers: of {own if reactions is None else reactions.name}")
    return Truth(
        values, units, kinematics.multipliers, kinematics.units, t, found, tuple(words)
    )  # fmt: skip


def _identified(fit: Fit) -> tuple[dict[str, float], dict[str, str]]:
    """Values and units of all that the data determine, by name."""
    own = [value for value in fit.parameters if value.identifiable]
    own += [
        value
        for each in fit.effects
        for value in each.parameters
        if value.identifiable and value.name in fit.columns.names
    ]
    combined = [value for value in fit.base_parameters if " " in value.name]
    every: list[Value | BaseValue] = [*own, *combined]
    return {v.name: v.value for v in every}, {v.name: v.unit for v in every}


def _known(mechanism: Mechanism, reactions: Log) -> np.ndarray:
    """Reactions (n, m) of a log whose columns are named as the multipliers are."""
    names = mechanism.kinematics.multipliers
    if not any(name in reactions for name in names):
        column = next(iter(reactions.columns), "t")
        raise FitError(f"{reactions.name}: no column is a multiplier; {one_of(column, names)}")
    nothing = np.full(len(reactions.t), np.nan)
    return np.stack([reactions.columns.get(name, nothing) for name in names], axis=1)
