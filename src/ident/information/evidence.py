"""The rule of evidence: when a cause that explains a residual is believed, and what it may be else.

A cause is whatever explains what a model leaves: an effect, a curve or a law, a fault of a channel
or of the motion, a difference of one log from the others, a change since normal running or from
some time of a log on. Its own columns, right-hand sides or states are those of its engine; what
follows is the same for all. Of time k that was left out of its fit it leaves l_k, without it l⁰_k
remain (squares over the noise, or −2 log density, which are one number for normal errors):

    gain      G = Σ_k (l⁰_k − l_k), or as a share g = 1 − exp(−G/N) of N rows
    z         mean over standard error of the paired differences over blocks k; where the noise is
              known G / 2d, d the distance of both predictions in units of it

    credible  1. it explains more of what was left out than the best of so many causes would by
                 chance: of residuals in which nothing is missing (`Chance`), of H that are all
                 untrue (`surely_t`), or in all the time that is watched (a threshold of charts)
              2. what it explains is large enough to matter
              3. what it claims to explain it does not leave
              4. it can be: values, bodies, rivals of another kind
    rivals    other ones that are less than `RIVAL` standard errors behind
    simplest  of those within `PARSIMONY` of the best gain the one with the fewest numbers
    apart     a motion shows two apart if the distance d of their predictions, everything else
              refitted, makes z = d/2 exceed `RIVAL` in spite of its own scatter of one

Sources: z of two models of which neither contains the other: Vuong, Econometrica 57(2), 1989; the
largest gain of many on surrogates: Westfall, Young, Resampling-Based Multiple Testing, 1993.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import exp, log
from numbers import Real
from statistics import NormalDist
from typing import TypeVar

import numpy as np

from ident.errors import FitError
from ident.information.estimate import MATERIAL
from ident.information.linear import Array
from ident.information.student import tail_quantile

ALPHA = 0.01  # level: chance that anything is named where nothing is missing, wrong or changed
RIVAL = 2.0  # level: standard errors of a paired difference within which two are rivals
NEGATIVE = 2.0  # level: standard errors from zero at which a value has a sign
# level: standard errors that are no accident: of a sign that cannot be, of what is asked for again
# and again as time passes
CERTAIN = 3.0
# level: by how many standard errors a planned log is to show more than RIVAL: 93 in 100 logs do
POWER_SE = 1.5
TOLD_APART_SE = 2 * (RIVAL + POWER_SE)  # level: distance of two rivals that are told apart
APART_SE = 1.0  # level: the same from which a longer log tells them apart
# level: share of what one cause predicts, up to which another one can do it in its place where
# sizes are unknown, as a sine; its cosine is 0.999
SAME_SHARE = 0.045
# level: the same where sizes are known, up to which the columns are the same: of more a distance
# in standard errors says whether two are apart
SAME_COLUMNS = 0.003
SURROGATES = 100  # work: random series with the spectrum of the residual
NOISY = 1.5  # level: times the noise of the sensors, in good logs 0.5 to 1.3, from which it is more
EXCESS = 1.25  # tuned: times a noise or an error, from which something is more than that
# tuned: share of what is explained, or left, that is worth no further number and no name
PARSIMONY = 0.1
# level: share of what is to be explained, in squares or of an error as it is said, less of which no
# main cause explains
MAIN_CAUSE = 0.5
MATTERS = 0.05  # tuned: share of an error or of its squares, from which its cause is reported
# tuned: times what is known (a noise, a named change), beyond which there is more; residuals of
# good logs are 0.5 to 1.3 times the sensors' noise
BEYOND = 3.0
# tuned: relative error at which nothing is explained: no cause or closure leaves it
EXPLAINED_BELOW = 0.3
# tuned: times the error that all effects of the library leave: what takes their place leaves no
# more (with 1.25 a wrong gravity has no name any more: tests/mistakes)
AS_WELL = 1.5
LEAST_ERROR = 1e-6  # numerics: relative error below which a fit is exact
TINY = 1e-300  # numerics: of a chance: no logarithm of zero
DIFFERENT = 1e-9  # numerics: of squares, up to which two differ by rounding alone
SHARE_ROUNDING = 1e-12  # numerics: of a share, from one

Candidate = TypeVar("Candidate")


# --- the rule ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Decision:
    """The three arguments of the rule of evidence."""

    alpha: float = ALPHA  # chance that anything is credible where nothing is missing
    material: float = MATERIAL  # share of a joint's torque that an effect must have to matter
    rival_se: float = RIVAL  # standard errors of the paired difference within which two are rivals

    def __post_init__(self) -> None:
        """Refuse what is no chance, no share, or below what the random residuals can show."""
        least = 1 / SURROGATES
        for name, number in vars(self).items():
            if not isinstance(number, Real):
                raise FitError(f"{name} = {number!r}: is no number; valid: 0.01, for one")
        if not least <= self.alpha <= 0.5:
            raise FitError(
                f"alpha = {self.alpha:g}: {SURROGATES} random residuals show chances from "
                f"{least:g}; valid: {least:g} to 0.5"
            )
        if not 0 <= self.material < 1:
            raise FitError(
                f"material = {self.material:g}: is no share of a joint's torque; valid: 0 to below "
                "1, such as 0.003"
            )
        if not 0 <= self.rival_se < np.inf:
            raise FitError(
                f"rival_se = {self.rival_se:g}: valid: 0 or more standard errors, such as 2"
            )

    def matters(self, before: Array | float, after: Array | float, torque: Array | float) -> bool:
        """Whether squares (d,) fall by more than the share `material` of the torque's somewhere."""
        return bool(np.any(np.subtract(before, after) > self.material**2 * np.asarray(torque)))

    def __str__(self) -> str:
        return f"alpha {self.alpha:g}, material {self.material:g}, rival-se {self.rival_se:g}"


def credible(
    gain: float, chance: float, *, size: float = np.inf, least: float = 0.0,
    remaining: float = 0.0, most: float = np.inf, possible: bool = True,
) -> bool:  # fmt: skip
    """Return whether a cause is believed; see the head of this file.

    Args:
        gain: what it explains of time that was left out, and `chance`, which it must exceed: what
            the best of so many untrue causes explains. Both are shares, standard errors over
            blocks, or logarithms of a likelihood or of a chance.
        size: how much it explains, and `least`, more than which matters.
        remaining: what it leaves of what it claims to explain, and `most`, which that is at most.
        possible: whether there can be such a cause, and no other one stands for it.
    """
    return bool(possible and gain > chance and size > least and remaining <= most)


def surprise(p: float) -> float:
    """−log of a chance, as a gain: a cause must surprise by more than `surprise(ALPHA)`."""
    return -log(max(p, TINY))


def leaves_as_little(errors: Array, others: Array) -> bool:
    """Return whether a cause leaves relative errors (d,) hardly larger than those that other causes
    together leave, of which each has numbers of its own: geometric means, within `AS_WELL`.
    """
    ratios = np.maximum(errors, LEAST_ERROR) / (AS_WELL * np.maximum(others, LEAST_ERROR))
    return bool(np.log(ratios).mean() < 0)


def rivals_of(
    best: Candidate, others: Sequence[Candidate], behind: Callable[[Candidate], float],
    within: float = RIVAL,
) -> list[Candidate]:  # fmt: skip
    """Return other causes that are less than `within` standard errors behind the best one."""
    return [other for other in others if other is not best and behind(other) < within]


def nearly_best(gains: Sequence[float] | Array) -> np.ndarray:
    """Return which causes (n,) explain as much as the best one but for `PARSIMONY` of it."""
    every = np.asarray(gains, dtype=float)
    return every >= (1 - PARSIMONY) * every.max(initial=0.0)


# --- standard errors by which one is better ------------------------------------------------------


def paired(a: Array, b: Array) -> float:
    """Standard errors of paired blocks by which squares b (blocks,) are lower than a: of the
    differences, or of the differences of the logarithms, the larger; 0 where they differ by
    rounding, as those of equal columns do.
    """
    a = np.where(np.abs(a - b) > DIFFERENT * np.maximum(a, b), a, b)
    tiny = 1e-12 * max(float(a.sum()), float(b.sum())) + 1e-300
    return max(zscore(a - b), zscore(np.log((a + tiny) / (b + tiny))))


def zscore(D: Array) -> float:
    """Mean over standard error of differences (blocks,); 0 where nothing differs."""
    spread = float(D.std(ddof=1)) / np.sqrt(len(D)) if len(D) > 1 else 0.0
    return float(D.mean()) / spread if spread > 0 else 0.0


def surely_t(hypotheses: int, blocks: int) -> float:
    """Standard errors that the best of untrue hypotheses exceeds with chance ALPHA (Bonferroni)."""
    return tail_quantile(ALPHA / hypotheses, blocks - 1)


def zscore_in_noise(gain: float, distance: float) -> float:
    """Standard errors of a gain over another cause where the noise is known: the gain has twice the
    distance of both predictions, in units of the noise, as its standard error. Of predictions that
    are nearly the same the gain alone counts.
    """
    return gain / (2.0 * max(distance, 1.0))


# --- what chance explains -------------------------------------------------------------------------


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
    if not (np.isfinite(m) and gain > np.median(chance)):
        return float((1 + (chance >= gain).sum()) / (1 + len(chance))) if len(chance) else np.nan
    above = float(_logit(np.array(gain))) - m
    return 1 - NormalDist().cdf(above / s) if s > 0 else 0.0  # draws that do not differ


@dataclass(frozen=True, eq=False)
class Chance:
    """The largest gains where nothing is missing, by the place where candidates act: one coordinate
    or several, so that a joint with slow noise does not hide what others show.
    """

    residual: Mapping[int, Array]  # (draws,) of surrogates of it: of what is missing, too
    noise: Mapping[int, Array]  # (draws,) of the sensors' noise
    alpha: float  # chance that any gain exceeds its limit
    elsewhere: float = 0.0  # the limit of all places, where nothing was drawn

    @cached_property
    def limits(self) -> dict[int, float]:
        """What a gain must exceed at each place."""
        a = self.alpha / max(len(self.residual), 1)
        return {
            u: max(quantile(x, a), quantile(self.noise[u], a)) for u, x in self.residual.items()
        }

    def limit(self, place: int) -> float:
        """What a gain at a place must exceed; of a place without candidates the largest limit."""
        return self.limits.get(place, max(self.limits.values(), default=self.elsewhere))

    def largest(self, other: Chance) -> Chance:
        """Return the chance of both kinds of candidates, from the same draws."""

        def maxima(one: Mapping[int, Array], two: Mapping[int, Array]) -> dict[int, Array]:
            common = {u: np.maximum(one[u], two[u]) for u in {*one} & {*two}}
            return {**one, **two, **common}

        residual, noise = (maxima(self.residual, other.residual), maxima(self.noise, other.noise))
        return Chance(residual, noise, self.alpha, self.elsewhere)

    def p(self, gain: float, place: int) -> float:
        """Chance that such a gain is exceeded at any place; NaN without draws."""
        if place not in self.residual:
            return np.nan
        p, noise = exceeding(gain, self.residual[place]), self.noise[place]
        # where most draws bring no gain there is no tail: beyond all of them, as the limit says
        if len(noise) and (np.median(noise) > 0 or gain <= noise.max()):
            p = max(p, exceeding(gain, noise))
        return min(1.0, len(self.residual) * p)


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


def limit_by_coordinate(chance: Chance, gain: float, place: int, shares: Array) -> float:
    """Return what a gain at a place is held against.

    What acts on several coordinates may show in one of them far beyond chance, while the others
    dilute its share of all rows: then the limit is below the gain by as much as the limit of that
    coordinate is below its share (d,), in odds g/(1 − g).
    """
    limit = chance.limit(place)
    own_shares = [
        (x, place + 1 + u) for u, x in enumerate(shares) if place + 1 + u in chance.residual
    ]
    if not (own_shares and gain > 0 and limit > 0):
        return limit
    ratio = max(odds_ratio(x, chance.limit(at)) for x, at in own_shares)
    if ratio <= odds_ratio(gain, limit):
        return limit
    odds = gain / max(1 - gain, SHARE_ROUNDING) / ratio
    return odds / (1 + odds)
