"""`complete` against motions closed by Pinocchio alone."""

from dataclasses import replace

import numpy as np
import pytest

from helpers import Truth, series, write_mechanism
from ident import identify
from ident.assess.check import identifiable
from ident.errors import MechanismError, MotionError
from ident.log import Log, read_log
from ident.mechanism import load
from ident.mechanism.load import absolute
from ident.motion import complete

NAMES = ("slider_crank", "pendulum", "four_bar", "five_bar", "arm")


@pytest.fixture(scope="module")
def truth():
    """`truth(name, **series)`: t and q, v, a of all joints of a robot; each made once."""
    made = {}

    def of(name, **options):
        key = (name, *sorted(options.items()))
        if key not in made:
            t, *driven = series(name, **options)
            made[key] = (t, *Truth(name).complete(t, *driven))
        return made[key]

    return of


def log_of(mechanism, t, joints, name="run.csv", **channels):
    """A log with the named joints' channels (q=…, v=…, a=…) and torques of some shape."""
    columns = {f"{prefix}.{joint}": x[joint] for prefix, x in channels.items() for joint in joints}
    columns |= {f"tau.{joint}": np.sin(3 * t) + 0.1 * i for i, joint in enumerate(mechanism.driven)}
    return Log.from_arrays(name, t, columns)


def driven_joints(name):
    return tuple(series(name)[1])


def check(mechanism, e, q, v, a, tol):
    """Joint coordinates, rates and accelerations against the truth, [rad | m] and derivatives."""
    keep = e.usable
    for joint, exact in q.items():
        at = mechanism.joint_index[joint]
        off = e.y[keep, at] - exact[keep]
        assert np.abs(off - 2 * np.pi * np.round(off.mean() / 2 / np.pi)).max() < tol[0], joint
        assert np.abs(e.yd[keep, at] - v[joint][keep]).max() < tol[1], joint
        assert np.abs(e.ydd[keep, at] - a[joint][keep]).max() < tol[2], joint


@pytest.mark.parametrize("form", [lambda m: m, absolute], ids=["joint", "absolute"])
@pytest.mark.parametrize("name", NAMES)
def test_all_joints_follow_from_the_logged_ones(name, form, robots, truth):
    mechanism = form(load(robots / name))
    t, q, v, a = truth(name)
    motion = complete(mechanism, log_of(mechanism, t, driven_joints(name), q=q, v=v, a=a))
    (e,) = motion.experiments
    assert e.usable.all()
    assert motion.closure_error < 1e-10
    check(mechanism, e, q, v, a, (1e-9, 1e-8, 1e-7))


@pytest.mark.parametrize("name", NAMES)
def test_the_absolute_form_gives_the_same_motion(name, robots, truth):
    joint = load(robots / name)
    bodies = absolute(joint)
    t, q, v, a = truth(name)
    log = log_of(joint, t, driven_joints(name), q=q, v=v, a=a)
    one, other = (complete(m, log).experiments[0] for m in (joint, bodies))
    n = len(joint.joints)
    np.testing.assert_allclose(other.y[:, :n], one.y, atol=1e-9)
    np.testing.assert_allclose(other.yd[:, :n], one.yd, atol=1e-9)
    np.testing.assert_allclose(other.ydd[:, :n], one.ydd, atol=1e-8)


@pytest.mark.parametrize("form", [lambda m: m, absolute], ids=["joint", "absolute"])
@pytest.mark.parametrize("rate", [100.0, 50.0, 25.0])
def test_a_coarse_log_stays_on_its_branch(rate, form, robots, truth):
    # at 25 Hz the crank moves up to 0.3 rad a sample, 10 rad between anchors 32 samples apart
    mechanism = form(load(robots / "four_bar"))
    t, q, v, a = truth("four_bar", rate=rate)
    motion = complete(mechanism, log_of(mechanism, t, ["crank"], q=q, v=v, a=a))
    check(mechanism, motion.experiments[0], q, v, a, (1e-9, 1e-8, 1e-7))


@pytest.mark.parametrize("form", [lambda m: m, absolute], ids=["joint", "absolute"])
def test_a_log_may_begin_many_turns_from_the_start(form, robots, truth):
    mechanism = form(load(robots / "four_bar"))
    t, q, v, a = truth("four_bar", seconds=8.0)
    late = t > 5.0  # five turns on
    q, v, a = ({j: x[late] for j, x in part.items()} for part in (q, v, a))
    motion = complete(mechanism, log_of(mechanism, t[late], ["crank"], q=q, v=v, a=a))
    check(mechanism, motion.experiments[0], q, v, a, (1e-9, 1e-8, 1e-7))
    at = mechanism.joint_index["crank"]
    np.testing.assert_allclose(motion.experiments[0].y[:, at], q["crank"], atol=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_positions_alone_give_rates_and_accelerations(name, robots, truth):
    mechanism = load(robots / name)
    t, q, v, a = truth(name)
    motion = complete(mechanism, log_of(mechanism, t, driven_joints(name), q=q))
    (e,) = motion.experiments
    inner = slice(20, -20)  # the spline knows less of its ends
    for joint in driven_joints(name):
        at = mechanism.joint_index[joint]
        assert np.abs(e.yd[inner, at] - v[joint][inner]).max() < 1e-6 * np.abs(v[joint]).max()
        assert np.abs(e.ydd[inner, at] - a[joint][inner]).max() < 1e-4 * np.abs(a[joint]).max()
    assert any("v and a by quintic interpolation of q" in note for note in motion.notes)


@pytest.mark.parametrize("name", ["four_bar", "five_bar", "arm"])
def test_noisy_positions_are_smoothed(name, robots, truth):
    # 0.1 mrad at 200 Hz: second differences would err by 10 rad/s² rms
    mechanism = load(robots / name)
    t, q, v, a = truth(name)
    rng = np.random.default_rng(0)
    noisy = {j: x + rng.normal(scale=1e-4, size=len(t)) for j, x in q.items()}
    motion = complete(mechanism, log_of(mechanism, t, driven_joints(name), q=noisy))
    (e,) = motion.experiments
    assert motion.band.cutoff is not None
    inner = slice(40, -40)
    for joint in driven_joints(name):
        at = mechanism.joint_index[joint]
        for found, exact, most in ((e.yd, v, 0.02), (e.ydd, a, 0.15)):
            off = found[inner, at] - exact[joint][inner]
            assert np.sqrt(np.mean(off**2)) < most * np.std(exact[joint]), joint


# --- more than is needed, less than is needed ---------------------------------------------------


@pytest.mark.parametrize("joint", ["crank", "coupler", "rocker", "closure.pin"])
def test_any_one_joint_of_a_loop_will_do(joint, robots, truth):
    mechanism = load(robots / "four_bar")
    t, q, v, a = truth("four_bar")
    (e,) = complete(mechanism, log_of(mechanism, t, ["crank"], q=q, v=v, a=a)).experiments
    logged = [{joint: x[:, mechanism.joint_index[joint]]} for x in (e.y, e.yd, e.ydd)]
    if joint in ("rocker", "closure.pin"):  # it swings: between its dead points, from a start there
        slow = np.abs(logged[1][joint] / v["crank"]) < 0.1
        dead = np.flatnonzero(slow)
        home = np.searchsorted(dead, at := np.argmin(np.abs(q["crank"] - 2 * np.pi - 1.0)))
        start = np.array([q[j.name][at] for j in mechanism.joints if j.in_tree])
        mechanism = replace(mechanism, start=start)
        part = slice(dead[home - 1] + 1, dead[home])
        t, (q, v, a) = t[part], ({j: x[part] for j, x in p.items()} for p in (q, v, a))
        logged = [{joint: x[joint][part]} for x in logged]
    log = log_of(mechanism, t, [joint], q=logged[0], v=logged[1], a=logged[2])
    motion = complete(mechanism, log)
    check(mechanism, motion.experiments[0], q, v, a, (1e-8, 1e-6, 1e-4))


@pytest.mark.parametrize("name", ["four_bar", "five_bar", "slider_crank"])
def test_all_joints_logged_agree(name, robots, truth):
    mechanism = load(robots / name)
    t, q, v, a = truth(name)
    motion = complete(mechanism, log_of(mechanism, t, q, q=q, v=v, a=a))
    check(mechanism, motion.experiments[0], q, v, a, (1e-9, 1e-8, 1e-7))
    assert motion.closure_error < 1e-10
    assert sum("agrees with the closures" in note for note in motion.notes) == len(q)


def test_a_biased_joint_is_reported(robots, truth):
    mechanism = load(robots / "five_bar")
    t, q, v, a = truth("five_bar")
    biased = q | {"left_elbow": q["left_elbow"] + 0.02}
    motion = complete(mechanism, log_of(mechanism, t, q, q=biased, v=v, a=a))
    said = {n.split("q.")[1].split()[0]: float(n.split("by ")[1].split()[0]) for n in motion.notes}
    assert max(said.values()) > 0.005
    assert motion.closure_error < 1e-10


@pytest.mark.parametrize("joint", ["left", "left_elbow", "right_elbow"])
def test_a_joint_of_the_wrong_sign_is_refused(joint, robots, truth):
    mechanism = load(robots / "five_bar")
    t, q, v, a = truth("five_bar")
    flipped = [x | {joint: -x[joint]} for x in (q, v, a)]
    log = log_of(mechanism, t, q, **dict(zip("qva", flipped, strict=True)))
    with pytest.raises(MotionError, match=r"contradict|cannot follow") as caught:
        complete(mechanism, log)
    assert "sign" in str(caught.value)


def test_a_joint_that_stands_still_may_be_logged(tmp_path, robots, truth):
    # standing still is no contradiction, however small the differences to it
    mechanism = load(robots / "five_bar")
    t, q, *_ = truth("five_bar")
    still = {j: np.full_like(t, x[0]) for j, x in q.items()}
    zero = {j: 0 * t for j in q}
    motion = complete(mechanism, log_of(mechanism, t, q, q=still, v=zero, a=zero))
    np.testing.assert_allclose(motion.experiments[0].yd, 0, atol=1e-12)


def test_too_few_positions_are_refused(robots, truth):
    mechanism = load(robots / "five_bar")
    t, q, *_ = truth("five_bar")
    with pytest.raises(MotionError, match=r"2 degrees of freedom.*determine only 1.*q\.right"):
        complete(mechanism, log_of(mechanism, t, ["left"], q=q))
    with pytest.raises(MotionError, match="determine only 0"):
        complete(mechanism, log_of(mechanism, t, [], q=q))


def test_a_driven_joint_needs_its_torque(robots, truth):
    mechanism = load(robots / "five_bar")
    t, q, *_ = truth("five_bar")
    columns = {"q.left": q["left"], "q.right": q["right"], "tau.left": t, "tau.rihgt": t}
    with pytest.raises(MotionError, match=r"'right' is driven.*did you mean 'tau.rihgt'"):
        complete(mechanism, Log.from_arrays("run.csv", t, columns))


PARALLELOGRAM = """<robot name="p"><link name="world"/>
<link name="crank"/><link name="coupler"/><link name="rocker"/>
<joint name="c" type="continuous"><parent link="world"/><child link="crank"/>
  <axis xyz="0 0 1"/></joint>
<joint name="k" type="continuous"><parent link="crank"/><child link="coupler"/>
  <origin xyz="0.1 0 0"/><axis xyz="0 0 1"/></joint>
<joint name="r" type="continuous"><parent link="world"/><child link="rocker"/>
  <origin xyz="0.3 0 0"/><axis xyz="0 0 1"/></joint></robot>"""
PARALLEL = """
[joints]
passive = ["k", "r"]
start = { c = 1.0, k = -1.0, r = 1.0 }
[[closure]]
name = "pin"
kind = "point"
a = { link = "coupler", xyz = [0.3, 0, 0] }
b = { link = "rocker", xyz = [0.1, 0, 0] }
"""


@pytest.mark.parametrize("form", [lambda m: m, absolute], ids=["joint", "absolute"])
@pytest.mark.parametrize("shift", [0.0, 0.003])
def test_a_parallelogram_turns_through_its_change_points(shift, form, tmp_path):
    # where all its links are in line it could fold; it is followed as it came, and this is said
    mechanism = form(load(write_mechanism(tmp_path, PARALLELOGRAM, PARALLEL)))
    t = np.arange(801) / 200
    turn = np.pi * (t + shift)  # exactly at π and 2π where shift = 0
    columns = {"q.c": turn, "v.c": np.full_like(t, np.pi), "a.c": 0 * t, "tau.c": np.sin(t)}
    motion = complete(mechanism, Log.from_arrays("run.csv", t, columns))
    (e,) = motion.experiments
    off = e.y[:, mechanism.joint_index["r"]] - turn
    off = (off + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(off[e.usable]).max() < 1e-6
    assert np.abs(e.yd[e.usable][:, mechanism.joint_index["r"]] - np.pi).max() < 1e-4
    assert any("near a singular position" in note for note in motion.notes)
    assert e.usable.mean() > 0.9


def test_no_log_is_refused(robots):
    with pytest.raises(MotionError, match="no log"):
        complete(load(robots / "arm"), [])


def test_where_the_loop_cannot_close_is_said(robots, truth):
    mechanism = load(robots / "slider_crank")
    t = np.arange(400) / 100
    columns = {
        "q.s": 0.2 + 0.1 * t,
        "tau.theta": t,
        "tau.s": t,
    }  # the rod is 0.3 m, the crank 0.08 m
    with pytest.raises(MotionError, match=r"cannot follow at t = \d.*s = 0\.\d+ m.*check"):
        complete(mechanism, Log.from_arrays("run.csv", t, columns))


def test_samples_near_a_dead_centre_are_left_out(robots, truth):
    # the four-bar driven by its rocker: at the dead points the rocker says nothing of the crank
    mechanism = load(robots / "four_bar")
    t, q, v, a = truth("four_bar")
    motion = complete(mechanism, log_of(mechanism, t, ["crank"], q=q, v=v, a=a))
    assert motion.experiments[0].usable.all()
    driven = replace(mechanism, driven=("rocker",), passive=("crank", "coupler"))
    columns = (
        {f"q.{j}": q[j] for j in q} | {f"v.{j}": v[j] for j in q} | {f"a.{j}": a[j] for j in q}
    )
    log = Log.from_arrays("run.csv", t, columns | {"tau.rocker": np.sin(t)})
    motion = complete(driven, log)
    assert motion.independent == ("rocker",)
    left_out = ~motion.experiments[0].usable
    slow = np.abs(v["rocker"] / v["crank"])
    assert 0 < left_out.sum() < 0.2 * len(t)
    assert slow[left_out].max() < 0.1 < slow[~left_out].max()
    (note,) = (note for note in motion.notes if "near a singular position of rocker" in note)
    edges = np.diff(left_out.astype(int), prepend=0, append=0)
    first, last = motion.experiments[0].t[[edges.argmax(), edges.argmin() - 1]]
    assert f"t = {first:.4g} to {last:.4g}" in note
    fit = identify(driven, motion)
    assert note in fit.warnings
    assert fit.information.rows <= (~left_out).sum()


@pytest.mark.parametrize("name", ["arm", "four_bar"])
@pytest.mark.parametrize("channels", ["q", "qv", "qva"])
def test_a_log_that_is_constant_to_the_last_bit_is_a_standstill(name, channels, robots):
    mechanism = load(robots / name)
    t, q, v, _ = series(name)
    still = {j: np.full(len(t), x[0] + 0.1) for j, x in q.items()}
    none = {j: np.zeros(len(t)) for j in v}
    given = {c: still if c == "q" else none for c in channels}
    log = log_of(mechanism, t, driven_joints(name), **given)
    (e,) = complete(mechanism, log).experiments
    assert np.ptp(e.q, axis=0).max() < 1e-12
    assert not e.yd.any()
    assert not e.ydd.any()


def test_a_logged_joint_that_closures_hold_still_is_named(robots, tmp_path):
    pair = (
        '[[closure]]\nname = "c{0}"\nkind = "linear"\njoints = ["yaw", "elbow"]\nratios = [1, {0}]'
    )
    (tmp_path / "arm.urdf").write_bytes((robots / "arm" / "arm.urdf").read_bytes())
    toml = "\n".join(['urdf = "arm.urdf"', pair.format(1), pair.format(2)])
    (tmp_path / "mechanism.toml").write_text(toml)
    mechanism, t = load(tmp_path), np.arange(0, 2, 0.01)
    log = log_of(mechanism, t, ["yaw"], q={"yaw": 0 * t})
    with pytest.raises(MotionError, match=r"let q.yaw not move at all.*one more of: q.shoulder"):
        complete(mechanism, log)


@pytest.mark.parametrize("kind", ["revolute", "point"])
def test_loops_that_hold_everything_still_are_refused(kind, robots, tmp_path):
    urdf = (robots / "four_bar" / "four_bar.urdf").read_text()
    head, tail = urdf.split('<joint name="coupler"')
    toml = (robots / "four_bar" / "mechanism.toml").read_text()
    (tmp_path / "four_bar.urdf").write_text(
        head + '<joint name="coupler"' + tail.replace('<axis xyz="0 -1 0"/>', "", 1)
    )
    (tmp_path / "mechanism.toml").write_text(toml.replace('kind = "revolute"', f'kind = "{kind}"'))
    mechanism = load(tmp_path)
    with pytest.raises(MechanismError) as caught:
        complete(mechanism, robots / "four_bar" / "run.csv")
    assert "0 degrees of freedom" in str(caught.value)
    assert "the axis of coupler is not parallel to those of crank, rocker" in str(caught.value)
    with pytest.raises(MechanismError, match=r"^[^ ]*: the loops leave 0 degrees"):
        identifiable(mechanism)


def test_columns_that_look_like_positions_and_torques_are_proposed(robots):
    log = read_log(robots / "arm" / "run.csv")
    words = {"q": "position", "tau": "effort"}
    given = {f"{words[n.split('.')[0]]}_{n.split('.')[1]}": x for n, x in log.columns.items()
             if n.split(".")[0] in words}  # fmt: skip
    mechanism = load(robots / "arm")
    with pytest.raises(MotionError, match=r'"q.\*" = "position_\*" and "tau.\*" = "effort_\*"'):
        complete(mechanism, Log.from_arrays("x", log.t, given))
    given |= {n: x for n, x in log.columns.items() if n.startswith("tau.")}
    with pytest.raises(MotionError, match=r'"q.\*" = "position_\*"'):
        complete(mechanism, Log.from_arrays("x", log.t, given))
