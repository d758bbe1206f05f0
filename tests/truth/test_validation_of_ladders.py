"""A ladder ends where an error on a validation log would rise, at once or little by little."""

import numpy as np
import pytest

import ident
from ident import Noise
from ident.diagnosis.validation import ValidationErrors
from identification import motion_log, plant, robot

BLOCKS, TORQUE = 10, 1000.0


def errors(share, scatter=0.1, seed=0, joint="elbow"):
    """Of one joint on one log, a share of its torque, with a scatter from block to block."""
    random = np.random.default_rng(seed)
    squares = share**2 * TORQUE / BLOCKS * (1 + scatter * random.normal(size=BLOCKS))
    return ValidationErrors(
        {(0, 0): dict(enumerate(squares.tolist()))}, {(0, 0): TORQUE}, {(0, 0): (joint, "b.csv")}
    )


def test_a_rise_is_named_with_its_joint_and_log():
    assert (
        errors(0.16)
        .increased_error(errors(0.12))
        .startswith("the error of elbow on b.csv would rise")
    )
    assert not errors(0.12).increased_error(errors(0.16))


def test_a_rise_within_the_scatter_of_the_blocks_is_none():
    assert not errors(0.125, scatter=0.8, seed=1).increased_error(errors(0.12, scatter=0.8, seed=2))


def test_a_rise_of_less_than_matters_is_none():
    assert not errors(0.0030, scatter=0.01).increased_error(errors(0.0029, scatter=0.01))


def test_a_rise_is_none_that_chance_makes_of_one_of_many_joints():
    """Of twelve joints on two logs the least error so far is that of the luckiest rung."""
    random, places = np.random.default_rng(0), [(log, u) for log in range(2) for u in range(12)]

    def rung(share=0.1):
        squares = share**2 * TORQUE / BLOCKS * (1 + 0.3 * random.normal(size=(24, BLOCKS)))
        return ValidationErrors(
            {place: dict(enumerate(x)) for place, x in zip(places, squares.tolist(), strict=True)},
            dict.fromkeys(places, TORQUE),
            dict.fromkeys(places, ("elbow", "b.csv")),
        )

    stopped = [bool(rung().increased_error(rung())) for _ in range(300)]
    assert np.mean(stopped) < 0.03
    assert all(rung(0.14).increased_error(rung()) for _ in range(20))


def test_many_small_rises_are_one():
    """Each is within the scatter of its blocks; beside the best rung the last is not."""
    best, shares, named = errors(0.100, 0.5, 0), (0.104, 0.109, 0.114, 0.119, 0.125), []
    before = best
    for share in shares:
        now = errors(share, 0.5, 0)
        squares = now.squares[0, 0]
        # half of the blocks rise, the other half fall: what remains is small beside their scatter
        turned = {k: x * (1.3 if k % 2 else 0.7) for k, x in squares.items()}
        step = ValidationErrors(
            {(0, 0): turned if len(named) % 2 else squares}, now.torque, now.names
        )
        named.append((bool(step.increased_error(before)), bool(now.increased_error(best))))
        before = step
    assert not any(at_once for at_once, _ in named[1:])
    assert named[-1][1]


def test_errors_of_a_fit_are_those_of_its_validation():
    mechanism = robot("arm").with_effect("viscous").with_effect("coulomb")
    noise = [Noise("tau", 0.02, relative=True)]
    one, two = (
        plant(mechanism, motion_log("arm", 100.0, seconds), noise=noise, seed=seed).log
        for seconds, seed in ((4.0, 1), (5.0, 2))
    )
    motion = ident.complete(mechanism, one, cutoff=10.0)
    validate = ident.complete(mechanism, two, cutoff=10.0)
    fit = ident.identify(mechanism, motion, validate=validate, estimator="least-squares")
    left = ValidationErrors.of(fit, validate)
    (log,) = fit.validation
    for place, (joint, name) in left.names.items():
        total = sum(left.squares[place].values())
        relative = np.sqrt(total / left.torque[place])
        assert name == log
        assert relative == pytest.approx(fit.validation[log][joint].relative, rel=1e-6)
    assert not left.increased_error(left)
    bare = robot("arm")
    worse = ident.identify(bare, motion, validate=validate, estimator="least-squares")
    without_friction = ValidationErrors.of(worse, validate)
    assert without_friction.increased_error(left)
    assert not left.increased_error(without_friction)
    for place, least in left.best(without_friction).squares.items():
        both = (sum(x.squares[place].values()) for x in (left, without_friction))
        assert sum(least.values()) == min(both)
    assert ValidationErrors.of(fit, None).squares == {}
