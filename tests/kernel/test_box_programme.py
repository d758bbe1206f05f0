"""Dry friction of joints at rest as a quadratic programme with box bounds."""

import numpy as np

from ident.simulate.dynamics import box_programme, holding_friction


def test_the_box_programme_is_complementary():
    rng = np.random.default_rng(0)
    for _ in range(500):
        k, d = rng.integers(1, 8), rng.integers(1, 5)  # H is often singular
        B, A = rng.normal(size=(k, d)), rng.normal(size=(d, d))
        back = np.linalg.solve(
            A @ A.T + 0.1 * np.eye(d), np.column_stack([rng.normal(size=d), B.T])
        )
        H, g = B @ back[:, 1:], B @ back[:, 0]
        F = rng.uniform(0, 2, k) * (rng.uniform(size=k) > 0.1)
        f, side = box_programme(H, g, F)
        u = g - H @ f
        assert (np.abs(f) <= F + 1e-12).all()
        assert np.abs(u[side == 0]).max(initial=0) < 1e-10
        assert (side * u > -1e-10).all()
        np.testing.assert_array_equal(f[side != 0], (side * F)[side != 0])


def test_friction_of_stuck_joints_is_continuous_where_one_breaks_away():
    """Friction that depends on the load is solved for by iteration, which a step would upset."""
    H, g = np.array([[2.0, 0.3], [0.3, 1.0]]), np.array([1.0, -0.7])
    f = np.linalg.solve(H, g)
    for share in (1 + 1e-8, 1 - 1e-10, 1 - 1e-6, 0.5):
        found, holds = holding_friction(H, g, share * np.abs(f))
        np.testing.assert_allclose(found, f, rtol=1e-14)
        assert holds == (share > 1)


def test_stuck_joints_of_one_motion_share_its_load():
    B = np.array([[1.0], [2.0]])  # two joints of a loop of one degree of freedom
    H, g = B @ B.T, 3.0 * B[:, 0]
    for F, possible in ((np.array([2.0, 1.0]), True), (np.array([0.5, 1.0]), False)):
        f, holds = holding_friction(H, g, F)
        assert holds == possible
        np.testing.assert_allclose(H @ f, g, atol=1e-12)
        assert not holds or (np.abs(f) <= F).all()
