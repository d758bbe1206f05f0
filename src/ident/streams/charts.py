"""Control charts: how much likelier each change makes the rows, summed since it could have begun.

    of a parameter   ℓ = (δ s − δ² I/2) / φ²                     of a change δ from the reference
    of an error      ℓ = ν/2 ((1 − 1/c) e − log c)               of a variance c times normal
    R ← (1 + R) exp ℓ,      alarm where Σ w R ≥ A

R is the Shiryaev-Roberts statistic; as long as E exp ℓ ≤ 1 in normal running, given all that was
before, Σ w R − n is a supermartingale for any weights of sum 1, so that the mean time to a false
alarm is at least A intervals, however many charts there are and however they depend on each other
(Pollak, Ann. Stat. 13(1), 1985; mixtures: Shin, Ramdas, Rinaldo, New England J. Stat. Data Sci.
2(2), 2024). Of scores that are alike from interval to interval a long-run φ² makes that hold about,
not exactly: what lasts as long as the log of normal running alarms more often. The onset is where
the cumulative sum of the leading chart was last at zero (Page, Biometrika 41, 1954).

An interval of time is one triangle of all coordinates' rows, each divided by its σ:

    score  s = Aᵀ(b − A x),  information  I_k = |A_k|²,  squares  Σ r_u²

Normal running is what a log of it shows, and the reference is moved there, since its own error
would be seen as a change in the long run. Changes are watched for from δ_k on:

    σ_u² = mean r_u²                                                   weighs the rows
    φ_k² = MARGIN · max over L of  Σ (Σ_L s_k)² / Σ I_k                block sums of L intervals
    δ_k  = max(FLOOR · φ_k / √ΣI_k,  material · √(Σ τ²/σ² / ΣI_k))
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ident.equations.rows import Rows
from ident.information import linear
from ident.information.evidence import BEYOND
from ident.information.linear import Triangle

SIZES = 2.0 ** np.arange(6)  # times the least change watched for
RATIOS = np.array([3.0, 9.0, 27.0])  # c: noise may grow by a third and is no fault
CLIP = 4.0  # level: standard deviations beyond which a score counts no more
PARAMETERS = 0.75  # range: weight of all charts of parameters; the rest is for errors
FLOOR = 6.0  # level: standard errors of the normal log: a smaller change could be its own error
MARGIN = 1.5  # tuned: for what a log of minutes has not shown yet
BLOCKS = 8  # work: at least, in the longest sums, and drawn from a log
FEWEST = 40  # work: intervals of a log of normal running
USUAL = 0.5  # level: of the rows that an interval usually has; one with fewer is left out
FELT = 1e-5  # numerics: of the largest column, singular value or component: less is no effect
KNOWN = 0.03  # tuned: of unit columns' largest singular value: what is known less well stays
STREAMS, STEPS = 20, 2000  # work: simulated beside each other, and intervals of each
OFTEN = 20.0  # work: alarms that a calibration has at the stated rate, at a lower threshold
WIDER, MOST_STEPS = 1.15, 12  # work: factor of φ² a step, and steps


@dataclass(frozen=True, eq=False)
class WatchedInterval:
    """The rows of one interval of time that inform, weighted."""

    start: float
    end: float  # start, end: first and last row [s]
    triangle: Triangle  # of [A | b] over all coordinates, each divided by its σ
    squares: np.ndarray  # (d,) of residuals over σ
    rows: np.ndarray  # (d,) of how many rows
    torque: float  # sum of squares of the measured torques over σ²

    @classmethod
    def of(cls, rows: Rows, sigma: np.ndarray, x: np.ndarray) -> WatchedInterval:
        """Absorb some rows; sigma (d,) weighs them, the residual is that of x (k,)."""
        weight = np.where(rows.informed, 1.0 / sigma, 0.0)
        informed = rows.informed.ravel()
        A = (rows.A * weight[:, :, None]).reshape(-1, rows.A.shape[2])
        return cls(
            start=float(rows.t[0]),
            end=float(rows.t[-1]),
            triangle=Triangle.of(A[informed], (rows.b * weight).ravel()[informed]),
            squares=(((rows.b - rows.A @ x) * weight) ** 2).sum(axis=0),
            rows=rows.informed.sum(axis=0),
            torque=float(((rows.tau * weight) ** 2).sum()),
        )


class Cutter:
    """Cuts rows at multiples of `seconds`; holds the rows of the interval that is not over yet."""

    def __init__(self, seconds: float) -> None:
        self._seconds, self._usual = seconds, 0
        self.waiting: list[Rows] = []

    def cut(self, rows: Rows, last: bool = False) -> Iterator[Rows]:
        """Yield the rows of intervals that are over, if about as many as usual; `last`: all are."""
        rows = Rows.concatenated([*self.waiting, rows])
        edges = np.flatnonzero(np.diff(np.floor(rows.t / self._seconds))) + 1
        intervals = [rows[a:b] for a, b in pairwise([0, *edges, len(rows)])]
        self.waiting = [] if last else [intervals.pop()]
        for interval in intervals:
            self._usual = max(self._usual, len(interval))
            if len(interval) >= USUAL * self._usual:
                yield interval


def intervals_of(
    rows: Sequence[Rows], seconds: float, sigma: np.ndarray, x: np.ndarray
) -> list[WatchedInterval]:
    """Cut rows into intervals of so many seconds; sigma (d,) weighs them, x (k,) the reference."""
    cutter = Cutter(seconds)
    parts = (part for portion in rows for part in cutter.cut(portion, portion is rows[-1]))
    return [WatchedInterval.of(part, sigma, x) for part in parts]


@dataclass(frozen=True, eq=False)
class NormalRunning:
    """Normal running: d coordinates, k columns."""

    sigma: np.ndarray  # (d,) rms of the residual of each coordinate [N m | N]
    triangle: Triangle  # of all rows
    spread: np.ndarray  # (k,) φ² of the scores
    least: np.ndarray  # (k,) δ, smallest changes watched for; ∞ where a column has no effect
    energy: np.ndarray  # (d,) mean squares of an interval, 0 where there are none
    freedom: np.ndarray  # (d,) ν, so that squares over rows and energy scatter like χ²_ν/ν

    @classmethod
    def of(
        cls, intervals: Sequence[WatchedInterval], sigma: np.ndarray, x: np.ndarray,
        material: float, felt: np.ndarray | bool = True,
    ) -> NormalRunning:  # fmt: skip
        """Learn normal running from `FEWEST` intervals or more; felt (k,): see `felt_columns`."""
        triangle = Triangle.merge([i.triangle for i in intervals])
        s = np.array([i.triangle.gradient(x) for i in intervals])
        norm = triangle.column_norms()
        felt = felt & (norm > 0)
        total = np.where(felt, norm**2, 1.0)
        lengths = np.unique(np.geomspace(1, len(s) // BLOCKS, 8).astype(int))
        spread = np.max([_block_variance(s, total, int(n)) for n in lengths], axis=0)
        spread = MARGIN * np.maximum(spread, 1.0)
        torque = sum(i.torque for i in intervals)
        least = np.sqrt(np.maximum(FLOOR**2 * spread, material**2 * torque) / total)
        squares, rows = (np.array([getattr(e, n) for e in intervals]) for n in ("squares", "rows"))
        _, fitted = moved_reference(triangle, x, felt)  # numbers of x: other rows leave more
        free = max(1.0 - fitted / max(triangle.rows, 1), 0.5)
        energy = squares.sum(axis=0) / np.maximum(free * rows.sum(axis=0), 1)
        i = squares / (np.maximum(rows, 1) * np.where(energy > 0, energy, 1.0))
        freedom = 2.0 / np.maximum(i.var(axis=0, ddof=1), 1e-3) / MARGIN
        return cls(sigma, triangle, spread, np.where(felt, least, np.inf), energy, freedom)

    @property
    def typical(self) -> float:
        """φ² of a typical column."""
        felt = np.isfinite(self.least)
        return float(np.median(self.spread[felt])) if felt.any() else MARGIN

    def beyond_error(self, R: np.ndarray, r: np.ndarray) -> float:
        """Return min |r − R δ|² + |A_n δ|², in which δ (k,) is the reference's own error."""
        felt = np.isfinite(self.least)
        both = np.vstack([R[:, felt], self.triangle.R[:, felt]])
        size = np.linalg.norm(both, axis=0)
        rest = np.append(r, np.zeros(len(self.triangle.R)))
        delta, _ = linear.lstsq(both / size, rest, FELT)
        return float(np.sum((rest - both / size @ delta) ** 2))

    def after_change(
        self, places: np.ndarray, root: np.ndarray, since: Sequence[WatchedInterval], x: np.ndarray
    ) -> NormalRunning:
        """Return normal running after a change has been made part of the reference: its error, seen
        as a change of column k, is I_k,g θ̃ / I_kk, and what it does not explain is normal now.
        """
        R, rest = self.triangle.R, Triangle.merge([interval.triangle for interval in since])
        information = np.maximum((R**2).sum(axis=0), 1e-300)
        error = np.linalg.norm((R.T @ R[:, places]) @ root, axis=1) / information
        remaining = np.abs(rest.gradient(x)) / np.maximum((rest.R**2).sum(axis=0), 1e-300)
        least = np.sqrt(self.least**2 + (FLOOR * error) ** 2 + (BEYOND * remaining) ** 2)
        return replace(self, least=least)

    def worse(
        self, since: Sequence[WatchedInterval], x: np.ndarray, remains: float,
        known: Sequence[WatchedInterval],
    ) -> NormalRunning:  # fmt: skip
        """Return normal running with something in it that nothing explains, by what the squares of
        the intervals `known` with the change have grown, or else all do.
        """
        now = NormalRunning.of(since, self.sigma, x, 0.0, np.isfinite(self.least))
        grown = np.full(len(self.energy), remains)
        if known:
            usual = np.sum([interval.rows for interval in known], axis=0) * self.energy
            grown = np.sum([interval.squares for interval in known], axis=0) / np.maximum(
                usual, 1e-300
            )
        return replace(
            self,
            spread=np.maximum(self.spread, now.spread),
            least=np.maximum(self.least, now.least),
            energy=self.energy * np.maximum(grown, 1.0),
            freedom=np.minimum(self.freedom, now.freedom),
        )


def _block_variance(s: np.ndarray, total: np.ndarray, length: int) -> np.ndarray:
    """(k,) Σ (Σ_L s)² / Σ I over the blocks of some length; all s together add up to zero."""
    blocks = len(s) // length
    sums = s[: blocks * length].reshape(blocks, length, -1).sum(axis=1)
    return (sums**2).sum(axis=0) / total * (len(s) / (blocks * length)) / (1 - 1 / blocks)


def felt_columns(triangle: Triangle, units: Sequence[str]) -> np.ndarray:
    """(k,) columns that have an effect: sizes compare within a unit only."""
    size, unit = triangle.column_norms(), np.array(units)
    largest = np.array([size[unit == name].max() for name in unit])
    return size > np.maximum(FELT * largest, np.finfo(float).eps * size.max(initial=0.0))


def moved_reference(
    triangle: Triangle, x: np.ndarray, felt: np.ndarray | bool = True
) -> tuple[np.ndarray, int]:
    """Move the reference x (k,) to where normal running has it, x + A⁺ (b − A x), in the directions
    that it knows well; return how many those are too.
    """
    size = triangle.column_norms()
    safe = np.where(felt & (size > 0), size, np.inf)
    step, rank = linear.lstsq(triangle.R / safe, triangle.d - triangle.R @ x, KNOWN)
    return x + step / safe, rank


def statistics(intervals: Sequence[WatchedInterval], x: np.ndarray) -> tuple[np.ndarray, ...]:
    """Collect score, information (n, k), squares, rows (n, d) of intervals at x (k,)."""
    values = [
        (i.triangle.gradient(x), (i.triangle.R**2).sum(axis=0), i.squares, i.rows)
        for i in intervals
    ]
    return tuple(np.array(columns) for columns in zip(*values, strict=True))


@dataclass(frozen=True, eq=False)
class Design:
    """Changes that the charts detect, from normal running."""

    normal: NormalRunning
    mask: np.ndarray  # (k,) columns that have charts
    delta: np.ndarray  # (signs · sizes, k) changes
    weight: np.ndarray  # (charts,) of all, parameters' first

    @classmethod
    def of(cls, normal: NormalRunning, mask: np.ndarray) -> Design:
        """Design charts of the columns `mask` (k,) that have an effect, and of all errors."""
        use, errors = mask & np.isfinite(normal.least), normal.energy > 0
        delta = np.concatenate([SIZES, -SIZES])[:, None] * np.where(use, normal.least, 0.0)
        parts = [(PARAMETERS, use, len(delta)), (1 - PARAMETERS, errors, len(RATIOS))]
        weight = [
            np.broadcast_to(
                share * charted / max(int(charted.sum()), 1) / count, (count, len(charted))
            )
            for share, charted, count in parts
        ]
        return cls(normal, mask, delta, np.concatenate([w.ravel() for w in weight]))

    def evidence(
        self, score: np.ndarray, info: np.ndarray, squares: np.ndarray, rows: np.ndarray
    ) -> np.ndarray:
        """Return ℓ (…, charts) of the `statistics` score, info, squares, rows of intervals."""
        normal = self.normal
        most = CLIP * np.sqrt(normal.spread * info)
        s = np.clip(score, -most, most)[..., None, :]
        change = (self.delta * s - 0.5 * self.delta**2 * info[..., None, :]) / normal.spread
        usual = rows * normal.energy
        e = np.where(usual > 0, squares / np.where(usual > 0, usual, 1.0), 1.0)
        e = np.minimum(e, 1 + CLIP * np.sqrt(2 / normal.freedom))[..., None, :]
        c = RATIOS[:, None]
        error = 0.5 * normal.freedom * ((1 - 1 / c) * e - np.log(c))
        flat = [x.reshape(*x.shape[:-2], -1) for x in (change, error)]
        return np.concatenate(flat, axis=-1)

    def subjects(self, columns: Sequence[str], errors: Sequence[str]) -> list[str]:
        """Return what each chart is about, from the names of columns (k,) and errors (d,)."""
        return [*columns] * len(self.delta) + [f"error of {name}" for name in errors] * len(RATIOS)


@dataclass(eq=False)
class Charts:
    """The running state of all charts, of one stream or of several beside each other."""

    log_R: np.ndarray  # (…, charts)
    total: np.ndarray  # (…, charts) cumulative sums G
    since: np.ndarray  # (…, charts) intervals since G was last at zero

    @classmethod
    def fresh(cls, charts: int, streams: tuple[int, ...] = ()) -> Charts:
        """Return charts before the first interval."""
        shape = (*streams, charts)
        return cls(np.full(shape, -np.inf), np.zeros(shape), np.zeros(shape, dtype=int))

    def update(self, evidence: np.ndarray) -> None:
        """Add one interval's ℓ (…, charts)."""
        self.log_R = np.logaddexp(0.0, self.log_R) + evidence
        self.total = np.maximum(self.total + evidence, 0.0)
        self.since = np.where(self.total > 0, self.since + 1, 0)

    def restart(self, which: np.ndarray) -> None:
        """Forget everything in the streams of a mask (streams,)."""
        self.log_R[which], self.total[which], self.since[which] = -np.inf, 0.0, 0

    def height(self, weight: np.ndarray) -> np.ndarray:
        """Return log Σ w R (…,)."""
        most = self.log_R.max(axis=-1, keepdims=True)
        most = np.where(np.isfinite(most), most, 0.0)
        return most[..., 0] + np.log(np.exp(self.log_R - most) @ weight + 1e-300)

    def leader(self, weight: np.ndarray) -> int:
        """Return the chart that has the most of Σ w R, of one stream."""
        return int((self.log_R + np.log(weight + 1e-300)).argmax())


def calibrated(
    normal: NormalRunning, mask: np.ndarray, intervals: Sequence[WatchedInterval], x: np.ndarray
) -> tuple[Design, int]:
    """Raise φ² until charts keep their rate on normal running, drawn again in blocks of the log,
    which keep its tails and its correlation. Return the charts, and their alarms at a threshold so
    low that `OFTEN` of them are stated.
    """
    data, random = statistics(intervals, x), np.random.default_rng(0)
    length = len(intervals) // BLOCKS
    first = random.integers(0, len(intervals) - length + 1, (-(-STEPS // length), 1, STREAMS))
    order = (first + np.arange(length)[:, None]).reshape(-1, STREAMS)[:STEPS]
    threshold, raised = float(np.log(STEPS * STREAMS / OFTEN)), 1.0
    for _ in range(MOST_STEPS):
        wider = {"spread": raised * normal.spread, "least": raised**0.5 * normal.least}
        wide = replace(normal, freedom=normal.freedom / raised, **wider)
        design, alarms = Design.of(wide, mask), 0
        evidence = design.evidence(*data)
        charts = Charts.fresh(evidence.shape[1], (STREAMS,))
        for at in order:
            charts.update(evidence[at])
            alarmed = charts.height(design.weight) > threshold
            alarms += int(alarmed.sum())
            charts.restart(alarmed)
        if alarms <= OFTEN:
            break
        raised *= WIDER
    return design, alarms
