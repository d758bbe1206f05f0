import numpy as np
import pytest
from scipy.linalg import null_space
from solve_systems import System, relative

from ident.errors import FitError
from ident.solve.factor import Factor
from ident.solve.rank import reveal, solve
from ident.solve.samplewise import eliminate_samplewise, multipliers_samplewise


def redundant(system):
    system.J_T = np.concatenate([system.J_T, system.J_T[..., :1], 0 * system.J_T[..., :1]], axis=2)
    system.J_T[7] = 0.0  # a singular position
    return system


@pytest.mark.parametrize("change", [lambda system: system, redundant])
def test_parameters_are_those_of_the_null_space_projection(change):
    system = change(System(N=60, n=5))
    projected = eliminate_samplewise(system.J_T, system.A, system.b)
    Z = [null_space(J_T.T, rcond=1e-9) for J_T in system.J_T]
    rows = np.concatenate([z.T @ A for z, A in zip(Z, system.A, strict=True)])
    right = np.concatenate([z.T @ b for z, b in zip(Z, system.b, strict=True)])
    factor = Factor.of(projected.A[projected.free], projected.b[projected.free])
    p = solve(factor, reveal(factor)).x
    assert relative(p, np.linalg.lstsq(rows, right)[0]) < 1e-12
    assert factor.rows == len(rows)
    assert (projected.A[~projected.free] == 0).all()
    assert (projected.b[~projected.free] == 0).all()
    assert projected.rank.tolist() == [np.linalg.matrix_rank(J_T) for J_T in system.J_T]


@pytest.mark.parametrize("change", [lambda system: system, redundant])
def test_multipliers_have_the_least_norm(change):
    system = change(System(N=40, n=5))
    rest = system.b - system.A @ [1.0, -2.0, 0.5]
    found = multipliers_samplewise(system.J_T, rest)
    expected = [np.linalg.lstsq(J, r, rcond=1e-9)[0] for J, r in zip(system.J_T, rest, strict=True)]
    np.testing.assert_allclose(found, expected, atol=1e-11)


def test_more_multipliers_than_rows_leave_nothing():
    system = System(N=10, n=2, m=3)
    projected = eliminate_samplewise(system.J_T, system.A, system.b)
    assert not projected.free.any()


def test_no_multipliers_leave_everything():
    system = System(N=10, m=0)
    projected = eliminate_samplewise(system.J_T, system.A, system.b)
    assert projected.free.all()
    assert np.linalg.norm(projected.b) == pytest.approx(np.linalg.norm(system.b))
    assert multipliers_samplewise(system.J_T, system.b).shape == (10, 0)


def test_what_does_not_fit_is_refused():
    system = System(N=10)
    with pytest.raises(FitError, match="J_T"):
        eliminate_samplewise(system.J_T[:5], system.A, system.b)
    with pytest.raises(FitError, match="valid"):
        eliminate_samplewise(system.J_T, system.A, system.b[:5])
    with pytest.raises(FitError, match="not finite"):
        eliminate_samplewise(system.J_T * np.nan, system.A, system.b)
    with pytest.raises(FitError, match="rest"):
        multipliers_samplewise(system.J_T, system.b[:5])
