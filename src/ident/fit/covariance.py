"""Standard errors that stay honest when residuals are correlated in time.

Neighbouring residuals are alike (filters, unmodelled physics), so rows are no independent
witnesses. Blocks of time nearly are: the delete-one-block jackknife

    δ_b = (H − H_b)⁻¹ g_b,   H = Σ AᵀA / σ²,   g_b = A_bᵀ(b_b − A_b x) / σ²
    cov = (B − 1)/B · Σ_b [δ_b δ_bᵀ + ½ (δ_b δ_{b+1}ᵀ + δ_{b+1} δ_bᵀ)]

is the CR3 estimate of Bell and McCaffrey (Survey Methodology 28(2), 2002) with one Bartlett lag
for blocks that still touch.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.fit.accumulate import Cell
from ident.fit.estimate import Estimate


def covariance(cells: Sequence[Cell], estimate: Estimate) -> np.ndarray:
    """Covariance (n_ind, n_ind) of the base parameters."""
    own = estimate.base.independent
    size = len(own)
    if size == 0:
        return np.zeros((0, 0))
    place = np.full(len(estimate.solution.x), -1)
    place[own] = np.arange(size)
    norm = estimate.factor.column_norms()[own]  # equilibrated: H has a unit diagonal
    H = np.zeros((size, size))
    blocks: dict[tuple[int, int], tuple[np.ndarray, np.ndarray]] = {}
    for cell in cells:
        if cell.factor.rows == 0:
            continue
        inside = place[cell.support] >= 0
        at = place[cell.support][inside]
        weight = 1 / estimate.sigma[cell.coordinate]
        R = cell.factor.R[:, inside] * weight / norm[at]
        g = cell.factor.gradient(estimate.solution.x[cell.support])[inside] * weight**2 / norm[at]
        H_b, g_b = blocks.setdefault(
            (cell.experiment, cell.block), (np.zeros((size, size)), np.zeros(size))
        )
        H_b[np.ix_(at, at)] += R.T @ R
        g_b[at] += g
    for H_b, _ in blocks.values():
        H += H_b
    count = len(blocks)
    if count < 2:
        return np.full((size, size), np.nan)
    deltas = np.array(
        [np.linalg.lstsq(H - H_b, g_b, rcond=1e-13)[0] for H_b, g_b in blocks.values()]
    )
    total = deltas.T @ deltas
    keys = list(blocks)
    for i in range(count - 1):
        if keys[i][0] == keys[i + 1][0]:
            cross = np.outer(deltas[i], deltas[i + 1])
            total += 0.5 * (cross + cross.T)
    # the factor's own covariance is the least there can be when residuals carry no structure
    scaled = (count - 1) / count * total / np.outer(norm, norm)
    return scaled
