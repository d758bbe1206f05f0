"""Bodies drawn to a prior: as far as rows do not know better, and by no more than is likely."""

import numpy as np

from ident.information.blocks import Block, Information
from ident.information.estimate import estimate
from ident.information.linear import Triangle
from ident.information.shrinkage import Shrinkage

ROWS, BLOCKS, BODIES, EFFECTS = 600, 12, 8, 2
SIZES = np.geomspace(1.0, 1e-3, BODIES)  # of their columns: from well to badly determined


def _case(seed, noise=0.02, spread=1.0):
    """Rows of bodies that are `spread` from their prior, in units of what is plausible; the truth,
    their least squares and how these are drawn.
    """
    random, k = np.random.default_rng(seed), BODIES + EFFECTS
    A = random.standard_normal((ROWS, k)) * np.append(SIZES, np.ones(EFFECTS))
    prior, plausible = np.append(np.ones(BODIES), np.zeros(EFFECTS)), np.ones(k)
    truth = prior + np.append(spread * np.ones(BODIES), 5.0 * np.ones(EFFECTS)) * (
        random.standard_normal(k)
    )
    b = A @ truth + noise * random.standard_normal(ROWS)
    block = np.arange(ROWS) * BLOCKS // ROWS
    none, support, blocks = Triangle.empty(k), np.arange(k), []
    for i in range(BLOCKS):
        rows = Triangle.of(A[block == i], b[block == i])
        blocks.append(Block(0, i, 0, rows, none, none, support, (1.0, 0.0), (float(i), i + 1.0)))
    information = Information.of(blocks, k, 1)
    fitted = estimate(information.totals, prior, np.ones(1))
    return truth, fitted, Shrinkage.of(information, fitted, prior, plausible, BODIES)


def test_bodies_are_nearer_to_the_truth_and_what_is_known_stays():
    before, after = [], []
    for seed in range(20):
        truth, fitted, shrinkage = _case(seed)
        drawn = shrinkage.drawn(fitted)
        before.append(fitted.x - truth)
        after.append(drawn.x - truth)
        known = SIZES > 0.1
        change = np.abs(drawn.x - fitted.x)[:BODIES][known]
        assert (change < 0.2 * np.sqrt(np.diag(fitted.solution.C))[:BODIES][known]).all()
    before, after = (np.sqrt(np.mean(np.square(x), axis=0)) for x in (before, after))
    assert after[BODIES - 1] < 0.8 * before[BODIES - 1]
    assert after[BODIES - 1] < 1.3  # of what is plausible
    np.testing.assert_allclose(after[:3], before[:3], rtol=0.02)
    np.testing.assert_allclose(after[BODIES:], before[BODIES:], rtol=0.1)  # friction has no prior


def test_without_noise_nothing_moves():
    assert _case(0, noise=1e-12)[2] is None


def test_placeholders_do_not_hold_bodies():
    """Bodies that all are thirty plausible sizes from the prior show that it is none."""
    scales, changes = [], []
    for seed in range(10):
        _, fitted, shrinkage = _case(seed, spread=30.0)
        if shrinkage is None:
            continue
        scales.append(shrinkage.scale)
        errors = np.sqrt(np.diag(fitted.solution.C))
        changes.append(np.abs(shrinkage.change(fitted)) / errors)
    assert not scales or np.median(scales) > 10.0
    assert not changes or np.median(changes, axis=0).max() < 0.5
