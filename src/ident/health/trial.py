"""What would be left if the torque channels were others: refits from small triangles.

Each coordinate's rows [X | B] are reduced to a triangle once; every arrangement c of the torque
channels is then one small least-squares problem with all parameters free,

    min_x Σ_u ‖R_u x − S_u c‖² / σ_u(c)²          [R_u | S_u] = Qᵀ [X_u | B_u]

with σ_u(c) the rms of the torque that c makes of coordinate u: relative errors weigh alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ident.fit import Fit
from ident.health.bounded import within
from ident.health.evidence import Evidence, gather
from ident.health.possible import possible
from ident.motion import Experiment


@dataclass(frozen=True, eq=False)
class Result:
    """x (k + 5 J,) of a refit, and each coordinate's relative error (d,)."""

    x: np.ndarray
    relative: np.ndarray

    @property
    def score(self) -> float:
        """Root mean square of the relative errors."""
        return float(np.sqrt(np.mean(np.minimum(self.relative, 1e3) ** 2)))


@dataclass(frozen=True, eq=False)
class Trial:
    """Triangles of all rows of a fit.

    Attributes:
        driven: names of the J driven joints; own: for each coordinate the place among them, or −1.
        triangles: for each coordinate [R_u | S_u]; width: columns of R_u; rows: (d,).
        lags: (L,) [s]; dt: [s].
    """

    driven: tuple[str, ...]
    own: tuple[int, ...]
    triangles: tuple[np.ndarray, ...]
    width: int
    rows: np.ndarray
    lags: np.ndarray
    dt: float
    limits: tuple[np.ndarray, np.ndarray]

    @classmethod
    def of(cls, fit: Fit, experiments: Sequence[Experiment] | None = None) -> Trial:
        """The triangles of a fit's rows; of other experiments: few rows, without shifts."""
        rows = gather(fit) if experiments is None else gather(fit, experiments, 1500, False)
        return cls.of_rows(fit, rows)

    @classmethod
    def of_rows(cls, fit: Fit, rows: Evidence) -> Trial:
        """The triangles of rows that are at hand."""
        found, counts = [], []
        for u in range(rows.X.shape[1]):
            told = rows.informed[:, u]
            stack = np.concatenate([rows.X[told, u], rows.B[told, u]], axis=1)
            there = stack.any(axis=0)
            R = np.linalg.qr(stack[:, there], mode="r")
            triangle = np.zeros((len(R), stack.shape[1]))
            triangle[:, there] = R
            found.append(triangle)
            counts.append(int(told.sum()))
        driven = fit.mechanism.driven
        own = tuple(driven.index(n) if n in driven else -1 for n in fit.motion.independent)
        return cls(
            driven, own, tuple(found), rows.X.shape[2], np.array(counts), rows.lags, rows.dt,
            possible(fit),
        )  # fmt: skip

    @property
    def square(self) -> bool:
        """Whether each coordinate has one drive, so that its rows are that joint's torque."""
        return sorted(self.own) == list(range(len(self.driven)))

    def arrangement(self, take: np.ndarray, gain: np.ndarray) -> np.ndarray:
        """c where joint j is given gain[j] times channel take[j]."""
        J, L = len(self.driven), len(self.lags)
        c = np.zeros(1 + J * J + J * L)
        c[0] = 1.0
        c[1 + J * np.arange(J) + take] = gain
        return c

    @cached_property
    def as_logged(self) -> np.ndarray:
        """c of the log as it is."""
        J = len(self.driven)
        return self.arrangement(np.arange(J), np.ones(J))

    def torque(self, c: np.ndarray) -> np.ndarray:
        """Norm (d,) of the torques that c makes."""
        only = np.concatenate([[0.0], c[1:]])
        return np.array([np.linalg.norm(T[:, self.width :] @ only) for T in self.triangles])

    def refit(self, c: np.ndarray) -> Result:
        """All parameters refitted to the torques that c makes."""
        size = self.torque(c)
        scale = np.where(size > 0, size, max(size.max(), 1e-300))
        X = np.concatenate(
            [T[:, : self.width] / s for T, s in zip(self.triangles, scale, strict=True)]
        )
        b = np.concatenate(
            [T[:, self.width :] @ c / s for T, s in zip(self.triangles, scale, strict=True)]
        )
        x = within(X, b, *self.limits)
        left, at = [], 0
        for T in self.triangles:
            part = slice(at, at + len(T))
            left.append(float(np.linalg.norm(X[part] @ x - b[part])))
            at += len(T)
        return Result(x, np.array(left))

    @cached_property
    def now(self) -> Result:
        """The log as it is."""
        return self.refit(self.as_logged)
