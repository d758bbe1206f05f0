"""Systematic errors of a good fit, which the scatter of its residual does not show.

Reversals: dry friction is taken as Fc sign(v). In a machine it builds up over some speed or
distance, which is an error in rows at reversals. By how much it moves Fc and Fv is known from the
fit without these rows, where they fit worse:

    x_away − x        x_away: weighted least squares without rows at reversals

A common delay: all torques are late by some milliseconds, or one low-pass filter is on them,
which delays by its time constant what is slower:

    τ_u(t) = τ̂_u(t − d) ≈ τ̂_u − d ṙ_u          r: torque of the rigid bodies

Dry friction that builds up over a distance is late at reversals, in each joint by a time of its
own, and is left out of r: it says nothing of d.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ident.effects import Effect
from ident.equations.filter import Decimator
from ident.equations.rows import largest_transmission, of_joints
from ident.equations.table import Table
from ident.faults.channel_fits import ROUNDS, SMALL, SQUARES_ROUNDING, columns_of
from ident.information import linear
from ident.information.blocks import Part
from ident.information.estimate import MATERIAL, Estimate
from ident.information.evidence import MAIN_CAUSE, RIVAL, credible, surely_t, zscore
from ident.information.hypotheses import Array, PartialRegression
from ident.information.projection import RANK
from ident.motion.signals import SLOW, at_limit

GUARD = 0.06  # tuned: s on either side that are left out; at most 0.3 periods of the motion
ENOUGH = 0.5  # level: share of a coordinate's rows that must stay
FEWEST = 30  # work: rows at reversals that tell how well they fit
FAINT = 0.01  # numerics: weight of a row there: what only such rows determine stays as it is
# numerics: the same of a row with a torque at its limit, of which many may be
CLIPPED_WEIGHT = 1e-4
WORSE = 4.0  # tuned: squared residual there over that elsewhere, from which these rows fit worse


def away_from_reversals(table: Table) -> np.ndarray:
    """(N, d) whether a row is in motion and away from the reversals that it feels, at which a
    filtered sign of speed, stick phases and the torque's jump are out of step; of a coordinate with
    few such rows, whether it informs and is away from them.
    """
    guard = min(GUARD, 0.3 / max(table.motion.band.motion, 1e-9))
    while True:
        numbers = range(len(table.scenes))
        calm_rows = np.concatenate([_away_in_log(table, i, guard) for i in numbers])
        if guard < 1e-3 or calm_rows.mean(axis=0).min() >= ENOUGH:
            moving = calm_rows & table.moving
            too_few = moving.mean(axis=0) < ENOUGH  # slow filters have standstill in most rows
            use = np.where(too_few, calm_rows & table.informed, moving)
            return use if use.any() else table.informed
        guard *= 0.5


def _away_in_log(table: Table, number: int, guard: float) -> np.ndarray:
    scene, at = table.scenes[number], table.sample[table.experiment == number]
    e = scene.e
    top = np.quantile(np.abs(e.yd[e.usable]), 0.98, axis=0)
    slow = np.abs(e.yd) < np.maximum(SLOW * top, e.still)
    slow &= top > e.still  # a joint that never moves has no reversals
    near = _within(slow, at, int(guard * e.rate))
    return of_joints(scene.samples.reduced(at), ~near, largest_transmission(e))


def _within(flags: np.ndarray, at: np.ndarray, samples: int) -> np.ndarray:
    """Return (N, J) whether any of `flags` (n, J) is true within so many samples of `at` (N,)."""
    count = np.concatenate([np.zeros((1, flags.shape[1]), dtype=int), np.cumsum(flags, axis=0)])
    first, stop = np.maximum(at - samples, 0), np.minimum(at + samples + 1, len(flags))
    return np.asarray(count[stop] > count[first])


def clear_of_limits(table: Table) -> np.ndarray:
    """(N, d) whether no torque that a row's filter averages stays at an extreme of its channel."""
    return np.concatenate([_clear_in_log(table, i) for i in range(len(table.scenes))])


def _clear_in_log(table: Table, number: int) -> np.ndarray:
    scene, at = table.scenes[number], table.sample[table.experiment == number]
    e, mechanism = scene.e, table.mechanism
    clipped = np.zeros(e.yd.shape, dtype=bool)
    for name, torque in zip(mechanism.driven, e.tau.T, strict=True):
        clipped[:, mechanism.joint_index[name]] = at_limit(torque)
    if not clipped.any():
        return np.ones((len(at), len(table.motion.independent)), dtype=bool)
    taps = Decimator.of(table.motion.band.cutoff, e.rate).taps
    near = _within(clipped, at, 0 if taps is None else len(taps) // 2)
    return of_joints(scene.samples.reduced(at), ~near, largest_transmission(e))


def misfit_at_reversals(table: Table, calm_rows: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(d,) squared residual of a row at reversals over that of a row `away` (N, d) from them, of
    unknowns x (k,); 0 where such rows are few, or do not matter.
    """
    misfit = np.zeros(table.b.shape[1])
    squares = (table.b - table.A @ x) ** 2
    for u, (calm, informed) in enumerate(zip(calm_rows.T, table.informed.T, strict=True)):
        near = informed & ~calm
        if near.sum() < FEWEST or not calm.any():
            continue
        at_reversals, elsewhere = (float(squares[rows, u].mean()) for rows in (near, calm))
        if at_reversals > MATERIAL**2 * float((table.tau[informed, u] ** 2).mean()):
            misfit[u] = at_reversals / max(elsewhere, 1e-300)
    return misfit


def moved_by_rows(
    table: Table, others: np.ndarray, estimate: Estimate, faint: float = FAINT
) -> tuple[np.ndarray, np.ndarray]:
    """(k,) x_without − x: what rows do to the unknowns that are not among the `others` (N, d), and
    the covariance (n_ind, n_ind) that the others leave of those in the base.

    H (x_without − x) = Σ w Aᵀ r        r = b − A x, H = Σ w Aᵀ A, w = 1/σ², faint/σ² of these rows
    """
    independent = estimate.base.independent
    change, covariance = np.zeros(len(estimate.x)), np.zeros((len(independent),) * 2)
    if others[table.informed].all() or not len(independent):
        return change, covariance
    r = table.b - table.A @ estimate.x
    H, g = np.zeros((len(independent),) * 2), np.zeros(len(independent))
    for u in range(r.shape[1]):
        rows = table.informed[:, u]
        calm = others[rows, u]
        A, residuals = table.A[rows, u][:, independent], r[rows, u]
        elsewhere = residuals[calm] if calm.any() else residuals
        # its square is a number, too
        sigma = max(float(np.sqrt((elsewhere**2).sum() / max(len(elsewhere), 1))), 1e-150)
        w = np.where(calm, 1.0, faint)[:, None] / sigma**2
        H += A.T @ (w * A)
        g += A.T @ (w[:, 0] * residuals)
    scale = np.sqrt(np.where(np.diag(H) > 0, np.diag(H), 1.0))
    inverse = linear.pinv(H / scale / scale[:, None], rcond=RANK, hermitian=True)
    change[independent] = inverse @ (g / scale) / scale
    return change, inverse / scale / scale[:, None]


# --- a common delay ---------------------------------------------------------------------------

GAP = 1.5  # numerics: usual steps from one row to the next, beyond which no rate is taken


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
    """Return whether the residual of a good fit may contain a delay of all torques (score test) in
    the rows `use` (N, d): products of the residual with the delay's column, projected off the
    model's, must be no chance from block to block, and it must make half of SMALL of some torque.
    """
    x, rigid, free = estimate.solution.x, len(table.columns.rigid), ~estimate.fixed
    squares = (np.where(use, table.tau, 0.0) ** 2).sum(axis=0)
    if not squares.any():  # no torque acts, of a body that flies or rolls
        return False
    residual = np.where(use, table.b - table.A @ x, 0.0)
    late = np.where(use, -_rates(table, table.A[:, :, :rigid] @ x[:rigid] + table.tau - table.b), 0)
    weight = 1 / np.sqrt((residual**2).sum(axis=0) + SQUARES_ROUNDING * squares + 1e-300)
    X = (table.A[:, :, free] * np.where(use, weight, 0.0)[:, :, None]).reshape(use.size, -1)
    y = np.stack([(late * weight).ravel(), (residual * weight).ravel()], axis=1)
    column, residual = (y - X @ np.linalg.lstsq(X, y, rcond=None)[0]).T
    products = np.zeros(int(table.blocks.max(initial=0)) + 1)
    np.add.at(products, table.blocks, (column * residual).reshape(use.shape).sum(axis=1))
    products = products[np.unique(table.blocks[use.any(axis=1)])]
    delay = abs(products.sum()) / max(float(column @ column), 1e-300)
    shares = delay * np.sqrt((late**2).sum(axis=0) / np.maximum(squares, 1e-300))
    if len(products) < 2:
        return False
    z, chance = abs(zscore(products)), surely_t(1, len(products))
    return credible(z, chance, size=shares.max(), least=MAIN_CAUSE * SMALL)


def common_delay(
    estimate: Estimate, table: Table, use: np.ndarray, effects: Sequence[Effect]
) -> CommonDelay | None:
    """Return the delay that all torques have in common; None if there is none that matters.

    It must predict left-out blocks better, also where any one joint does not have it, explain half
    of what a delay of its own in each joint does, and make more than SMALL of some torque. Its
    standard error is that of a jackknife over blocks, and by how much it moves where friction is
    late as well. Rows `use` (N, d) of the table count; further linear effects are refitted.
    """
    names, free = table.motion.independent, ~estimate.fixed
    d = len(names)
    if d < 2 or sorted(names) != sorted(table.mechanism.driven):
        return None
    columns = [table.effect_columns(effect, [{}]) for effect in effects]
    held_torque = table.A[:, :, ~free] @ estimate.solution.x[~free]
    k = int(free.sum()) + sum(C.shape[2] for C, _ in columns)
    numbers, parts = np.arange(int(table.blocks.max(initial=0)) + 2), []
    for u, rows in enumerate(use.T):
        X, y = columns_of(table, free, columns, u), table.b[:, u] - held_torque[:, u]
        edges = np.searchsorted(table.blocks[rows], numbers)
        parts.append(Part(u, np.arange(k), X[rows], y[rows, None], edges))
    squares = (np.where(use, table.tau, 0.0) ** 2).sum(axis=0)
    if not squares.all():
        return None
    sigma = np.sqrt(squares / use.sum(axis=0))
    for _ in range(ROUNDS):
        model = PartialRegression(tuple(parts), np.arange(k), 1 / sigma)
        sigma *= np.sqrt(model.losses.sum(axis=0) / use.sum(axis=0) + SMALL**2 * SQUARES_ROUNDING)
    x, known = estimate.solution.x, table.tau - table.b
    rigid = len(table.columns.rigid)

    def column(torque: Array) -> list[Array]:
        rates = _rates(table, torque).T
        return [-rate[rows, None] for rate, rows in zip(rates, use.T, strict=True)]

    late = column(table.A[:, :, :rigid] @ x[:rigid] + known)
    refit = model.refit_with(late)
    z, chance = zscore(refit.D), surely_t(1, model.blocks)
    if not credible(z, chance):
        return None
    unit = np.eye(d)
    others = [model.refit_with([x * (1 - e[u]) for u, x in enumerate(late)]) for e in unit]
    with_own_delays = model.refit_with([x * e for x, e in zip(late, unit, strict=True)])
    delay = float(refit.theta[0])
    shares = [abs(delay) * float(np.linalg.norm(x)) for x in late] / np.sqrt(squares)
    everywhere = min(zscore(refit.D) for refit in others) > RIVAL
    in_common = everywhere and refit.G >= MAIN_CAUSE * with_own_delays.G
    if not credible(z, chance, size=shares.max(), least=SMALL, possible=in_common):
        return None
    # the slope along the delay's columns, the model projected out, without each block
    along, y = refit.direction[:, None], np.concatenate([y[:, :1] for y in model.residual])
    part, fall = (model.by_block(along, x)[:, 0, 0] for x in (along, y))
    slopes = (fall.sum() - fall) / (1 - part) / fall.sum()
    spread = delay**2 * (len(slopes) - 1) * float(np.mean((slopes - slopes.mean()) ** 2))
    with_friction = float(model.refit_with(column(table.A @ x + known)).theta[0])
    shares_left = np.array([model.losses.sum(axis=0), refit.loss.sum(axis=0)]) * sigma**2 / squares
    before, after = np.exp(0.5 * np.log(shares_left).mean(axis=1)).tolist()
    stderr = float(np.hypot(np.sqrt(spread), with_friction - delay))
    return CommonDelay(delay, stderr, before, after)


def _rates(table: Table, torque: Array) -> Array:
    """Rates (N, d) of torques (N, d) in a table's rows; 0 where a row stands alone."""
    step, rates = np.diff(table.t), np.zeros_like(torque)
    if not len(step):
        return rates
    cut = (step <= 0) | (step > GAP * np.median(step)) | (np.diff(table.experiment) > 0)
    for a, b in pairwise([0, *(np.flatnonzero(cut) + 1), len(torque)]):
        if b - a > 1:
            rates[a:b] = np.gradient(torque[a:b], table.t[a:b], axis=0)
    return rates
