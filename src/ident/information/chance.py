"""What chance does: noise with the spectra of a residual, quantiles, differences of blocks.

Source of the series: Theiler et al., Testing for nonlinearity in time series, Physica D 58, 1992.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import exp
from statistics import NormalDist

import numpy as np

from ident.information.triangle import Array

SMOOTH = 9  # frequencies over which power is averaged: noise has no lines
EVERYWHERE = 0.75  # share of alpha for the null of all places together; the rest: by place
LEAST = 0.05  # the least share: where nearly all is lost, nothing is known of the noise


def surrogates(
    r: Array, runs: Sequence[slice], count: int, random: np.random.Generator,
    remaining: Sequence[Array] = (),
) -> Array:  # fmt: skip
    """Series (N, d, count) that have the smooth spectra of r (N, d) and nothing else, in single
    precision.

    Each run of equal steps is mirrored at its end, so that its two ends meet, and its phases are
    turned at random, in all coordinates alike: correlations between them stay. The power is the
    mean of neighbouring frequencies: lines are of the motion, not of the noise.

    Args:
        runs: rows without a gap.
        remaining: by run, the share (frequencies, d) of its power that is left of r, from
            `remaining_power`; what was lost is given back.
    """
    found = np.zeros((*r.shape, count), dtype=np.float32)
    for i, run in enumerate(runs):
        n = run.stop - run.start
        if n < 2:
            continue
        F = _transformed(r[run])
        share = _smooth(remaining[i]) if remaining else 1.0
        size = np.abs(F)
        F *= np.sqrt(_smooth(size**2) / share) / np.maximum(size, np.finfo(np.float32).tiny)
        turn = np.exp(2j * np.pi * random.random((len(F), 1, count))).astype(np.complex64)
        turn[0] = np.sign(random.standard_normal((1, count)))
        found[run] = np.fft.irfft(F.astype(np.complex64)[:, :, None] * turn, 2 * n, axis=0)[:n]
    return found


def remaining_power(left: Array, whole: Array) -> Array:
    """Return the share (frequencies, d) of the power of series (n, d, count) that is left of them,
    averaged over the series.
    """
    if len(left) < 2:
        return np.ones((1, left.shape[1]))
    one, other = ((np.abs(_transformed(x)) ** 2).sum(axis=2) for x in (left, whole))
    return np.asarray(np.clip(one / np.maximum(other, np.finfo(np.float32).tiny), LEAST, 1.0))


def _smooth(x: Array) -> Array:
    from scipy.ndimage import uniform_filter1d  # takes 0.1 s to import

    return np.asarray(uniform_filter1d(x, SMOOTH, axis=0))


def _transformed(x: Array) -> np.ndarray:
    """Spectrum (n + 1, ...) of a run x (n, ...) that is mirrored at its end."""
    return np.fft.rfft(np.concatenate([x, x[::-1]]), axis=0)


def quantile(chance: Array, alpha: float) -> float:
    """The (1 − alpha) quantile of shares (draws,), each the largest gain of a draw.

    z = ln g/(1 − g) above its median m is close to normal, and its spread s is known better than
    the largest of a hundred draws:

        s² = mean (z − m)² over z > m        ln g_α/(1 − g_α) = m + s Φ⁻¹(1 − α)
    """
    m, s = _tail(chance)
    if not np.isfinite(m):  # no gain at all in most draws
        return float(np.quantile(chance, 1 - alpha, method="higher")) if len(chance) else 0.0
    return 1 / (1 + exp(-m - s * NormalDist().inv_cdf(1 - alpha)))


def exceeding(gain: float, chance: Array) -> float:
    """Chance that the largest gain of a draw exceeds a gain, both as shares; see `quantile`."""
    m, s = _tail(chance)
    if not (np.isfinite(m) and s > 0 and gain > np.median(chance)):
        return float((1 + (chance >= gain).sum()) / (1 + len(chance))) if len(chance) else np.nan
    return 1 - NormalDist(m, s).cdf(float(_logit(np.array(gain))))


@dataclass(frozen=True, eq=False)
class Chance:
    """The largest gains where nothing is missing, each as a share of the squares of its draw.

    Two nulls share alpha. Surrogates of the whole residual are judged by the place where candidates
    act, one coordinate or several, so that a joint with slow noise does not hide what others show;
    where something large is missing, they have its power too. Surrogates of what the best candidate
    leaves have not; what that takes of noise is the smaller the more places are looked at together.

    Attributes:
        whole: by place, of surrogates of the residual (draws,).
        left: at all places, of surrogates of what the best candidate leaves (draws,).
        noise: by place, of draws of the sensors' noise (draws,).
        alpha: chance that any gain exceeds its limit.
        elsewhere: the limit of all places, where nothing was drawn.
    """

    whole: Mapping[int, Array]
    left: Array
    noise: Mapping[int, Array]
    alpha: float
    elsewhere: float = 0.0

    @cached_property
    def limits(self) -> dict[int, float]:
        """What a gain must exceed at each place."""
        n = max(len(self.whole), 1)
        left, a = quantile(self.left, EVERYWHERE * self.alpha), (1 - EVERYWHERE) * self.alpha / n
        return {
            u: max(min(quantile(x, a), left), quantile(self.noise[u], self.alpha / n))
            for u, x in self.whole.items()
        }

    def limit(self, place: int) -> float:
        """What a gain at a place must exceed; of a place without candidates the largest limit."""
        return self.limits.get(place, max(self.limits.values(), default=self.elsewhere))

    def p(self, gain: float, place: int) -> float:
        """Chance that such a gain is exceeded at any place; NaN without draws."""
        if place not in self.whole:
            return np.nan
        n = len(self.whole)
        found = min(
            n * exceeding(gain, self.whole[place]) / (1 - EVERYWHERE),
            exceeding(gain, self.left) / EVERYWHERE,
        )
        noise = self.noise[place]
        # where most draws bring no gain there is no tail: beyond all of them, as the limit says
        if len(noise) and (np.median(noise) > 0 or gain <= noise.max()):
            found = max(found, n * exceeding(gain, noise))
        return min(1.0, found)


def _tail(chance: Array) -> tuple[float, float]:
    """Median m and spread s above it of ln g/(1 − g); NaN where no gain is the median."""
    if not len(chance) or np.median(chance) <= 0:
        return np.nan, np.nan
    z = _logit(chance)
    m = float(np.median(z))
    return m, float(np.sqrt(np.mean((z[z >= m] - m) ** 2)))


def _logit(g: Array) -> Array:
    g = np.clip(g, 1e-12, 1 - 1e-12)
    return np.log(g / (1 - g))


def odds_ratio(gain: float, limit: float) -> float:
    """Odds g/(1 − g) of a gain over those of another one, both as shares: explained over left."""
    one, other = (x / max(1 - x, 1e-12) for x in (gain, limit))
    return one / max(other, 1e-12)


def paired(a: Array, b: Array) -> float:
    """Standard errors of paired blocks by which squares b (blocks,) are lower than a: of the
    differences, or of the differences of the logarithms, the larger.
    """
    tiny = 1e-12 * max(float(a.sum()), float(b.sum())) + 1e-300
    return max(zscore(a - b), zscore(np.log((a + tiny) / (b + tiny))))


def zscore(D: Array) -> float:
    """Mean over standard error of differences (blocks,); 0 where nothing differs."""
    spread = float(D.std(ddof=1)) / np.sqrt(len(D)) if len(D) > 1 else 0.0
    return float(D.mean()) / spread if spread > 0 else 0.0
