"""Effects in closed loops forward against inverse dynamics, and logs that are identified again."""

import pytest
from forward import integrated, judged, planted

import ident
from helpers import ROBOTS
from identification import motion_log, robot

LOOPS = {
    "coulomb:closure.pin": {"Fc": 0.05},
    "viscous:closure.pin": {"Fv": 0.05},
    "load_friction:closure.pin": {"mu": 0.004},
    "load_friction:crank": {"mu": 0.05},
    "hysteresis:rocker": {"sigma": 3.0, "z0": 0.02},
    "rotor_inertia:crank": {"Ia": 0.01},
    "torque_gain:crank": {"g": 0.1},
    "spring:closure.pin": {"k": 0.2, "b": 0.0},
    "geometry:pin.a.x": {"Delta": 0.004},
    "encoder_offset:crank": {"delta": 0.05},
}


@pytest.mark.parametrize("label", LOOPS)
def test_an_effect_of_the_four_bar(label):
    mechanism = planted(robot("four_bar"), {label: LOOPS[label]})
    run = integrated(mechanism, motion_log("four_bar", 250.0, 0.6))
    close = 2e-4 if label.startswith("hysteresis") else 1e-8
    assert judged(mechanism, run) < close
    assert run.closure_error < 1e-11


@pytest.mark.parametrize(
    "name",
    ["four_bar", *(pytest.param(name, marks=pytest.mark.slow) for name in ("arm", "five_bar"))],
)
def test_what_is_simulated_is_identified_again(name):
    """Dry and viscous friction and a heavier last link, from a log without noise."""
    mechanism = robot(name).with_effect("viscous").with_effect("coulomb")
    link = mechanism.bodies.links[-1]
    truth = {f"viscous.{j}.Fv": 0.05 for j in mechanism.driven}
    truth |= {f"coulomb.{j}.Fc": 0.08 for j in mechanism.driven}
    bare = mechanism.prior.copy()
    at = mechanism.bodies.columns(link)
    bare[at] *= 1.3
    log = motion_log(name, 250.0, 4.0)
    run = ident.integrate(mechanism, ident.ComputedTorque(log), values=truth, pi=bare)
    fit = ident.identify(mechanism, ident.complete(mechanism, run.log))
    for full, value in truth.items():
        assert fit[full].value == pytest.approx(value, rel=2e-3), full
    again = ident.replay(fit, window=0.5)
    for errors in again.runs["fit"]:
        for joint, error in errors.errors.items():
            assert error.relative < 0.02, joint


def test_the_robots_folder_is_simulated_by_its_own_fit(tmp_path):
    """`identified/` holds all values: it integrates as it is."""
    mechanism = robot("four_bar").with_effect("viscous").with_effect("coulomb")
    log = ident.read_log(ROBOTS / "four_bar" / "run.csv")
    fit = ident.identify(mechanism, ident.complete(mechanism, log))
    fit.write(tmp_path / "out")
    own = ident.load(tmp_path / "out" / "identified")
    run = ident.integrate(own, ident.PD(log), duration=1.0)
    assert run.closure_error < 1e-11
