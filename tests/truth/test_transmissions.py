"""Springs and plays between motors and links, against MuJoCo's, with a second hinge for a link."""

import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

import ident
from helpers import ROBOTS
from ident.effects.drive import EncoderOffset
from ident.equations.table import Table
from ident.equations.terms import Samples
from ident.equations.unknowns import Point
from ident.errors import MechanismError, MotionError
from ident.fit.springs import within_signs
from ident.information.chance import covariance
from ident.information.evidence import CERTAIN
from ident.simulate.inverse import point_of
from ident.simulate.twisting import twisting

pytest.importorskip("mujoco")
pl = pytest.importorskip("polars")

from servo_hidden import hidden  # noqa: E402
from servo_logs import Servos, servo_log  # noqa: E402

JOINTS = ("yaw", "shoulder", "elbow")
ARM = ROBOTS / "servo_arm"
SPRING = Servos(springs={"elbow": (12.0, 0.05)})
PLAY = Servos(plays={"elbow": 0.01})


def frame(truth, seed=3, top=8.0, **options):
    return pl.DataFrame(servo_log(truth, seed, top=top, **options))


def fitted(text, truth, **options):
    mechanism = ident.load(ARM).with_calibration("exact").with_effect(text)
    log = frame(truth, **options)
    return ident.identify(mechanism, ident.complete(mechanism, log))


def values(fit):
    return {p.name: p for effect in fit.effects for p in effect.parameters}


def test_a_spring_whose_resonance_is_in_the_band():
    of = values(fit := fitted("elasticity:elbow", SPRING))
    c, D = of["elasticity.elbow.compliance"], of["elasticity.elbow.damping"]
    assert c.value == pytest.approx(1 / 12, rel=0.02)
    assert D.value == pytest.approx(0.05, rel=0.2)
    assert of["servo.elbow.kp"].value == pytest.approx(14.0, rel=0.01)
    assert of["rotor_inertia.elbow.Ia"].value == pytest.approx(0.008, rel=0.03)
    assert fit.relative["elbow"] < 0.025  # 0.16 without


def test_a_spring_beyond_what_a_slow_log_shows_is_said_with_the_stiffness_that_would_show():
    slow = fitted("elasticity:elbow", Servos(springs={"elbow": (2000.0, 0.05)}), top=1.6)
    (finding,) = (f for f in slow.findings if f.code == "rigid here")
    text = str(finding)
    limit = float(re.search(r"not to be seen here; below ([\d.e+]+) N m/rad", text)[1])
    assert text.startswith("compliance of elbow")
    assert limit < 2000.0
    # one that is softer than that by half is seen
    softer = fitted("elasticity:elbow", Servos(springs={"elbow": (limit / 2, 0.05)}), top=1.6)
    compliance = values(softer)["elasticity.elbow.compliance"]
    assert compliance.value == pytest.approx(2 / limit, abs=3 * compliance.stderr)
    assert not any(f.code == "rigid here" for f in softer.findings)


def test_a_play():
    of = values(fit := fitted("backlash:elbow", PLAY))
    # smoothing the motor's motion at the blows makes it look wider
    assert 0.01 < of["backlash.elbow.width"].value < 0.012
    assert of["servo.elbow.kp"].value == pytest.approx(14.0, rel=0.01)
    assert fit.relative["elbow"] < 0.03  # 0.08 without


def planted_values(truth):
    of = {"command_delay.yaw,shoulder,elbow.d": truth.delay}
    for i, joint in enumerate(JOINTS):
        of |= {f"servo.{joint}.kp": truth.kp[i], f"servo.{joint}.kd": truth.kd[i]}
        of |= {f"coulomb.{joint}.Fc": truth.Fc[i], f"viscous.{joint}.Fv": truth.Fv[i]}
        of[f"rotor_inertia.{joint}.Ia"] = truth.Ia[i]
    return of


def test_a_link_flies_in_its_play_in_the_simulation_as_in_mujoco(tmp_path):
    log = frame(PLAY, seconds=2.0, twisted=True)
    log.drop("twist.elbow").write_csv(tmp_path / "log.csv")
    mechanism = ident.load(ARM).with_effect("viscous").with_effect("backlash:elbow")
    given = planted_values(PLAY) | {"backlash.elbow.width": 0.01}
    run = ident.integrate(
        mechanism, ident.Torques(str(tmp_path / "log.csv")), values=given, duration=0.8,
        tolerance=1e-6,
    )  # fmt: skip
    at = run.mechanism.joint_index["elbow.twist"]
    twist, q = (np.interp(run.t, log["t"], log[f"{c}.elbow"]) for c in ("twist", "q"))
    assert np.std(run.y[:, at] - twist) < 2e-4
    assert np.std(run.log.columns["q.elbow"] - q) < 5e-4
    assert not any("twist" in name for name in run.log.columns)


def test_poses_twist_a_spring_by_their_load_alone():
    random, compliance = np.random.default_rng(1), 2e-3
    mechanism = ident.load(ROBOTS / "arm").with_calibration("exact")
    model, at = mechanism.model, mechanism.joint("elbow").index
    data, still = model.createData(), np.zeros(model.nv)
    q = random.uniform(-1, 1, (60, model.nv))
    load = np.array([pin.rnea(model, data, x, still, still) for x in q])
    q[:, at] += compliance * load[:, at]
    tau = load + 1e-3 * random.normal(size=load.shape)
    series = {"q": q, "tau": tau}
    poses = pl.DataFrame(
        {f"{k}.{j.name}": x[:, j.index] for k, x in series.items() for j in mechanism.joints}
    )
    soft = mechanism.with_effect("elasticity:elbow")
    fit = ident.identify(soft, ident.complete(soft, poses, poses=True))
    of = values(fit)["elasticity.elbow.compliance"]
    assert abs(of.value - compliance) < 3 * of.stderr < compliance
    assert fit.relative["shoulder"] < 1e-3


def test_a_zero_of_a_joint_leaves_the_swing_of_its_link():
    """Its column by a small step, from the model's own state, and by differences to both sides."""
    fit = fitted("elasticity:elbow", SPRING, seconds=5.0)
    table = Table.of(fit.mechanism, fit.columns, fit.motion, fit.point)
    zero, none = EncoderOffset(("elbow",)), {"delta": 0.0}
    slope, wide = (table.sensitivity(zero, none, "delta", step) for step in (None, 1e-3))
    assert np.std(slope - wide) < 1e-3 * np.std(wide)


def test_a_spring_without_damping_does_not_run_away_in_a_loop():
    robot = ROBOTS / "five_bar"
    soft = ident.load(robot).with_effect("elasticity:right")
    torques = [
        ident.simulate(
            soft, ident.read_log(robot / "run.csv"),
            values={"elasticity.right.compliance": c, "elasticity.right.damping": 0.0},
        )[0].columns["tau.right"]
        for c in (0.0, 2e-3)
    ]  # fmt: skip
    assert np.std(torques[1]) == pytest.approx(np.std(torques[0]), rel=0.05)


def test_forces_at_places_move_a_link_behind_its_motor_too():
    arm = ident.load(ARM).with_effect("elasticity:elbow").with_effect("body_drag:forearm")
    spring = {"elasticity.elbow.compliance": 0.05, "elasticity.elbow.damping": 0.1}
    names = [name for effect in arm.effects for name in effect.names]
    point = point_of(arm, dict.fromkeys(names, 0.1) | spring, None)
    divided, _, _ = twisting(arm, point, None)
    drag = next(effect for effect in divided.effects if effect.kind == "body_drag")
    assert drag.acting == ("yaw", "shoulder", "elbow", "elbow.twist")


def test_a_motor_without_inertia_is_no_mass_beside_its_link():
    arm = ident.load(ROBOTS / "arm").with_effect("elasticity:elbow")
    with pytest.raises(MechanismError, match="rotor_inertia:elbow"):
        ident.integrate(
            arm, values={"elasticity.elbow.compliance": 1e-3, "elasticity.elbow.damping": 1.0}
        )


def test_a_search_for_a_spring_ends_no_worse_than_without_it():
    """At a resonance the parameters that swing the link go to and fro from step to step."""
    stiff = Servos(springs={"elbow": (60.0, 0.08)})
    arm, log = ident.load(ARM).with_calibration("exact"), frame(stiff, seconds=10.0)
    motion = ident.complete(arm, log)
    without = ident.identify(arm, motion)
    fit = ident.identify(arm.with_effect("elasticity:elbow"), motion)
    for joint in JOINTS:
        assert fit.relative[joint] < 1.1 * without.relative[joint]
    of = values(fit)
    assert min(of["elasticity.elbow.compliance"].value for name in ("compliance", "damping")) >= 0


# a gain that is too low by a quarter holds the rotor at zero: the refit alone shows it; so does
# that of a link in resonance, which a clock 22 times as fast explains better than slopes
@pytest.mark.parametrize(
    ("what", "seed"), [("compliance", 2000), ("compliance", 5001), ("wrong kp", 1002)]
)
def test_a_diagnosis_names_what_is_hidden_in_a_servo_joint(what, seed):
    case = hidden(what, seed)
    motion = ident.complete(case.mechanism, pl.DataFrame(case.log))
    found = ident.diagnose(ident.identify(case.mechanism, motion))
    assert found.verdict == "missing"
    assert found.candidates[0].effect.label == case.label


def test_what_chance_makes_negative_is_zero_with_its_standard_error():
    soft = ident.load(ROBOTS / "arm").with_effect("elasticity:elbow")
    values = {"elasticity.elbow.compliance": 0.002, "elasticity.elbow.damping": 2.0}
    log = ident.read_log(ROBOTS / "arm" / "run.csv")
    simulated, _ = ident.simulate(
        soft, log, values=values, noise=[ident.Noise("tau", 0.01, relative=True)], seed=5
    )
    fit = ident.identify(soft, ident.complete(soft, simulated))
    problem, first = fit.problem, fit.estimate
    place = fit.columns.index["elasticity.elbow.damping"]
    at = first.limited(np.array([place]))
    assert at.x[place] == 0
    assert at.at_limit.tolist() == [place]
    # least squares on what remains, as if it were known
    fixed = first.fixed.copy()
    fixed[place] = True
    point = problem.point_at(first.x).with_values({"elasticity.elbow.damping": 0.0})
    known = replace(problem, point=point).estimate(sigma=first.sigma, fixed=fixed)
    assert np.allclose(known.x, at.x, rtol=1e-6, atol=1e-9)
    limited = replace(fit, estimate=at)
    (value,) = (p for p in limited.effects[-1].parameters if p.name.endswith("damping"))
    assert value.value == 0
    assert value.at_bound
    assert value.stderr > 0


@pytest.mark.parametrize(("robot", "joint"), [("servo_arm", "elbow"), ("five_bar", "right")])
def test_columns_at_starts_are_those_of_the_whole_way_to_first_order(robot, joint):
    """In a tree from derivatives of all bodies, in a loop from differences, where the whole way's
    passes run away for some starts.
    """
    mechanism = ident.load(ROBOTS / robot).with_calibration("exact")
    log = frame(SPRING, seconds=5.0) if joint == "elbow" else ROBOTS / robot / "run.csv"
    fit = ident.identify(mechanism, ident.complete(mechanism, log))
    table = Table.of(fit.mechanism, fit.columns, fit.motion, fit.point)
    for kind in ("elasticity", "backlash"):
        every = fit.mechanism.candidates((joint,), set())
        effect = next(e for e in every if e.label == f"{kind}:{joint}")
        starts = table.starts(effect)
        first, exact = (
            columns(effect, starts)[0].reshape(-1, len(starts) * len(effect.searched))
            for columns in (table.start_columns, table.effect_columns)
        )
        sizes = np.linalg.norm(first, axis=0) * np.linalg.norm(exact, axis=0)
        alike = (first * exact).sum(axis=0)[sizes > 0] / sizes[sizes > 0]
        assert np.median(alike) > (0.99 if joint == "elbow" else 0.95)


def test_what_swings_behind_a_joint_of_a_loop_is_known_of_independent_ones():
    """The load of another drive is its torque, which says nothing of what it carries."""
    robot = ROBOTS / "five_bar"
    motion = ident.complete(mechanism := ident.load(robot), ident.read_log(robot / "run.csv"))
    samples = Samples(mechanism, motion.experiments[0], slice(None), Point.prior(mechanism))
    assert (samples.load_slopes(("left",))[2] > 0).all()
    with pytest.raises(MotionError, match="leave out the spring or play of left_elbow"):
        samples.load_slopes(("left_elbow",))


def torque_of_crank(mechanism, q, v, a):
    """The torque of the crank of a rigid four-bar in states that need not follow each other."""
    t, none = 0.01 * np.arange(len(q)), np.zeros(len(q))
    columns = {"q.crank": q, "v.crank": v + none, "a.crank": a + none}
    log, _ = ident.simulate(mechanism, ident.Log.from_arrays("states", t, columns))
    return log.columns["tau.crank"]


def test_a_spring_that_turns_a_four_bar_swings_as_an_integrator_has_it():
    """The crank's own angle, M(q) q̈ + M'(q) q̇²/2 + g(q) = K δ + D δ̇, integrated by SciPy."""
    compliance, damping = 0.005, 0.1
    bar = ident.load(ROBOTS / "four_bar").with_calibration("exact")
    q = np.linspace(-1.0, 3.0, 801)
    g = torque_of_crank(bar, q, 0.0, 0.0)
    gravity = CubicSpline(q, g)
    inertia = CubicSpline(q, torque_of_crank(bar, q, 0.0, 1.0) - g)
    t, K = np.arange(0.0, 8.0, 0.005), 1 / compliance
    fine = np.arange(-0.01, 8.01, 5e-4)
    s = np.clip(fine, 0.0, 1.0)
    waves = zip((0.8, 0.25, 0.08, 0.03, 0.015), (0.4, 1.1, 2.3, 4.1, 6.3), strict=True)
    way = sum(A * np.sin(2 * np.pi * f * fine + f) for A, f in waves)
    motor = CubicSpline(fine, 1.0 + s**3 * (10 - 15 * s + 6 * s**2) * way)
    start = float(motor(0.0))
    for _ in range(50):
        start = float(motor(0.0) - compliance * gravity(start))

    def right(at, x):
        push = K * (motor(at) - x[0]) + damping * (motor(at, 1) - x[1])
        return [x[1], (push - gravity(x[0]) - 0.5 * inertia(x[0], 1) * x[1] ** 2) / inertia(x[0])]

    crank = solve_ivp(right, (0.0, t[-1]), [start, 0.0], "LSODA", t, rtol=1e-9, atol=1e-11).y
    torque = K * (motor(t) - crank[0]) + damping * (motor(t, 1) - crank[1])
    columns = {"q.crank": motor(t), "v.crank": motor(t, 1), "a.crank": motor(t, 2)}
    log = ident.Log.from_arrays("run", t, {**columns, "tau.crank": torque})
    soft = bar.with_effect("elasticity:crank")
    of = values(fit := ident.identify(soft, ident.complete(soft, log)))
    assert of["elasticity.crank.compliance"].value == pytest.approx(compliance, rel=1e-3)
    assert of["elasticity.crank.damping"].value == pytest.approx(damping, rel=1e-2)
    assert fit.relative["crank"] < 1e-3
    rigid = ident.identify(bar, ident.complete(bar, log))
    assert rigid.relative["crank"] > 0.05


@pytest.mark.parametrize("below", [1.0, 5.0])
def test_only_what_is_negative_beyond_chance_is_known_to_be_zero(below):
    """Right sides that put the compliance so many standard errors below zero."""
    arm = ident.load(ROBOTS / "arm").with_effect("elasticity:elbow")
    values = {"elasticity.elbow.compliance": 0.002, "elasticity.elbow.damping": 2.0}
    noise = [ident.Noise("tau", 0.01, relative=True)]
    log = ident.read_log(ROBOTS / "arm" / "run.csv")
    simulated, _ = ident.simulate(arm, log, values=values, noise=noise, seed=5)
    fit = ident.identify(arm, ident.complete(arm, simulated), estimator="least-squares")
    place = fit.columns.index["elasticity.elbow.compliance"]
    problem, first = fit.problem, fit.estimate
    variances = np.diag(covariance(problem.fitting, first))
    error = float(np.sqrt(variances[np.searchsorted(first.base.independent, place)]))
    lower, blocks = first.x[place] + below * error, {}
    for key, block in problem.information.blocks.items():
        column = block.triangle.R @ (block.support == place)
        triangle = replace(block.triangle, d=block.triangle.d - lower * column)
        blocks[key] = replace(block, triangle=triangle)
    problem = replace(problem, information=replace(problem.information, blocks=blocks))
    shifted = problem.estimate(sigma=first.sigma, fixed=first.fixed)
    assert shifted.x[place] == pytest.approx(-below * error, rel=1e-6)
    problem, within, (finding, *_) = within_signs(problem, shifted)
    certain = below > CERTAIN
    assert within.x[place] == 0
    assert within.fixed[place] == certain
    assert (place in within.at_limit) != certain
    assert finding.code == ("negative" if certain else "held at zero")
    assert ("the model or the data are wrong there" in str(finding)) == certain
