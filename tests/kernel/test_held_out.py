"""Leaving each stretch out once: the same as merging all the others."""

import numpy as np
import pytest

from ident.information.chance import without_each
from ident.information.linear import Triangle


@pytest.mark.parametrize("count", [1, 2, 7])
def test_without_each_is_the_factor_of_all_other_rows(count):
    random = np.random.default_rng(0)
    A, b = random.standard_normal((count, 9, 4)), random.standard_normal((count, 9))
    found = without_each([Triangle.of(*each) for each in zip(A, b, strict=True)])
    assert len(found) == count
    for i, factor in enumerate(found):
        rest = np.arange(count) != i
        expected = Triangle.of(A[rest].reshape(-1, 4), b[rest].reshape(-1))
        np.testing.assert_allclose(factor.R, expected.R, atol=1e-12)
        np.testing.assert_allclose(factor.d, expected.d, atol=1e-12)
        assert factor.rho == pytest.approx(expected.rho, abs=1e-12)
        assert factor.rows == expected.rows
