"""One delay of all torques, or one low-pass filter on them, of some milliseconds.

    τ_u(t) = τ̂_u(t − d) ≈ τ̂_u − d ṙ_u          r: torque of the rigid bodies

A filter delays by its time constant what is slower. Dry friction that builds up over a distance is
late at reversals, in each joint by a time of its own, and is left out of r: it says nothing of d.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ident.effects import Effect
from ident.fit.channel_fits import HALF, RIVAL, ROUNDING, ROUNDS, SMALL, columns_of, credible_t
from ident.fit.problem import Table
from ident.information.blocks import Part
from ident.information.chance import zscore
from ident.information.estimate import Estimate
from ident.information.hypotheses import Array, PartialRegression

GAP = 1.5  # usual steps from one row to the next, beyond which no rate is taken


@dataclass(frozen=True)
class CommonDelay:
    """All torques are late by `delay` ± `stderr` [s]; `before`, `after`: relative errors of blocks
    that were left out without and with it, geometric means over the joints.
    """

    delay: float
    stderr: float
    before: float
    after: float


def delay_shows(estimate: Estimate, table: Table, use: np.ndarray) -> bool:
    """Return whether the residual of a good fit may contain a delay of all torques (score test).

    The column of the delay is projected off the model's columns. Its products with the residual
    must be no chance from block to block, and its coefficient must make HALF of SMALL of some
    torque. Rows `use` (N, d) of the table count.
    """
    x, rigid, free = estimate.solution.x, len(table.columns.rigid), ~estimate.held
    squares = (np.where(use, table.tau, 0.0) ** 2).sum(axis=0)
    residual = np.where(use, table.b - table.A @ x, 0.0)
    late = np.where(use, -_rates(table, table.A[:, :, :rigid] @ x[:rigid] + table.tau - table.b), 0)
    weight = 1 / np.sqrt((residual**2).sum(axis=0) + ROUNDING * squares + 1e-300)
    X = (table.A[:, :, free] * np.where(use, weight, 0.0)[:, :, None]).reshape(use.size, -1)
    y = np.stack([(late * weight).ravel(), (residual * weight).ravel()], axis=1)
    column, left = (y - X @ np.linalg.lstsq(X, y, rcond=None)[0]).T
    products = np.zeros(int(table.blocks.max(initial=0)) + 1)
    np.add.at(products, table.blocks, (column * left).reshape(use.shape).sum(axis=1))
    products = products[np.unique(table.blocks[use.any(axis=1)])]
    delay = abs(products.sum()) / max(float(column @ column), 1e-300)
    shares = delay * np.sqrt((late**2).sum(axis=0) / np.maximum(squares, 1e-300))
    chance = credible_t(1, len(products)) if len(products) > 1 else np.inf
    return bool(shares.max() > HALF * SMALL and abs(zscore(products)) > chance)


def common_delay(
    estimate: Estimate, table: Table, use: np.ndarray, effects: Sequence[Effect]
) -> CommonDelay | None:
    """Return the delay that all torques have in common; None if there is none that matters.

    It must predict left-out blocks better, also where any one joint does not have it, explain HALF
    of what a delay of its own in each joint does, and make more than SMALL of some torque. Its
    standard error is that of a jackknife over blocks, and by how much it moves where friction is
    late as well. Rows `use` (N, d) of the table count; further linear effects are refitted.
    """
    names, free = table.motion.independent, ~estimate.held
    d = len(names)
    if d < 2 or sorted(names) != sorted(table.mechanism.driven):
        return None
    columns = [table.effect_columns(each, [{}]) for each in effects]
    held = table.A[:, :, ~free] @ estimate.solution.x[~free]
    k = int(free.sum()) + sum(C.shape[2] for C, _ in columns)
    numbers, parts = np.arange(int(table.blocks.max(initial=0)) + 2), []
    for u, rows in enumerate(use.T):
        X, y = columns_of(table, free, columns, u), table.b[:, u] - held[:, u]
        edges = np.searchsorted(table.blocks[rows], numbers)
        parts.append(Part(u, np.arange(k), X[rows], y[rows, None], edges))
    squares = (np.where(use, table.tau, 0.0) ** 2).sum(axis=0)
    if not squares.all():
        return None
    sigma = np.sqrt(squares / use.sum(axis=0))
    for _ in range(ROUNDS):
        model = PartialRegression(tuple(parts), np.arange(k), 1 / sigma)
        sigma *= np.sqrt(model.losses.sum(axis=0) / use.sum(axis=0) + SMALL**2 * ROUNDING)
    x, known = estimate.solution.x, table.tau - table.b
    rigid = len(table.columns.rigid)

    def column(torque: Array) -> list[Array]:
        rates = _rates(table, torque).T
        return [-rate[rows, None] for rate, rows in zip(rates, use.T, strict=True)]

    late = column(table.A[:, :, :rigid] @ x[:rigid] + known)
    found = model.refit_with(late)
    if zscore(found.D) <= credible_t(1, model.blocks):
        return None
    unit = np.eye(d)
    others = [model.refit_with([x * (1 - e[u]) for u, x in enumerate(late)]) for e in unit]
    own = model.refit_with([x * e for x, e in zip(late, unit, strict=True)])
    delay = float(found.theta[0])
    shares = [abs(delay) * float(np.linalg.norm(x)) for x in late] / np.sqrt(squares)
    if (
        min(zscore(each.D) for each in others) <= RIVAL
        or found.G < HALF * own.G
        or shares.max() < SMALL
    ):
        return None
    # the slope along the delay's columns, the model projected out, without each block
    along, y = found.direction[:, None], np.concatenate([y[:, :1] for y in model.residual])
    part, fall = (model.by_block(along, x)[:, 0, 0] for x in (along, y))
    slopes = (fall.sum() - fall) / (1 - part) / fall.sum()
    spread = delay**2 * (len(slopes) - 1) * float(np.mean((slopes - slopes.mean()) ** 2))
    with_friction = float(model.refit_with(column(table.A @ x + known)).theta[0])
    left = np.array([model.losses.sum(axis=0), found.loss.sum(axis=0)]) * sigma**2 / squares
    before, after = np.exp(0.5 * np.log(left).mean(axis=1)).tolist()
    return CommonDelay(
        delay, float(np.hypot(np.sqrt(spread), with_friction - delay)), before, after
    )


def _rates(table: Table, torque: Array) -> Array:
    """Rates (N, d) of torques (N, d) in a table's rows; 0 where a row stands alone."""
    step, rates = np.diff(table.t), np.zeros_like(torque)
    cut = (step <= 0) | (step > GAP * np.median(step)) | (np.diff(table.experiment) > 0)
    for a, b in pairwise([0, *(np.flatnonzero(cut) + 1), len(torque)]):
        if b - a > 1:
            rates[a:b] = np.gradient(torque[a:b], table.t[a:b], axis=0)
    return rates
