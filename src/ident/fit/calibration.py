"""The error budget of a fit: what a calibration that is a little wrong does to its parameters.

    b = A β + N S η + ε,    η ~ N(0, 1)         N: columns of the causes, S: their prior scales

N is the change of b − A x that one unit of each cause would make, through the rows' filter and the
closures like all columns; β are the base parameters. With H the normal matrix of [A, N S] in rows
divided by their noise, and P = diag(0, 1) the prior of η,

    [β; η] = (H + P)⁻¹ [A, N S]ᵀ b              β: the marginal estimate
    Cov β  = (noise)  +  C C ᵀ                  C = (H + P)⁻¹ restricted to β, η: by cause

The first part is what noise of the rows makes of that estimate, by the jackknife of all standard
errors; the columns of C are what one standard deviation of each cause makes, and their squares add
up: the budget. Sources: JCGM 100 (GUM), 2008, sect. 5; mixed estimation (Theil, Goldberger, Int.
Econ. Rev. 2(1), 1961).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ident.equations.problem import Problem, block_edges, triangles
from ident.equations.rows import Rows
from ident.equations.table import SMOOTH, Table
from ident.equations.unknowns import Columns, Point
from ident.errors import IdentError
from ident.finding import Finding
from ident.information import linear
from ident.information.blocks import Block, Information
from ident.information.chance import CERTAIN, covariance
from ident.information.estimate import MATERIAL, Estimate, estimate, term_sizes
from ident.information.linear import Triangle
from ident.mechanism.causes import Cause, causes_of
from ident.motion import Motion
from ident.text import listed

ROUNDS = 2  # work: of columns at the parameters that they lead to
SAMPLES = 8_000  # work: that columns are made of, as few as smooth series allow
STRETCHES = 16  # work: of a log with more
PASSES = 6  # work: over the weights of the coordinates
SETTLED = 1e-3  # numerics: of a weight: a smaller change is the last
SMALLER = (1.0, 0.1, 0.01)  # work: shares of a prior scale at which a column is taken
TRADES = 0.9  # level: correlation of two causes' errors from which one stands for the other
MOST_NAMED = 3  # shown: causes that trade with one that is named


@dataclass(frozen=True, eq=False)
class Budget:
    """What calibration errors do to the base parameters of a fit.

    Attributes:
        causes: c of them; left_out: names of those of which no column could be made.
        noise: covariance (n, n) of the marginal estimate by the noise of the rows.
        parts: (n, c) change of the base parameters by one standard deviation of each cause.
        propagated: (n, c) the same of the least-squares estimate, in which no cause is fitted.
        shift: (n,) marginal estimate less least squares.
        remaining: (d,) squared residual over that of least squares.
        values, errors: (c,) of the causes, in their prior scales; correlation: (c, c) of these.
    """

    causes: tuple[Cause, ...]
    left_out: tuple[str, ...]
    noise: np.ndarray
    parts: np.ndarray
    propagated: np.ndarray
    shift: np.ndarray
    remaining: np.ndarray
    values: np.ndarray
    errors: np.ndarray
    correlation: np.ndarray

    @property
    def believed(self) -> bool:
        """Whether no error is far outside of its prior."""
        return bool((np.abs(self.values) <= CERTAIN).all())

    @property
    def covariance(self) -> np.ndarray:
        """Covariance (n, n) of the marginal estimate, of noise and calibration."""
        return self.noise + self.parts @ self.parts.T

    def findings(self) -> Iterator[Finding]:
        """Report causes that the data put far outside of their priors."""
        far = np.flatnonzero(np.abs(self.values) > CERTAIN)
        for i in far[np.argsort(-np.abs(self.values[far]))][:1]:
            cause, size = self.causes[i], self.values[i]
            value, error = size * cause.scale, self.errors[i] * cause.scale
            trades = np.flatnonzero(np.abs(self.correlation[i]) > TRADES)
            order = sorted(trades[trades != i], key=lambda j: -abs(self.correlation[i, j]))
            rivals = [self.causes[j].name for j in order[:MOST_NAMED]]
            also = f", or {listed(rivals)}, which this log cannot tell from it" if rivals else ""
            unit = "" if cause.unit == "1" else f" {cause.unit}"
            text = (
                f"{cause.name}: {value:.2g} ± {error:.1g}{unit}, {abs(size):.2g} times the "
                f"{cause.scale:.2g}{unit} that its calibration is stated to be good for{also}"
            )
            remedy = f"calibrate it, or state what it is: [calibration] {cause.kind}"
            yield Finding("calibration", text, remedy, (cause.place or "t",), float(size), CERTAIN)


def budget_of(problem: Problem, table: Table, fitted: Estimate) -> Budget | None:
    """Return the error budget of an estimate, in the rows `table` of its problem; None where
    nothing may be wrong, or no column of a cause is felt.

    The second round is about the parameters and causes that the first one leads to: a channel that
    is a sample late shifts the steps of dry friction, which a slope describes badly.
    """
    base, causes, left_out = fitted.base.independent, list[Cause](), list[str]()
    states = problem.motion.experiments
    logged = dict.fromkeys(name for e in states for name in e.logged)
    rate = max(e.rate for e in states)
    driven = problem.mechanism.driven
    zero = {  # a torque that is 0 because nothing pushes has no gain
        f"tau.{name}"
        for j, name in enumerate(driven)
        if not any(np.any(e.tau[:, j]) for e in states)
    }
    for cause in causes_of(problem.mechanism, tuple(logged), rate):
        if cause.place not in zero:
            causes.append(cause)
    if not causes or not len(base):
        return None
    x, values, at = fitted.x.copy(), np.zeros(len(causes)), table
    motion = _excerpt(problem.motion)
    if motion is not problem.motion:
        problem = replace(problem, motion=motion)
        at = Table.of(problem.mechanism, problem.columns, motion, table.point)
    least, every = fitted.solution.beta, problem.information.rows // table.b.shape[1]
    for number in range(ROUNDS):
        if number:
            with suppress(IdentError, np.linalg.LinAlgError):
                at = _corrected(problem, x, causes, values)
        columns_of_causes = [
            _column(at, cause, value) for cause, value in zip(causes, values, strict=True)
        ]
        felt = [
            k for k, N in enumerate(columns_of_causes) if N is not None and N[at.informed].any()
        ]
        left_out = [
            cause.name for cause, N in zip(causes, columns_of_causes, strict=True) if N is None
        ]
        causes, values = [causes[k] for k in felt], values[felt]
        if not causes:
            return None
        columns = np.stack(
            [N for N in columns_of_causes if N is not None and N[at.informed].any()], axis=-1
        )
        n, c = len(base), len(causes)
        information = _augmented(problem, at, fitted, columns, columns @ values)
        z, total, sigma = _marginal(information, fitted, at, n, c)
        if not number and (problem.stacked or len(at.t) != every):  # other rows than the fit's
            of_rows = total_of(information, sigma).restricted(np.arange(n))
            least = estimate([of_rows], np.zeros(n), np.ones(1), sigma=np.ones(1)).x
        x[base] = fitted.x[base] + z.x[:n] - least
        values = z.x[n:]
    weighted = Estimate(z.solution, z.base, sigma, total, z.fixed)
    of_causes = z.solution.C[n:, n:]
    errors = np.sqrt(np.diag(of_causes))
    return Budget(
        causes=tuple(causes),
        left_out=tuple(left_out),
        noise=covariance(information, weighted, with_prior=True)[:n, :n],
        parts=z.solution.C[:n, n:],
        propagated=_propagated(information, sigma, n),
        shift=z.x[:n] - least,
        remaining=_mean_squares(information, z.x)
        / np.maximum(_mean_squares(problem.information, fitted.x), 1e-300),
        values=values,
        errors=errors,
        correlation=of_causes / np.outer(errors, errors),
    )


def _mean_squares(information: Information, x: np.ndarray) -> np.ndarray:
    """Return the mean squared residual (d,) of unknowns x (k,)."""
    return np.array([t.residual_norm(x) ** 2 / max(t.rows, 1) for t in information.totals])


def _propagated(information: Information, sigma: np.ndarray, n: int) -> np.ndarray:
    """Return (AᵀA)⁻¹ Aᵀ N S (n, c): by how much causes move an estimate that knows of none."""
    R = total_of(information, sigma).R
    change: np.ndarray = linear.lstsq(R[:, :n], R[:, n:], rcond=None)[0]
    return change


def _excerpt(motion: Motion) -> Motion:
    """Return a motion of no more samples than budgets are made of: of longer ones, stretches."""
    cutoff = motion.band.cutoff
    steps = [max(1, int(e.rate / (SMOOTH * cutoff))) if cutoff else 1 for e in motion.experiments]
    share = SAMPLES / sum(len(e) / k for e, k in zip(motion.experiments, steps, strict=True))
    if share >= 1:
        return motion
    states = []
    for e in motion.experiments:
        length = len(e) / STRETCHES
        cuts = (int(i * length) for i in range(STRETCHES))
        pieces = (e.at_samples(slice(a, a + max(3, int(share * length)))) for a in cuts)
        states += [piece for piece in pieces if piece.usable.any()]
    return replace(motion, experiments=tuple(states))


def _corrected(
    problem: Problem, x: np.ndarray, causes: Sequence[Cause], values: np.ndarray
) -> Table:
    """Return the rows of the data and the mechanism without causes of some `values`, in units of
    their prior scales, at the parameters x (k,).
    """
    mechanism = problem.mechanism
    for cause, value in zip(causes, values, strict=True):
        (parameter,) = cause.effect.parameters
        known = {parameter.name: float(value * cause.scale)}
        mechanism += replace(cause.effect, values=known)
    point = problem.point_at(x)
    point = point.with_values(Point.prior(mechanism).values)
    return Table.of(mechanism, Columns.of(mechanism), problem.motion, point)


def _column(table: Table, cause: Cause, value: float) -> np.ndarray | None:
    """Return the change (N, d) of b − A x by one standard deviation of a cause at a `value` of it,
    by a difference over a share of it: so that friction which jumps counts as it does in the mean.
    None if no difference can be made: a loop that cannot be closed with another length, say.
    """
    effect, (parameter,) = cause.effect, cause.effect.parameters
    if not effect.corrects:
        C, felt = table.effect_columns(effect, [{}])
        column = np.zeros(table.b.shape)
        column[:, felt] = C[:, :, 0]
        return cause.scale * column
    for share in SMALLER:
        with suppress(IdentError, np.linalg.LinAlgError):
            step, shape = share * cause.scale, {parameter.name: value * cause.scale}
            column = cause.scale * table.sensitivity(effect, shape, parameter.name, step)
            if np.isfinite(column).all():
                return column
    return None


def _augmented(
    problem: Problem, table: Table, fitted: Estimate, columns: np.ndarray, known: np.ndarray
) -> Information:
    """Return the rows of [A_I, N S] as information, with what is corrected in the table already
    (N, d) given back; unknowns that are held stay at their prior.
    """
    base, fixed = fitted.base.independent, np.flatnonzero(fitted.fixed)
    b = table.b - table.A[:, :, fixed] @ fitted.x[fixed] + known
    A = np.concatenate([table.A[:, :, base], columns], axis=2)
    blocks, cutoff = list[Block](), problem.motion.band.cutoff
    supports = [np.arange(A.shape[2])] * b.shape[1]
    for number, e in enumerate(problem.motion.experiments):
        at = table.experiment == number
        if at.any():
            rows = Rows(
                table.t[at], table.sample[at], A[at], b[at], table.tau[at],
                table.informed[at], table.moving[at], table.rest[at],
            )  # fmt: skip
            edges = block_edges(cutoff, e.t[0], e.t[-1], len(e), e.poses)
            blocks += triangles(number, [rows], edges, supports)
    return Information.of(blocks, A.shape[2], b.shape[1])


def total_of(information: Information, sigma: np.ndarray) -> Triangle:
    """Return all rows, each divided by its coordinate's noise."""
    return information.total(sigma)


def _marginal(
    information: Information, fitted: Estimate, table: Table, n: int, c: int
) -> tuple[Estimate, Triangle, np.ndarray]:
    """Return the estimate of [β; η], its triangle with the priors' rows, and the noise (d,) of the
    coordinates' rows: what is left, but no less than a share of the terms that cancel in them.
    """
    totals = information.totals
    prior = Triangle.of(np.eye(n + c)[n:], np.zeros(c))
    torque = np.sqrt((table.tau**2).mean(axis=0))
    start = np.concatenate([fitted.solution.beta, np.zeros(c)])
    floor = MATERIAL * np.maximum(term_sizes(totals, start), torque)
    sigma = np.array(fitted.sigma) if len(fitted.sigma) == len(totals) else None
    if sigma is None:
        rms = [t.residual_norm(start) / np.sqrt(max(t.rows, 1)) for t in totals]
        sigma = np.maximum(rms, floor)
    sigma = np.where(sigma > 0, sigma, 1.0)
    held, poses = (
        [sum(b.held_rows for b in information if b.coordinate == u) for u in range(len(sigma))],
        table.motion.poses,
    )
    at_rest = np.array([not poses and t.rows == n for t, n in zip(totals, held, strict=True)])
    one = np.ones(1)
    for _ in range(PASSES):
        total = Triangle.merge([total_of(information, sigma), prior])
        z = estimate([total], np.zeros(n + c), one, sigma=one)
        rms = [t.residual_norm(z.x) / np.sqrt(max(t.rows, 1)) for t in totals]
        new = np.maximum(rms, floor)
        new = np.where((new > 0) & ~at_rest, new, sigma)
        if np.abs(np.log(new / sigma)).max() < SETTLED:
            break
        sigma = new
    return z, total, sigma
