import numpy as np
import pytest
from scipy.interpolate import BSpline

from ident.errors import FitError
from ident.information.time_bases import Basis


def centres(basis):
    """The middle of each function; for hats the knots, where a_ij is lambda_i."""
    return basis.t0 + (np.arange(basis.count) - (basis.degree - 1) / 2) * basis.spacing


@pytest.mark.parametrize("degree", [0, 1, 3, 5])
def test_values_are_those_of_scipys_b_splines_and_sum_to_one(degree):
    basis = Basis.with_count(0.3, 5.3, 41, degree)
    t = np.linspace(0.3, 5.3, 777)[1:-1]
    _, values = basis.window(t)
    assert values.shape == (len(t), degree + 1)
    assert (values >= 0).all()
    np.testing.assert_allclose(values.sum(axis=1), 1.0, rtol=1e-14)
    a = np.random.default_rng(0).standard_normal((41, 2))
    knots = basis.t0 + (np.arange(41 + degree + 1) - degree) * basis.spacing
    np.testing.assert_allclose(basis.evaluate(a, t), BSpline(knots, a, degree)(t), atol=1e-12)


def test_hats_are_the_papers():
    basis = Basis.spanning(0.0, 5.0, 0.05)
    assert (basis.count, basis.degree) == (101, 1)
    np.testing.assert_allclose(centres(basis), np.arange(101) * 0.05)
    first, values = basis.window([0.12])
    beta = (0.12 - 0.10) / 0.05
    assert first[0] == 2
    np.testing.assert_allclose(values[0], [1 - beta, beta])  # eq. 4
    a = np.random.default_rng(0).standard_normal((101, 3))
    np.testing.assert_allclose(basis.evaluate(a, centres(basis)), a, atol=1e-12)


@pytest.mark.parametrize("degree", [1, 3, 5])
def test_lines_are_reproduced_up_to_both_ends(degree):
    basis = Basis.spanning(-1.0, 2.0, 0.25, degree)
    t = np.linspace(-1, 2, 100)
    np.testing.assert_allclose(basis.evaluate(centres(basis)[:, None], t)[:, 0], t, atol=1e-13)


def test_span_and_count():
    assert [Basis.with_count(0, 5, 101, degree).count for degree in (1, 3, 5)] == [101] * 3
    assert Basis.with_count(0, 5, 101, 3).t_end == pytest.approx(5)
    assert Basis.spanning(0, 1, 0.3, 3).count == 4 + 3
    assert Basis.spanning(0, 1, 0.3, 3).t_end == pytest.approx(1.2)
    assert Basis.spanning(0, 1, 7.0).count == 2


@pytest.mark.parametrize("t", [1.2, np.nan])
def test_times_outside_the_span_are_refused(t):
    with pytest.raises(FitError, match=r"valid: 0\.0 to 1\.0"):
        Basis.spanning(0, 1, 0.1).window([0.5, t])
