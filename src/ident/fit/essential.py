"""Which base parameters a model can do without: backward elimination on the triangular factors.

Base parameters are set to zero one after the other, the one with the largest relative standard
error first (M. T. Pham, M. Gautier, Essential parameters of robots, IEEE CDC 1991), the others
estimated anew, as long as no joint's held-out error rises by more than LOSS. What is left are the
essential parameters: a shorter model, that often predicts better.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import lapack

from ident.fit.accumulate import Cell
from ident.fit.estimate import Estimate, totals
from ident.fit.score import folds, rises, stretches, without_each
from ident.residual.error import Error, Squares
from ident.show.html import Shown
from ident.solve.factor import Factor
from ident.text import percent, table

if TYPE_CHECKING:
    from ident.fit.fit import Fit

LOSS = 0.01  # share by which any joint's held-out error may rise in all


@dataclass(frozen=True)
class Dropped:
    """A base parameter that is not needed.

    Attributes:
        name: its leading unknown; relative: its standard error over its size when it was dropped.
        rise: of the held-out error with it and all before it at zero, over that of the full model,
            in the joint where it rises most; below zero where it falls in all.
    """

    name: str
    relative: float
    rise: float


@dataclass(frozen=True)
class Essential(Shown):
    """The essential base parameters of a fit.

    Attributes:
        names: leading unknowns of those that stay.
        values, stderr: estimated without the others, by name.
        dropped: in the order in which they went.
        full, reduced: held-out errors of both models, by joint.
    """

    names: tuple[str, ...]
    values: Mapping[str, float]
    stderr: Mapping[str, float]
    dropped: tuple[Dropped, ...]
    full: Mapping[str, Error]
    reduced: Mapping[str, Error]

    @property
    def line(self) -> str:
        """In one line."""
        count = len(self.names) + len(self.dropped)
        if not self.dropped:
            return f"essential: all {count} base parameters"
        rise = self.dropped[-1].rise
        change = f"rises by more than {100 * rise:.2g} %" if rise > 0 else "rises"
        return (
            f"essential: {len(self.names)} of {count} base parameters; with the others at zero no "
            f"joint's held-out error {change}"
        )

    def json(self) -> dict[str, object]:
        """For fit.json."""
        return {
            "parameters": [
                {"name": n, "value": self.values[n], "stderr": self.stderr[n]} for n in self.names
            ],
            "dropped": [
                {"name": d.name, "relative_stderr": min(d.relative, 1e30), "rise": d.rise}
                for d in self.dropped
            ],
            "held_out": {
                joint: {"full": self.full[joint].rms, "reduced": self.reduced[joint].rms}
                for joint in self.full
            },
        }

    def __str__(self) -> str:
        rows = [["dropped, in this order", "± / value", "held-out error"]]
        rows += [
            [d.name, f"{100 * d.relative:.3g} %", f"{100 * d.rise:+.2g} %"] for d in self.dropped
        ]
        errors = [["joint", "full", "", "reduced", ""]]
        for joint, e in self.full.items():
            r = self.reduced[joint]
            errors.append(
                [joint, f"{e.rms:.3g} {e.unit}", percent(e.relative), f"{r.rms:.3g} {r.unit}",
                 percent(r.relative)]
            )  # fmt: skip
        lines = [self.line, *table([[name] for name in self.names])]
        return "\n".join([*lines, "", *table(rows), "", "held out", *table(errors)])

    __repr__ = __str__


def essential(fit: Fit, loss: float = LOSS) -> Essential | None:
    """The essential parameters; None for data that cannot be parted into stretches of time.

    Args:
        fit: the full model.
        loss: share by which a joint's held-out error may rise in all.
    """
    columns, estimate, names = fit.columns, fit.estimate, fit.motion.independent
    trial = _Trial.of(fit.cells, estimate, fit.worth)
    own = estimate.base.independent
    if trial is None or not len(own):
        return None
    whole = trial.total
    wider = _wider(whole, fit.covariance)
    may_go = ~np.isin(own, columns.shapes)  # a shape's column is a slope, no size
    kept, dropped = np.ones(len(own), dtype=bool), []
    full = trial.held_out(kept)
    best = full
    while (kept & may_go).any():
        beta, stderr = _solved(whole, kept, wider)
        relative = np.where(kept & may_go, stderr / np.maximum(np.abs(beta), 1e-300), -np.inf)
        weakest = int(relative.argmax())
        fewer = kept.copy()
        fewer[weakest] = False
        after = trial.held_out(fewer)
        change = float(rises(after, full).max(initial=-1.0))
        if change > loss:
            break
        kept, best = fewer, after
        dropped.append(Dropped(columns.names[own[weakest]], float(relative[weakest]), change))
    beta, stderr = _solved(whole, kept, wider)
    left = [columns.names[i] for i in own[kept]]
    return Essential(
        tuple(left),
        dict(zip(left, map(float, beta[kept]), strict=True)),
        dict(zip(left, map(float, stderr[kept]), strict=True)),
        tuple(dropped),
        full.errors(names, fit.regression.units),
        best.errors(names, fit.regression.units),
    )


@dataclass(frozen=True, eq=False)
class _Trial:
    """Factors in the base parameters alone, weighted: of all rows, by stretch, and to score in."""

    total: Factor
    others: tuple[Factor, ...]
    scored: tuple[tuple[tuple[Factor, ...], np.ndarray], ...]
    torque: np.ndarray
    sigma: np.ndarray

    @classmethod
    def of(cls, cells: Sequence[Cell], estimate: Estimate, sigma: np.ndarray) -> _Trial | None:
        parted = folds(cells, stretches(cells))
        if len(parted) < 2:
            return None
        own, k, d = estimate.base.independent, len(estimate.solution.x), len(sigma)
        known = np.where(estimate.held, estimate.solution.x, 0.0)  # x_D = 0: then x_I = β
        fitting, scored, torque = [], [], np.zeros(d)
        for part in parted.values():
            informed = [f.restricted(own, known) for f in totals(part, k, d)]
            fitting.append(
                Factor.merge([f.scaled(1 / s) for f, s in zip(informed, sigma, strict=True)])
            )
            rest = [replace(cell, triangle=cell.rest) for cell in part]
            still = [f.restricted(own, known) for f in totals(rest, k, d)]
            both = tuple(Factor.merge(pair) for pair in zip(informed, still, strict=True))
            scored.append((both, np.array([f.rows for f in both])))
            for cell in part:
                torque[cell.coordinate] += cell.tau
        others = tuple(without_each(fitting))
        return cls(Factor.merge(fitting), others, tuple(scored), torque, sigma)

    def held_out(self, kept: np.ndarray) -> Squares:
        """Errors in each stretch of the model fitted to the others, with some base parameters."""
        error, rows = np.zeros(len(self.sigma)), np.zeros(len(self.sigma))
        for factor, (both, count) in zip(self.others, self.scored, strict=True):
            beta, _ = _solved(factor, kept, None)
            error += [f.residual_norm(beta) ** 2 for f in both]
            rows += count
        return Squares(error, self.torque, rows)


def _solved(
    factor: Factor, kept: np.ndarray, wider: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """β (n,), zero where not kept, and standard errors (n,)."""
    own = factor.restricted(np.flatnonzero(kept))
    beta, stderr = np.zeros(len(kept)), np.zeros(len(kept))
    if own.k == 0:
        return beta, stderr
    if (np.abs(own.R.diagonal()) > 1e-12 * np.linalg.norm(own.R, axis=0)).all():
        beta[kept] = lapack.dtrtrs(own.R, own.d)[0]
    else:  # a stretch alone knew something
        beta[kept] = np.linalg.lstsq(own.R, own.d, rcond=1e-12)[0]
    if wider is not None:
        inverse, _ = lapack.dtrtri(own.R)
        stderr[kept] = np.linalg.norm(inverse, axis=1) * wider[kept]
    return beta, stderr


def _wider(factor: Factor, covariance: np.ndarray) -> np.ndarray:
    """(n,) the fit's standard errors over those of independent rows of unit noise."""
    inverse, _ = lapack.dtrtri(factor.R)
    own = np.linalg.norm(inverse, axis=1)
    stderr = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return np.where(np.isfinite(stderr) & (own > 0), stderr / np.maximum(own, 1e-300), 1.0)
