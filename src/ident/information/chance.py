"""What chance does to estimates: standard errors, held-out errors, noise with given spectra.

Neighbouring residuals are alike (filters, unmodelled physics), so rows are no independent
witnesses. Blocks of time nearly are: the delete-one-block jackknife

    δ_b = (H − H_b)⁻¹ g_b,   H = Σ AᵀA / σ²,   g_b = A_bᵀ(b_b − A_b x) / σ²
    cov = (B − 1)/B · Σ_b [δ_b δ_bᵀ + Σ_l w_l (δ_b δ_{b+l}ᵀ + δ_{b+l} δ_bᵀ)]

is the CR3 estimate of Bell and McCaffrey (Survey Methodology 28(2), 2002), with Bartlett weights
w_l = 1 − l/(L + 1) for blocks that are still alike; L follows from how alike they are (Andrews,
Econometrica 59(3), 1991, eq. 6.2 and 6.4). A window cuts off what lasts longer. Where a parameter's
neighbouring δ_b are clearly alike, its variance is averaged with what a first-order autoregression
has in the long run, which errs in the other direction (prewhitening: Andrews, Monahan, Econometrica
60(4), 1992):

    Σ_b (δ_b − ρ δ_{b−1})² / (1 − ρ)²

It is a variance from few squares: ν of them, if those of equal blocks are counted as one each
(Satterthwaite). Its t-distribution is ν/(ν − 2) times as wide, and that is what is returned: value
± 2 standard errors covers the truth in 95 of 100 logs.

`held_out`: errors of the predicted torque in stretches of time that were left out of the fit.

Source of series with the spectra of a residual: Theiler et al., Testing for nonlinearity in time
series, Physica D 58, 1992; resampled: Rubin, The Bayesian bootstrap, Annals of Statistics 9, 1981.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import accumulate, groupby
from operator import add, attrgetter

import numpy as np

from ident.information import linear
from ident.information.blocks import Information, Squares
from ident.information.estimate import Estimate, estimate
from ident.information.gamma import digamma, trigamma
from ident.information.left_out import LeftOut
from ident.information.linear import Array, Triangle

# level: standard errors of no correlation beyond which neighbouring blocks are alike
CORRELATED = 1.3
LASTING = 0.8  # tuned: the most by which a block is believed to resemble the one before
FEWEST_EQUATIONS = 3.0  # level: equations a parameter below which values follow the noise
FEWEST_SQUARES = 3.0  # level: ν below which the t-distribution's width means nothing
MANY_SQUARES = 100.0  # level: ν beyond which it is no wider than a normal distribution
# numerics: of the largest share that noise has in a variance: a smaller one is rounding
OF_LARGEST = 1e-10
SQUARES_APART = 1e-12  # numerics: of ν: a smaller step of its search is the last

Times = Sequence[tuple[int, int]]  # (log, block)


def covariance(
    information: Information, estimate: Estimate, blocks: LeftOut | None = None
) -> Array:
    """Return the covariance (n_ind, n_ind) of the base parameters; NaN for a single block.

    `blocks`: of both, where they are made already.
    """
    size, times = estimate.base.rank, information.times
    if not size or len(times) < 2:
        return np.full((size, size), np.nan)
    blocks = blocks or LeftOut.of(information, estimate)
    deltas, shares = blocks.deltas
    total, nu = long_run(information.neighbours, deltas, shares)
    wider = np.sqrt(nu / (nu - 2))
    result = total * np.outer(wider, wider)
    # what only one block determines has no spread between blocks; white residuals are the least
    least = blocks.white_covariance
    if any(block.resting for block in information) and information.neighbours != information.times:
        return _at_least(result, least)
    return np.asarray(result + np.diag(np.maximum(np.diag(least - result), 0.0)))


def moderated_covariance(information: Information, estimate: Estimate, white: Array) -> Array:
    """Return what noise of rows makes of an estimate (n_ind, n_ind) that rests on a prior too.

    Few blocks determine most of its worst directions, so the scatter of blocks is a variance s_i²
    from few squares ν_i, and leaving one out exaggerates. `white` w_i, the covariance by noise that
    is the same all the time, is a second opinion, from many squares. Both are averaged by their
    squares ν, of a prior that the s_i²/w_i of all parameters make together,

        v_i = (ν₀ s₀² w_i + ν_i s_i²)/(ν₀ + ν_i)
        log s₀² = mean e,  ψ'(ν₀/2) = var e − mean ψ'(ν_i/2)
        e_i = log s_i²/w_i − ψ(ν_i/2) + log ν_i/2

    (moderated variances: Smyth, Stat. Appl. Genet. Mol. Biol. 3(1), 2004), and no less than w_i.
    Blocks' changes are (I − G)^(−1/2) h, unbiased if rows are white (CR2: Bell, McCaffrey 2002).
    Parameters of which the prior alone tells have w_i of rounding, and no part in this.
    """
    blocks, w = LeftOut.of(information, estimate, with_prior=True), np.diag(white)
    by_noise = w / estimate.solution.C.diagonal()
    by_rows = by_noise > OF_LARGEST * by_noise.max(initial=0.0)
    if len(blocks.times) < 2 or not by_rows.any():
        return white
    changes, shares = (x[:, by_rows] for x in blocks.unbiased_changes)
    total, nu = long_run(information.neighbours, changes, shares)
    count, w = len(blocks.times), w[by_rows]
    ratio = np.maximum(np.diag(total) * count / (count - 1) / w, np.finfo(float).tiny)
    e = np.log(ratio) - digamma(nu / 2) + np.log(nu / 2)
    common = max(float(np.exp(np.mean(e))), 1.0)
    nu_common = _squares_of_spread(float(np.var(e) - np.mean(trigamma(nu / 2))))
    squares = nu_common + nu
    variance = np.maximum((nu_common * common + nu * ratio) / squares, 1.0)
    wider = np.ones(len(white))
    wider[by_rows] = np.sqrt(variance * squares / (squares - 2))
    return np.asarray(white * np.outer(wider, wider))


def _squares_of_spread(spread: float) -> float:
    """Return ν with ψ'(ν/2) = `spread`, the variance of the logarithm of a mean of ν squares, from
    FEWEST_SQUARES to MANY_SQUARES.
    """
    if spread <= trigamma(MANY_SQUARES / 2):
        return MANY_SQUARES
    if spread >= trigamma(FEWEST_SQUARES / 2):
        return FEWEST_SQUARES
    low, high = FEWEST_SQUARES, MANY_SQUARES
    while high - low > SQUARES_APART * high:
        middle = np.sqrt(low * high)
        low, high = (middle, high) if trigamma(middle / 2) > spread else (low, middle)
    return float(low)


def _at_least(covariance: Array, least: Array) -> Array:
    """Return a covariance (n, n) that is in no direction less than `least`."""
    L = np.linalg.cholesky(least + np.finfo(float).eps * np.diag(np.diag(least)))
    values, V = np.linalg.eigh(np.linalg.solve(L, np.linalg.solve(L, covariance).T))
    wide = L @ V
    return np.asarray((wide * np.maximum(values, 1.0)) @ wide.T)


def prior_covariance(estimate: Estimate, plausible: Array) -> Array:
    """Return what the priors of held unknowns add to the covariance (n_ind, n_ind).

    An unknown δ that is held may be off its prior by its plausible (k,) distance, as far as the
    rows do not contradict that, and then moves the base parameters:

        Cov(δ) = (L² + P⁻²)⁻¹        L = A_held − A_I K, K = (A_IᵀA_I)⁻¹ A_Iᵀ A_held, P = plausible
        K Cov(δ) Kᵀ

    Of a shape that is held because its linear step leaves its bounds the rows know more than P.
    """
    R, fixed, base = estimate.triangle.R, estimate.fixed, estimate.base.independent
    if not fixed.any():
        return np.zeros((estimate.base.rank,) * 2)
    columns = R[:, fixed] * plausible[fixed]
    response = linear.lstsq(R[:, base], columns, rcond=None)[0]
    new_part = columns - R[:, base] @ response
    known = np.linalg.inv(np.eye(new_part.shape[1]) + new_part.T @ new_part)
    return np.asarray(response @ known @ response.T)


def scores(
    information: Information, estimate: Estimate, norm: Array
) -> tuple[list[tuple[int, int]], Array, Array]:
    """Return (log, block), H_b (B, n_ind, n_ind) and g_b (B, n_ind) for columns divided by `norm`
    (n_ind,), at an estimate that these rows need not be all of.
    """
    size, times = len(norm), information.times
    number = {time: b for b, time in enumerate(times)}
    place = np.full(information.k, -1)
    place[estimate.base.independent] = np.arange(size)
    H_blocks, g_blocks = np.zeros((len(times), size, size)), np.zeros((len(times), size))
    for block in information:
        if not block.triangle.rows:
            continue
        rows = block.triangle.stack() / estimate.sigma[block.coordinate]
        inside = place[block.support] >= 0
        at, b = place[block.support][inside], number[block.log, block.block]
        r = rows[:, -1] - rows[:, :-1] @ estimate.x[block.support]
        A = rows[:, :-1][:, inside] / norm[at]
        H_blocks[b][np.ix_(at, at)] += A.T @ A
        g_blocks[b][at] += r @ A
    return times, H_blocks, g_blocks


def long_run(times: Times, deltas: Array, shares: Array) -> tuple[Array, Array]:
    """Return the covariance (m, m) of m numbers from their changes δ, `deltas` (B, m), when one
    block is left out, and the number of squares ν (m,) that it rests on; `shares` (B, m): of the
    variance, by block, if residuals were white.
    """
    tiny = np.finfo(float).tiny
    size = np.maximum((deltas**2).sum(axis=0), tiny)
    one, other = _pairs(times, 1)
    correlation = (deltas[one] * deltas[other]).sum(axis=0) / size
    total, squares = deltas.T @ deltas, (shares**2).sum(axis=0)
    rho = np.clip(correlation, -0.97, 0.97)
    alpha = np.mean(4 * rho**2 / ((1 - rho) ** 6 * (1 + rho) ** 2)) / np.mean((1 - rho) ** -4.0)
    lags = int(np.clip(1.1447 * np.cbrt(alpha * len(times)), 1, max(1, len(times) // 4)))
    for lag in range(1, lags + 1):  # filtered blocks touch: one at least
        a, b = _pairs(times, lag)
        weight = 1 - lag / (lags + 1)
        cross = deltas[a].T @ deltas[b]
        total += weight * (cross + cross.T)
        squares += 2 * weight**2 * (shares[a] * shares[b]).sum(axis=0)
    nu = np.maximum(shares.sum(axis=0) ** 2 / np.maximum(squares, tiny), FEWEST_SQUARES)
    window = np.maximum(np.diag(total), tiny)
    rho = np.clip(correlation, 0.0, LASTING)
    new = ((deltas[other] - rho * deltas[one]) ** 2).sum(axis=0)
    autoregression = len(times) / max(len(one), 1) * new / (1 - rho) ** 2
    lasting = np.where(correlation > CORRELATED / np.sqrt(len(times)), autoregression, window)
    wider = np.sqrt(0.5 + 0.5 * lasting / window)
    return (len(times) - 1) / len(times) * total * np.outer(wider, wider), nu


def _pairs(times: Times, lag: int) -> tuple[list[int], list[int]]:
    """Return the places of the blocks of one log that are `lag` apart."""
    first = [i for i in range(len(times) - lag) if times[i][0] == times[i + lag][0]]
    return first, [i + lag for i in first]


FOLDS = 10  # work
ZERO_ERROR = 1e-9  # numerics: of the torque, below which an error is none


def rise(after: Squares, before: Squares) -> float:
    """Return the rise of the error: √ of the mean over coordinates of (after / before)², less 1."""
    sums = after.counted, before.counted
    new, old = (np.maximum(error, ZERO_ERROR**2 * torque) for error, torque, _ in sums)
    ratios = new[old > 0] / old[old > 0]
    return float(np.sqrt(ratios.mean()) - 1) if len(ratios) else 0.0


def folds(information: Information, stretches: int) -> dict[int, Information]:
    """Part the blocks by log and stretch of time, `each` stretches a log."""
    parted = dict[int, dict]()
    for number, (_, of_log) in enumerate(groupby(information, attrgetter("log"))):
        blocks = [*of_log]  # of one log, as keys are in order
        first, last = min(b.span[0] for b in blocks), max(b.span[1] for b in blocks)
        for block in blocks:
            share = (sum(block.span) / 2 - first) / max(last - first, 1e-300)
            stretch = min(int(share * stretches), stretches - 1)
            parted.setdefault(number * stretches + stretch, {})[block.key] = block
    return {number: replace(information, blocks=blocks) for number, blocks in parted.items()}


def held_out(
    fitting: Information,
    scoring: Information,
    fitted: Estimate,
    prior: Array,
    refit: Callable[[Estimate], Array] | None = None,
    left_out: LeftOut | None = None,
) -> Squares | None:
    """Return errors in each stretch of the rows `scoring` of the model fitted to all other rows
    `fitting`, with the weights of `fitted`; None for one stretch. `refit`: what follows from the
    estimate of the other stretches, (k,); by default as it is. `left_out`: of `fitting` and
    `fitted`, where it is made already.
    """
    both = fitting, scoring
    logs = {log for information in both for log in information.logs}
    blocks = (
        len({b.block for b in information.of_log(log)})
        for information in both
        for log in information.logs
    )
    stretches = max(1, min(-(-FOLDS // len(logs)), *blocks))  # no log in more than it has blocks
    parted, scored = (folds(information, stretches) for information in both)
    if len(parted) < 2:
        return None
    changes, good = np.zeros((len(parted), fitted.base.rank)), np.zeros(len(parted), dtype=bool)
    if refit is None and fitted.base.rank:
        # (log, block) of the rows in each stretch
        groups = [part.times for part in parted.values()]
        changes, good = (left_out or LeftOut.of(fitting, fitted)).without(groups)
    changed = dict(zip(parted, zip(changes, good, strict=True), strict=True))
    without = _Without(fitted, prior, parted)
    sums = Squares.zero(scoring.d)
    for number, part in scored.items():
        change, determined = changed.get(number, (np.zeros(fitted.base.rank), False))
        if determined:
            x = fitted.x.copy()
            x[fitted.base.independent] += change
        elif (other := without.estimate(number)) is None:
            continue
        else:
            x = refit(other) if refit else other.x
        sums = sums + part.squares(x)
    return sums


class _Without:
    """Estimates from all stretches but one, solved anew."""

    def __init__(self, fitted: Estimate, prior: Array, parted: Mapping[int, Information]) -> None:
        self.fitted, self.prior, self.parted = fitted, prior, parted

    @cached_property
    def _others(self) -> dict[int, Triangle]:
        weighted = [part.total(self.fitted.sigma) for part in self.parted.values()]
        whole_blocks = {-1: Triangle.merge(weighted)}
        return whole_blocks | dict(zip(self.parted, without_each(weighted), strict=True))

    def estimate(self, number: int) -> Estimate | None:
        """Return the estimate without a stretch, with the weights of all; None without rows."""
        rows, one = self._others.get(number, self._others[-1]), np.ones(1)
        if not rows.rows:
            return None
        other = estimate([rows], self.prior, np.zeros(1), sigma=one, fixed=self.fitted.fixed)
        return replace(other, sigma=self.fitted.sigma)  # which the rows are divided by already


def without_each(triangles: Sequence[Triangle]) -> list[Triangle]:
    """Return for each triangle all others merged: those before it and those after it."""
    nothing = Triangle.empty(triangles[0].k)
    before = accumulate(triangles[:-1], add, initial=nothing)
    after = [*accumulate(reversed(triangles[1:]), add, initial=nothing)]
    return [one + other for one, other in zip(before, reversed(after), strict=True)]


TINY = float(np.finfo(np.float32).tiny)
TOGETHER = 10  # work: series that are in memory in double precision at once
SMOOTH = 9  # work: frequencies over which power is averaged: noise has no lines
LEAST = 0.05  # numerics: the least share: where nearly all is lost, nothing is known of the noise


def surrogates(
    r: Array, runs: Sequence[slice], count: int, random: np.random.Generator,
    remaining: Sequence[Array] = (), known: Array | None = None,
) -> Array:  # fmt: skip
    """Series (N, d, count) that have the smooth spectra of r (N, d) and nothing else, in single
    precision.

    Each run without a gap is mirrored at its end, so that its two ends meet, and its phases are
    turned at random, in all coordinates alike: correlations between them stay. The power is the
    mean of neighbouring frequencies: lines are of the motion, not of the noise. One series does not
    determine it: each draw takes another sample of its frequencies.

        P = mean w |F|²        w ~ Exp(1), mean over SMOOTH frequencies

    `remaining`: by run, the share (frequencies, d) of its power that is left of r, which is given
    back (`remaining_power`); `known` (N, d): where r is known, elsewhere it is zero.
    """
    known = np.ones(r.shape, dtype=bool) if known is None else known
    series = np.zeros((*r.shape, count), dtype=np.float32)
    for i, run in enumerate(runs):
        n = run.stop - run.start
        if n < 2:
            continue
        F = _transformed(r[run])
        F[n] = 0.0  # by symmetry: rounding there would have some phase
        power = np.maximum(np.abs(F) ** 2, TINY)
        P = _without_gaps(power, known[run]) / (_smooth(remaining[i]) if remaining else 1.0)
        F *= np.sqrt(P / (_smooth(power) * power))
        m = max(round(known[run].mean() * n / 2), 1)  # independent powers of the known values
        for first in range(0, count, TOGETHER):
            draws = slice(first, min(first + TOGETHER, count))
            size = draws.stop - first
            w = random.exponential(size=(m + 1, 1, size))[np.arange(n + 1) * m // n]
            turn = np.exp(2j * np.pi * random.random((n + 1, 1, size)))
            turn[[0, n]] = np.sign(random.standard_normal((2, 1, size)))
            drawn = F[:, :, None] * np.sqrt(_smooth(w * power[:, :, None])) * turn
            series[run, :, draws] = np.fft.irfft(drawn.astype(np.complex64), 2 * n, axis=0)[:n]
    return series


def remaining_power(rest: Array, full: Array) -> Array:
    """Return the mean share (frequencies, d) of the power of series (n, d, count) that is left."""
    if len(rest) < 2:
        return np.ones((1, rest.shape[1]))
    one, other = ((np.abs(_transformed(x)) ** 2).sum(axis=2) for x in (rest, full))
    return np.asarray(np.clip(one / np.maximum(other, TINY), LEAST, 1.0))


def _without_gaps(P: Array, known: Array) -> Array:
    """Return the smooth power (frequencies, d) of a series whose rows `known` (n, d) have power P.

    Gaps make slow noise look faster. Products of pairs of rows, k apart, know of no gap:

        c_k = F⁻¹(P)_k / F⁻¹(|F(m)|²)_k        m: 1 where the series is known, else 0
    """
    if known.all():
        return _smooth(P)
    c, pairs = (np.fft.irfft(x, axis=0) for x in (P, np.abs(_transformed(known)) ** 2))
    c = np.where(pairs > 0.5, c / np.maximum(pairs, 0.5), 0.0) * len(c)
    smooth = _smooth(np.fft.rfft(c, axis=0).real)
    power = np.maximum(smooth, 0.0)  # few pairs make some power negative; the variance stays
    return power * np.maximum(smooth.mean(axis=0), 0.0) / np.maximum(power.mean(axis=0), TINY)


def _smooth(x: Array) -> Array:
    """Return means over SMOOTH frequencies, added up each, so that small ones beside large stay."""
    sides = ((SMOOTH // 2, (SMOOTH - 1) // 2), *((0, 0),) * (x.ndim - 1))
    padded, total = np.pad(x, sides, mode="symmetric"), np.zeros_like(x)
    for shift in range(SMOOTH):
        total += padded[shift : shift + len(x)]
    return np.asarray(total / SMOOTH)


def _transformed(x: Array) -> np.ndarray:
    """Spectrum (n + 1, ...) of a run x (n, ...) that is mirrored at its end."""
    return np.fft.rfft(np.concatenate([x, x[::-1]]), axis=0)
