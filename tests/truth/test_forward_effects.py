"""Every effect forward against inverse dynamics: the torque that acted is the one predicted."""

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from forward import integrated, judged, planted

import ident
from helpers import J, tree_urdf, write_mechanism
from ident import Log, MechanismError
from ident.effects import KINDS
from ident.mechanism.parameters import Rigid
from identification import motion_log, robot

ARM = {
    "viscous:elbow": {"Fv": 0.6},
    "coulomb:elbow": {"Fc": 0.9},
    "stribeck:elbow": {"Fs": 0.5, "vs": 0.3},
    "friction_width:elbow": {"Fw": 0.5, "w": 0.3},
    "drag:yaw": {"Fd": 0.4},
    "direction_friction:elbow": {"dFc": 0.3, "dFv": 0.1},
    "position_friction:elbow": {"F1": 0.1, "F2": 0.2},
    "load_friction:elbow": {"mu": 0.06},
    "hysteresis:elbow": {"sigma": 60.0, "z0": 0.02},
    "temperature_friction:elbow": {"kappa": 0.01},
    "spring:wrist": {"k": 2.0, "b": 0.3},
    "cable:elbow": {"k0": 0.1, "k1": 0.5, "k2": -0.2, "k3": 0.1},
    "end_stop:elbow": {"k": 30.0, "q1": 1.3, "side": 1.0},
    "rotor_inertia:elbow": {"Ia": 0.2},
    "coupling:elbow,wrist": {"Im": 0.02, "Fvm": 0.1, "Fcm": 0.2},
    "ripple:elbow": {"A": 0.3, "B": 0.2, "N": 6.0},
    "torque_offset:elbow": {"c": 0.7},
    "torque_gain:elbow": {"g": 0.05},
    "delay:elbow": {"d": 0.01},
    "position_delay:elbow": {"d": 0.01},
    "encoder_offset:elbow": {"delta": 0.02},
    "gravity_tilt": {"x": 0.03, "y": -0.02},
    "payload:hand": dict(
        zip(
            ("m", "mx", "my", "mz", "Lxx", "Lxy", "Lyy", "Lxz", "Lyz", "Lzz"),
            (0.4, 0.02, 0.01, 0.0, 2e-3, 0.0, 3e-3, 0.0, 0.0, 3e-3),
            strict=True,
        )
    ),
    "geometry:elbow.x": {"Delta": 0.01},
    "drift:elbow": {"c": 0.2},
}


def moving(name):
    """A log to follow, with a temperature that rises."""
    log = motion_log(name, 250.0, 0.8)
    return Log.from_arrays("log", log.t, {**log.columns, "temperature.elbow": 20 + 5 * log.t})


@pytest.fixture(scope="module")
def bare():
    """The arm without effects on the same motion."""
    return integrated(robot("arm"), moving("arm"))


@pytest.mark.parametrize("label", ARM)
def test_an_effect_of_the_arm(label, bare):
    effects = {label: ARM[label]}
    if label.startswith("temperature"):
        effects = {"viscous:elbow": {"Fv": 0.6}, **effects}
    if label.startswith("friction_width"):
        effects = {"coulomb:elbow": {"Fc": 0.6}, **effects}
    mechanism = planted(robot("arm"), effects)
    run = integrated(mechanism, moving("arm"))
    close = 2e-4 if label.startswith("hysteresis") else 1e-8  # a tabulated state has steps
    assert judged(mechanism, run) < close
    same = np.isin(np.round(bare.t, 6), np.round(run.t, 6))  # a delay leaves out the ends
    seen = max(
        np.abs(run.log.columns[c] - bare.log.columns[c][same]).max() for c in bare.log.columns
    )
    assert seen > 1e-4


def test_all_frictions_at_one_joint_together_and_a_payload():
    effects = {
        label: ARM[label] for label in ARM if "friction" in label or label[:4] in "coul,stri"
    }
    effects |= {"viscous:elbow": {"Fv": 0.6}, "torque_gain:elbow": {"g": 0.05}}
    effects["payload:hand"] = ARM["payload:hand"]  # a part of the load on which friction depends
    mechanism = planted(robot("arm"), {"viscous:elbow": effects.pop("viscous:elbow"), **effects})
    run = integrated(mechanism, moving("arm"))
    assert judged(mechanism, run) < 1e-8


def test_an_effect_of_ones_own():
    """With q, v, a, tau and t in it; sign() would jump and is refused."""
    kind = ident.user_effect(
        "odd", lambda s: {"A": ca.tanh(s.v) * s.q + 0.3 * s.a + 0.1 * s.tau + 0.2 * s.t}
    )
    mechanism = robot("arm") + kind(("elbow",), {"A": 0.4})
    run = integrated(mechanism, moving("arm"))
    assert judged(mechanism, run) < 1e-8
    jumps = ident.user_effect("jumps", lambda s: {"A": ca.sign(s.v)})
    with pytest.raises(MechanismError, match=r"'jumps:elbow': cannot be integrated: .*direction"):
        ident.integrate(robot("arm") + jumps(("elbow",), {"A": 0.4}))


def test_measured_wrenches_push():
    """A force in the hand's axes, as `complete` understands it."""
    mechanism, log = robot("arm"), moving("arm")
    push = {"wrench.hand.fx": 3 * np.sin(5 * log.t), "wrench.hand.mz": 0.2 * np.cos(3 * log.t)}
    pushed = Log.from_arrays("log", log.t, {**log.columns, **push})
    run = integrated(mechanism, pushed)
    assert set(push) < set(run.log.columns)
    assert judged(mechanism, run) < 1e-8


def test_bodies_that_cannot_exist_are_integrated_where_the_motion_is_determined(tmp_path):
    """M and h of any parameters are those of the regressor, which is linear in them."""
    joints = [J("a", axis="0 1 0"), J("b", axis="1 0 0", parent="a"), J("c", parent="b")]
    mechanism = ident.load(write_mechanism(tmp_path, tree_urdf(joints, seed=3)))
    rng = np.random.default_rng(1)
    pi = mechanism.prior + 0.3 * rng.normal(size=30)
    pi[10], pi[20] = -0.4, 0.0  # a negative mass, and none
    rigid, model, data = (
        Rigid.of(mechanism.model, pi),
        mechanism.model,
        mechanism.model.createData(),
    )
    q, v, a = rng.normal(size=(3, 3))
    truth = pin.computeJointTorqueRegressor(model, data, q, v, a) @ pi
    np.testing.assert_allclose(
        rigid(pin.crba, q) @ a + rigid(pin.nonLinearEffects, q, v), truth, atol=1e-12
    )
    np.testing.assert_allclose(rigid(pin.rnea, q, v, a), truth, atol=1e-12)
    heavy = mechanism.prior.copy()
    heavy[10] = -0.01  # a little negative, and still M is positive definite
    run = ident.integrate(mechanism, pi=heavy, duration=0.5)
    assert np.isfinite(run.q).all()
    with pytest.raises(MechanismError, match=r"not positive definite.*b_link.*--consistent"):
        ident.integrate(
            mechanism, pi=np.where(np.arange(30) // 10 == 1, -1.0, 1.0) * mechanism.prior
        )


def test_an_effect_that_acts_by_a_state_must_say_how_that_changes():
    with pytest.raises(MechanismError, match=r"'viscous' .* define its .state_rate"):
        KINDS["viscous"](("elbow",)).state_rate(np.zeros(1), np.zeros(1), {})
