"""Which base parameters are known only together: r_ij = cov_ij / (s_i s_j)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.equations.columns import Columns
from ident.fit.estimate import Estimate
from ident.show.html import Shown

STRONG = 0.95  # |r| at which two parameters are known only together


@dataclass(frozen=True, eq=False)
class Correlation(Shown):
    """Correlation of the errors of base parameters; `print` shows the strong ones.

    Attributes:
        names: (n,) the leading unknown of each base parameter.
        matrix: (n, n), 1 on the diagonal; NaN where a standard error is not known.
    """

    names: tuple[str, ...]
    matrix: np.ndarray

    @classmethod
    def of(cls, columns: Columns, estimate: Estimate, cov: np.ndarray) -> Correlation:
        """From the covariance (n, n) of the base parameters."""
        s = np.sqrt(np.diag(cov))
        with np.errstate(invalid="ignore", divide="ignore"):
            r = cov / np.outer(s, s)
        return cls(tuple(columns.names[i] for i in estimate.base.independent), np.clip(r, -1, 1))

    def pairs(self, least: float = STRONG) -> list[tuple[str, str, float]]:
        """Pairs with |r| ≥ least, the strongest first."""
        i, j = np.triu_indices(len(self.names), 1)
        r = self.matrix[i, j]
        some = np.flatnonzero(np.abs(r) >= least)
        order = some[np.argsort(-np.abs(r[some]), kind="stable")]
        return [(self.names[i[k]], self.names[j[k]], float(r[k])) for k in order]

    def __getitem__(self, names: tuple[str, str]) -> float:
        """Of two base parameters by their leading unknowns.

        Raises:
            KeyError: if one of them leads no base parameter.
        """
        for name in names:
            if name not in self.names:
                raise KeyError(f"'{name}' leads no base parameter; {_few(self.names)}")
        i, j = (self.names.index(name) for name in names)
        return float(self.matrix[i, j])

    def __str__(self) -> str:
        strong = self.pairs()
        if not strong:
            most = self.pairs(0.0)[:1]
            said = f"; the most: {_pair(most[0])}" if most else ""
            return f"no two base parameters are known only together (|r| < {STRONG}){said}"
        return "\n".join(["known only together:", *(f"  {_pair(pair)}" for pair in strong)])

    __repr__ = __str__

    def notes(self) -> list[str]:
        """A note where parameters are known only together."""
        strong = self.pairs()
        if not strong:
            return []
        return [
            f"known only together (correlation of errors): {'; '.join(map(_pair, strong[:4]))}"
            + (f" and {len(strong) - 4} more pairs" if len(strong) > 4 else "")
            + ": their sum or difference is known better than each"
        ]


def _pair(pair: tuple[str, str, float]) -> str:
    return f"{pair[0]} and {pair[1]} ({pair[2]:+.3f})"


def _few(names: Sequence[str]) -> str:
    return f"valid: {', '.join(names[:12])}" + (", …" if len(names) > 12 else "")
