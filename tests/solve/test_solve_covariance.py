import numpy as np
import pytest
from solve_systems import System

from ident.errors import FitError
from ident.solve.covariance import multiplier_variance
from ident.solve.eliminate import eliminate
from ident.solve.rank import reveal, solve


@pytest.mark.parametrize("degree", [0, 1, 3, 5])
def test_variances_are_those_of_the_dense_inverse(degree):
    system = System(N=121, t_end=1.2, degree=degree, spacing=0.07)
    elimination = eliminate(system.chunks(50), system.basis.count)
    border = elimination.border
    C = solve(border, reveal(border)).C
    found = multiplier_variance(elimination, C, system.first, system.values)
    inverse = np.linalg.inv(np.linalg.qr(system.dense()[0], mode="r"))
    a = (inverse @ inverse.T)[3:, 3:].reshape(system.basis.count, 3, -1, 3)
    B = system.window_matrix()
    np.testing.assert_allclose(found, np.einsum("ta,aibi,tb->ti", B, a, B), rtol=1e-6)


def test_a_redundancy_that_turns_leaves_the_projected_multipliers_sure():
    system = System(n=5, N=201, t_end=2.0, spacing=0.04)
    turn = 2 * system.t
    open_ = np.column_stack([np.cos(turn), 0.8 * np.sin(turn), 0.6 * np.sin(turn)])
    system.J_T -= (system.J_T @ open_[..., None]) * open_[:, None, :]
    projector = np.eye(3) - open_[..., None] * open_[:, None, :]
    elimination = eliminate(system.chunks(), system.basis.count)
    C = solve(elimination.border, reveal(elimination.border)).C
    window = system.basis.window(system.t)
    plain = multiplier_variance(elimination, C, *window)
    found = multiplier_variance(elimination, C, *window, projector)
    _, s, Vt = np.linalg.svd(system.dense()[0], full_matrices=False)
    root = (Vt.T / s)[3:].reshape(system.basis.count, 3, -1)
    B = system.window_matrix()
    expected = (np.einsum("tij,ta,ajs->tis", projector, B, root) ** 2).sum(axis=2)
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    assert plain.max() > 1e4 * found.max()


def test_known_parameters_make_multipliers_surer():
    system = System()
    elimination = eliminate(system.chunks(), system.basis.count)
    C = solve(elimination.border, reveal(elimination.border)).C
    window = system.basis.window(system.t)
    unsure, sure = (multiplier_variance(elimination, cov, *window) for cov in (C, 0 * C))
    assert (unsure >= sure).all()
    assert (unsure > 1.0001 * sure).any()


def test_what_the_data_leave_open_has_no_finite_variance():
    system = System(m=2, n=3)
    system.J_T = np.concatenate([system.J_T, system.J_T[..., :1], 0 * system.J_T[..., :1]], axis=2)
    system.J_T[100:150] = 0.0
    elimination = eliminate(system.chunks(), system.basis.count)
    found = multiplier_variance(elimination, np.zeros((3, 3)), system.first, system.values)
    assert np.isinf(found[:, [0, 2, 3]]).all()
    gap = (system.t > 1.05) & (system.t < 1.45)
    assert np.isinf(found[gap, 1]).all()
    outside = (system.t < 0.94) | (system.t > 1.56)
    assert np.isfinite(found[outside, 1]).all()


def test_what_does_not_fit_is_refused():
    system = System()
    elimination = eliminate(system.chunks(), system.basis.count)
    with pytest.raises(FitError, match=r"valid: \(3, 3\)"):
        multiplier_variance(elimination, np.eye(2), system.first, system.values)
