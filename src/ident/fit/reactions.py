"""Identified multipliers beside reactions that are known, from a simulation or load cells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ident.errors import FitError, one_of
from ident.fit.plots import plot_multipliers
from ident.log import Log
from ident.show.charts import Chart
from ident.text import table

if TYPE_CHECKING:
    from ident.fit.fit import Fit


@dataclass(frozen=True, eq=False)
class Reactions:
    """Known reactions and what the identified multipliers miss them by.

    Attributes:
        fit: whose first experiment they belong to.
        t: (n,) [s]; known: (n, m), NaN where nothing is known.
        off: (n, m) identified − known.
    """

    fit: Fit
    t: np.ndarray
    known: np.ndarray
    off: np.ndarray

    def __str__(self) -> str:
        kinematics = self.fit.mechanism.kinematics
        rows = [["multiplier", "rms of it", "rms error", "largest error"]]
        for i, (name, unit) in enumerate(
            zip(kinematics.multipliers, kinematics.units, strict=True)
        ):
            if not np.isfinite(self.off[:, i]).any():
                continue
            size, rms = (float(np.sqrt(np.nanmean(x[:, i] ** 2))) for x in (self.known, self.off))
            worst = float(np.nanmax(np.abs(self.off[:, i])))
            rows.append([name, f"{size:.4g} {unit}", f"{rms:.3g} {unit}", f"{worst:.3g} {unit}"])
        return "\n".join(["multipliers against known reactions", *table(rows)])

    def plot(self) -> Chart:
        """λ(t) identified over λ(t) known."""
        t, values = self.fit.multipliers[0]
        return plot_multipliers(
            self.fit.mechanism, t, values, (self.t, self.known), self.fit.motion.experiments[0].name
        )


def compare_multipliers(fit: Fit, reactions: Log) -> Reactions:
    """Multipliers of the first experiment against a log of known reactions on its clock.

    Args:
        fit: of a mechanism with closures.
        reactions: columns named as the multipliers are, [N | N m].

    Raises:
        FitError: if no column is a multiplier of this mechanism.
    """
    names = fit.mechanism.kinematics.multipliers
    if not any(name in reactions for name in names):
        column = next(iter(reactions.columns), "t")
        raise FitError(f"{reactions.name}: no column is a multiplier; {one_of(column, names)}")
    t, values = fit.multipliers[0]
    known = np.full((len(reactions.t), len(names)), np.nan)
    off = known.copy()
    for i, name in enumerate(names):
        if name not in reactions:
            continue
        known[:, i] = reactions.columns[name]
        found = np.interp(reactions.t, t, values[:, i], left=np.nan, right=np.nan)
        off[:, i] = found - known[:, i]
    return Reactions(fit, reactions.t, known, off)
