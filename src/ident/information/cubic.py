"""The cubic spline through a series, without SciPy's package, which takes 0.2 s to import.

    s(t_i + u) = x_i + u m_i + u² (3 Δ_i − 2 m_i − m_{i+1})/h_i + u³ (m_i + m_{i+1} − 2 Δ_i)/h_i²
    h_i = t_{i+1} − t_i,    Δ_i = (x_{i+1} − x_i)/h_i

Slopes m make the second derivative continuous, and at the first and last inner knot the third, too
("not a knot"). Source: C. de Boor, A Practical Guide to Splines, 1978, ch. IV.
"""

from __future__ import annotations

import numpy as np

from ident.information.lapack import lapack

UNEVEN = 1e-6  # numerics: of a step in time: times are taken for even whose steps differ by less


def cubic(t: np.ndarray, x: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return the values at `at` of the spline through x (n, …) at increasing times t (n,).

    Beyond the ends their polynomials go on. Of fewer than four points it is the polynomial through
    them. As `scipy.interpolate.CubicSpline`.
    """
    n = len(t)
    if n < 4:
        scale = t[-1] - t[0] or 1.0
        powers, wanted = (np.vander((times - t[0]) / scale, n) for times in (t, at))
        values = wanted @ np.linalg.solve(powers, x.reshape(n, -1))
        return np.asarray(values.reshape(-1, *x.shape[1:]))
    i = np.clip(np.searchsorted(t, at, side="right") - 1, 0, n - 2)
    u, c = (at - t[i]).reshape(-1, *(1,) * (x.ndim - 1)), coefficients(t, x)
    return np.asarray(c[0][i] + u * (c[1][i] + u * (c[2][i] + u * c[3][i])))


def coefficients(t: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return those of 1, u, u² and u³ after each of the n ≥ 4 points but the last (n − 1, …)."""
    h, m = np.diff(t).reshape(-1, *(1,) * (x.ndim - 1)), slopes(t, x)
    rise, m0, m1 = np.diff(x, axis=0) / h, m[:-1], m[1:]
    return x[:-1], m0, (3 * rise - 2 * m0 - m1) / h, (m0 + m1 - 2 * rise) / h**2


def slopes(t: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the slopes m (n, …) at the n ≥ 4 points."""
    n = len(t)
    steps, shape = np.diff(t), (-1, *(1,) * (x.ndim - 1))
    first, last = t[2] - t[0], t[-1] - t[-3]
    h = steps.reshape(shape)
    rise, right = np.diff(x, axis=0) / h, np.empty(x.shape)
    right[0] = ((h[0] + 2 * first) * h[1] * rise[0] + h[0] ** 2 * rise[1]) / first
    right[1:-1] = 3 * (h[1:] * rise[:-1] + h[:-1] * rise[1:])
    right[-1] = ((h[-1] + 2 * last) * h[-2] * rise[-1] + h[-1] ** 2 * rise[-2]) / last
    diagonal = np.concatenate([steps[1:2], 2 * (steps[1:] + steps[:-1]), steps[-2:-1]])
    lower, upper = np.append(steps[1:], last), np.append(first, steps[:-1])
    *_, m, _ = lapack.dgtsv(lower, diagonal, upper, right.reshape(n, -1))
    return np.asarray(m.reshape(x.shape))


def late(t: np.ndarray, x: np.ndarray, d: float) -> np.ndarray:
    """Return x(t − d) of a series x (n, …) at the times t (n,) [s]; the ends stand still."""
    n = len(t)
    if not d or n < 2:  # of one sample no rate is known
        return x
    h = (t[-1] - t[0]) / (n - 1)
    if n < 4 or np.abs(np.diff(t) - h).max() > UNEVEN * h:
        return cubic(t, x, np.clip(t - d, t[0], t[-1]))
    k, f = int(np.floor(-d / h)), float(-d / h % 1)  # samples on: k whole ones, and a part
    first, stop, m = max(0, -k), min(n, n - 1 - k), slopes(t, x)
    out = np.empty(x.shape)
    out[:first], out[max(stop, 0) :] = x[0], x[-1]
    if first < stop:  # Hermite's polynomials of values and slopes at both ends
        one, other = slice(first + k, stop + k), slice(first + k + 1, stop + k + 1)
        out[first:stop] = x[one] * ((1 + 2 * f) * (1 - f) ** 2) + x[other] * (f * f * (3 - 2 * f))
        out[first:stop] += h * f * (1 - f) * ((1 - f) * m[one] - f * m[other])
    return out
