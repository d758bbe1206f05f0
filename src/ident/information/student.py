"""Student's t-distribution; `scipy.special`, which has it too, takes 0.3 s to be imported."""

from __future__ import annotations

from math import exp, lgamma, log, log1p, sqrt

TERMS = 500  # numerics: of a continued fraction
PRECISION = 1e-15  # numerics: of its last factor
TINY = 1e-300  # numerics: stands for a zero denominator


def tail(t: float, nu: float) -> float:
    """Return the chance P(T > t) of the t-distribution with ν degrees of freedom, t ≥ 0."""
    x = nu / (nu + t * t)
    return 0.5 * _incomplete_beta(0.5 * nu, 0.5, x)


def tail_quantile(p: float, nu: float) -> float:
    """Return t with P(T > t) = p, 0 < p ≤ ½."""
    low, high = 0.0, 1.0
    while tail(high, nu) > p:
        low, high = high, 2 * high
        if high > 1 / TINY:
            return high
    for _ in range(200):
        middle = 0.5 * (low + high) if low else 0.5 * high
        if middle in (low, high):
            break
        low, high = (middle, high) if tail(middle, nu) > p else (low, middle)
    return 0.5 * (low + high)


def _incomplete_beta(a: float, b: float, x: float) -> float:
    """I_x(a, b), regularised: W. Press et al., Numerical Recipes, 3rd ed., 2007, sect. 6.4."""
    if x <= 0.0 or x >= 1.0:
        return float(x >= 1.0)
    factor = exp(lgamma(a + b) - lgamma(a) - lgamma(b) + a * log(x) + b * log1p(-x))
    if x > (a + 1) / (a + b + 2):
        return 1.0 - factor * _fraction(b, a, 1 - x) / b
    return factor * _fraction(a, b, x) / a


def _fraction(a: float, b: float, x: float) -> float:
    """The continued fraction of I_x(a, b) by Lentz's method."""
    c, d = 1.0, 1.0 / (1.0 - (a + b) * x / (a + 1.0) or TINY)
    value = d
    for m in range(1, TERMS):
        for term in (
            m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m)),
            -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1)),
        ):
            d = 1.0 / (1.0 + term * d or TINY)
            c = 1.0 + term / c or TINY
            value *= c * d
        if abs(c * d - 1.0) < PRECISION * sqrt(m):
            break
    return value
