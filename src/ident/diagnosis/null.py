"""Residuals in which nothing is missing: what chance and the noise of the sensors make.

Surrogates have the spectrum of the present residual in each coordinate and random phases. Draws of
noise are what the torques' white noise, the motion's noise and the errors of values that an earlier
fit has found make of the residual,

    δr = Σ_i Σ_k ∂r/∂u_i^(k) δu_i^(k) + δτ + A δx        u = B c, U (c − ĉ) of unit noise

through the same filter; their rms is the noise floor. What candidates explain is held
against the most that any of them explains of these.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np

from ident.diagnosis.candidates import Contest, NoiseDraws
from ident.equations.motion_noise import gain
from ident.equations.table import Table
from ident.equations.unknowns import Columns
from ident.information import linear
from ident.information.blocks import Part
from ident.information.chance import remaining_power, surrogates
from ident.information.evidence import SURROGATES
from ident.information.hypotheses import Array, Gains, Index, PartialRegression
from ident.information.projection import RANK
from ident.mechanism.parameters import Covariance
from ident.motion import State
from ident.motion.spline import WIDTH, Spline, evaluated

NEW_COLUMN = 1e-6  # numerics: norm of a column beside the model below which it is rounding
TRIALS = 25  # work: random series that show what share of its power a noise loses
DRAWS = 24  # work: of noise
CHUNK = 2048  # work: samples whose noise is in memory at once
GAIN_SAMPLES = 800  # work: of a log at which ∂r/∂motion is evaluated; between, it is interpolated


def with_noise(contest: Contest) -> Contest:
    """Return the contest with draws of the sensors' noise in its rows."""
    table, random = contest.table, np.random.default_rng([contest.seed, 1])
    filtered = []
    for number, scene in enumerate(table.scenes):
        r = _of_torques(table, scene.e, random)
        if scene.e.smooth is not None:
            _add_motion(r, table, number, random)
        filtered.append(table.filtered(number, r))
    rows = np.concatenate(filtered)
    if (errors := contest.fit.known_errors) is not None:
        rows = rows + _of_values(contest, errors, random)
    regression = contest.regression
    null_regression = regression.with_targets(
        [_rows(contest, part, rows) for part in regression.parts]
    )
    losses = np.zeros((DRAWS, regression.d))
    for part, x in zip(regression.parts, null_regression.errors, strict=True):
        losses[:, part.coordinate] += (x**2).sum(axis=0)
    rms = np.sqrt(losses / np.maximum(regression.rows, 1)) / regression.weight
    draws = NoiseDraws(rows, np.median(rms, axis=0), rms.max(axis=0))
    return replace(contest, draws=draws)


def _of_torques(table: Table, e: State, random: np.random.Generator) -> np.ndarray:
    """(n, d, DRAWS) of the torque channels' white noise, in single precision."""
    out = np.zeros((len(e), table.b.shape[1], DRAWS), dtype=np.float32)
    for name in table.mechanism.driven:
        sigma = np.float32(e.noise.get(f"tau.{name}", 0.0))
        x = sigma * random.standard_normal((len(e), DRAWS), dtype=np.float32)
        if e.loop is None:
            out[:, table.mechanism.joint(name).index] += x
        else:
            W = e.leverage[:, table.mechanism.joint_index[name]].astype(np.float32)
            out += W[:, :, None] * x[:, None, :]
    return out


def _add_motion(out: np.ndarray, table: Table, number: int, random: np.random.Generator) -> None:
    """Adds what the smooth motion's noise makes to draws (n, d, DRAWS), to first order."""
    e = table.scenes[number].e
    assert e.smooth is not None
    chosen = np.unique(np.linspace(0, len(e) - 1, min(GAIN_SAMPLES, len(e))).astype(int))
    G = gain(table.mechanism, e.at_samples(chosen), e.smooth.names, table.point,
             table.motion.band.cutoff)  # fmt: skip
    G = G.transpose(0, 1, 3, 2).reshape(*G.shape[:2], -1).astype(np.float32)
    for run, spline in e.smooth.runs:
        count, J = spline.c.shape
        c = _coefficients(spline, random).reshape(count, J * DRAWS)
        for start in range(run.start, run.stop, CHUNK):
            sample = np.arange(start, min(start + CHUNK, run.stop))
            du = evaluated(spline.basis, c, e.t[sample]).astype(np.float32)
            after = np.clip(np.searchsorted(chosen, sample), 1, len(chosen) - 1)
            share = (sample - chosen[after - 1]) / (chosen[after] - chosen[after - 1])
            share = share.astype(np.float32)[:, None, None]
            between = G[after - 1] + share * (G[after] - G[after - 1])
            out[sample] += between @ du.transpose(1, 0, 2).reshape(len(sample), 3 * J, DRAWS)


def _of_values(contest: Contest, errors: Covariance, random: np.random.Generator) -> Array:
    """Return draws (N, d, DRAWS) of what errors of known values make in the table's rows."""
    table = contest.table
    model = table.mechanism.freed(errors.names)
    columns = Columns.of(model)
    present = np.array([name in columns.index for name in errors.names], dtype=bool)
    at = [columns.index[name] for name in np.array(errors.names)[present]]
    A = Table.of(model, columns, table.motion, table.point).A[:, :, at]
    return np.asarray(A @ (errors.root[present] @ random.standard_normal((len(present), DRAWS))))


def _coefficients(spline: Spline, random: np.random.Generator) -> Array:
    """c (count, coordinates, DRAWS) with U c of unit noise."""
    import scipy.sparse as sp  # takes half a second to import
    from scipy.sparse.linalg import splu

    count, d = spline.c.shape
    size = count * d
    row = np.repeat(np.arange(size), WIDTH * d)
    column = (spline.first[:, None] * d + np.arange(WIDTH * d)).ravel()
    U = sp.csc_matrix((spline.U.reshape(size, -1).ravel(), (row, column)), shape=(size, size))
    return splu(U).solve(random.standard_normal((size, DRAWS))).reshape(count, d, DRAWS)


def runs(table: Table) -> list[slice]:
    """Return the stretches of rows in equal steps of one experiment."""
    step = np.diff(table.sample)
    usual = np.median(step) if len(step) else 1
    new = (np.diff(table.experiment) != 0) | (step != usual)
    edges = np.concatenate([[0], np.flatnonzero(new) + 1, [len(table.sample)]]).astype(int)
    return [slice(a, b) for a, b in pairwise(edges)]


def judging(contest: Contest) -> Contest:
    """The contest with surrogates of its residual and draws of noise as right-hand sides.

    What the model takes of any noise is given back to the surrogates, frequency by frequency, as
    random series show it that lose the same way.
    """
    random, steps = np.random.default_rng(contest.seed), runs(contest.table)
    regression = contest.regression
    r = _series(contest, [y[:, :1] for y in regression.residual])[:, :, 0]
    tries = surrogates(r, steps, TRIALS, random, known=contest.use) * contest.use[:, :, None]
    parts = regression.parts
    trial_regression = regression.with_targets([_rows(contest, part, tries) for part in parts])
    left_series = _series(contest, trial_regression.residual)
    remaining = [remaining_power(left_series[run], tries[run]) for run in steps]
    drawn = surrogates(r, steps, SURROGATES, random, remaining, contest.use)
    Y = []
    for part in parts:
        more = [part.Y[:, :1], _rows(contest, part, drawn)]
        if contest.draws is not None:  # of a size that the residual has, at most
            x, rms = _rows(contest, part, contest.draws.rows), _rms(_rows(contest, part, r))
            more.append(x * rms / np.maximum(_rms(x), rms))
        Y.append(np.column_stack(more))
    return contest.with_model(regression.with_targets(Y))


def path_shares(
    regression: PartialRegression, u: int, effects: Sequence[Sequence[Index]], steps: int,
    draws: int,
) -> Array:  # fmt: skip
    """Return the shares (steps, 1 + draws) of the squares of coordinate u that 1, 2, … effects
    explain in all rows, for the residual and for draws of the right-hand sides: of surrogates, then
    of noise, as shares of the residual, if that is larger.

    Args:
        effects: groups of columns of each, one a start of its search.

    Each effect is the one that explains most beside those before it (orthogonal matching pursuit):

        Δ = t_gᵀ T_gg⁻¹ t_g        T = S − S_c S_cc⁻¹ S_cᵀ, t = s − S_c S_cc⁻¹ s_c        c: chosen
    """
    groups = [group for starts in effects for group in starts]
    owner = np.repeat(np.arange(len(effects)), [len(starts) for starts in effects])
    parts, weight = regression.parts, regression.weight
    X = [part.taken(np.concatenate(groups)) * weight[part.coordinate] for part in parts]
    P = sum(q.T @ x for q, x in zip(regression.Q, X, strict=True))
    local_parts = [i for i, part in enumerate(parts) if part.coordinate == u]
    C = np.concatenate([X[i] - regression.Q[i] @ P for i in local_parts])
    r = np.concatenate([regression.residual[i] for i in local_parts])[:, : 1 + draws]
    squares = np.maximum((r**2).sum(axis=0), 1e-300)
    squares[1 + SURROGATES :] = np.maximum(squares[1 + SURROGATES :], squares[0])
    size = np.sqrt((C**2).sum(axis=0))
    C = C / np.where(size > NEW_COLUMN, size, np.inf)
    S, s = C.T @ C, C.T @ r
    ends, sizes = np.cumsum([0, *map(len, groups)]), np.array([*map(len, groups)])
    owner_of_column = np.repeat(owner, sizes)

    @cache
    def with_chosen(chosen: tuple[int, ...]) -> tuple[Array, list[tuple[Index, Array]]]:
        """S_c S_cc⁻¹, and by size n the columns (groups, n) and T_gg⁻¹ of other effects' groups."""
        c = np.array(chosen, dtype=int)
        K = S[:, c] @ linear.pinv(S[np.ix_(c, c)], rcond=RANK, hermitian=True)
        free, others = ~np.isin(owner, owner_of_column[c]), list[tuple[Index, Array]]()
        for n in np.unique(sizes[free]):
            at = ends[:-1][free & (sizes == n)][:, None] + np.arange(n)
            T = S[at[:, :, None], at[:, None]] - K[at] @ S[c[:, None], at[:, None]]
            others.append((at, linear.inverse(T)))
        return K, others

    shares = np.zeros((steps, r.shape[1]))
    for draw in range(r.shape[1]):
        chosen = tuple[int, ...]()
        for step in range(steps):
            K, others = with_chosen(chosen)
            t, most, best = s[:, draw] - K @ s[[*chosen], draw], 0.0, tuple[int, ...]()
            for at, inverse in others:
                falls = np.einsum("gi,gij,gj->g", t[at], inverse, t[at])
                if falls[i := int(falls.argmax())] > most:
                    most, best = float(falls[i]), tuple(at[i].tolist())
            shares[step, draw] = (shares[step - 1, draw] if step else 0.0) + most / squares[draw]
            chosen += best
    return shares


def _rows(contest: Contest, part: Part, x: Array) -> Array:
    """Return the rows (m, ...) of a part in series x (N, d, ...)."""
    return x[contest.use[:, part.coordinate], part.coordinate]


def _series(contest: Contest, Y: Sequence[Array]) -> Array:
    """Return series (N, d, count) of weighted rows Y (m, count) of every part; zero elsewhere."""
    series = np.zeros((*contest.table.b.shape, Y[0].shape[1]))
    for u, y in zip([part.coordinate for part in contest.regression.parts], Y, strict=True):
        series[contest.use[:, u], u] = y / contest.regression.weight[u]
    return series


def _rms(x: Array) -> Array:
    """Return the rms of each column of x (m, …), at least rounding, also of no row."""
    return np.maximum(np.sqrt((x**2).sum(axis=0) / max(len(x), 1)), np.finfo(x.dtype).tiny)


def null_by_coordinate(regression: PartialRegression, null: Array) -> Array:
    """Return the shares (groups, d, draws) of each coordinate's squares that columns explain of
    random residuals, from their falls (groups, d, draws); see `null_shares`.
    """
    before = _squares_before(regression)
    shares = regression.explained_by_coordinate(null.transpose(0, 2, 1), before)
    return shares.transpose(0, 2, 1)


def _squares_before(regression: PartialRegression) -> Array:
    """Return the left-out squares (draws, d) of random residuals; noise counts as the residual."""
    before = regression.null_losses.T.copy()
    before[SURROGATES:] = np.maximum(before[SURROGATES:], regression.losses.sum(axis=0))
    return before


def null_shares(regression: PartialRegression, gains: Gains) -> Array:
    """Return the shares (groups, draws) of surrogates, then of noise, that columns explain."""
    return regression.explained(gains.null.transpose(0, 2, 1), _squares_before(regression))
