"""The charts: how much likelier each change makes what was seen, summed since it could have begun.

    of a parameter   ℓ = (δ s − δ² I/2) / φ²                     of a change δ from the reference
    of an error      ℓ = ν/2 ((1 − 1/c) e − log c)               of a variance c times the clean one
    R ← (1 + R) exp ℓ,      alarm where Σ w R ≥ A

R is the Shiryaev-Roberts statistic; as long as E exp ℓ ≤ 1 in normal running, given all that was
before, Σ w R − n is a supermartingale for any weights of sum 1, so that the mean time to a false
alarm is at least A intervals, however many charts there are and however they depend on each other
(Pollak, Ann. Stat. 13(1), 1985; mixtures: Shin, Ramdas, Rinaldo, New England J. Stat. Data Sci.
2(2), 2024). Of scores that are alike from interval to interval a long-run φ² makes that hold about,
not exactly: what lasts as long as the log that φ² was learnt from alarms more often. The onset
is where the cumulative sum of the leading chart was last at zero (Page, Biometrika 41, 1954).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.monitor.clean import Clean
from ident.monitor.interval import Interval

SIZES = 2.0 ** np.arange(6)  # times the least change watched for
RATIOS = np.array([3.0, 9.0, 27.0])  # c: noise may grow by a third and is no fault
CLIP = 4.0  # standard deviations beyond which a score counts no more
PARAMETERS = 0.75  # weight of all charts of parameters; the rest is for errors


@dataclass(frozen=True, eq=False)
class Statistics:
    """What charts take of intervals (…): score, information (…, k); squares, rows (…, d + m)."""

    score: np.ndarray
    information: np.ndarray
    squares: np.ndarray
    rows: np.ndarray

    @classmethod
    def of(cls, intervals: Sequence[Interval], x: np.ndarray) -> Statistics:
        """Of some intervals (n,) at the reference x (k,)."""
        return cls(
            np.array([each.score(x) for each in intervals]),
            np.array([each.information for each in intervals]),
            np.array([each.squares for each in intervals]),
            np.array([each.rows for each in intervals]),
        )


@dataclass(frozen=True, eq=False)
class Design:
    """What the charts of a clean reference look for.

    Attributes:
        clean: normal running.
        mask: (k,) columns that have charts.
        delta: (signs · sizes, k) changes; weight: (charts,) of all, parameters' first.
    """

    clean: Clean
    mask: np.ndarray
    delta: np.ndarray
    weight: np.ndarray

    @classmethod
    def of(cls, clean: Clean, mask: np.ndarray) -> Design:
        """Charts of the columns `mask` (k,) that are felt, and of all errors that there are."""
        use, errors = mask & np.isfinite(clean.least), clean.energy > 0
        delta = np.concatenate([SIZES, -SIZES])[:, None] * np.where(use, clean.least, 0.0)
        weight = [np.broadcast_to(PARAMETERS * _even(use) / len(delta), delta.shape)]
        shape = (len(RATIOS), len(errors))
        weight += [np.broadcast_to((1 - PARAMETERS) * _even(errors) / len(RATIOS), shape)]
        return cls(clean, mask, delta, np.concatenate([each.ravel() for each in weight]))

    def evidence(self, seen: Statistics) -> np.ndarray:
        """ℓ (…, charts) of intervals."""
        clean, info = self.clean, seen.information
        most = CLIP * np.sqrt(clean.spread * info)
        s = np.clip(seen.score, -most, most)[..., None, :]
        change = (self.delta * s - 0.5 * self.delta**2 * info[..., None, :]) / clean.spread
        usual = seen.rows * clean.energy
        e = np.where(usual > 0, seen.squares / np.where(usual > 0, usual, 1.0), 1.0)
        e = np.minimum(e, 1 + CLIP * np.sqrt(2 / clean.freedom))[..., None, :]
        c = RATIOS[:, None]
        error = 0.5 * clean.freedom * ((1 - 1 / c) * e - np.log(c))
        flat = [x.reshape(*x.shape[:-2], -1) for x in (change, error)]
        return np.concatenate(flat, axis=-1)

    def about(self, chart: int) -> tuple[int | None, int | None]:
        """The column, or else the error, that a chart is about."""
        if chart < self.delta.size:
            return chart % self.delta.shape[1], None
        return None, (chart - self.delta.size) % len(self.clean.energy)


def _even(use: np.ndarray) -> np.ndarray:
    return use / max(int(use.sum()), 1)


@dataclass(eq=False)
class Charts:
    """The running state of all charts, of one stream or of several beside each other.

    Attributes:
        log_R: (…, charts); total: (…, charts) cumulative sums G; since: (…, charts) intervals
            since G was last at zero.
    """

    log_R: np.ndarray
    total: np.ndarray
    since: np.ndarray

    @classmethod
    def fresh(cls, charts: int, streams: tuple[int, ...] = ()) -> Charts:
        """Nothing seen yet."""
        shape = (*streams, charts)
        return cls(np.full(shape, -np.inf), np.zeros(shape), np.zeros(shape, dtype=int))

    def update(self, evidence: np.ndarray) -> None:
        """One interval's ℓ (…, charts)."""
        self.log_R = np.logaddexp(0.0, self.log_R) + evidence
        self.total = np.maximum(self.total + evidence, 0.0)
        self.since = np.where(self.total > 0, self.since + 1, 0)

    def restart(self, which: np.ndarray) -> None:
        """Forgets everything in the streams of a mask (streams,)."""
        self.log_R[which], self.total[which], self.since[which] = -np.inf, 0.0, 0

    def height(self, weight: np.ndarray) -> np.ndarray:
        """log Σ w R (…,)."""
        most = self.log_R.max(axis=-1, keepdims=True)
        most = np.where(np.isfinite(most), most, 0.0)
        return most[..., 0] + np.log(np.exp(self.log_R - most) @ weight + 1e-300)

    def leader(self, weight: np.ndarray) -> int:
        """The chart that has the most of Σ w R, of one stream."""
        return int((self.log_R + np.log(weight + 1e-300)).argmax())
