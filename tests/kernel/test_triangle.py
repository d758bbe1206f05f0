from itertools import pairwise

import numpy as np
import pytest

from ident.errors import FitError
from ident.information.estimate import rank_revealing, solve
from ident.information.linear import Triangle, merged_by_support


def householder_longdouble(A, b):
    """Least squares by textbook Householder reflections in extended precision: the truth."""
    T = np.column_stack([A, b]).astype(np.longdouble)
    k = A.shape[1]
    for j in range(k):
        v = T[j:, j].copy()
        v[0] += np.copysign(np.sqrt(v @ v), v[0])
        T[j:] -= np.outer(v, (v @ T[j:]) * (2 / (v @ v)))
    x = np.zeros(k, np.longdouble)
    for j in reversed(range(k)):
        x[j] = (T[j, k] - T[j, j + 1 : k] @ x[j + 1 :]) / T[j, j]
    return x


def conditioned(rng, rows, k, condition):
    U, _ = np.linalg.qr(rng.standard_normal((rows, k)))
    V, _ = np.linalg.qr(rng.standard_normal((k, k)))
    return U * np.geomspace(1, 1 / condition, k) @ V


@pytest.mark.parametrize("condition", [1e0, 1e4, 1e7, 1e10])
@pytest.mark.parametrize("split", ["whole", "rows", "merged", "reversed"])
def test_any_order_and_split_agrees_with_extended_precision(condition, split):
    rng = np.random.default_rng(3)
    A, noise = conditioned(rng, 600, 6, condition), 1e-6 * rng.standard_normal(600)
    b = A @ np.ones(6) + noise
    if split == "whole":
        factor = Triangle.of(A, b)
    elif split == "rows":
        factor = Triangle.empty(6)
        for row in range(600):
            factor = factor.updated(A[row : row + 1], b[row : row + 1])
    else:
        cuts = [0, 7, 8, 120, 600]
        parts = [Triangle.of(A[i:j], b[i:j]) for i, j in pairwise(cuts)]
        factor = Triangle.merge(parts if split == "merged" else parts[::-1])
    truth = householder_longdouble(A, b).astype(float)
    x = solve(factor, rank_revealing(factor, tol=1e-13)).x
    # least squares perturbed by rounding: Björck 1996, th. 1.4.6
    size = np.linalg.norm(truth) + condition * np.linalg.norm(A @ truth - b)
    assert np.linalg.norm(x - truth) < 50 * np.finfo(float).eps * condition * size
    assert factor.rows == 600
    for at in (truth, np.zeros(6), rng.standard_normal(6)):
        assert factor.residual_norm(at) == pytest.approx(np.linalg.norm(A @ at - b), rel=1e-13)
        np.testing.assert_allclose(factor.gradient(at), A.T @ (b - A @ at), atol=1e-13 * 50)
    assert factor.rhs_norm() == pytest.approx(np.linalg.norm(b), rel=1e-14)
    np.testing.assert_allclose(factor.column_norms(), np.linalg.norm(A, axis=0), rtol=1e-13)


def test_equal_data_give_an_equal_triangle():
    rng = np.random.default_rng(0)
    A, b = rng.standard_normal((5000, 4)), rng.standard_normal(5000)
    whole, parts = (
        Triangle.of(A, b),
        Triangle.of(A[3000:], b[3000:]) + Triangle.of(A[:3000], b[:3000]),
    )
    np.testing.assert_allclose(parts.R, whole.R, rtol=0, atol=1e-12)
    np.testing.assert_allclose(parts.d, whole.d, rtol=0, atol=1e-12)
    assert parts.rho == pytest.approx(whole.rho, rel=1e-13)
    assert (np.tril(whole.R, -1) == 0).all()
    assert (whole.R.diagonal() > 0).all()
    assert not whole.R.flags.writeable


def test_a_factor_is_unchanged_by_what_is_made_of_it():
    rng = np.random.default_rng(0)
    factor = Triangle.of(rng.standard_normal((9, 3)), rng.standard_normal(9))
    before = factor.R.copy(), factor.d.copy(), factor.rho
    factor.updated(rng.standard_normal((4, 3)), rng.standard_normal(4))
    (
        factor.restricted([1], np.ones(3)),
        factor.embedded([2, 0, 4], 5),
        factor.scaled(3),
        factor + factor,
    )
    assert np.array_equal(factor.R, before[0])
    assert np.array_equal(factor.d, before[1])
    assert factor.rho == before[2]


def test_the_callers_arrays_are_left_alone():
    A, b = np.asfortranarray(np.random.default_rng(0).standard_normal((20, 3))), np.ones(20)
    copy = A.copy()
    Triangle.of(A, b)
    assert np.array_equal(A, copy)


def test_scaled_embedded_and_restricted_are_those_of_the_rows():
    rng = np.random.default_rng(1)
    A, b, x = rng.standard_normal((50, 4)), rng.standard_normal(50), rng.standard_normal(7)
    factor = Triangle.of(A, b)
    scaled = factor.scaled(2.5)
    assert scaled.residual_norm(x[:4]) == pytest.approx(np.linalg.norm(2.5 * (A @ x[:4] - b)))

    for place in ([5, 0, 6, 2], [0, 2, 5, 6]):
        wide = factor.embedded(place, 7)
        assert wide.rows == 50
        assert len(wide.R) < 7  # fewer rows than columns stay as they are
        assert wide.residual_norm(x) == pytest.approx(np.linalg.norm(A @ x[place] - b))

    keep, known = [2, 0], x[:4]
    small = factor.restricted(keep, known)
    expected = Triangle.of(A[:, keep], b - A[:, [1, 3]] @ known[[1, 3]])
    np.testing.assert_allclose(small.R, expected.R, atol=1e-13)
    np.testing.assert_allclose(small.d, expected.d, atol=1e-13)
    assert small.rho == pytest.approx(expected.rho)
    mask = np.array([True, False, False, True])
    np.testing.assert_allclose(factor.restricted(mask).R, Triangle.of(A[:, mask], b).R, atol=1e-13)


def test_fewer_rows_than_unknowns_and_none_at_all():
    few = Triangle.of([[3.0, 4.0, 0.0]], [10.0])
    assert few.residual_norm([2.0, 1.0, 7.0]) == pytest.approx(0.0, abs=1e-15)
    assert Triangle.empty(3).residual_norm(np.ones(3)) == 0.0
    assert Triangle.of(np.zeros((5, 0)), np.ones(5)).rho == pytest.approx(np.sqrt(5))
    assert (Triangle.empty(2) + Triangle.of(np.eye(2), np.ones(2))).rows == 2


@pytest.mark.parametrize(("A", "b"), [([[1.0, np.nan]], [0.0]), ([[1.0, 2.0]], [np.inf])])
def test_numbers_that_are_not_finite_are_refused(A, b):
    with pytest.raises(FitError, match="not finite"):
        Triangle.of(A, b)


def test_few_rows_stay_rows_and_add_to_the_same_equations():
    rng = np.random.default_rng(5)
    A, b, x = rng.standard_normal((40, 9)), rng.standard_normal(40), rng.standard_normal(9)
    few = [Triangle.of(A[i : i + 4], b[i : i + 4]) for i in range(0, 40, 4)]
    assert all(np.array_equal(each.R, A[4 * i : 4 * i + 4]) for i, each in enumerate(few))
    merged, at_once = Triangle.merge(few), Triangle.of(A, b)
    assert merged.rows == at_once.rows == 40
    np.testing.assert_allclose(merged.R, at_once.R, atol=1e-12)
    np.testing.assert_allclose(merged.rho, at_once.rho)
    in_steps = few[0].updated(A[4:7], b[4:7]).updated(A[7:], b[7:])
    np.testing.assert_allclose(in_steps.R, at_once.R, atol=1e-12)
    assert few[0].residual_norm(x) == pytest.approx(np.linalg.norm(A[:4] @ x - b[:4]))


def test_blocks_with_few_columns_first_make_the_same_triangle():
    rng = np.random.default_rng(6)
    A, b = rng.standard_normal((60, 8)), rng.standard_normal(60)
    A[:20, :6], A[20:40, [0, 1, 4]] = 0.0, 0.0
    rows = np.column_stack([A, b])
    found = merged_by_support([rows[:20], rows[20:40], rows[40:]], 8)
    expected = Triangle.of(A, b)
    np.testing.assert_allclose(found[:8, :8], expected.R, atol=1e-12)
    np.testing.assert_allclose(found[:8, 8], expected.d, atol=1e-12)
    assert found[8, 8] == pytest.approx(expected.rho)
