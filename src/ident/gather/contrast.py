"""One log against others in the base parameters: what differs, and how sure that is.

The formulas are in `gather.disagree`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from ident.equations.columns import Columns
from ident.fit.accumulate import Cell
from ident.fit.covariance import FEWEST_SQUARES, long_run, scores
from ident.fit.estimate import Estimate

UNKNOWN = 1e-12  # of the largest eigenvalue of H, below which logs do not tell
BELIEVED = 0.5  # of ν: far out in the tail it counts that how long blocks are alike is estimated
CERTAIN = 1e-6  # a block that is all that is known of a direction leaves no residual there
QUIET = 0.01  # of σ²: a log is believed to have no less noise


@dataclass(frozen=True, eq=False)
class Contrast:
    """One log against others.

    Attributes:
        delta, stderr: (k,) by how much each unknown alone would differ; NaN where it tells nothing.
        falls: (k,) how much the squared error would fall with it, δ² h.
        p_value: chance of the largest of them.
        parts: by body or effect, its share of the excess of squared error; fewest unknowns first.
    """

    delta: np.ndarray
    stderr: np.ndarray
    falls: np.ndarray
    p_value: float
    parts: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Logs:
    """Logs in the n base parameters, scaled to columns of unit norm.

    Attributes:
        H, g: by log (n, n) and (n,), at the estimate; noise: by log s².
        S: by log (n, n), covariance of g, of its blocks in its own fit; nu: by log, the number of
            squares that this rests on.
        ways: (n, k) what a unit of each unknown changes of the base parameters.
        parts: unknowns by body or effect, those of the fewest first.
    """

    H: Mapping[int, np.ndarray]
    g: Mapping[int, np.ndarray]
    noise: Mapping[int, float]
    S: Mapping[int, np.ndarray]
    nu: Mapping[int, float]
    ways: np.ndarray
    parts: Mapping[str, list[int]]

    @classmethod
    def of(cls, cells: Sequence[Cell], estimate: Estimate, columns: Columns) -> Logs:
        """From the cells of all logs, an estimate of all of them, and names of its unknowns."""
        base = estimate.base
        norm = estimate.factor.column_norms()[base.independent]
        ways = np.zeros((base.rank, len(estimate.solution.x)))
        ways[np.arange(base.rank), base.independent] = 1.0
        ways[:, base.dependent] = base.K
        by_log: dict[int, list[Cell]] = {}
        for cell in cells:
            by_log.setdefault(cell.experiment, []).append(cell)
        H, g, noise, S, nu = {}, {}, {}, {}, {}
        for log, mine in by_log.items():
            keys, H_b, g_b, _ = scores(mine, estimate, norm)
            if not keys:
                continue
            H[log], g[log] = H_b.sum(axis=0), g_b.sum(axis=0)
            inverse, open_ = _inverse(H[log])
            own = inverse @ g[log]
            squares, rows = _squares(mine, estimate)
            spare = max(rows - base.rank + open_.shape[1], 1)
            noise[log] = max((squares - g[log] @ own) / spare, QUIET)
            errors = _unfitted(H[log], H_b, g_b - H_b @ own)
            S[log], each = long_run(keys, errors, np.diagonal(H_b, axis1=1, axis2=2))
            nu[log] = float(np.median(each))
        return cls(H, g, noise, S, nu, ways * norm[:, None], _parts(columns))

    def against(self, agreeing: Sequence[int], log: int) -> Contrast:
        """A log (its number) against all others of those that agree."""
        others = [i for i in agreeing if i != log]
        H, H_o = self.H[log], np.sum([self.H[i] for i in others], axis=0)
        inverse, open_ = _inverse(H_o)
        beta = inverse @ np.sum([self.g[i] for i in others], axis=0)
        # what the others leave open, this log may choose
        free = open_ @ np.linalg.pinv(open_.T @ H @ open_, rcond=UNKNOWN, hermitian=True) @ open_.T
        own = beta + free @ (self.g[log] - H @ beta)
        W = self.ways - free @ (H @ self.ways)
        h = _along(H, W)
        tells = h > UNKNOWN * _along(H + H_o, self.ways)
        if not tells.any():
            nothing = np.full(len(tells), np.nan)
            return Contrast(nothing, nothing, nothing, 1.0, {})
        W, h, g = W[:, tells], h[tells], self.g[log] - H @ own
        delta, project = W.T @ g / h, H @ W / h  # of an error of β onto δ
        more, nu = self._spread({i: S / self.noise[i] for i, S in self.S.items()}, W)
        white = _along(np.sum(list(self.H.values()), axis=0), W)
        V = self.noise[log] * np.maximum(more / white, 1.0) / h
        V_o, nu_o = self._spread({i: self.S[i] for i in others}, inverse @ project)
        size = np.sqrt(V + V_o)
        nu = BELIEVED * (V + V_o) ** 2 / (V**2 / nu + V_o**2 / nu_o)
        p = 2 * student.sf(np.abs(delta / size), np.maximum(nu, FEWEST_SQUARES))
        joint = W.T @ H @ W / np.outer(h, h) + project.T @ inverse @ project
        known, stderr, falls = np.full((3, len(tells)), np.nan)
        known[tells], stderr[tells], falls[tells] = delta, size, delta**2 * h
        shares = self._shares(H, g, W, np.flatnonzero(tells))
        return Contrast(known, stderr, falls, _of_many(p, joint), shares)

    def fall(self, agreeing: Sequence[int], log: int) -> float:
        """Of the squared error, if a log may have parameters that those agreeing have not."""
        others = [i for i in agreeing if i != log]
        falls = [self._explained(each) for each in ([log], others, agreeing)]
        return falls[0] + falls[1] - falls[2]

    def _explained(self, logs: Sequence[int]) -> float:
        """How much the squared error of some logs falls from the estimate to their own fit."""
        H, g = (np.sum([each[i] for i in logs], axis=0) for each in (self.H, self.g))
        return float(g @ _inverse(H)[0] @ g)

    def _spread(
        self, covariances: Mapping[int, np.ndarray], D: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Variances (m,) of sums over logs along directions D (n, m), and the numbers of squares
        that they rest on (Satterthwaite).
        """
        each = _along(np.array(list(covariances.values())), D)
        nu = np.array([self.nu[log] for log in covariances])[:, None]
        total, tiny = each.sum(axis=0), np.finfo(float).tiny
        return total, total**2 / np.maximum((each**2 / nu).sum(axis=0), tiny)

    def _shares(
        self, H: np.ndarray, g: np.ndarray, W: np.ndarray, which: np.ndarray
    ) -> Mapping[str, float]:
        """How much of the fall of squared error each part of the model brings by itself."""
        whole = g @ np.linalg.pinv(H, rcond=UNKNOWN, hermitian=True) @ g
        found = {}
        for name, unknowns in self.parts.items():
            D = W[:, np.isin(which, unknowns)]
            fall = (D.T @ g) @ np.linalg.pinv(D.T @ H @ D, rcond=1e-9, hermitian=True) @ (D.T @ g)
            found[name] = float(np.clip(fall / whole, 0.0, 1.0)) if whole > 0 else 0.0
        return found


def _along(S: np.ndarray, D: np.ndarray) -> np.ndarray:
    """dᵀ S d (…, m) for each direction d of D (n, m), of one S (n, n) or several."""
    return np.asarray((D * (S @ D)).sum(axis=-2))


def _inverse(H: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """In the directions that H tells, and the others (n, n − rank)."""
    values, vectors = np.linalg.eigh(H)
    told = values > UNKNOWN * values.max(initial=0.0)
    return (vectors[:, told] / values[told]) @ vectors[:, told].T, vectors[:, ~told]


def _unfitted(H: np.ndarray, H_b: np.ndarray, g_b: np.ndarray) -> np.ndarray:
    """(B, n) scores of blocks at the fit of all others, from those at the fit that has them.

    With K_b = H^(-1/2) H_b H^(-1/2), H^(1/2) (1 − K_b)⁻¹ H^(-1/2) g_b; a fit takes noise for its
    own, so that what it leaves would look too quiet (CR3, as in `fit.covariance`).
    """
    values, vectors = np.linalg.eigh(H)
    told = values > UNKNOWN * values.max(initial=0.0)
    root = np.sqrt(values[told])
    down, up = vectors[:, told] / root, vectors[:, told] * root
    shares, axes = np.linalg.eigh(down.T @ H_b @ down)
    along = np.einsum("bij,bi->bj", axes, g_b @ down) / np.maximum(1 - shares, CERTAIN)
    return np.einsum("bij,bj->bi", axes, along) @ up.T


def _squares(mine: Sequence[Cell], estimate: Estimate) -> tuple[float, int]:
    """Of the residuals over σ of a log at the estimate, and rows."""
    x, sigma = estimate.solution.x, estimate.sigma
    left = [c.factor.residual_norm(x[c.support]) / sigma[c.coordinate] for c in mine]
    return float(np.sum(np.square(left))), sum(c.factor.rows for c in mine)


def _of_many(p: np.ndarray, covariance: np.ndarray) -> float:
    """Chance that the smallest of m p-values is as small as that of these."""
    if not len(p):
        return 1.0
    size = np.sqrt(np.diag(covariance))
    values = np.maximum(np.linalg.eigvalsh(covariance / np.outer(size, size)), 0.0)
    m = np.sqrt(values).sum() ** 2 / values.sum()
    return float(-np.expm1(m * np.log1p(-min(p.min(), 1.0 - 1e-16))))


def _parts(columns: Columns) -> Mapping[str, list[int]]:
    """Unknowns by body and by effect, those of the fewest first."""
    found: dict[str, list[int]] = {}
    for i in range(len(columns.rigid)):
        found.setdefault(columns.names[i].rpartition(".")[0], []).append(i)
    for effect, places in columns.effects:
        if own := [int(place) for place in places if place >= 0]:
            found[effect.label] = own
    return dict(sorted(found.items(), key=lambda item: len(item[1])))
