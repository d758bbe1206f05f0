"""Partial regression by blocks left out, against refits; the null distribution on planted data."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np
import pytest

from ident.fit.residual_maps import (
    LEAST,
    ExplainedBounds,
    SignalMap,
    by_halves,
    dependence,
    depends_on,
)
from ident.information.blocks import Block, Information, Part
from ident.information.chance import SMOOTH, remaining_power, surrogates
from ident.information.evidence import Chance, exceeding, paired, quantile, zscore
from ident.information.hypotheses import PartialRegression
from ident.information.linear import Triangle

BLOCKS, ROWS, K = 6, 25, 14
WEIGHT = np.array([1.0, 2.5])
GROUPS = [np.array(g) for g in ([5], [6, 7], [8, 9, 10], [4, 6], [11], [12, 13])]


def parts(seed: int = 0) -> tuple[Part, ...]:
    """Two coordinates, of which the second lacks some columns; three further right-hand sides."""
    random = np.random.default_rng(seed)
    found = []
    for u, columns in enumerate((np.arange(K), np.setdiff1d(np.arange(K), [2, 4, 5, 12]))):
        X = random.standard_normal((BLOCKS * ROWS, len(columns)))
        Y = random.standard_normal((BLOCKS * ROWS, 4))
        found.append(Part(u, columns, X, Y, np.arange(BLOCKS + 1) * ROWS))
    return tuple(found)


def refitted(given: tuple[Part, ...], columns: np.ndarray) -> np.ndarray:
    """(blocks, right-hand sides) squares of blocks left out, by one fit a block."""
    X, Y, block = [], [], []
    for part in given:
        whole = np.zeros((len(part.X), K))
        whole[:, part.columns] = part.X
        X.append(whole[:, columns] * WEIGHT[part.coordinate])
        Y.append(part.Y * WEIGHT[part.coordinate])
        block.append(np.repeat(np.arange(BLOCKS), ROWS))
    X, Y, block = (np.concatenate(x) for x in (X, Y, block))
    loss = np.zeros((BLOCKS, Y.shape[1]))
    for k in range(BLOCKS):
        mine = block == k
        x = np.linalg.lstsq(X[~mine], Y[~mine], rcond=None)[0]
        loss[k] = ((Y[mine] - X[mine] @ x) ** 2).sum(axis=0)
    return loss


def test_gains_are_those_of_refits():
    given = parts()
    regression = PartialRegression(given, np.arange(4), WEIGHT)
    before = refitted(given, np.arange(4))
    np.testing.assert_allclose(regression.loss, before[:, 0], rtol=1e-10)
    np.testing.assert_allclose(regression.losses.sum(axis=1), before[:, 0], rtol=1e-10)
    gains = regression.gains(GROUPS)
    for i, group in enumerate(GROUPS):
        D = before - refitted(given, np.append(np.arange(4), group))
        np.testing.assert_allclose(gains.D[i], D[:, 0], atol=1e-10)
        np.testing.assert_allclose(
            gains.null[i].sum(axis=0), D[:, 1:].sum(axis=0), 1e-5, 1e-5
        )  # single precision
        refit = regression.refit(group)
        np.testing.assert_allclose(refit.D, D[:, 0], atol=1e-10)
        assert refit.visible == pytest.approx(gains.visible[i])


def test_adding_a_group_is_the_gain_that_was_announced():
    regression = PartialRegression(parts(), np.arange(4), WEIGHT)
    for group in GROUPS:
        after = regression.extended(group)
        assert regression.loss.sum() - after.loss.sum() == pytest.approx(
            regression.refit(group).G, abs=1e-9
        )
        assert after.without(group).loss.sum() == pytest.approx(regression.loss.sum())
        theta = after.solved[0][-len(group) :]
        np.testing.assert_allclose(theta, regression.refit(group).theta, atol=1e-10)


def test_last_columns_that_are_zero_everywhere_gain_nothing():
    regression = PartialRegression(parts(), np.arange(4), WEIGHT, K + 2)
    gains = regression.gains([np.array([K, K + 1]), np.array([6])])
    assert gains.visible[0] == 0
    assert gains.D[0].sum() == 0
    assert gains.D[1].sum() != 0
    assert regression.place(np.array([K + 1])) == regression.d


def test_what_is_projected_already_stays_when_the_model_changes():
    regression = PartialRegression(parts(), np.arange(4), WEIGHT)
    assert regression.loss.all()  # is projected here
    twin = [3 * part.taken(np.array([0, 5])) for part in regression.parts]
    wide, new = regression.added(twin)
    bare = regression.extended(np.array([4, 5, 5])).without(np.array([1, 4]))
    twice = wide.extended(np.array([5, *new]))
    for changed, model in (
        (regression.extended(np.array([4, 6])), [0, 1, 2, 3, 4, 6]),
        (bare, [0, 2, 3, 5]),
        (regression.without(np.arange(4)), []),
        (twice, [0, 1, 2, 3, 5]),
        (twice.without(np.array([0, 5])), [0, 1, 2, 3, 5]),
    ):
        fresh = PartialRegression(parts(), np.array(model, dtype=int), WEIGHT)
        assert changed.rank == fresh.rank
        np.testing.assert_allclose(changed.losses, fresh.losses, rtol=1e-10)
        np.testing.assert_allclose(changed.null_losses, fresh.null_losses, rtol=1e-10)
        group = [np.array([7, 8])]
        np.testing.assert_allclose(changed.gains(group).D, fresh.gains(group).D, atol=1e-9)


@pytest.mark.parametrize("alone", [False, True], ids=["in all blocks", "in one block"])
def test_errors_without_some_columns_are_those_of_the_model_without_them(alone):
    given = parts()
    if alone:  # a direction that one block alone determines
        for part in given:
            part.X[ROWS:, part.columns == 1] = 0.0
    model = np.arange(8)
    regression = PartialRegression(given, model, WEIGHT)
    for columns in ([0], [1], [2, 3], [1, 4, 7]):
        expected = PartialRegression(given, np.setdiff1d(model, columns), WEIGHT).losses
        found = regression.losses_without(np.array(columns))
        np.testing.assert_allclose(found, expected, rtol=1e-9)
    groups = [np.array(columns) for columns in ([9], [10, 11], [3, 12])]
    expected = regression.gains(groups).visible
    np.testing.assert_allclose(regression.visible(groups), expected, atol=1e-12)


def test_columns_that_the_model_has_are_not_visible():
    given = parts()
    twin = tuple(
        Part(p.coordinate, np.append(p.columns, K), np.column_stack([p.X, 3 * p.X[:, :2].sum(1)]),
             p.Y, p.edges)
        for p in given
    )  # fmt: skip
    gains = PartialRegression(twin, np.arange(4), WEIGHT).gains([np.array([K]), np.array([K, 6])])
    assert gains.visible[0] < 1e-6
    np.testing.assert_allclose(gains.D[0], 0.0, atol=1e-10)
    alone = PartialRegression(given, np.arange(4), WEIGHT).gains([np.array([6])])
    np.testing.assert_allclose(gains.D[1], alone.D[0], atol=1e-8)


def test_triangles_say_what_their_rows_say():
    given = parts()
    blocks = []
    for part in given:
        for k in range(BLOCKS):
            rows = part.block(k)
            triangle = Triangle.empty(part.X.shape[1]).updated(part.X[rows], part.Y[rows, 0])
            rest = Triangle.empty(part.X.shape[1])
            both, torque = (triangle, rest, rest), (1.0, 0.0)
            blocks.append(Block(0, k, part.coordinate, *both, part.columns, torque, (0, 1)))
    information = Information.of(blocks, K, 2)
    of_triangles = PartialRegression.of(information, WEIGHT, np.arange(4))
    of_rows = PartialRegression(given, np.arange(4), WEIGHT)
    np.testing.assert_allclose(of_triangles.loss, of_rows.loss, rtol=1e-9)
    np.testing.assert_allclose(of_triangles.gains(GROUPS).D, of_rows.gains(GROUPS).D, atol=1e-9)
    x = np.random.default_rng(1).standard_normal(K)
    off = PartialRegression.of(information, WEIGHT, np.zeros(0, dtype=int), x)
    left = sum(
        WEIGHT[p.coordinate] ** 2 * ((p.Y[:, 0] - p.X @ x[p.columns]) ** 2).sum() for p in given
    )
    assert off.loss.sum() == pytest.approx(left)


def coloured(n: int, random: np.random.Generator, rho: float = 0.9) -> np.ndarray:
    """Noise that remembers (n, 2)."""
    e = random.standard_normal((n, 2))
    for i in range(1, n):
        e[i] += rho * e[i - 1]
    return e


def test_surrogates_have_the_spectrum_and_nothing_else():
    random = np.random.default_rng(0)
    r = coloured(4000, random)
    made = surrogates(r, [slice(0, 2500), slice(2500, 4000)], 50, random)
    np.testing.assert_allclose(made.std(axis=0).mean(axis=1), r.std(axis=0), rtol=0.15)
    lag = [(x[1:] * x[:-1]).mean() / (x**2).mean() for x in made[:, 0].T]
    assert np.mean(lag) == pytest.approx((r[1:, 0] * r[:-1, 0]).mean() / r[:, 0].var(), abs=0.03)
    assert abs(np.mean([np.corrcoef(x, r[:, 0])[0, 1] for x in made[:, 0].T])) < 0.1


def test_surrogates_of_a_series_with_gaps_are_as_slow_as_the_series():
    random = np.random.default_rng(3)
    n = 600
    r, known = coloured(n, random, 0.95), np.ones((n, 2), dtype=bool)
    for begin in random.integers(0, n, 40):  # as around reversals
        known[begin : begin + 10] = False
    whole = surrogates(r, [slice(0, n)], 100, random)
    given = surrogates(np.where(known, r, 0.0), [slice(0, n)], 100, random, known=known)
    one, other = (np.mean(x[1:] * x[:-1]) / np.mean(x**2) for x in (whole, given))
    assert other == pytest.approx(one, abs=0.05)
    assert given.std() == pytest.approx(whole.std(), rel=0.15)


def test_surrogates_of_a_constant_are_numbers_and_keep_what_coordinates_share():
    random = np.random.default_rng(5)
    for n in (2, 3, 20, 60):
        assert np.isfinite(surrogates(np.ones((n, 2)), [slice(0, n)], 20, random)).all()
    z = coloured(400, random)[:, :1]
    made = surrogates(np.column_stack([z, -2 * z]), [slice(0, 400)], 20, random)
    np.testing.assert_allclose(made[:, 1], -2 * made[:, 0], atol=1e-4 * made.std())


def test_surrogates_differ_as_much_as_noise_does_whose_spectrum_one_run_shows():
    random = np.random.default_rng(4)
    n, slow = 300, slice(1, 2 * SMOOTH)

    def slow_share(x: np.ndarray) -> np.ndarray:
        power = np.abs(np.fft.rfft(x, axis=0)) ** 2
        return np.log(power[slow].sum(axis=0) / power[1:].sum(axis=0)).ravel()

    runs = [coloured(n, random)[:, :1] for _ in range(40)]
    true = np.array([slow_share(r)[0] for r in runs])
    made = [slow_share(surrogates(r, [slice(0, n)], 50, random)[:, 0]) for r in runs[:10]]
    spread = np.mean(
        [x.std() for x in made]
    )  # a resampled periodogram's is up to √2 times as large
    assert 0.9 * true.std() < spread < 1.6 * true.std()


def test_power_that_a_model_takes_is_given_back():
    random = np.random.default_rng(1)
    n, run = 2000, [slice(0, 2000)]
    t = np.arange(n) / n
    A = np.column_stack([f(2 * np.pi * k * t) for k in range(1, 200, 4) for f in (np.sin, np.cos)])
    Q = np.linalg.qr(A)[0]
    r, trials = coloured(n, random)[:, :1], coloured(n, random)[:, :1]
    trials = surrogates(trials, run, 25, random)
    left = trials - np.einsum("nk,kdc->ndc", Q, np.einsum("nk,ndc->kdc", Q, trials))
    remaining = remaining_power(left, trials)
    e = r - Q @ (Q.T @ r)
    made = surrogates(e, run, 50, random, [remaining])
    assert e.std() < 0.9 * r.std()
    assert made.std() == pytest.approx(r.std(), rel=0.1)


def test_a_quantile_of_few_draws_is_that_of_many():
    random = np.random.default_rng(2)
    g = 1 / (1 + np.exp(-random.normal(-2.0, 0.6, (200, 100))))
    for alpha in (0.01, 0.05):
        true = 1 / (1 + np.exp(2.0 - 0.6 * NormalDist().inv_cdf(1 - alpha)))
        found = [quantile(each, alpha) for each in g]
        assert np.mean(found) == pytest.approx(true, rel=0.05)
        assert exceeding(found[0], g[0]) == pytest.approx(alpha)
    assert np.std(found) < np.std([each.max() for each in g])


def test_a_gain_at_its_limit_has_the_chance_alpha():
    random = np.random.default_rng(4)
    loud, quiet = (1 / (1 + np.exp(m - random.standard_normal(100))) for m in (1.0, 5.0))
    none = {0: np.zeros(0), 1: np.zeros(0)}
    chance = Chance({0: loud, 1: quiet}, none, 0.01)
    assert chance.limit(1) < 0.2 < chance.limit(0)  # a noisy place hides no other
    for place in (0, 1):
        assert chance.p(chance.limit(place), place) == pytest.approx(0.01, rel=1e-6)
    assert chance.limit(7) == chance.limit(0)  # of a place without draws, the largest
    noisy = Chance({0: loud, 1: quiet}, {0: loud, 1: loud}, 0.01)
    assert noisy.limit(1) == quantile(loud, 0.005)


def test_draws_without_any_gain_have_a_quantile():
    g = np.array([-0.1] * 60 + [0.2] * 40)
    assert quantile(g, 0.01) == 0.2
    assert exceeding(0.1, g) == 41 / 101


def test_no_gain_exceeds_draws_that_do_not_differ_by_chance():
    """Of a log without noise: gains of rounding are all alike."""
    assert exceeding(0.9, np.full(24, 1e-13)) == 0.0
    assert exceeding(1e-14, np.full(24, 1e-13)) == 1.0


def test_noise_without_any_gain_makes_no_gain_likely():
    """As the limit has it: what exceeds that is rarer than alpha, however few draws there are."""
    draws = 1 / (1 + np.exp(5.0 - np.random.default_rng(5).standard_normal(100)))
    noise = np.array([-1e-8] * 18 + [1e-5] * 6)
    chance = Chance({0: draws, 1: draws}, {0: noise, 1: noise}, 0.01)
    assert chance.limit(0) < 0.6
    assert chance.p(0.6, 0) < 0.01


def credible(seed: int, size: float) -> tuple[bool, int]:
    """Whether the best of 30 slow candidates is, in coloured noise, and which it is."""
    random = np.random.default_rng(seed)
    n = 600
    C = np.column_stack([coloured(n, random, 0.97) for _ in range(15)])
    r = coloured(n, random)[:, :1] + size * C[:, 17:18]
    edges = np.arange(21) * (n // 20)
    A = np.ones((n, 1))

    def asked(Y: np.ndarray) -> PartialRegression:
        X = np.column_stack([A, C])
        return PartialRegression((Part(0, np.arange(31), X, Y, edges),), np.arange(1), np.ones(1))

    left = asked(r).residual[0]
    null = surrogates(left, [slice(0, n)], 100, random)[:, 0]
    judged = asked(np.column_stack([r, null]))
    found = judged.gains([np.array([i]) for i in range(1, 31)])
    shares = judged.explained(found.null.transpose(0, 2, 1), judged.null_losses.T).max(axis=0)
    share = judged.explained(found.by).max()
    return share > quantile(shares, 0.01), int(found.D.sum(axis=1).argmax())


def test_coloured_noise_makes_no_candidate_credible_and_an_effect_is_found():
    assert sum(credible(seed, 0.0)[0] for seed in range(40)) <= 2
    assert all(credible(seed, 1.0) == (True, 17) for seed in range(10))


def test_what_explains_all_of_one_coordinate_is_not_diluted_by_the_others():
    """The likelihood ratio of coordinates with noise of their own; weights do not matter to it."""
    random = np.random.default_rng(0)
    edges, d, n = np.arange(6) * 20, 7, 100
    X = random.standard_normal((n, 2))
    some = [Part(u, np.arange(2), X * (u == 0), random.standard_normal((n, 3)), edges)
            for u in range(d)]  # fmt: skip
    some[0].Y[:, 0] = 1e3 * X[:, 1] + 1e-2 * random.standard_normal(n)
    for weight in (np.ones(d), np.array([p.Y[:, 0].std() for p in some]) ** -1):
        asked = PartialRegression(tuple(some), np.arange(1), weight)
        gains = asked.gains([np.array([1])])
        losses = asked.losses.sum(axis=0)
        left = asked.extended(np.array([1])).losses.sum(axis=0)
        np.testing.assert_allclose(gains.by[0], losses - left, atol=1e-9 * losses.sum())
        assert asked.explained(gains.by)[0] > 1 - 1e-5 ** (1 / d)
        assert asked.gain(asked.refit(np.array([1]))) == pytest.approx(asked.explained(gains.by)[0])
    before = asked.null_losses.T
    assert before.shape == (2, d)
    assert np.abs(asked.explained(gains.null.transpose(0, 2, 1), before)).max() < 0.1


def test_differences_that_do_not_differ_have_no_z():
    assert zscore(np.zeros(5)) == 0.0
    assert zscore(np.array([1.0, 1.1, 0.9, 1.0])) > 10


@pytest.mark.parametrize("size", [1.0, 1e-3, 1e-6])
def test_what_a_residual_depends_on_does_not_depend_on_its_unit(size: float) -> None:
    random, n = np.random.default_rng(0), 600
    x = np.sin(np.linspace(0, 40, n))
    r = size * (x + 0.3 * random.standard_normal(n))
    maps = [SignalMap("v.elbow", x[:, None])]
    (step,), threshold = depends_on(r, np.arange(n) // 60, maps, [slice(0, n)])
    assert step.r2 == pytest.approx(0.85, abs=0.03)
    assert LEAST <= threshold < 1
    noise = size * random.standard_normal(n)
    assert depends_on(noise, np.arange(n) // 60, maps, [slice(0, n)]) == ([], LEAST)


@pytest.mark.parametrize("seed", range(4))
def test_no_map_explains_more_than_its_bound(seed: int) -> None:
    """By regressions in which each stretch is left out in turn."""
    random, n = np.random.default_rng(seed), 300
    fold, t = np.arange(n) // 30, np.linspace(0, 1, n)
    hats = np.maximum(0, 1 - np.abs(8 * (0.5 + 0.5 * np.sin(20 * t))[:, None] - np.arange(9)))
    maps = [SignalMap("q", hats), SignalMap("t", np.stack([t, t**2], axis=1)),
            SignalMap("sign(v)", np.sign(np.cos(20 * t))[:, None])]  # fmt: skip
    r = hats @ random.standard_normal(9) + 2 * random.standard_normal(n) + t * (fold > 4)
    rows = random.uniform(size=n) < 0.9
    bounds, of_halves = ExplainedBounds(fold).most(r, rows, maps)
    y, of_rows = r[rows], fold[rows]

    def left_out(X: np.ndarray) -> float:
        A, squares = np.column_stack([np.ones(len(X)), X]), 0.0
        for number in range(10):
            out = of_rows == number
            theta = np.linalg.lstsq(A[~out], y[~out])[0]
            squares += float(np.sum((y[out] - A[out] @ theta) ** 2))
        return squares

    total, some = left_out(np.zeros((len(y), 0))), [x.of_rows(rows) for x in maps]
    for bound, signal_map in zip(bounds, some, strict=True):
        assert 1 - left_out(signal_map.columns) / total <= bound + 1e-9
        assert bound < 0.5
    for bound, signal_map in zip(of_halves, by_halves(some, of_rows), strict=True):
        assert 1 - left_out(signal_map.columns) / total <= bound + 1e-9
    expected = depends_on(y, of_rows, some, [slice(0, len(y))])
    assert dependence(r, rows, maps, [slice(0, len(y))], ExplainedBounds(fold))[:2] == expected


def test_rounding_does_not_change_random_residuals():
    random = np.random.default_rng(0)
    r = random.standard_normal((300, 2))
    both = (r, r + 1e-15 * random.standard_normal(r.shape))
    one, other = (surrogates(x, [slice(0, 300)], 5, np.random.default_rng(1)) for x in both)
    np.testing.assert_allclose(one, other, atol=1e-6)


def test_squares_that_differ_by_rounding_are_the_same():
    b = 1 + np.random.default_rng(0).uniform(size=20)
    assert paired(b * (1 + 1e-14), b) == 0  # every block the larger one, by rounding
    assert paired(b * (1 + 1e-6), b) > 2
