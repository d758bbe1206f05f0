import tracemalloc

import numpy as np
import pytest
from banded_systems import System, chunk_of, relative

from ident.information import time_bases
from ident.information.estimate import rank_revealing, solve
from ident.information.linear import Triangle
from ident.information.time_bases import Basis, Chunk, eliminate


def solved(chunks, count, **options):
    elimination = eliminate(chunks, count, **options)
    border = Triangle.merge(elimination.factors)
    x = solve(border, rank_revealing(border)).x
    return elimination, x, elimination.back_substitute(x)


@pytest.mark.parametrize("degree", [0, 1, 3, 5])
@pytest.mark.parametrize("size", [10**9, 37, 1])
def test_agrees_with_dense_least_squares(degree, size):
    system = System(N=121, t_end=1.2, degree=degree, spacing=0.06, k=4)
    elimination, x, a = solved(system.chunks(size), system.basis.count, blocks=4)
    p, dense_a, residual = system.dense_solution()
    assert relative(x, p) < 3e-11  # cores without fused products: 1.03e-11
    assert relative(a, dense_a) < 1e-9
    assert Triangle.merge(elimination.factors).residual_norm(x) == pytest.approx(
        residual, rel=1e-12
    )
    L = system.dense()[0][:, 4:]
    assert elimination.rank == np.linalg.matrix_rank(L)
    assert elimination.rows == len(L)
    assert sum(factor.rows for factor in elimination.factors) == len(L) - elimination.rank
    assert all(factor.rows >= 0 for factor in elimination.factors)


@pytest.mark.parametrize(("n", "m", "k"), [(1, 1, 0), (1, 1, 2), (7, 5, 12), (3, 0, 2), (2, 1, 30)])
def test_any_number_of_rows_multipliers_and_parameters(n, m, k):
    system = System(N=200, t_end=1.0, spacing=0.05, n=n, m=m, k=k)
    _, x, a = solved(system.chunks(64), system.basis.count)
    p, dense_a, _ = system.dense_solution()
    M, b = system.dense()
    y = np.concatenate([x, a.ravel()])
    assert a.shape == (21, m)
    size = np.linalg.norm(M) * (np.linalg.norm(M) * np.linalg.norm(y) + np.linalg.norm(b))
    assert np.linalg.norm(M.T @ (b - M @ y)) < 1e-15 * size
    if k < 30:  # thirty sines are too much alike for their parameters to be compared
        np.testing.assert_allclose(y, np.concatenate([p, dense_a.ravel()]), rtol=1e-7, atol=1e-9)


def test_chunks_may_come_in_any_order():
    system = System(degree=3)
    forward = solved(system.chunks(50), system.basis.count)[1:]
    backward = solved(list(system.chunks(50))[::-1], system.basis.count)[1:]
    assert relative(backward[0], forward[0]) < 1e-12
    assert relative(backward[1], forward[1]) < 1e-10


def test_one_crowded_interval_is_no_obstacle():
    rng = np.random.default_rng(0)
    t = np.sort(np.concatenate([rng.uniform(0, 1, 60), rng.uniform(0.31, 0.34, 3000)]))
    system = System(N=len(t), t_end=1.0, spacing=0.1, n=2, m=1)
    system.t, (system.first, system.values) = t, system.basis.window(t)
    _, x, a = solved(system.chunks(1000), system.basis.count)
    p, dense_a, _ = system.dense_solution()
    assert relative(x, p) < 1e-11
    assert relative(a, dense_a) < 1e-9


def test_rows_filtered_in_time_have_wide_windows():
    """A moving average over 15 samples of every column alike: rows touch four hats, not two."""
    system, taps = System(N=301, t_end=3.0, spacing=0.05, n=4), 15
    M, b = system.dense()
    mix = np.array([np.eye(301)[i : i + taps].mean(axis=0) for i in range(301 - taps + 1)])
    M = np.einsum("st,tij->sij", mix, M.reshape(301, 4, -1)).reshape(-1, M.shape[1])
    b = (mix @ b.reshape(301, 4)).reshape(-1)
    width, (k, m) = 5, (3, 3)
    first = np.minimum(np.repeat(system.first[: len(mix)], 4), system.basis.count - width)
    L = M[:, k:].reshape(len(b), -1, m)
    window = np.take_along_axis(L, (first[:, None] + np.arange(width))[..., None], axis=1)
    assert np.abs(window).sum() == pytest.approx(np.abs(L).sum())
    _, x, a = solved([Chunk(first, window, M[:, :k], b)], system.basis.count)
    y = np.linalg.lstsq(M, b)[0]
    assert relative(x, y[:k]) < 1e-9
    assert relative(a.ravel(), y[k:]) < 1e-6  # a filter leaves knots only weakly determined


def test_factors_are_those_of_their_blocks_of_time():
    """Without multipliers' rows between blocks the factors are exactly those of the samples."""
    system = System(N=300, t_end=3.0)
    system.J_T[:] = 0.0
    count = system.basis.count
    begins = np.arange(1, 3) * count // 3
    factors = eliminate(system.chunks(70), count, blocks=3).factors
    for factor, part in zip(
        factors, np.split(np.arange(300), np.searchsorted(system.first, begins)), strict=True
    ):
        own = Triangle.of(system.A[part].reshape(-1, 3), system.b[part].reshape(-1))
        np.testing.assert_allclose(factor.R, own.R, atol=1e-11)
        assert factor.rho == pytest.approx(own.rho)
        assert factor.rows == own.rows


def test_blocks_change_where_equations_go_not_what_they_say():
    system = System()
    count = system.basis.count
    whole = Triangle.merge(eliminate(system.chunks(), count).factors)
    for blocks in (2, 7, count):
        elimination = eliminate(system.chunks(), count, blocks=blocks)
        np.testing.assert_allclose(Triangle.merge(elimination.factors).R, whole.R, atol=1e-11)
        assert Triangle.merge(elimination.factors).rows == whole.rows


def redundant(system):
    """A closure equation given twice, one that is a mixture of others, and an empty one."""
    J = system.J_T
    system.J_T = np.concatenate(
        [J, J[..., :1], (J @ [0.3, -1.2, 0.7])[..., None], np.zeros_like(J[..., :1])], axis=2
    )
    return system


@pytest.mark.parametrize("degree", [1, 3])
def test_redundant_multipliers_get_the_least_norm(degree):
    shape = {"degree": degree, "n": 5, "N": 151, "t_end": 1.5}
    plain, system = System(**shape), redundant(System(**shape))
    elimination, x, a = solved(system.chunks(90), system.basis.count)
    reference, p, _ = solved(plain.chunks(), plain.basis.count)
    assert elimination.rank == reference.rank == np.linalg.matrix_rank(system.dense()[0][:, 3:])
    assert relative(x, p) < 1e-12
    _, dense_a, residual = system.dense_solution()  # of least norm too, in all unknowns
    assert relative(a, dense_a) < 1e-6
    assert np.abs(a[:, -1]).max() < 1e-12
    assert Triangle.merge(elimination.factors).residual_norm(x) == pytest.approx(
        residual, rel=1e-12
    )


def test_redundant_multipliers_leave_every_block_of_time_its_equations():
    plain, system = System(n=5), redundant(System(n=5))
    expected = eliminate(plain.chunks(), plain.basis.count, blocks=4).factors
    found = eliminate(system.chunks(), system.basis.count, blocks=4).factors
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one.R, other.R, atol=1e-11)
        assert one.rho == pytest.approx(other.rho)
        assert one.rows == other.rows


@pytest.mark.parametrize("degree", [1, 3, 5])
def test_gaps_leave_their_multipliers_at_zero_and_the_rest_untouched(degree):
    system = System(degree=degree, N=301)
    keep = (system.t < 0.9) | (system.t > 1.62)
    for name in ("t", "first", "values", "J_T", "A", "b"):
        setattr(system, name, getattr(system, name)[keep])
    elimination, x, a = solved(system.chunks(40), system.basis.count)
    p, dense_a, residual = system.dense_solution()
    assert relative(x, p) < 1e-11
    assert relative(a, dense_a) < 1e-6
    assert Triangle.merge(elimination.factors).residual_norm(x) == pytest.approx(
        residual, rel=1e-12
    )
    assert elimination.rank == np.linalg.matrix_rank(system.dense()[0][:, 3:])
    untouched = (system.window_matrix() == 0).all(axis=0)
    assert untouched.sum() > 5
    assert np.abs(a[untouched]).max() < 1e-8 * np.abs(a).max()


def test_a_single_sample_and_a_span_of_one_interval():
    basis = Basis.spanning(0, 1, 1.0)
    first, values = basis.window([0.25])
    chunk = chunk_of(
        first, values, np.ones((1, 2, 1)), np.array([[[1.0], [0.0]]]), np.array([[5.0, 2.0]])
    )
    elimination, x, a = solved([chunk], basis.count)
    assert x == pytest.approx([3.0])
    np.testing.assert_allclose([0.75, 0.25] @ a, [2.0])
    assert elimination.rank == 1


def test_the_tolerance_is_not_felt_by_what_the_data_determine(monkeypatch):
    system = System(n=5)
    _, strong, _ = solved(system.chunks(), system.basis.count)
    monkeypatch.setattr(time_bases, "TOLERANCE", 1e-14)
    _, weak, _ = solved(system.chunks(), system.basis.count)
    assert relative(strong, weak) < 1e-14


def test_memory_is_linear_in_samples():
    def peak(N):
        system = System(N=N, t_end=N * 0.01, spacing=0.05)
        chunks = system.chunks(500)
        tracemalloc.start()
        eliminate(chunks, system.basis.count)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return peak

    small, large = peak(1000), peak(4000)
    assert large < 4.5 * small
    assert large < 4000 * 2000  # bytes a sample; a dense band would have 20 kB
