"""The error budget of a fit: what a calibration that is a little wrong does to its parameters.

    b = A β + N S η + ε,    η ~ N(0, 1)         N: columns of the causes, S: their prior scales

N is the change of b − A x that one unit of each cause would make, through the rows' filter and the
closures like all columns; β are the base parameters. With H the normal matrix of [A, N S] in rows
divided by their noise, and P = diag(0, 1) the prior of η,

    [β; η] = (H + P)⁻¹ [A, N S]ᵀ b              β: the marginal estimate, within its limits
    Cov β  = (noise)  +  C C ᵀ                  C = (H + P)⁻¹ restricted to β, η: by cause

The first part is what noise of the rows makes of that estimate. Rows are divided by a noise that
counts how alike neighbours are, and that holds the steps of friction which jitter between samples;
its covariance is averaged with what blocks of time scatter (`information.chance`). The columns of C
are what one standard deviation of each cause makes, and their squares add up: the budget. Where
torques and motion are weighed together, the rows are those that the motion's noise whitens
(`fit.calibration_rows`). Sources: JCGM 100 (GUM), 2008, sect. 5; mixed estimation (Theil,
Goldberger, Int. Econ. Rev. 2(1), 1961).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ident.effects import KINDS
from ident.equations.rows import Rows
from ident.errors import IdentError
from ident.finding import Finding
from ident.fit.calibration_rows import FitRows
from ident.information import linear
from ident.information.blocks import Information
from ident.information.chance import moderated_covariance
from ident.information.estimate import ROUNDING, Estimate, estimate, least_noise, term_sizes
from ident.information.evidence import CERTAIN
from ident.information.linear import Triangle
from ident.mechanism.causes import CalibrationError
from ident.text import listed
from ident.threads import on_one_thread

ROUNDS = 2  # work: of columns at the parameters that they lead to
NEAR = 0.1  # work: prior scales, below which a second round is saved: errors differ by 3 %
PASSES = 6  # work: over the weights of the coordinates
SETTLED = 1e-3  # numerics: of a weight: a smaller change is the last
TRADES = 0.9  # level: correlation of two causes' errors from which one stands for the other
LIBRARY = {"late_torque": "delay"}  # kinds of calibration errors: the library's for the same
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

    causes: tuple[CalibrationError, ...]
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

    def shares(
        self, gradient: np.ndarray, by_noise: np.ndarray, parts: np.ndarray
    ) -> dict[str, float]:
        """Return the share of each cause, and of `noise`, in the variance of a value, the largest
        first.

        Args:
            gradient: (n,) of the value by the base parameters.
            by_noise: (n, n) covariance of these by all but the calibration.
            parts: (n, c) their change by one standard deviation of each cause.
        """
        squares, noise = (gradient @ parts) ** 2, float(gradient @ by_noise @ gradient)
        total = noise + float(squares.sum()) or 1.0
        shares = {"noise": noise / total}
        shares |= {c.name: float(x) / total for c, x in zip(self.causes, squares, strict=True)}
        return dict(sorted(shares.items(), key=lambda share: -share[1]))

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
            kind, effects = LIBRARY.get(cause.effect.kind, cause.effect.kind), tuple[str, ...]()
            if kind in KINDS and not rivals:
                effects = (f"{kind}:{','.join(cause.effect.joints)}",)
                remedy += f"; or give --with {effects[0]}"
            elif cause.kind == "lateness":
                to = "earlier" if value > 0 else "later"
                remedy += f"; or shift column {cause.place} {abs(1e3 * value):.2g} ms {to}"
            where = (cause.place or "t",)
            yield Finding("calibration", text, remedy, where, float(size), CERTAIN, effects)


@on_one_thread
def budget_of(of_fit: FitRows, fitted: Estimate) -> Budget | None:
    """Return the error budget of an estimate, in the rows that it was made of; None where nothing
    may be wrong, or no column of a cause is felt.

    The second round is about the parameters and causes that the first one leads to, unless they
    are NEAR: a channel that is a sample late shifts the steps of dry friction, which a slope
    describes badly.
    """
    base, causes, left_out = fitted.base.independent, [*of_fit.causes()], list[str]()
    if not causes or not len(base):
        return None
    x, values, at = fitted.x.copy(), np.zeros(len(causes)), of_fit.excerpt()
    least, n = fitted.solution.beta, len(base)
    for number in range(ROUNDS):
        if number:
            if np.abs(values).max(initial=0.0) < NEAR:
                break
            with suppress(IdentError, np.linalg.LinAlgError):
                at = at.corrected(x, causes, values)
        columns = at.columns(causes)
        rounding = ROUNDING * float(at.torque.max())
        felt = [k for k, N in enumerate(columns) if N is not None and _size(N, at) > rounding]
        left_out += [c.name for c, N in zip(causes, columns, strict=True) if N is None]
        causes, values = [causes[k] for k in felt], values[felt]
        if not causes:
            return None
        N = np.stack([column for k in felt if (column := columns[k]) is not None], axis=-1)
        rows, jitter = at.with_causes(fitted, N, N @ values), at.jitter(x, causes)
        information, z, total, sigma, white = _weighed(rows, jitter, fitted, at, len(causes))
        if len(z.base.dependent):  # a log that is spoilt: which of its errors is open
            kept = np.setdiff1d(np.arange(len(causes)), z.base.dependent - n)
            if (z.base.dependent < n).any() or not len(kept):
                return None
            left_out += [c.name for k, c in enumerate(causes) if k not in kept]
            causes, values, N = [causes[k] for k in kept], values[kept], N[..., kept]
            rows = at.with_causes(fitted, N, N @ values)
            information, z, total, sigma, white = _weighed(rows, jitter, fitted, at, len(causes))
            if len(z.base.dependent):
                return None
        if not number and not at.same_as(of_fit):
            of_rows = information.total(sigma).restricted(np.arange(n))
            of_excerpt = estimate([of_rows], np.zeros(n), np.ones(1), sigma=np.ones(1))
            least = _within_limits(of_excerpt, fitted).x
        x[base] = fitted.x[base] + z.x[:n] - least
        values = z.x[n:]
    weighted = Estimate(z.solution, z.base, sigma, total, z.fixed)
    of_causes, parts = z.solution.C[n:, n:], z.solution.C[:n, n:]
    errors = np.sqrt(np.diag(of_causes))
    return Budget(
        causes=tuple(causes),
        left_out=tuple(left_out),
        noise=at.noise(
            moderated_covariance(information, weighted, white)[:n, :n], white[:n, :n], weighted
        ),
        parts=parts,
        propagated=_propagated(information, sigma, n),
        shift=z.x[:n] - least,
        remaining=at.remaining(information, z.x, fitted),
        values=values,
        errors=errors,
        correlation=of_causes / np.outer(errors, errors),
    )


def _size(N: np.ndarray, of: FitRows) -> float:
    """Return the largest entry of a column (N, d) in rows that inform."""
    return float(np.abs(N[of.informed]).max(initial=0.0))


def _propagated(information: Information, sigma: np.ndarray, n: int) -> np.ndarray:
    """Return (AᵀA)⁻¹ Aᵀ N S (n, c): by how much causes move an estimate that knows of none."""
    R = information.total(sigma).R
    change: np.ndarray = linear.lstsq(R[:, :n], R[:, n:], rcond=None)[0]
    return change


def _weighed(
    rows: Rows, jitter: np.ndarray, fitted: Estimate, of: FitRows, c: int
) -> tuple[Information, Estimate, Triangle, np.ndarray, np.ndarray]:
    """Return rows whose weights hold what jitters (N, d) in them, and `_marginal` of these."""
    if of.white or not jitter.any():
        information = of.reduced(rows)
        return information, *_marginal(rows, information, fitted, of, c)
    whole = of.reduced(rows, whole=True)
    result = _marginal(rows, whole, fitted, of, c)
    for _ in range(PASSES):
        sigma = result[2]
        w = 1 / np.sqrt(1 + jitter / sigma**2)
        weighted = replace(rows, A=rows.A * w[:, :, None], b=rows.b * w)
        whole = of.reduced(weighted, whole=True)
        result = _marginal(weighted, whole, fitted, of, c)
        if np.abs(np.log(result[2] / sigma)).max() < NEAR:
            break
    information = of.reduced(weighted)
    vars(information).update(totals=whole.totals)  # of the same rows
    return information, *result


def _within_limits(z: Estimate, fitted: Estimate) -> Estimate:
    """Return the estimate of [β; η] whose β are at the limits at which the fit's are."""
    places = np.flatnonzero(np.isin(fitted.base.independent, fitted.at_limit))
    return z.limited(places, fitted.solution.beta[places])


def _marginal(
    rows: Rows, information: Information, fitted: Estimate, of: FitRows, c: int
) -> tuple[Estimate, Triangle, np.ndarray, np.ndarray]:
    """Return the estimate of [β; η], its triangle with the priors' rows, the noise (d,) by which
    the coordinates' rows are divided, and what noise of that kind makes of the estimate, (n + c,
    n + c).

    Of a filtered residual a few neighbouring rows tell as much as one of white noise, so its noise
    is larger than its rms: against a prior, rows count for what they tell. It is no less than a
    share of the terms that cancel in the rows, and 1 where these are divided by their noise.
    """
    totals, one, n = information.totals, np.ones(1), information.k - c
    prior = Triangle.of(np.eye(n + c)[n:], np.zeros(c))
    if of.white:
        total = Triangle.merge([information.total(one), prior])
        z = _within_limits(estimate([total], np.zeros(n + c), one, sigma=one), fitted)
        return z, total, one, _by_noise(z, [information.total(one)], one, one)
    start = np.concatenate([fitted.solution.beta, np.zeros(c)])
    floor = least_noise(term_sizes(totals, start), of.torque)
    sigma = np.array(fitted.sigma) if len(fitted.sigma) == len(totals) else None
    if sigma is None:
        rms = [t.residual_norm(start) / np.sqrt(max(t.rows, 1)) for t in totals]
        sigma = np.maximum(rms, floor)
    sigma = np.where(sigma > 0, sigma, 1.0)
    rest_rows = [
        sum(b.rest_count for b in information if b.coordinate == u) for u in range(len(sigma))
    ]
    at_rest = np.array(
        [not of.poses and t.rows == count for t, count in zip(totals, rest_rows, strict=True)]
    )
    for _ in range(PASSES):
        total = Triangle.merge([information.total(sigma), prior])
        z = _within_limits(estimate([total], np.zeros(n + c), one, sigma=one), fitted)
        noise = np.where(at_rest, sigma, _noise_of(z, totals, sigma, of.repeated(rows, z.x)))
        new = np.where(at_rest, sigma, np.maximum(noise, floor))
        new = np.where(new > 0, new, sigma)
        if np.abs(np.log(new / sigma)).max() < SETTLED:
            break
        sigma = new
    return z, total, sigma, _by_noise(z, totals, sigma, np.minimum(noise, sigma))


def _noise_of(
    z: Estimate, totals: Sequence[Triangle], sigma: np.ndarray, neighbours: np.ndarray
) -> np.ndarray:
    """Return the noise (d,) of white rows that tell as much as those of a residual of which so many
    are alike, `neighbours` (d,), without what the estimate took out of it.
    """
    noise = np.zeros(len(totals))
    for u, (t, of_one) in enumerate(zip(totals, neighbours, strict=True)):
        R = t.R[:, z.base.independent] / sigma[u]
        taken = min(of_one * float(np.sum(R @ z.solution.C * R)), t.rows / 2)
        noise[u] = np.sqrt(of_one / max(t.rows - taken, 1)) * t.residual_norm(z.x)
    return noise


def _by_noise(
    z: Estimate, totals: Sequence[Triangle], sigma: np.ndarray, noise: np.ndarray
) -> np.ndarray:
    """Return the covariance of an estimate in rows divided by `sigma` (d,) that noise makes."""
    independent, middle = z.base.independent, 0.0
    for t, divisor, size in zip(totals, sigma, noise, strict=True):
        R = t.R[:, independent] * size / divisor**2
        middle = middle + R.T @ R
    return np.asarray(z.solution.C @ middle @ z.solution.C)
