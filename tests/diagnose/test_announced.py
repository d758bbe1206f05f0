"""What a diagnosis announces is what the refit delivers; and the engine equals explicit refits."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import ident
from ident import Diagnosis, Fit, Noise
from ident.diagnose.quiet import quiet
from ident.diagnose.screen import Judgement, Screen
from ident.fit.table import Table
from identification import Planted, motion_log, plant, robot

NOISE = [Noise("tau", 0.01, relative=True)]
HIDDEN = {
    "arm": ("coulomb:elbow", {"coulomb.elbow.Fc": 0.6}),
    "four_bar": ("viscous:rocker", {"viscous.rocker.Fv": 0.2}),
}


@cache
def planted(name: str) -> Planted:
    effect, values = HIDDEN[name]
    mechanism = robot(name).with_effect(effect)
    return plant(mechanism, motion_log(name, 100.0, 8.0), values, noise=NOISE, seed=3)


@cache
def bare(name: str) -> Fit:
    return planted(name).fit(mechanism=robot(name), cutoff="auto")


@cache
def diagnosed(name: str) -> Diagnosis:
    return ident.diagnose(bare(name))


@cache
def screened(name: str) -> tuple[Table, Screen]:
    fit = bare(name)
    table = Table.of(fit.mechanism, fit.columns, fit.motion, fit.point)
    return table, Screen.of(table, quiet(table), fit.estimate.sigma, fit.estimate.held)


@pytest.mark.parametrize("name", HIDDEN)
def test_the_fall_announced_is_the_fall_delivered(name):
    """With a motion completed and both models fitted anew, from nothing that the diagnosis knew."""
    d, case = diagnosed(name), planted(name)
    linear = [each for each in d.candidates if each.effect.linear]
    assert HIDDEN[name][0] in {each.effect.label for each in linear}
    motion = ident.complete(robot(name), case.log)
    old = ident.identify(robot(name), motion)
    for each in linear:
        new = ident.identify(robot(name).with_effect(each.effect.label), motion)
        squares = [0.0, 0.0]
        for joint in motion.independent:
            for i, (told, fit) in enumerate(((each.before, old), (each.after, new))):
                assert told[joint].rms == pytest.approx(fit.held_out[joint].rms, rel=1e-6)
                assert told[joint].relative == pytest.approx(fit.held_out[joint].relative, rel=1e-6)
                torque = old.held_out[joint].rms / old.held_out[joint].relative
                squares[i] += (fit.held_out[joint].rms / torque) ** 2
        assert each.fall == pytest.approx(1 - squares[1] / squares[0], abs=1e-6)
        assert each.json()["error_after"] == each.after[each.joint].relative


def test_the_ladder_announces_the_same():
    history = ident.grow(robot("arm"), bare("arm").motion)
    first, second = history.steps[:2]
    assert second.added is not None
    found = next(e for e in diagnosed("arm").candidates if e.effect.label == second.added.label)
    assert second.fall == pytest.approx(found.fall, rel=1e-9)
    for joint, error in second.errors.items():
        assert error.rms == pytest.approx(found.after[joint].rms, rel=1e-9)
        assert first.errors[joint].rms == pytest.approx(found.before[joint].rms, rel=1e-9)


def weighted(name: str) -> tuple[np.ndarray, np.ndarray]:
    """A (M, rank) and b (M,) of the screen's rows, unknowns left where the model is silent."""
    table, screen = screened(name)
    held = bare(name).estimate.held
    weight = screen.weight[screen.coordinate]
    A = table.A[screen.row, screen.coordinate] * weight[:, None]
    b = table.b[screen.row, screen.coordinate] * weight - A[:, held] @ table.columns.prior[held]
    return A[:, bare(name).estimate.base.independent], b


def refitted(name: str, C: np.ndarray) -> np.ndarray:
    """(blocks, d) losses of a block by what was fitted to all others, one explicit fit a block."""
    _, screen = screened(name)
    A, b = weighted(name)
    X = np.column_stack([A, C])
    X = X / np.linalg.norm(X, axis=0)
    losses = np.zeros((len(screen.edges) - 1, screen.d))
    for block, (i, j) in enumerate(zip(screen.edges[:-1], screen.edges[1:], strict=True)):
        others = np.r_[0:i, j : len(b)]
        x = np.linalg.lstsq(X[others], b[others], rcond=1e-12)[0]
        error = b[i:j] - X[i:j] @ x
        losses[block] = np.bincount(screen.coordinate[i:j], error**2, screen.d)
    return losses


@pytest.mark.parametrize("name", HIDDEN)
@pytest.mark.parametrize("labels", [(), (0,), (0, 1), (0, 1, 2)], ids=len)
def test_blocks_left_out_are_as_if_refitted(name, labels):
    table, screen = screened(name)
    joint = HIDDEN[name][0].split(":")[1]
    kinds = ("coulomb", "viscous", "drag")
    effects = [(table.mechanism.with_effect(f"{k}:{joint}")).effects[-1] for k in kinds]
    C = [screen.taken(table.with_effect(effects[i], [{}]), table.felt(effects[i])) for i in labels]
    columns = np.column_stack(C) if C else np.zeros((len(screen.row), 0))
    loss = screen.judge(columns).loss if C else screen.loss
    np.testing.assert_allclose(loss, refitted(name, columns), rtol=1e-8)


def test_the_fall_in_sample_is_that_of_a_refit():
    table, screen = screened("arm")
    effect = table.mechanism.with_effect("spring:elbow").effects[-1]
    x = table.with_effect(effect, [{}])
    C = screen.taken(x, table.felt(effect))
    A, b = weighted("arm")
    judged = screen.judge(C)
    norm = np.linalg.norm(np.column_stack([A, C]), axis=0)
    whole = np.linalg.lstsq(np.column_stack([A, C]) / norm, b, rcond=1e-12)[0] / norm
    left = b - np.column_stack([A, C]) @ whole
    before = b - A @ np.linalg.lstsq(A, b, rcond=1e-12)[0]
    assert judged.fall == pytest.approx(before @ before - left @ left, rel=1e-7)
    assert judged.by.sum() == pytest.approx(judged.fall, rel=1e-9)
    np.testing.assert_allclose(judged.theta, whole[-2:], rtol=1e-6)
    quick = screen.falls(x, table.felt(effect), 2, screen.r[:, None])
    assert quick[0, 0] == pytest.approx(judged.fall, rel=1e-6)


def finite(judged: Judgement) -> bool:
    parts = (judged.loss, judged.theta, judged.fall, judged.visible, judged.by)
    return all(np.isfinite(part).all() for part in parts)


def test_columns_that_depend_on_each_other_do_no_harm():
    table, screen = screened("arm")
    effect = table.mechanism.with_effect("coulomb:elbow").effects[-1]
    c = screen.taken(table.with_effect(effect, [{}]), table.felt(effect))
    A, _ = weighted("arm")
    once = screen.judge(c)
    for more in (c, 0 * c, 1e-9 * c, A[:, :3] * 7.0):
        judged = screen.judge(np.column_stack([c, more]))
        assert finite(judged)
        np.testing.assert_allclose(judged.loss, once.loss, rtol=1e-6)
        assert judged.fall == pytest.approx(once.fall, rel=1e-6)
    hidden = screen.judge(A[:, :3])
    assert finite(hidden)
    assert hidden.visible < 1e-9
    np.testing.assert_allclose(hidden.loss, screen.loss, rtol=1e-6)
    assert finite(screen.judge(np.zeros((len(c), 2))))
    assert finite(screen.judge(np.zeros((len(c), 0))))


def test_a_screen_without_rows_is_silent():
    table, _ = screened("arm")
    fit = bare("arm")
    none = Screen.of(table, np.zeros_like(table.informed), fit.estimate.sigma, fit.estimate.held)
    assert len(none.row) == 0
    assert none.loss.shape == (0, 4)
    judged = none.judge(np.zeros((0, 2)))
    assert judged.fall == 0.0
    assert finite(judged)


def test_a_screen_with_rows_of_one_block_or_coordinate():
    table, screen = screened("arm")
    fit = bare("arm")
    few = quiet(table)
    few[:, 1:] = False
    one = Screen.of(table, few, fit.estimate.sigma, fit.estimate.held)
    assert list(one.rows > 0) == [True, False, False, False]
    assert finite(one.judge(np.ones((len(one.row), 1))))
    first = quiet(table)
    first[screen.row[screen.edges[1]] :] = False
    single = Screen.of(table, first, fit.estimate.sigma, fit.estimate.held)
    assert finite(single.judge(np.ones((len(single.row), 1))))
