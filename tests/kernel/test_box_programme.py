"""Dry friction of joints at rest as a quadratic programme with box bounds."""

import numpy as np

from ident.simulate.balance import box_programme


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
