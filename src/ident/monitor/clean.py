"""What normal running looks like, from a clean log: noise by joint, scatter of scores, smallest
changes that are watched for.

    σ_u² = mean r_u²                     weighs the rows
    x_ref ← x_ref + A⁺ r                 in the directions that the clean log knows well
    φ_k² = MARGIN · max over L of  Σ (Σ_L s_k)² / Σ I_k        block sums of L intervals
    δ_k  = max(FLOOR · φ_k / √ΣI_k,  material · √(Σ τ²/σ² / ΣI_k))

φ is the long-run variance of the scores (their spread, their correlation in time and what is wrong
with the model for a while), 1 for white rows; L up to an eighth of the log. What is normal is what
the clean log shows: the reference is moved there, else its own error, as small as it may be, would
be seen as a change in the long run. δ is so many standard errors of that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.errors import FitError
from ident.monitor.interval import Interval
from ident.solve.factor import Factor

FLOOR = 6.0  # standard errors of the clean log: a smaller change could be its own error
MARGIN = 1.5  # for what a clean log of minutes has not shown yet
BLOCKS = 8  # at least, in the longest sums
FEWEST = 40  # intervals of a clean log
FELT = 1e-6  # of the largest column: a smaller one is felt by nothing
KNOWN = 0.03  # of the largest singular value of unit columns: a direction known less well stays
LEFT = 3.0  # times what is left of a change that has been named: that is no new change


@dataclass(frozen=True, eq=False)
class Clean:
    """Normal running: d coordinates, m multipliers, k columns.

    Attributes:
        sigma: (d,) rms of the residual of each coordinate [N m | N].
        factor: of all rows.
        spread: (k,) φ² of the scores.
        least: (k,) δ, the smallest changes watched for; infinite where nothing is felt.
        energy: (d + m,) mean squares of an interval, 0 where there are none; freedom: (d + m,) ν,
            so that squares over rows and energy scatter like χ²_ν/ν.
    """

    sigma: np.ndarray
    factor: Factor
    spread: np.ndarray
    least: np.ndarray
    energy: np.ndarray
    freedom: np.ndarray

    @classmethod
    def of(
        cls, intervals: Sequence[Interval], sigma: np.ndarray, x: np.ndarray, material: float
    ) -> Clean:
        """From the intervals of a clean log, `FEWEST` or more.

        Args:
            intervals: of the clean log; sigma: (d,) by which rows were weighed.
            x: (k,) the reference.
            material: share of the torques that a change must be.
        """
        factor = Factor.merge([each.factor for each in intervals])
        s = np.array([each.score(x) for each in intervals])
        norm = factor.column_norms()
        felt = norm > FELT * norm.max(initial=0.0)
        total = np.where(felt, norm**2, 1.0)
        lengths = np.unique(np.geomspace(1, len(s) // BLOCKS, 8).astype(int))
        spread = np.max([_block_variance(s, total, int(n)) for n in lengths], axis=0)
        spread = MARGIN * np.maximum(spread, 1.0)
        torque = sum(each.torque for each in intervals)
        least = np.sqrt(np.maximum(FLOOR**2 * spread, material**2 * torque) / total)
        squares, rows = (np.array([getattr(e, n) for e in intervals]) for n in ("squares", "rows"))
        energy = squares.sum(axis=0) / np.maximum(rows.sum(axis=0), 1)
        each = squares / (np.maximum(rows, 1) * np.where(energy > 0, energy, 1.0))
        freedom = 2.0 / np.maximum(each.var(axis=0, ddof=1), 1e-3) / MARGIN
        return cls(sigma, factor, spread, np.where(felt, least, np.inf), energy, freedom)

    @property
    def typical(self) -> float:
        """φ² of a typical column."""
        felt = np.isfinite(self.least)
        return float(np.median(self.spread[felt])) if felt.any() else MARGIN

    def wider(self, factor: float) -> Clean:
        """Normal running that scatters more."""
        return replace(
            self,
            spread=factor * self.spread,
            least=factor**0.5 * self.least,
            freedom=self.freedom / factor,
        )

    def moved(
        self, places: np.ndarray, root: np.ndarray, since: Sequence[Interval], x: np.ndarray
    ) -> Clean:
        """Normal running after a change has been made part of the reference.

        Its error, seen as a change of column k, is I_k,g θ̃ / I_kk; and what it does not explain
        is normal from now on.

        Args:
            places: (g,) columns that changed; root: (g, r) of their covariance.
            since: intervals since the change; x: (k,) the reference now.
        """
        R, rest = self.factor.R, Factor.merge([each.factor for each in since])
        own = np.maximum((R**2).sum(axis=0), 1e-300)
        error = np.linalg.norm((R.T @ R[:, places]) @ root, axis=1) / own
        left = np.abs(rest.gradient(x)) / np.maximum((rest.R**2).sum(axis=0), 1e-300)
        least = np.sqrt(self.least**2 + (FLOOR * error) ** 2 + (LEFT * left) ** 2)
        return replace(self, least=least)

    def worse(self, since: Sequence[Interval], x: np.ndarray, remains: float) -> Clean:
        """Normal running with something in it that nothing explains.

        Args:
            since: intervals that have it; x: (k,) the reference now.
            remains: mean square of what is left, 1 in normal running.
        """
        here = Clean.of(since, self.sigma, x, 0.0)
        return replace(
            self,
            spread=np.maximum(self.spread, here.spread),
            least=np.maximum(self.least, here.least),
            energy=self.energy * max(remains, 1.0),
            freedom=np.minimum(self.freedom, here.freedom),
        )


def check_long_enough(intervals: Sequence[Interval]) -> None:
    """Refuse a clean log of a few intervals.

    Raises:
        FitError: saying how many it has, and how many are needed.
    """
    if len(intervals) < FEWEST:
        raise FitError(
            f"normal running: {len(intervals)} intervals; valid: {FEWEST} or more, better a "
            "thousand: give longer logs, or shorter intervals"
        )


def settled(factor: Factor, x: np.ndarray) -> np.ndarray:
    """(k,) the reference x moved to where the clean log has it, as far as it knows.

    Args:
        factor: of the clean log's weighted rows.
        x: (k,) the reference as it was identified.
    """
    size = factor.column_norms()
    safe = np.where(size > FELT * size.max(initial=0.0), size, np.inf)
    U, s, Vt = np.linalg.svd(factor.R / safe)
    known = s > KNOWN * s[0]
    return x + Vt[known].T @ ((U[:, known].T @ (factor.d - factor.R @ x)) / s[known]) / safe


def _block_variance(s: np.ndarray, total: np.ndarray, length: int) -> np.ndarray:
    """(k,) Σ (Σ_L s)² / Σ I over the blocks of some length; all s together add up to zero."""
    whole = len(s) // length
    sums = s[: whole * length].reshape(whole, length, -1).sum(axis=1)
    return (sums**2).sum(axis=0) / total * (len(s) / (whole * length)) / (1 - 1 / whole)
