"""The fit nearest to the data among those that are physically possible.

    x = argmin ‖A (x − x_u)‖² + ‖A_0 (x − x_0)‖² + ρ² ‖W (x − a)‖²    such that limits(x)

x_u is least squares without limits, A the rows that it rests on, in units of their noise. The
anchor a is the prior, or the nearest possible to it. It counts as if every body was known to
1/ρ = 100 times its own mass and size: that decides what the data leave open, unknowns in no base
parameter and those that were held at the prior, and moves a base parameter that the data know to
σ body sizes by (σ/100)² of its distance from the prior, which is nothing. A_0 are the rows at
standstill, where dry friction is open: they do not inform, but a choice is not made at their
expense. Those of a coordinate count as a tenth of one row, in units of the error there of x_0, the
better one of x_u and a.

W measures a body's change by its own pseudo-inertia, ‖S^-½ (P − P_a) S^-½‖: the second-order part
of the affine-invariant distance of bodies (T. Lee, P. Wensing, F. Park, IEEE T-RO 36(1), 2020).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.equations.columns import Columns
from ident.errors import FitError
from ident.fit.bodies import basis, unit_ball
from ident.fit.estimate import FLOOR, Estimate
from ident.fit.limits import limits_of
from ident.fit.regression import Regression
from ident.fit.within import concerned, nearest_within, restricted
from ident.information.cone import Limit, Point, conflict, smat, svec
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import COUNT, Consistency

PULL = 0.01  # ρ: bodies' own sizes in which the prior counts as one standard deviation
STILL = 0.1  # rows that all rows of a coordinate at standstill count as
BALL = 0.05  # of the prior's ball in S, so that a flat prior can become a little less flat
EFFECT = 1e-4  # of a plausible size: an effect that bodies can replace gives way to them
UNFELT = 1e9  # plausible size of an unknown that no data feel


@dataclass(frozen=True, eq=False)
class Program:
    """Everything of the conic problem but the data. Made once, solved for the fit and every fold.

    Attributes:
        columns: the unknowns.
        limits: what must hold.
        prior: (k,); anchor: (k,) the nearest to it within the limits; scale: (k,) plausible sizes.
        W: (rows, k) the metric; ‖W (x − a)‖ is the distance from the anchor.
        still: (d, k, k) triangles of the rows at standstill, in units of the error there.
        trusted: (d,) whether that is the error of least squares, else of the anchor.
    """

    columns: Columns
    limits: Sequence[Limit]
    prior: np.ndarray
    anchor: np.ndarray
    scale: np.ndarray
    W: np.ndarray
    still: np.ndarray
    trusted: np.ndarray

    @classmethod
    def of(
        cls,
        r: Regression,
        asked: Consistency,
        shapes: dict[int, tuple[float, float]],
        x: np.ndarray,
    ) -> Program:
        """The limits of a mechanism, and the prior within them; x (k,): least squares without.

        Raises:
            FitError: for limits that contradict each other, naming a smallest set of them.
        """
        mechanism, columns, prior = r.mechanism, r.columns, r.prior
        scale = r.sensible
        scale = np.where(scale < UNFELT, scale, 1.0)  # of a column of zeros any size will do
        limits = limits_of(mechanism, columns, asked, scale, shapes)
        if against := conflict(limits, scale):
            raise FitError(_contradiction([limit.name for limit in against]))
        anchor = prior.copy()
        if (free := concerned(limits, prior)).any():
            W = _metric(mechanism, columns, scale, 1.0, None)[:, free]
            near = restricted(limits, np.where(free, 0.0, prior), free)
            anchor[free] = nearest_within(W, W @ prior[free], near, W, None).x
        W = _metric(mechanism, columns, scale, BALL, anchor)
        return cls(columns, limits, prior, anchor, scale, W, *_still(r, x, anchor))

    def at(self, prior: np.ndarray) -> Program:
        """With shapes, which stay where they are if no data move them, at another place."""
        moved = np.where(np.isin(np.arange(len(prior)), self.columns.shapes), prior, self.anchor)
        return replace(self, prior=prior, anchor=moved)

    def solve(self, found: Estimate) -> Point:
        """The nearest x within the limits, and by how much each of them pushes.

        Raises:
            FitError: if no x is found that holds when looked at without the solver.
        """
        data, W, x_u = self._data(found), self._pull(found), found.solution.x
        at_rest = np.where(self.trusted[:, None], x_u, self.anchor)  # x_0, by coordinate
        still = np.einsum("uij,uj->ui", self.still, at_rest)
        A = np.vstack([data, *self.still, PULL * W])
        b = np.concatenate([data @ x_u, *still, PULL * (W @ self.anchor)])
        free = self._felt(found)
        fixed = np.where(free, 0.0, self.anchor)
        limits = restricted(self.limits, fixed, free)
        part = nearest_within(A[:, free], b - A @ fixed, limits, W[:, free], self.anchor[free])
        x = self.anchor.copy()
        x[free] = part.x
        return replace(part, x=x)

    def _felt(self, found: Estimate) -> np.ndarray:
        """(k,) all but effects that no data feel or that are held, which stay at the anchor."""
        felt = ~found.held
        felt[found.base.dependent[~found.base.K.any(axis=0)]] = False
        felt[: len(self.columns.rigid)] = True
        for limit in self.limits:
            if limit.kind == "psd":
                felt |= limit.G.any(axis=0)
        return felt

    def _pull(self, found: Estimate) -> np.ndarray:
        """W (rows, k), stiff for effects that are in no base parameter."""
        stiff = np.ones(len(self.prior))
        silent = found.base.dependent[found.base.dependent >= len(self.columns.rigid)]
        stiff[silent] = 1 / EFFECT
        return self.W * stiff

    def _data(self, found: Estimate) -> np.ndarray:
        """A (rows, k)."""
        base, k = found.base, len(self.prior)
        held = np.flatnonzero(found.held)
        B = np.zeros((base.rank + len(held), k))  # x ↦ (β, what is held)
        B[np.arange(base.rank), base.independent] = 1.0
        B[: base.rank, base.dependent] += base.K
        B[np.arange(base.rank, len(B)), held] = 1.0
        own = found.factor.restricted(np.concatenate([base.independent, held]).astype(int))
        return np.asarray(own.R @ B / noise(found))


def _still(r: Regression, x: np.ndarray, anchor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A_0 (d, k, k), a triangle a coordinate, and whether x is better there than the anchor."""
    rows, trusted = np.zeros((r.d, len(x), len(x))), np.ones(r.d, dtype=bool)
    for u, factor in enumerate(r.at_rest):
        left = [factor.residual_norm(y) / np.sqrt(max(factor.rows, 1)) for y in (x, anchor)]
        unit = max(min(left), FLOOR * r.torque[u], 1e-300)
        rows[u] = np.sqrt(STILL / max(factor.rows, 1)) * factor.R / unit
        trusted[u] = left[0] <= left[1]
    return rows, trusted


def noise(found: Estimate) -> float:
    """Of the rows divided by their weights: 1, or with equal weights what they leave."""
    if (found.sigma != 1.0).any():
        return 1.0
    rows = max(found.factor.rows, 1)
    left = found.factor.residual_norm(found.solution.x)
    terms = np.linalg.norm(found.factor.column_norms() * found.solution.x)
    return float(max(left, FLOOR * terms) / np.sqrt(rows)) or 1.0


def _metric(
    mechanism: Mechanism, columns: Columns, scale: np.ndarray, ball: float, at: np.ndarray | None
) -> np.ndarray:
    """W: a body's change by S = P(at) + ball · B (or the ball alone), an effect's by its size."""
    rows = []
    pi = None if at is None else columns.dynamic_parameters(mechanism, at)
    for number in range(len(mechanism.bodies.links)):
        mine = slice(COUNT * number, COUNT * (number + 1))
        places = np.flatnonzero((columns.rigid >= mine.start) & (columns.rigid < mine.stop))
        if not len(places):
            continue
        P = basis(unit_ball(mechanism, number))
        S = ball * np.eye(4) + (0.0 if pi is None else smat(P @ pi[mine]))
        eigenvalues, V = np.linalg.eigh(S)
        root = V @ np.diag(eigenvalues**-0.5) @ V.T
        block = np.stack([svec(root @ smat(column) @ root) for column in P.T], axis=1)
        wide = np.zeros((COUNT, len(columns)))
        wide[:, places] = block[:, columns.rigid[places] - mine.start]
        rows.append(wide)
    effects = np.arange(len(columns.rigid), len(columns))
    rows.append(np.eye(len(columns))[effects] / scale[effects, None])
    return np.vstack(rows)


def _contradiction(names: Sequence[str]) -> str:
    if len(names) == 1:
        return (
            f"{names[0]}: impossible with what is known of it, or flat to a millionth of its size; "
            "make more of it unknown, or correct what the URDF says"
        )
    return (
        f"these limits contradict each other: {'; '.join(names)}; each can hold without one of the "
        "others: loosen one of them"
    )
