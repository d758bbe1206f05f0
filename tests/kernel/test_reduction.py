"""Batches of small reductions: an orthogonal transformation changes no product of columns."""

import numpy as np
import pytest

from ident.information.reduction import reflect

SHAPES = [(20, 6, 4), (12, 9, 4), (35, 6, 61), (9, 9, 3), (5, 2, 40), (4, 3, 1), (7, 0, 3)]


def gram(X, Y):
    Z = np.concatenate([X, Y], axis=-1)
    return Z.swapaxes(1, 2) @ Z


@pytest.mark.parametrize(("r", "c", "k"), SHAPES)
@pytest.mark.parametrize("rank_deficient", [False, True])
def test_products_of_columns_are_kept(r, c, k, rank_deficient):
    random = np.random.default_rng(0)
    X, Y = random.standard_normal((5, r, c)), random.standard_normal((5, r, k))
    if rank_deficient and c > 1:
        X[..., 1] = 2 * X[..., 0]
    R, taken = reflect(X, Y)
    assert R.shape == (5, c, c)
    assert taken.shape[1] >= c
    np.testing.assert_array_equal(R, np.triu(R))
    rest = taken.shape[1] - c
    whole = np.concatenate([R, np.zeros((5, rest, c))], axis=1)
    np.testing.assert_allclose(gram(whole, taken), gram(X, Y), atol=1e-12 * r)


def test_free_rows_are_no_more_than_columns():
    random = np.random.default_rng(1)
    _, taken = reflect(random.standard_normal((3, 40, 6)), random.standard_normal((3, 40, 4)))
    assert taken.shape == (3, 10, 4)
