"""Derivatives of log Γ; `scipy.special`, which has them too, takes 0.3 s to be imported."""

from __future__ import annotations

import numpy as np

from ident.information.linear import Array

STEPS = 12  # numerics: of x → x + 1 before the series for large x, which is then exact to 1e-15
# numerics: of z⁻², z⁻⁴, … in ψ(z) − log z + 1/(2 z): −B_2k/(2 k), Bernoulli's numbers
SERIES = (-1 / 12, 1 / 120, -1 / 252, 1 / 240, -1 / 132, 691 / 32760)


def digamma(x: Array | float) -> Array:
    """Return ψ(x) = (log Γ)'(x) of x > 0. M. Abramowitz, I. Stegun, 1964, eq. 6.3.5 and 6.3.18."""
    z = np.asarray(x, dtype=float) + STEPS
    series = sum(c * z ** (-2 * k) for k, c in enumerate(SERIES, start=1))
    steps = sum(1 / (z - k) for k in range(1, STEPS + 1))
    return np.asarray(np.log(z) - 0.5 / z + series - steps)


def trigamma(x: Array | float) -> Array:
    """Return ψ'(x) of x > 0; eq. 6.4.6 and 6.4.12 there."""
    z = np.asarray(x, dtype=float) + STEPS
    series = sum(-2 * k * c * z ** (-2 * k - 1) for k, c in enumerate(SERIES, start=1))
    steps = sum(1 / (z - k) ** 2 for k in range(1, STEPS + 1))
    return np.asarray(1 / z + 0.5 / z**2 + series + steps)
