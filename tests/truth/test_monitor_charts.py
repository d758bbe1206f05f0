"""The statistics alone, on rows of known distribution."""

import numpy as np
import pytest
from scipy.signal import lfilter

import ident
from ident.equations.rows import Rows
from ident.information.linear import Triangle
from ident.streams.charts import (
    MARGIN,
    OFTEN,
    Charts,
    NormalRunning,
    calibrated,
    felt_columns,
    intervals_of,
    moved_reference,
    statistics,
)
from ident.streams.suspects import Suspect, load_change, name_change, onset

ROWS, K, D = 12, 5, 2


def pieces(rng, count, x, rho=0.0, change=None, spread=1.0):
    """Rows b = A x + noise of an autoregression `rho`, and from half on with a change."""
    n = ROWS * count
    A = rng.standard_normal((n, D, K))
    noise = lfilter([np.sqrt(1 - rho**2)], [1, -rho], rng.standard_normal((200 + n, D)), axis=0)
    b = A @ x + spread * noise[200:]
    if change is not None:
        b[n // 2 :] += A[n // 2 :] @ change
    t = np.arange(n) * 0.5 / ROWS
    whole = np.ones((n, D), dtype=bool)
    return Rows(t, np.arange(n), A, b, b, whole, whole, np.zeros(whole.shape))


def intervals(piece, x):
    return intervals_of([piece], 0.5, np.ones(D), x)


@pytest.fixture(scope="module")
def clean():
    rng = np.random.default_rng(0)
    x = rng.standard_normal(K)
    seen = intervals(pieces(rng, 400, x), x)
    return x, seen, NormalRunning.of(seen, np.ones(D), x, 0.0)


@pytest.mark.parametrize("rho", [0.0, 0.6, 0.9])
def test_long_run_variance_is_that_of_the_noise(rho):
    rng = np.random.default_rng(3)
    x = np.zeros(K)
    piece = pieces(rng, 1500, x, rho)
    piece.A[:] = 1.0  # a column that feels the noise's own correlation
    found = NormalRunning.of(intervals(piece, x), np.ones(D), x, 0.0).spread[0] / MARGIN
    true = (1 + rho) / (1 - rho)
    assert 0.75 * true < found < 1.7 * true  # the largest of several estimates


def test_charts_keep_the_stated_rate_on_other_data(clean):
    x, seen, normal = clean
    design, _ = calibrated(normal, np.ones(K, dtype=bool), seen, x)
    assert design.weight.sum() == pytest.approx(1.0)
    rng = np.random.default_rng(4)
    other = statistics(intervals(pieces(rng, 6000, x), x), x)
    evidence = design.evidence(*other).reshape(60, 100, -1)  # 60 streams
    A = 200.0
    charts, alarms = Charts.fresh(evidence.shape[2], (60,)), 0
    for i in range(100):
        charts.update(evidence[:, i])
        over = charts.height(design.weight) > np.log(A)
        alarms += int(over.sum())
        charts.restart(over)
    assert alarms <= 6000 / A


def test_heavy_tails_are_calibrated(clean):
    x, _, _ = clean
    rng = np.random.default_rng(6)
    piece = pieces(rng, 400, x)
    piece.b[:] = piece.A @ x + 0.5 * rng.standard_t(2.0, piece.b.shape)
    seen = intervals(piece, x)
    normal = NormalRunning.of(seen, np.ones(D), x, 0.0)
    _, alarms = calibrated(normal, np.ones(K, dtype=bool), seen, x)
    assert alarms <= OFTEN


def test_the_reference_moves_to_the_clean_log_where_it_knows(clean):
    x, seen, _ = clean
    triangle = Triangle.merge([each.triangle for each in seen])
    np.testing.assert_allclose(
        moved_reference(triangle, x + 0.1)[0], moved_reference(triangle, x)[0], atol=1e-9
    )
    rng = np.random.default_rng(7)
    A = rng.standard_normal((300, 3)) @ np.diag([1.0, 1.0, 0.0])  # nothing feels the third
    moved, _ = moved_reference(
        Triangle.of(A, A @ np.array([1.0, 2.0, 0.0])), np.array([0.0, 0.0, 5.0])
    )
    np.testing.assert_allclose(moved, [1.0, 2.0, 5.0], atol=1e-9)


def suspect(label, *places):
    kind, joint = label.split(":")
    effect = ident.effect(kind, joint)
    units = ("N m",) * len(places)
    return Suspect((effect,), np.array(places), effect.unknowns, units)


SUSPECTS = tuple(suspect(f"torque_offset:{joint}", i) for i, joint in enumerate("abc"))


def test_the_name_is_that_of_the_column(clean):
    x, _, normal = clean
    rng = np.random.default_rng(8)
    held = intervals(pieces(rng, 40, x, change=np.array([0.0, 0.4, 0.0, 0.0, 0.0])), x)
    naming = name_change(SUSPECTS, held[20:], x, normal, 11.0)
    assert naming.sound
    assert naming.rivals == ()
    assert naming.best.suspect.label == "torque_offset:b"
    A = np.concatenate([each.triangle.R for each in held[20:]])  # the same squares as the rows
    d = np.concatenate([each.triangle.d for each in held[20:]])
    true = float(A[:, 1] @ (d - A @ x) / (A[:, 1] @ A[:, 1]))
    assert naming.best.theta[0] == pytest.approx(true, rel=1e-9)
    assert abs(true - 0.4) < 4 * naming.best.stderr[0]
    assert abs(onset(held, x, naming.best) - 20) <= 1


def test_columns_that_are_the_same_are_rivals(clean):
    x, _, normal = clean
    rng = np.random.default_rng(9)
    piece = pieces(rng, 40, x)
    piece.A[:, :, 2] = piece.A[:, :, 1]
    change = np.array([0.0, 0.4, 0.0, 0.0, 0.0])
    piece.b[:] = piece.A @ (x + change) + rng.standard_normal(piece.b.shape)
    naming = name_change(SUSPECTS, intervals(piece, x), x, normal, 11.0)
    labels = {naming.best.suspect.label, *(each.suspect.label for each in naming.rivals)}
    assert labels == {"torque_offset:b", "torque_offset:c"}


def test_sizes_of_columns_compare_within_a_unit():
    rng = np.random.default_rng(12)
    A = rng.standard_normal((50, 4)) * np.array([1.0, 1e10, 1e-9, 1e-9])
    A[:, 3] = 0.0
    felt = felt_columns(Triangle.of(A, A[:, 0]), ("N", "m/N", "N", "kg"))
    assert felt.tolist() == [True, True, False, False]


def test_a_column_of_rounding_is_no_freedom_of_a_suspect(clean):
    """As of a tilt across a planar machine, whose differences are second order."""
    x, _, normal = clean
    tilt = ident.effect("gravity_tilt")
    rng = np.random.default_rng(14)
    piece = pieces(rng, 20, x)
    piece.A[:, :, 2] *= 1e-6
    piece.b[:] += piece.A @ np.array([0.0, 0.4, 4e5, 0.0, 0.0])
    suspects = (Suspect((tilt,), np.array([1, 2]), tilt.shapes, ("rad", "rad")),)
    naming = name_change(suspects, intervals(piece, x), x, normal, 11.0)
    assert naming.best.suspect.places.tolist() == [1]
    assert not naming.sound


def test_rivals_hold_the_truth_and_fewer_than_what_does_not_lead_alone(clean):
    """Two columns that are 99 % alike: the other one is excluded at three standard errors."""
    x, _, normal = clean
    right = open_ = held = 0
    for seed in range(100):
        rng = np.random.default_rng(100 + seed)
        piece = pieces(rng, 20, x)
        piece.A[:, :, 2] = piece.A[:, :, 1] + 0.15 * piece.A[:, :, 2]
        change = np.array([0.0, 2.0, 0.0, 0.0, 0.0])
        piece.b[:] = piece.A @ (x + change) + rng.standard_normal(piece.b.shape)
        naming = name_change(SUSPECTS, intervals(piece, x), x, normal, 11.0)
        labels = [naming.best.suspect.label, *(each.suspect.label for each in naming.rivals)]
        held += "torque_offset:b" in labels
        right += labels == ["torque_offset:b"]
        open_ += not naming.alone
    assert held >= 98
    assert right > 100 - open_


def test_another_motion_is_judged_by_the_error_of_the_reference():
    """Normal running of little motion leaves a reference that errs in ten times as much of it."""
    rng, x = np.random.default_rng(13), np.zeros(K)
    seen = intervals(pieces(rng, 40, x), x)
    reference, _ = moved_reference(Triangle.merge([each.triangle for each in seen]), x)
    normal = NormalRunning.of(intervals(pieces(rng, 40, x), reference), np.ones(D), reference, 0.0)
    piece = pieces(rng, 40, x)
    piece.A[:] *= 10.0
    piece.b[:] = piece.A @ np.array([0.0, 0.4, 0.0, 0.0, 0.0]) + rng.standard_normal(piece.b.shape)
    naming = name_change(SUSPECTS, intervals(piece, reference), reference, normal, 11.0)
    assert naming.excess > 2.5 > naming.surplus
    assert naming.sound


def test_what_no_suspect_explains_is_not_sound(clean):
    x, _, normal = clean
    rng = np.random.default_rng(10)
    change = np.array([0.0, 0.5, 0.0, 0.5, 0.0])  # the fourth column is nobody's
    held = intervals(pieces(rng, 40, x, change=change), x)
    assert not name_change(SUSPECTS, held[20:], x, normal, 11.0).sound


def test_a_load_is_a_body_that_can_exist():
    rng = np.random.default_rng(11)
    C = rng.standard_normal((80, 10))
    m, c = 0.4, np.array([0.1, 0.02, -0.03])
    L = m * (c @ c * np.eye(3) - np.outer(c, c))
    body = np.array([m, *(m * c), L[0, 0], L[0, 1], L[1, 1], L[0, 2], L[1, 2], L[2, 2]])
    for sign in (1.0, -1.0):  # put on, taken off
        np.testing.assert_allclose(load_change(C, C @ (sign * body)), sign * body, atol=1e-5)
    planar = C * np.isin(np.arange(10), (0, 1, 2, 9))  # a loop in a plane feels m, mx, my, Lzz
    found = (
        1e4 * planar @ load_change(1e4 * planar, 1e4 * planar @ body)
    )  # however sure the rows are
    np.testing.assert_allclose(found, 1e4 * planar @ body, atol=0.1)
    impossible = np.array([0.1, 1.0, 0, 0, 0, 0, 0, 0, 0, 0])  # a first moment without inertia
    left = np.linalg.norm(C @ load_change(C, C @ impossible) - C @ impossible)
    assert left > 0.1 * np.linalg.norm(C @ impossible)
