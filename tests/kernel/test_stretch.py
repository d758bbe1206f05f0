"""Stretches merge to the batch's factor, whatever the split and the order of merging."""

import numpy as np
import pytest
from banded_systems import System, relative

from ident.errors import FitError
from ident.information.band import Stretch, eliminate
from ident.information.base import rank_revealing, solve
from ident.information.reduction import Chunk
from ident.information.triangle import Triangle


def chain(stretches):
    total, *rest = stretches
    for each in rest:
        total = total + each
    return total


def tree(stretches, rng):
    """Neighbours merged in random order, which is any bracketing of the sum."""
    left = list(stretches)
    while len(left) > 1:
        i = rng.integers(len(left) - 1)
        left[i : i + 2] = [left[i] + left[i + 1]]
    return left[0]


def factor_of(stretch):
    return Triangle.merge(stretch.closed())


def same(found: Triangle, expected: Triangle):
    assert found.rows == expected.rows
    assert relative(found.R, expected.R) < 1e-9
    assert relative(found.d, expected.d) < 1e-9
    assert abs(found.rho / expected.rho - 1) < 1e-9


@pytest.mark.parametrize("degree", [0, 1, 3, 5])
@pytest.mark.parametrize("size", [1, 7, 40, 10**9])
def test_any_split_merges_to_the_batch(degree, size):
    system = System(degree=degree)
    batch = eliminate(system.chunks(), system.basis.count).border
    pieces = [Stretch.of(chunk) for chunk in system.chunks(size)]
    same(factor_of(chain(pieces)), batch)
    same(factor_of(chain(pieces[::-1])), batch)
    same(factor_of(tree(pieces, np.random.default_rng(1))), batch)


@pytest.mark.parametrize("size", [1, 40])
@pytest.mark.parametrize("degree", [1, 3])
def test_blocks_of_time_are_those_of_the_batch(size, degree):
    system = System(degree=degree)
    begins = np.arange(1, 5) * system.basis.count // 5
    batch = eliminate(system.chunks(), system.basis.count, 5).factors
    pieces = [Stretch.of(chunk, begins) for chunk in system.chunks(size)]
    found = tree(pieces, np.random.default_rng(4)).closed()
    assert [f.rows for f in found] == [f.rows for f in batch]
    same(Triangle.merge(found), Triangle.merge(batch))
    with pytest.raises(FitError, match="valid: the same"):
        pieces[0] + Stretch.of(list(system.chunks(size))[1])


def test_the_parameters_are_those_of_dense_least_squares():
    system = System(degree=3)
    p, _, residual = system.dense_solution()
    factor = factor_of(chain(Stretch.of(chunk) for chunk in system.chunks(1)))
    assert relative(solve(factor, rank_revealing(factor)).x, p) < 1e-9
    assert abs(factor.residual_norm(p) / residual - 1) < 1e-9


def test_sample_by_sample_takes_constant_memory():
    system = System(N=2001, t_end=20.0)
    total, largest = None, 0
    for chunk in system.chunks(1):
        piece = Stretch.of(chunk)
        total = piece if total is None else total + piece
        largest = max(largest, sum(part.X.size + part.Y.size for part in total.parts))
    assert len(total.parts) == 3
    assert largest <= 3 * (6 * 6 + 6 * 4)


def test_redundant_multipliers_and_gaps_are_those_of_the_batch():
    system = System(m=3)
    system.J_T[..., 2] = system.J_T[..., 0] + system.J_T[..., 1]
    chunks = [c for i, c in enumerate(system.chunks(10)) if not 10 <= i < 18]
    batch = eliminate(chunks, system.basis.count).border
    found = factor_of(tree([Stretch.of(chunk) for chunk in chunks], np.random.default_rng(2)))
    same(found, batch)


@pytest.mark.parametrize("condition", [1e4, 1e7, 1e10])
def test_ill_conditioned_columns_lose_nothing_to_the_merging(condition):
    """Against Householder QR of the dense stack in extended precision."""
    if np.finfo(np.longdouble).eps > 1e-18:
        pytest.skip("no extended precision on this machine")
    system = System(N=61, k=4, t_end=0.6, spacing=0.1)
    rng = np.random.default_rng(3)
    mix = np.linalg.qr(rng.standard_normal((4, 4)))[0] * np.geomspace(1, 1 / condition, 4)
    system.A = system.A @ (mix @ np.linalg.qr(rng.standard_normal((4, 4)))[0])
    k = system.A.shape[2]
    system.b = system.A.sum(axis=2) + 1e-6 * rng.standard_normal(system.b.shape)
    M, b = system.dense()
    R = triangle(np.column_stack([M[:, k:], M[:, :k], b]))[-k - 1 :, -k - 1 :]
    exact = np.linalg.norm(np.asarray(R[:k, :k], dtype=float), axis=0)
    found = factor_of(tree([Stretch.of(c) for c in system.chunks(3)], rng))
    expected = np.asarray(R[:k] * np.sign(R.diagonal()[:k])[:, None], dtype=float)
    # rows of a triangle are as sure as its columns are far from each other: backward stability
    off = np.abs(np.column_stack([found.R, found.d]) - expected)
    assert (off[:, :k] / exact).max() < 1e-15 * 300 * condition
    mine = solve(found, rank_revealing(found, 1e-13)).x
    best = abs(float(R[k, k]))
    assert abs(found.rho - best) < 1e-13 * np.linalg.norm(b)
    assert abs(residual(R, mine, k) - best) < 1e-13 * np.linalg.norm(b)


def residual(R, x, k):
    rest = R[:k, :k] @ x.astype(np.longdouble) - R[:k, k]
    return float(np.sqrt(rest @ rest + R[k, k] ** 2))


def triangle(M):
    """R of a QR by Householder reflections in extended precision."""
    R = M.astype(np.longdouble)
    for j in range(min(R.shape)):
        v = R[j:, j].copy()
        size = np.sqrt(v @ v)
        if size == 0:
            continue
        v[0] += np.copysign(size, v[0])
        v /= np.sqrt(v @ v)
        R[j:] -= 2 * np.outer(v, v @ R[j:])
    return R[: M.shape[1]]


def test_what_does_not_fit_is_refused():
    system = System()
    first, second = (Stretch.of(c) for c in list(system.chunks(150))[:2])
    with pytest.raises(FitError, match="valid: neighbours"):
        first + first
    with pytest.raises(FitError, match="valid: all the same"):
        second + Stretch.of(next(iter(System(k=4).chunks(5))))
    empty = Chunk(np.zeros(0, int), np.zeros((0, 2, 3)), np.zeros((0, 3)), np.zeros(0))
    with pytest.raises(FitError, match="one or more"):
        Stretch.of(empty)
