"""DFKI's double pendulum: jittering stamps, columns of its own, published parameters.

Torques and positions have one sign convention; joint 2 is relative to link 1; both are 0 hanging.
In 11 both motors work; in 12 and 13 joint 1 swings freely but for its friction.
"""

import numpy as np
import pytest

import ident

TOML = """
urdf = "pendulum.urdf"
[log]
t = { column = "time" }
"q.Joint1" = { column = "pos_meas1" }
"q.Joint2" = { column = "pos_meas2" }
"v.Joint1" = { column = "vel_meas1" }
"v.Joint2" = { column = "vel_meas2" }
"tau.Joint1" = { column = "tau_meas1" }
"tau.Joint2" = { column = "tau_meas2" }
"""
PUBLISHED = (0.1079, 0.0239, 0.1111, 0.3491)  # I1 + m2 l1², I2 [kg m²], m2 r2, m1 r1 + m2 l1 [kg m]
TRIAL = (0.1088, 0.0247, 0.1141, 0.3422)  # of log 11, data/README.md


@pytest.fixture(scope="module")
def pendulum(shared_data, tmp_path_factory):
    folder = tmp_path_factory.mktemp("dfki")
    data = shared_data / "dfki_double_pendulum"
    (folder / "pendulum.urdf").write_bytes((data / "double_pendulum_A0.urdf").read_bytes())
    (folder / "mechanism.toml").write_text(TOML)
    # the published values are of least squares with the sensors as they are
    mechanism = ident.load(folder).with_calibration("exact")
    for kind in ("viscous", "coulomb", "rotor_inertia"):
        mechanism = mechanism.with_effect(kind)
    return mechanism, data


def fit_of(pendulum, log, cutoff="auto"):
    mechanism, data = pendulum
    return ident.identify(mechanism, ident.complete(mechanism, data / log, cutoff=cutoff))


def four(fit):
    """I1 + m2 l1², I2, m2 r2, m1 r1 + m2 l1; link 1 hangs along −z, link 2's frame is turned."""
    found = {v.name.split()[0]: v.value for v in fit.base_parameters}
    return np.array([found["Link1.Lxx"], found["Link2.Lxx"], found["Link2.mz"], -found["Link1.mz"]])


@pytest.mark.parametrize("log", ["A0_swingup_11.csv", "A0_swingup_12.csv", "A0_swingup_13.csv"])
def test_jittering_stamps_are_repaired_and_said(pendulum, log):
    mechanism, data = pendulum
    motion = ident.complete(mechanism, data / log)
    (e,) = motion.experiments
    steps = np.diff(e.t)
    assert np.ptp(steps) < 1e-9
    assert 400 < e.rate < 700
    assert any("time stamps are uneven" in note for note in motion.notes)
    raw = ident.read_log(data / log, mechanism.columns)
    at = mechanism.joint_index["Joint1"]
    np.testing.assert_allclose(
        e.y[:, at], np.interp(e.t, raw.t, raw.columns["q.Joint1"]), atol=0.02
    )


def test_parameters_are_near_those_of_the_trial(pendulum):
    fit = fit_of(pendulum, "A0_swingup_11.csv")
    np.testing.assert_allclose(four(fit), TRIAL, rtol=0.10)


def test_parameters_are_near_the_published_ones(pendulum):
    """At 10 Hz, where speeds are still more signal than noise: all four 5 to 11 % above published.

    One common factor, as of a motor's torque constant. At the 24 Hz that the motion's bandwidth
    asks for, noise in the accelerations takes 10 % off again, and joint 1's error is larger than
    its torque.
    """
    fit = fit_of(pendulum, "A0_swingup_11.csv", cutoff=10.0)
    ratio = four(fit) / PUBLISHED
    assert (np.abs(ratio - 1) < 0.13).all(), ratio
    assert np.ptp(ratio) < 0.08
    assert fit.train["Joint1"].relative < 0.57  # data/README.md: 34-57 %
    assert fit.train["Joint2"].relative < 0.10


def test_friction_is_positive_and_the_first_rotor_is_said_to_be_invisible(pendulum):
    fit = fit_of(pendulum, "A0_swingup_11.csv", cutoff=10.0)
    found = {v.name: v for each in fit.effects for v in each.parameters}
    assert 0.05 < found["coulomb.Joint1.Fc"].value < 0.2  # published 0.093 and 0.078
    assert 0.05 < found["coulomb.Joint2.Fc"].value < 0.2
    assert found["rotor_inertia.Joint2.Ia"].value == pytest.approx(36 * 7.66e-5, abs=1.5e-3)
    assert not found["rotor_inertia.Joint1.Ia"].identifiable
    assert any("rotor_inertia.Joint1.Ia cannot be identified" in said for said in fit.warnings)


def test_three_logs_together(pendulum):
    mechanism, data = pendulum
    logs = [data / f"A0_swingup_{number}.csv" for number in (11, 12, 13)]
    fit = ident.identify(mechanism, ident.complete(mechanism, logs, cutoff=8.0))
    ratio = four(fit) / PUBLISHED
    assert (np.abs(ratio - 1) < 0.13).all(), ratio


@pytest.mark.parametrize(
    "log",
    [
        pytest.param(
            "A0_swingup_12.csv",
            marks=pytest.mark.xfail(
                reason="noise in accelerations: where no torque holds parameters up, least squares "
                "shrinks them"
            ),
        ),
        "A0_swingup_13.csv",
    ],
)
def test_a_joint_that_swings_freely_does_not_ask_for_no_inertia(pendulum, log):
    """At 24 and 12 Hz all four come out near zero, at 8 Hz a third to two thirds of the truth."""
    fit = fit_of(pendulum, log)
    assert (four(fit) > 0.5 * np.array(PUBLISHED)).all(), four(fit)
