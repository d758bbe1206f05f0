"""The rule of evidence, and the measure by which a motion shows two causes apart."""

from __future__ import annotations

import numpy as np
import pytest

from ident.diagnosis.experiment import Attempt
from ident.excite.excitation import Separation
from ident.information.evidence import (
    RIVAL,
    SAME_SHARE,
    TOLD_APART_SE,
    credible,
    leaves_as_little,
    nearly_best,
    rivals_of,
    surely_t,
    surprise,
    zscore_in_noise,
)
from ident.information.separation import orthonormal, share_apart, without_columns_of


def test_every_question_of_the_rule_counts():
    asked = {"size": 0.1, "least": 0.01, "remaining": 0.2, "most": 0.5}
    assert credible(2.0, 1.0, **asked)
    assert not credible(1.0, 1.0, **asked)  # no more than chance
    assert not credible(2.0, 1.0, **{**asked, "size": 0.01})  # too small to matter
    assert not credible(2.0, 1.0, **{**asked, "remaining": 0.6})  # leaves what it claims
    assert not credible(2.0, 1.0, **asked, possible=False)


def test_a_chance_surprises_by_its_logarithm():
    assert credible(surprise(0.001), surprise(0.01))
    assert not credible(surprise(0.02), surprise(0.01))
    assert np.isfinite(surprise(0.0))


def test_the_best_of_many_untrue_causes_is_seldom_credible():
    """H causes that explain nothing: the best exceeds its limit in one log of a hundred."""
    random, H, blocks, logs = np.random.default_rng(3), 40, 20, 2000
    D = random.standard_normal((logs, H, blocks))
    z = D.mean(axis=2) / (D.std(axis=2, ddof=1) / np.sqrt(blocks))
    share = float((z.max(axis=1) > surely_t(H, blocks)).mean())
    assert 0.003 < share < 0.02


def test_the_gain_of_a_truth_over_a_rival_has_unit_scatter_in_known_noise():
    """z = G/2d is d/2 ± 1 where the first is true: half of what a planner predicts."""
    random, n = np.random.default_rng(4), 400
    one, other = random.standard_normal((2, n)) * 0.3
    d = float(np.linalg.norm(one - other))
    y = one + random.standard_normal((3000, n))
    G = ((y - other) ** 2 - (y - one) ** 2).sum(axis=1)
    z = np.array([zscore_in_noise(float(gain), d) for gain in G])
    assert z.mean() == pytest.approx(d / 2, abs=0.08)
    assert z.std() == pytest.approx(1.0, abs=0.05)


def test_rivals_are_those_close_behind_and_not_the_best():
    behind = {"a": 0.0, "b": 1.9, "c": 2.1}
    assert rivals_of("a", [*behind], behind.__getitem__) == ["b"]
    assert rivals_of("a", [*behind], behind.__getitem__, RIVAL + 1) == ["b", "c"]


def test_nearly_best_and_as_little():
    assert nearly_best([1.0, 0.91, 0.89]).tolist() == [True, True, False]
    assert not nearly_best([]).size
    assert leaves_as_little(np.array([0.1, 0.2]), np.array([0.1, 0.2]))
    assert not leaves_as_little(np.array([0.2, 0.4]), np.array([0.1, 0.2]))


@pytest.mark.parametrize("angle", [0.0, 0.01, 0.3, 1.5])
def test_the_share_that_another_cannot_do_is_the_sine_of_their_angle(angle):
    """Beside all else; of planes the least angle, whatever their bases."""
    random = np.random.default_rng(5)
    Q = orthonormal(random.standard_normal((30, 7)))
    A, e = Q[:, :2], Q[:, 2:]
    a = np.column_stack([e[:, 0], e[:, 2]]) @ random.standard_normal((2, 2))
    b = np.column_stack([np.cos(angle) * e[:, 0] + np.sin(angle) * e[:, 1], e[:, 3]])
    one, other = (
        orthonormal(without_columns_of(A, x + A @ [[1.0, 2.0], [3.0, 4.0]])) for x in (a, b)
    )
    assert share_apart(one, [other]) == pytest.approx(np.sin(angle), abs=1e-7)
    assert (share_apart(one, [other]) > SAME_SHARE) == (angle > 0.1)


def test_the_share_of_orthogonal_causes_is_no_more_than_one():
    """By rounding it was 1 + 4e-16, whose cosine is that of no angle."""
    for seed in range(200):
        random = np.random.default_rng(seed)
        Q = np.linalg.qr(random.normal(size=(50, 4)))[0]
        share = share_apart(Q[:, :1], [Q[:, 1:]])
        assert 1 - 1e-12 < share <= 1
        separation = Separation("a", "b", share, (1.0, 1.0), ("1", "1"))
        assert 0 <= separation.cosine < 1e-5
    assert share_apart(Q, []) == 1


def test_a_small_share_tells_two_apart_where_it_is_many_standard_errors():
    """A clean log shows 4 % of what one predicts by 40; a share of 0.2 % is the same columns."""
    apart, same = ("a", "b"), ("a", "c")
    attempt = Attempt(None, {apart: (40.0, 0.04), same: (40.0, 0.002)})
    assert attempt.separation(apart) == 40.0 > TOLD_APART_SE
    assert attempt.separation(same) == 0.0
    assert attempt.worth([apart, same]) == attempt.worth([apart]) > 0
