"""How much filtered noise repeats itself: the long-run variance of a series over its variance.

    Λ = Σ_l w_l γ_l / γ_0,      w_l = 1 − |l|/(L + 1),   |l| ≤ L

Λ neighbouring rows tell as much of a slow column as one row of white noise of the same size: their
filter has a band narrower than half of the rows' rate. L by the plug-in of a first-order
autoregression (Andrews, Econometrica 59(3), 1991, eq. 6.2 and 6.4).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.information.linear import Array

MOST_ALIKE = 0.97  # numerics: correlation of neighbours, beyond which a bandwidth has no end
FEWEST_SPANS = 10  # level: spans of the window in a series, below which it is a trend


def rows_alike(runs: Sequence[Array]) -> float:
    """Return Λ ≥ 1 of a series of zero mean in runs, NaN where there is no value."""
    series = [np.nan_to_num(run) for run in runs]
    given = [np.isfinite(run).astype(float) for run in runs]
    count = sum(float(g.sum()) for g in given)
    power = sum(float(x @ x) for x in series)
    if count < 2 * FEWEST_SPANS or not power:
        return 1.0

    def correlation(lag: int) -> float:
        product = sum(float(x[lag:] @ x[: len(x) - lag]) for x in series if len(x) > lag)
        return product / power

    rho = min(abs(correlation(1)), MOST_ALIKE)
    alpha = 4 * rho**2 / ((1 - rho) ** 2 * (1 + rho) ** 2)
    lags = int(min(max(1.0, 1.1447 * np.cbrt(alpha * count)), count / FEWEST_SPANS))
    weighted = ((1 - lag / (lags + 1)) * correlation(lag) for lag in range(1, lags + 1))
    return max(1.0, 1 + 2 * sum(weighted))
