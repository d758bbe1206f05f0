"""The rows that decide on a fit's candidates, and the fall of error counted in them.

loss(B, u) = Σ e²/σ_u² in block B, held out      fall = 1 − Σ w_u loss₁ / Σ w_u loss₀
w_u = 1 / Σ (τ_u/σ_u)²: joints weigh by their measured torque, as on the ladder of `grow`
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.diagnose.evidence import torque_squares
from ident.diagnose.quiet import quiet
from ident.diagnose.screen import Screen
from ident.explore.kept import Kept, Store
from ident.fit import Fit


@dataclass(frozen=True, eq=False)
class Ground:
    """A fit with its rows, the model projected out of those that are away from reversals."""

    fit: Fit
    table: Kept
    screen: Screen

    @classmethod
    def of(cls, fit: Fit, store: Store) -> Ground:
        """Of a fit; its columns are looked up in `store` first."""
        table = Kept.of_fit(fit, store)
        return cls(fit, table, Screen.of(table, quiet(table), fit.worth, fit.estimate.held))

    @property
    def weight(self) -> np.ndarray:
        """w (d,); 0 for a joint without torque."""
        torque = torque_squares(self.table, self.screen)
        return np.where(torque > 0, 1.0 / np.where(torque > 0, torque, 1.0), 0.0)

    def difference(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """D (blocks,) of losses (blocks, d)."""
        return (before - after) @ self.weight

    def fall(self, after: np.ndarray) -> tuple[float, float]:
        """Of the model's own losses to others (blocks, d), and its standard error over blocks."""
        total = float((self.screen.loss @ self.weight).sum())
        D = self.difference(self.screen.loss, after)
        if total <= 0 or len(D) < 2:
            return 0.0, 0.0
        return float(D.sum() / total), float(D.std(ddof=1) * np.sqrt(len(D)) / total)

    def without(self, held: np.ndarray) -> np.ndarray:
        """(blocks, d) losses with further unknowns (k,) held where they are without data."""
        return Screen.same_rows(self.screen, self.table, self.fit.estimate.held | held).loss

    def delivered(self, after: Ground) -> float | None:
        """The fall to another model, in the same rows and weights; None if its rows are others."""
        mine, other = self.table, after.table
        if len(mine.t) != len(other.t) or not np.array_equal(mine.sample, other.sample):
            return None
        loss = Screen.same_rows(self.screen, other, after.fit.estimate.held).loss
        return self.fall(loss)[0]
