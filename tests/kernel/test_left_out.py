"""Blocks left out by downdating, against fits that are made again without them."""

import numpy as np
import pytest

from ident.information.blocks import Block, Information
from ident.information.chance import covariance, held_out
from ident.information.estimate import estimate
from ident.information.left_out import LeftOut
from ident.information.linear import Triangle

K, BLOCKS, ROWS = 6, 12, 5


def information(seed: int = 0, alone: bool = False) -> Information:
    """Rows of two coordinates, of four and of six unknowns, of which the last is 2 × the first;
    `alone`: one unknown is felt in a single block."""
    rng, none = np.random.default_rng(seed), Triangle.empty
    supports, blocks = (np.arange(4), np.arange(K)), []
    x = rng.standard_normal(K)
    for block in range(BLOCKS):
        for u, support in enumerate(supports):
            A = rng.standard_normal((ROWS, len(support)))
            if u == 1:
                A[:, 5] = 2 * A[:, 0]
            A[:, 3] *= not alone or block == 2
            b = A @ x[support] + 0.1 * (1 + u) * rng.standard_normal(ROWS)
            empty = none(len(support))
            span = (float(block), block + 0.9)
            key = (0, block, u)
            blocks.append(
                Block(*key, Triangle.of(A, b), empty, empty, support, (float(b @ b), 0.0), span)
            )
    return Information.of(blocks, K, 2)


def test_changes_are_those_of_new_fits():
    rows = information()
    fit = estimate(rows.totals, np.zeros(K), np.ones(2))
    left = LeftOut.of(rows, fit)
    changes, good = left.without([[(0, 3)], [(0, 0), (0, 7), (0, 8)]])
    assert good.all()
    for gone, change in zip(([3], [0, 7, 8]), changes, strict=True):
        others = {key: block for key, block in rows.blocks.items() if block.block not in gone}
        again = estimate(Information(others, K, 2).totals, np.zeros(K), np.ones(2), sigma=fit.sigma)
        np.testing.assert_allclose(fit.solution.beta + change, again.solution.beta, rtol=1e-10)
    deltas, _ = left.deltas
    np.testing.assert_allclose(left.without([[t] for t in left.times])[0], -deltas, rtol=1e-10)
    np.testing.assert_allclose(np.diag(covariance(rows, fit)) > 0, True)


@pytest.mark.parametrize("alone", [False, True])
def test_errors_of_stretches_are_those_of_new_fits(alone):
    rows = information(1, alone)
    fit = estimate(rows.totals, np.zeros(K), np.ones(2))
    quick = held_out(rows, rows, fit, np.zeros(K))
    slow = held_out(rows, rows, fit, np.zeros(K), refit=lambda other: other.x)
    np.testing.assert_allclose(quick.all_rows, slow.all_rows, rtol=1e-9)


def test_held_unknowns_leave_the_base_without_another_search():
    rng = np.random.default_rng(3)
    A = rng.standard_normal((80, 5))
    A[:, 3], A[:, 4] = 1e-5 * A[:, 3], A[:, :2] @ [1.0, 2.0]  # hardly felt; a combination
    b = A @ np.array([1.0, -2.0, 3.0, 0.5, 0.0]) + rng.standard_normal(80)
    totals, prior = [Triangle.of(A, b)], np.array([0.1, 0.2, 0.3, 0.4, 0.5])
    for plausible in (np.full(5, 10.0), np.array([0.001, 10.0, 10.0, 10.0, 10.0])):
        found = estimate(totals, prior, np.array([5.0]), plausible)
        right = estimate(totals, prior, np.array([5.0]), fixed=found.fixed, sigma=found.sigma)
        assert found.fixed[3]
        np.testing.assert_allclose(found.x, right.x)
        free = ~found.fixed
        by_hand = np.linalg.lstsq(A[:, free], b - A[:, ~free] @ prior[~free], rcond=None)[0]
        np.testing.assert_allclose(A[:, free] @ found.x[free], A[:, free] @ by_hand, rtol=1e-8)
