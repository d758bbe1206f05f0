"""Matrices for which LAPACK's fast driver does not converge."""

import numpy as np
import pytest

from ident.errors import FitError
from ident.information import linear

random = np.random.default_rng(0)
A, STACK, LOW = (
    random.standard_normal((7, 4)),
    random.standard_normal((2, 3, 4, 6)),
    random.standard_normal((6, 2)) @ random.standard_normal((2, 5)),
)


@pytest.fixture
def broken(monkeypatch):
    """Every fast driver fails."""

    def fails(*_, **__):
        raise np.linalg.LinAlgError("SVD did not converge")

    def break_them():
        for name in ("svd", "pinv", "lstsq"):
            monkeypatch.setattr(np.linalg, name, fails)

    return break_them


@pytest.mark.parametrize("M", [A, A.T, STACK, LOW], ids=["tall", "wide", "stack", "rank 2"])
@pytest.mark.parametrize("full", [False, True])
def test_the_slower_drivers_find_the_same(M, full, broken):
    expected = np.linalg.svd(M, full_matrices=full), np.linalg.pinv(M, 1e-9)
    broken()
    for part, other in zip(linear.svd(M, full), expected[0], strict=True):
        assert part.shape == other.shape
    U, s, Vt = linear.svd(M, False)
    assert (U * s[..., None, :]) @ Vt == pytest.approx(M)
    assert s == pytest.approx(expected[0][1], abs=1e-12)
    assert linear.pinv(M, 1e-9) == pytest.approx(expected[1])


def test_least_squares_and_symmetric_inverses_too(broken):
    H, b = LOW.T @ LOW, random.standard_normal((6, 2))
    expected = np.linalg.lstsq(LOW, b, rcond=1e-9), np.linalg.pinv(H, 1e-9, hermitian=True)
    broken()
    x, rank = linear.lstsq(LOW, b, rcond=1e-9)
    assert x == pytest.approx(expected[0][0])
    assert rank == 2
    assert linear.pinv(H, 1e-9, hermitian=True) == pytest.approx(expected[1])


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_not_finite_is_said(value):
    M = np.full((3, 3), value)
    for ask in (lambda: linear.svd(M), lambda: linear.pinv(M), lambda: linear.lstsq(M, M)):
        with pytest.raises(FitError, match="not finite"):
            ask()


@pytest.mark.parametrize("size", [1, 4])
def test_inverses_of_stacks_leave_out_what_is_not_determined(size):
    turn = np.linalg.qr(random.standard_normal((2, 3, size, size)))[0]
    values = random.uniform(0.1, 1.0, (2, 3, size))
    whole = (turn * values[..., None, :]) @ turn.swapaxes(-1, -2)
    assert linear.inverse(whole) == pytest.approx(np.linalg.inv(whole))
    values[1, 2, 0] = 1e-9  # one direction of one matrix
    open_one = (turn * values[..., None, :]) @ turn.swapaxes(-1, -2)
    expected = np.linalg.pinv(open_one, 1e-8, hermitian=True)
    if size == 1:
        expected[1, 2] = 0.0
    assert linear.inverse(open_one) == pytest.approx(expected)
