"""The paper's first example (sect. 3.1), from its equations of motion to the identified inertia."""

import numpy as np
import pytest
from banded_systems import chunk_of
from scipy.integrate import solve_ivp

from ident.information.estimate import rank_revealing, solve
from ident.information.linear import Triangle
from ident.information.time_bases import Basis, eliminate

M, I_ZZ, L, g = 10.0, 0.2, 0.5, 9.81  # kg, kg m², m, m/s²


@pytest.fixture(scope="module")
def pendulum():
    """t (501,), J_T (501, 3, 2), A (501, 3, 1), b (501, 3), lambda (501, 2): paper, eq. 11."""

    def motion(_, state):
        return state[1], -M * g * L * np.sin(state[0]) / (I_ZZ + M * L**2)

    t = np.linspace(0, 5, 501)
    run = solve_ivp(
        motion, (0, 5), (np.pi / 2, 0), t_eval=t, rtol=1e-12, atol=1e-13, method="DOP853"
    )
    theta, v = run.y
    a = motion(0, run.y)[1]
    sin, cos = np.sin(theta), np.cos(theta)
    ddx, ddy = -L * (sin * a + cos * v**2), L * (cos * a - sin * v**2)
    J_T = np.zeros((501, 3, 2))
    J_T[:, 0, 0] = J_T[:, 1, 1] = 1.0
    J_T[:, 2] = np.column_stack([L * sin, -L * cos])
    A = np.zeros((501, 3, 1))
    A[:, 2, 0] = a
    b = np.column_stack([M * g - M * ddx, -M * ddy, np.zeros(501)])
    return t, J_T, A, b, b[:, :2]


def identified(pendulum, degree):
    t, J_T, A, b, _ = pendulum
    basis = Basis.with_count(0.0, 5.0, 101, degree)
    elimination = eliminate([chunk_of(*basis.window(t), J_T, A, b)], basis.count)
    border = Triangle.merge(elimination.factors)
    x = solve(border, rank_revealing(border)).x
    return x[0], basis.evaluate(elimination.back_substitute(x), t)


@pytest.mark.parametrize(
    ("degree", "inertia", "digits"),
    [(1, 0.20034, 5e-6), (3, 0.20000008, 5e-9), (5, 0.2000000002, 5e-11)],
)
def test_the_error_of_101_unknowns_is_that_of_the_basis(pendulum, degree, inertia, digits):
    found, force = identified(pendulum, degree)
    assert found == pytest.approx(inertia, abs=digits)
    error = np.abs(force - pendulum[-1]).max() / np.abs(pendulum[-1]).max()
    assert error < {1: 2e-2, 3: 2e-4, 5: 1e-5}[degree]


def test_free_multipliers_are_exact(pendulum):
    _, J_T, A, b, force = pendulum
    Q = np.linalg.qr(J_T, mode="complete")[0][..., 2:].swapaxes(1, 2)  # Q J_T = 0
    factor = Triangle.of((Q @ A)[:, 0], (Q @ b[..., None])[:, 0, 0])
    x = solve(factor, rank_revealing(factor)).x
    assert x[0] == pytest.approx(I_ZZ, rel=1e-13)
    found = (np.linalg.pinv(J_T) @ (b - A @ x)[..., None])[..., 0]
    np.testing.assert_allclose(found, force, atol=1e-11)
