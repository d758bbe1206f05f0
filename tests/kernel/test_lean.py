"""What stands in for parts of SciPy that take long to be imported, against SciPy itself."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.linalg import cho_solve_banded
from scipy.linalg import cholesky_banded as of_scipy
from scipy.optimize import nnls
from scipy.special import digamma as of_scipy_digamma
from scipy.special import polygamma, stdtrit

from ident.information.cubic import cubic
from ident.information.gamma import digamma, trigamma
from ident.information.lapack import cholesky_banded, lapack, solve_cholesky_banded
from ident.information.linear import nonnegative, nonnegative_least
from ident.information.student import tail_quantile
from ident.motion.spline import quantile


@pytest.mark.parametrize("nu", [1, 2, 3, 9, 40, 400])
@pytest.mark.parametrize("p", [0.4, 0.05, 1e-3, 1e-7])
def test_quantiles_of_student_are_scipys(nu, p):
    assert tail_quantile(p, nu) == pytest.approx(-stdtrit(nu, p), rel=1e-9)


@pytest.mark.parametrize("n", [1, 2, 3, 10, 101])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.8, 0.99, 1.0])
def test_quantiles_are_numpys(n, share):
    x = np.random.default_rng(n).standard_normal(n)
    assert quantile(x, share) == pytest.approx(np.quantile(x, share), rel=1e-14)
    assert np.isnan(quantile(np.append(x, np.nan), share))


@pytest.mark.parametrize("seed", range(30))
def test_nonnegative_least_squares_is_scipys(seed):
    rng = np.random.default_rng(seed)
    A, b = rng.standard_normal((8, 5)), rng.standard_normal(8)
    if seed % 3 == 0:  # columns that depend on each other
        A[:, 4] = A[:, 0] + A[:, 1]
    found, (right, size) = nonnegative(A, b), nnls(A, b)
    assert (found >= 0).all()
    assert np.linalg.norm(A @ found - b) == pytest.approx(size, abs=1e-10)
    if seed % 3:
        np.testing.assert_allclose(found, right, atol=1e-10)


@pytest.mark.parametrize("seed", range(12))
def test_nonnegative_least_of_products_is_that_of_rows_wherever_it_begins(seed):
    rng = np.random.default_rng(seed)
    A, b = rng.standard_normal((8, 5)), rng.standard_normal(8)
    right, _ = nnls(A, b)
    for start in (None, right > 0, rng.random(5) < 0.5, np.ones(5, dtype=bool)):
        np.testing.assert_allclose(nonnegative_least(A.T @ A, A.T @ b, start), right, atol=1e-10)


def test_banded_factors_are_scipys():
    rng = np.random.default_rng(0)
    bands = rng.standard_normal((4, 30))
    bands[0] = 9.0 + np.abs(bands[0])
    b = rng.standard_normal((30, 3))
    L = cholesky_banded(bands)
    np.testing.assert_allclose(L[:, :20], of_scipy(bands, lower=True)[:, :20])
    right = cho_solve_banded((of_scipy(bands, lower=True), True), b)
    np.testing.assert_allclose(solve_cholesky_banded(L, b), right)
    bands[0] = -1.0
    with pytest.raises(np.linalg.LinAlgError):
        cholesky_banded(bands)
    assert lapack.dtpqrt


@pytest.mark.parametrize("shape", [(), (3,), (3, 2)])
@pytest.mark.parametrize("n", [2, 3, 4, 5, 60])
def test_cubic_splines_are_scipys(n, shape):
    """At uneven times, and a little beyond the ends."""
    rng = np.random.default_rng(n)
    t, x = np.cumsum(rng.uniform(0.5, 1.5, n)), rng.standard_normal((n, *shape))
    at = np.linspace(t[0] - 0.3, t[-1] + 0.3, 200)
    np.testing.assert_allclose(cubic(t, x, at), CubicSpline(t, x)(at), atol=1e-9)


def test_nonnegative_least_squares_ends_where_all_numbers_are_rounding():
    """Of columns or data that are next to nothing, numbers enter as zero."""
    A = np.array([[1e-200, 0.0, 1.0], [0.0, 1e-300, 1.0], [0.0, 0.0, 0.0]])
    for b in (np.array([1e-160, 1e-300, 0.0]), np.array([5e-324, 1e-320, 1.0]), np.ones(3)):
        x = nonnegative(A, b)
        assert (x >= 0).all()
        assert np.isfinite(x).all()


def test_derivatives_of_log_gamma_are_scipys():
    x = np.geomspace(0.01, 1e6, 200)
    np.testing.assert_allclose(digamma(x), of_scipy_digamma(x), rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(trigamma(x), polygamma(1, x), rtol=1e-12)
