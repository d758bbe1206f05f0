"""Standard errors that stay honest when residuals are correlated in time.

Neighbouring residuals are alike (filters, unmodelled physics), so rows are no independent
witnesses. Blocks of time nearly are: the delete-one-block jackknife

    δ_b = (H − H_b)⁻¹ g_b,   H = Σ AᵀA / σ²,   g_b = A_bᵀ(b_b − A_b x) / σ²
    cov = (B − 1)/B · Σ_b [δ_b δ_bᵀ + Σ_l w_l (δ_b δ_{b+l}ᵀ + δ_{b+l} δ_bᵀ)]

is the CR3 estimate of Bell and McCaffrey (Survey Methodology 28(2), 2002), with Bartlett weights
w_l = 1 − l/(L + 1) for blocks that are still alike; L follows from how alike they are (Andrews,
Econometrica 59(3), 1991, eq. 6.2 and 6.4). A window cuts off what lasts longer. Where a parameter's
neighbouring δ_b are clearly alike, its variance is averaged with what a first-order autoregression
has in the long run, which errs on the other side (prewhitening: Andrews, Monahan, Econometrica
60(4), 1992):

    Σ_b (δ_b − ρ δ_{b−1})² / (1 − ρ)²

It is a variance from few squares: ν of them, if those of equal blocks are counted as one each
(Satterthwaite). Its t-distribution is ν/(ν − 2) times as wide, and that is what is returned: value
± 2 standard errors covers the truth in 95 of 100 logs.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.fit.accumulate import Cell
from ident.fit.estimate import Estimate

ALIKE = 1.3  # standard errors of no correlation beyond which neighbouring blocks are alike
LASTING = 0.8  # the most by which a block is believed to resemble the one before
FEWEST_SQUARES = 3.0  # ν below which the t-distribution's width means nothing


def covariance(cells: Sequence[Cell], estimate: Estimate) -> np.ndarray:
    """Covariance (n_ind, n_ind) of the base parameters; NaN for a single block."""
    own = estimate.base.independent
    size = len(own)
    norm = estimate.factor.column_norms()[own]  # equilibrated: H has a unit diagonal
    keys, H_blocks, g_blocks, white = _blocks(cells, estimate, norm)
    count = len(keys)
    if size == 0 or count < 2:
        return np.full((size, size), np.nan)
    H = H_blocks.sum(axis=0)
    deltas, shares = np.empty((count, size)), np.empty((count, size))
    for b, (H_b, g_b) in enumerate(zip(H_blocks, g_blocks, strict=True)):
        others = np.linalg.pinv(H - H_b, rcond=1e-13, hermitian=True)
        deltas[b] = others @ g_b
        shares[b] = np.einsum(
            "ij,jk,ik->i", others, H_b, others
        )  # of the variance, white residuals
    total, squares = deltas.T @ deltas, (shares**2).sum(axis=0)
    lags = _lags(keys, deltas)
    for lag in range(1, lags + 1):
        one, other = _pairs(keys, lag)
        weight = 1 - lag / (lags + 1)
        cross = deltas[one].T @ deltas[other]
        total += weight * (cross + cross.T)
        squares += 2 * weight**2 * (shares[one] * shares[other]).sum(axis=0)
    tiny = np.finfo(float).tiny
    nu = np.maximum(shares.sum(axis=0) ** 2 / np.maximum(squares, tiny), FEWEST_SQUARES)
    wider = np.sqrt(nu / (nu - 2)) / norm
    window = np.maximum(np.diag(total), tiny)
    wider = wider * np.sqrt(0.5 + 0.5 * _lasting(keys, deltas, window) / window)
    found = (count - 1) / count * total * np.outer(wider, wider)
    # what only one block tells has no spread between blocks; white residuals are the least there is
    inverse = np.linalg.pinv(H, rcond=1e-13, hermitian=True) / norm[:, None]
    least = np.einsum("ij,jk,ik->i", inverse, white, inverse)
    return np.asarray(found + np.diag(np.maximum(least - np.diag(found), 0.0)))


def _blocks(
    cells: Sequence[Cell], estimate: Estimate, norm: np.ndarray
) -> tuple[list[tuple[int, int]], np.ndarray, np.ndarray, np.ndarray]:
    """(experiment, block), H_b (B, n_ind, n_ind), g_b (B, n_ind), and Cov[Σ g_b] (n_ind, n_ind) of
    white residuals; all for columns of unit norm.
    """
    size, d = len(norm), len(estimate.sigma)
    place = np.full(len(estimate.solution.x), -1)
    place[estimate.base.independent] = np.arange(size)
    blocks: dict[tuple[int, int], tuple[np.ndarray, np.ndarray]] = {}
    own, rows, squares = np.zeros((d, size, size)), np.zeros(d), np.zeros(d)
    for cell in cells:
        if cell.factor.rows == 0:
            continue
        inside = place[cell.support] >= 0
        at = place[cell.support][inside]
        x, weight = estimate.solution.x[cell.support], 1 / estimate.sigma[cell.coordinate]
        R = cell.factor.R[:, inside] * weight / norm[at]
        H_b, g_b = blocks.setdefault(
            (cell.experiment, cell.block), (np.zeros((size, size)), np.zeros(size))
        )
        H_b[np.ix_(at, at)] += R.T @ R
        g_b[at] += cell.factor.gradient(x)[inside] * weight**2 / norm[at]
        own[cell.coordinate][np.ix_(at, at)] += R.T @ R
        rows[cell.coordinate] += cell.factor.rows
        squares[cell.coordinate] += (cell.factor.residual_norm(x) * weight) ** 2
    white = np.einsum("u,uij->ij", squares / np.maximum(rows, 1), own)
    H_blocks, g_blocks = (np.array([each[i] for each in blocks.values()]) for i in (0, 1))
    return list(blocks), H_blocks, g_blocks, white


def _pairs(keys: list[tuple[int, int]], lag: int) -> tuple[list[int], list[int]]:
    """Places of the blocks of one experiment that are `lag` apart."""
    first = [i for i in range(len(keys) - lag) if keys[i][0] == keys[i + lag][0]]
    return first, [i + lag for i in first]


def _lasting(keys: list[tuple[int, int]], deltas: np.ndarray, window: np.ndarray) -> np.ndarray:
    """(n_ind,) Σ δ² in the long run, of first-order autoregressions; the window's if not alike."""
    one, other = _pairs(keys, 1)
    size = np.maximum((deltas**2).sum(axis=0), np.finfo(float).tiny)
    seen = (deltas[one] * deltas[other]).sum(axis=0) / size
    rho = np.clip(seen, 0.0, LASTING)
    new = ((deltas[other] - rho * deltas[one]) ** 2).sum(axis=0)
    long = len(keys) / max(len(one), 1) * new / (1 - rho) ** 2
    return np.where(seen > ALIKE / np.sqrt(len(keys)), long, window)


def _lags(keys: list[tuple[int, int]], deltas: np.ndarray) -> int:
    """L, from the correlation of neighbouring blocks: 1 at least, since filtered blocks touch."""
    a, b = _pairs(keys, 1)
    size = np.maximum((deltas**2).sum(axis=0), np.finfo(float).tiny)
    rho = np.clip((deltas[a] * deltas[b]).sum(axis=0) / size, -0.97, 0.97)
    alpha = np.mean(4 * rho**2 / ((1 - rho) ** 6 * (1 + rho) ** 2)) / np.mean((1 - rho) ** -4.0)
    return int(np.clip(1.1447 * np.cbrt(alpha * len(keys)), 1, max(1, len(keys) // 4)))
