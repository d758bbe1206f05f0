import numpy as np
import pytest

from ident.information.chance import prior_covariance
from ident.information.estimate import estimate, rank_revealing, solve
from ident.information.linear import Triangle


@pytest.fixture
def regrouped():
    """Ten columns of very different size of which 1, 4, 5 and 8 depend on those before them."""
    rng = np.random.default_rng(2)
    free = rng.standard_normal((400, 6)) * [1, 1e-4, 1e3, 1, 10, 1e-2]
    K = np.zeros((6, 4))
    K[0, 1], K[1, 1] = 2.0, -3e3
    K[2, 2] = 1e-5
    K[[0, 3, 4], 3] = 0.5, -1.0, 0.25
    A = np.zeros((400, 10))
    A[:, [0, 2, 3, 6, 7, 9]] = free
    A[:, [1, 4, 5, 8]] = free @ K
    return A, K, rng.standard_normal(400)


def test_the_first_of_dependent_columns_is_kept_and_the_rest_regrouped(regrouped):
    A, K, b = regrouped
    base = rank_revealing(Triangle.of(A, b))
    assert base.independent.tolist() == [0, 2, 3, 6, 7, 9]
    assert base.dependent.tolist() == [1, 4, 5, 8]
    assert base.rank == 6
    assert ((base.K == 0) == (K == 0)).all()
    np.testing.assert_allclose(base.K, K, rtol=1e-11)
    unit = A[:, base.independent] / np.linalg.norm(A[:, base.independent], axis=0)
    assert base.condition_number == pytest.approx(np.linalg.cond(unit), rel=1e-10)
    assert base.distance[base.dependent].max() < 1e-13


def test_dependent_unknowns_keep_their_prior_and_the_fit_is_the_best(regrouped):
    A, K, b = regrouped
    factor = Triangle.of(A, b)
    base = rank_revealing(factor)
    prior = np.random.default_rng(5).standard_normal(10)
    solution = solve(factor, base, prior)
    assert (solution.x[base.dependent] == prior[base.dependent]).all()
    norm = np.linalg.norm(A[:, base.independent], axis=0)  # equilibrated: lstsq's SVD needs it
    beta = np.linalg.lstsq(A[:, base.independent] / norm, b)[0] / norm
    np.testing.assert_allclose(solution.beta, beta, rtol=1e-11)
    np.testing.assert_allclose(solution.x[base.independent], beta - K @ prior[[1, 4, 5, 8]])
    assert factor.residual_norm(solution.x) == pytest.approx(
        np.linalg.norm(A[:, base.independent] @ beta - b), rel=1e-9
    )
    own = A[:, base.independent]
    np.testing.assert_allclose(solution.C, np.linalg.inv(own.T @ own), rtol=1e-9, atol=1e-16)
    assert solve(factor, base).x[base.dependent].tolist() == [0.0] * 4


@pytest.mark.parametrize("closeness", [1e-2, 1e-5, 1e-7])
def test_dependence_is_found_behind_nearly_dependent_columns(closeness):
    """Columns 0 and 1 nearly coincide, so the combination for column 3 is huge, yet exact."""
    rng = np.random.default_rng(0)
    a, e, c = rng.standard_normal((3, 500))
    A = np.column_stack([a, a + closeness * e, c, e, a - c])
    base = rank_revealing(Triangle.of(A, np.zeros(500)))
    assert base.independent.tolist() == [0, 1, 2]
    eps = np.finfo(float).eps / closeness**2 * 1e3
    expected = [[-1 / closeness, 1.0], [1 / closeness, 0.0], [0.0, -1.0]]
    np.testing.assert_allclose(base.K, expected, rtol=max(eps, 1e-12), atol=1e-16)


def test_independent_columns_with_a_large_condition_number_are_all_kept():
    rng = np.random.default_rng(0)
    U, _ = np.linalg.qr(rng.standard_normal((300, 8)))
    V, _ = np.linalg.qr(rng.standard_normal((8, 8)))
    A = U * np.geomspace(1, 1e-6, 8) @ V
    base = rank_revealing(Triangle.of(A, np.zeros(300)))
    assert base.rank == 8
    assert base.condition_number == pytest.approx(
        np.linalg.cond(A / np.linalg.norm(A, axis=0)), rel=1e-6
    )


def test_the_tolerance_is_the_new_part_of_a_column():
    a, b = np.eye(2)
    factor = Triangle.of(np.column_stack([a, a + 1e-4 * b]), np.zeros(2))
    assert rank_revealing(factor, tol=0.9e-4).rank == 2
    assert rank_revealing(factor, tol=1.1e-4).rank == 1
    assert rank_revealing(factor).distance[1] == pytest.approx(1e-4, rel=1e-6)


def test_nothing_to_find():
    for k in (0, 3):
        factor = Triangle.empty(k)
        base = rank_revealing(factor)
        assert base.rank == 0
        assert base.condition_number == 1.0
        assert base.K.shape == (0, k)
        assert solve(factor, base, np.arange(k)).x.tolist() == list(range(k))


def test_what_is_held_adds_the_errors_that_a_prior_row_gives():
    """Solved together with rows δ = prior ± plausible, whether the data contradict that or not."""
    random = np.random.default_rng(5)
    A = random.standard_normal((60, 5)) * [1.0, 1.0, 1.0, 0.5, 1e-3]
    plausible = np.array([np.inf, np.inf, np.inf, 1e4, 0.3])
    held = np.isfinite(plausible)
    found = estimate(
        [Triangle.of(A, A.sum(axis=1))], np.ones(5), np.ones(1), None, np.ones(1), held
    )
    together = np.linalg.inv(A.T @ A + np.diag(plausible**-2.0))[:3, :3]
    np.testing.assert_allclose(
        found.solution.C + prior_covariance(found, plausible), together, rtol=1e-6
    )


def test_a_column_that_only_the_last_weights_make_independent_is_held_too():
    """Two columns are one to 1e-9; rows that part them weigh 100 times as much later."""
    random = np.random.default_rng(3)
    common, free = random.standard_normal((2, 200))
    coarse, fine = random.standard_normal((2, 200)) * [[30.0], [0.1]]
    none = np.zeros(200)
    slow = Triangle.of(np.column_stack([common, common, none]), common + coarse)
    fast = Triangle.of(
        np.column_stack([none, 1e-9 * random.standard_normal(200), free]), free + fine
    )
    plausible = np.full(3, 10.0)
    fit = estimate([slow, fast], np.zeros(3), np.array([30.0, 1.0]), plausible)
    assert fit.base.independent.tolist() == [0, 2]
    assert fit.fixed.tolist() == [False, True, False]
    assert abs(fit.x[1]) < 10.0
    weights, none_held = np.array([30.0, 0.1]), np.zeros(3, dtype=bool)
    before = np.array([0, 2])
    for known, held in ((None, False), (before, True), (np.arange(3), False)):
        fit = estimate(
            [slow, fast], np.zeros(3), np.ones(2), plausible, weights, none_held, known=known
        )
        assert fit.fixed.tolist() == [False, held, False]


def test_what_follows_an_unknown_below_zero_is_held_at_zero_too():
    """Of (−1, 0.3, 2) the second becomes −0.6 once the first is at zero, and the third 1.5."""
    C = np.array([[1.0, -0.9, -0.5], [-0.9, 1.0, 0.4], [-0.5, 0.4, 1.0]])
    R = np.linalg.cholesky(np.linalg.inv(C)).T
    total = Triangle.of(R, R @ [-1.0, 0.3, 2.0])
    free = estimate([total], np.zeros(3), np.ones(1), sigma=np.ones(1))
    assert free.limited(np.array([0])).x == pytest.approx([0, -0.6, 1.5])
    at_zero = free.nonnegative(np.array([0, 1]))
    assert at_zero.at_limit.tolist() == [0, 1]
    last = C[2, :2] @ np.linalg.solve(C[:2, :2], [-1.0, 0.3])
    assert at_zero.x == pytest.approx([0, 0, 2 - last])
    # in two steps, and from another limit, as least squares of the third alone have it
    assert free.limited(np.array([1])).limited(np.array([0])).x == pytest.approx(at_zero.x)
    moved = free.limited(np.array([1]), 0.1).limited(np.array([0]))
    assert moved.x[:2] == pytest.approx([0, 0.1])
    assert moved.at_limit.tolist() == [0, 1]
    fixed = np.array([True, True, False])
    alone = estimate([total], at_zero.x, np.ones(1), sigma=np.ones(1), fixed=fixed)
    assert alone.x == pytest.approx(at_zero.x)
