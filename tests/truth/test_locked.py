"""Joints that are held at a coordinate: one body with their parent, in every result."""

import json
import shutil

import numpy as np
import pinocchio as pin
import pytest

import ident
from helpers import ROBOTS
from ident.cli.options import _unlogged_hands
from ident.errors import MechanismError
from identification import motion_log, plant, robot

HELD = 0.4  # [rad]


@pytest.fixture
def held():
    return ident.load(ROBOTS / "arm", locked={"wrist": HELD})


def test_the_others_move_as_if_the_joint_stood_still(held):
    whole = robot("arm").model
    index = whole.getJointId("wrist")
    at = whole.idx_vs[index]
    q, v, a = np.random.default_rng(0).normal(size=(3, whole.nv))
    q[at], v[at], a[at] = HELD, 0.0, 0.0
    others = np.arange(whole.nv) != at
    torque = pin.rnea(whole, whole.createData(), q, v, a)[others]
    model = held.model
    found = pin.rnea(model, model.createData(), q[others], v[others], a[others])
    np.testing.assert_allclose(found, torque, atol=1e-12)
    assert "wrist" not in held.joint_index
    assert held.locked == {"wrist": HELD}
    assert any("wrist at 0.4" in note for note in held.notes)


def test_a_fit_and_its_folder_hold_it_too(held, tmp_path):
    fit = plant(held, motion_log("arm")).fit()
    fit.write(tmp_path / "out")
    again = ident.load(tmp_path / "out" / "identified")
    assert again.locked == held.locked
    np.testing.assert_allclose(again.prior, fit.dynamic_parameters, atol=1e-9)


def test_a_joint_that_mimics_is_held_with_its_leader(tmp_path):
    text = (ROBOTS / "arm" / "arm.urdf").read_text()
    at = text.index("</joint>", text.index('name="wrist"'))
    mimic = '<mimic joint="elbow" multiplier="-2" offset="0.1"/>'
    (tmp_path / "arm.urdf").write_text(text[:at] + mimic + text[at:])
    mechanism = ident.load(tmp_path / "arm.urdf", locked={"elbow": 0.3})
    assert mechanism.locked == pytest.approx({"elbow": 0.3, "wrist": -0.5})
    assert mechanism.degrees_of_freedom == 2
    assert not mechanism.closures


def test_mechanism_toml_and_start(tmp_path):
    (tmp_path / "arm.urdf").write_bytes((ROBOTS / "arm" / "arm.urdf").read_bytes())
    toml = tmp_path / "mechanism.toml"
    toml.write_text(
        'urdf = "arm.urdf"\n[joints]\npassive = ["wrist"]\nstart = { wrist = 0.2, elbow = 1.0 }\n'
        "locked = { yaw = 0.1 }\n"
    )
    mechanism = ident.load(tmp_path, locked={"wrist": None})
    assert mechanism.locked == {"yaw": 0.1, "wrist": 0.2}
    assert not mechanism.passive
    with pytest.raises(MechanismError, match=r"'yam'.*did you mean 'yaw'"):
        ident.load(tmp_path, locked={"yam": 0.0})
    toml.write_text('urdf = "arm.urdf"\n[joints]\nlocked = 3\n')
    with pytest.raises(MechanismError, match="locked = 3"):
        ident.load(tmp_path)
    toml.write_text('urdf = "arm.urdf"\n[joints]\nlocked = ["yaw"]\n')
    with pytest.raises(MechanismError, match=r"write locked = \{ yaw = 0.0 \}"):
        ident.load(tmp_path)


def test_a_fixed_joint_that_mimics_is_a_note(tmp_path):
    text = (ROBOTS / "arm" / "arm.urdf").read_text().replace('"revolute"', '"fixed"', 1)
    at = text.index("</joint>", text.index('"fixed"'))
    mimic = '<mimic joint="elbow"/>'
    (tmp_path / "arm.urdf").write_text(text[:at] + mimic + text[at:])
    assert any("<mimic> is ignored" in note for note in ident.load(tmp_path / "arm.urdf").notes)


def test_the_command_line_holds_it(tmp_path, spoken):
    arm, out = ROBOTS / "arm", tmp_path / "out"
    status, said, noted = spoken("check", arm, "--lock", "wrist=0.4")
    assert status == 0
    assert "locked: wrist at 0.4" in said + noted
    case = plant(ident.load(arm, locked={"wrist": HELD}), motion_log("arm"))
    case.log.write(tmp_path / "run.csv")
    words = ("identify", arm, tmp_path / "run.csv", "--lock", "wrist=0.4", "--out", out)
    assert spoken(*words)[0] == 0
    names = [each["name"] for each in json.loads((out / "fit.json").read_text())["parameters"]]
    assert names
    assert not any(name.startswith("hand.") for name in names)
    assert spoken("check", arm, "--lock", "wrist=much")[0] == 1


BALL = (
    '<mujoco><worldbody><body name="a"><joint name="hinge" type="hinge"/>'
    '<geom type="sphere" size=".1" mass="1"/><body name="b" pos="0 0 1"><joint name="ball" '
    'type="ball"/><geom type="sphere" size=".1" mass="1"/></body></body></worldbody></mujoco>'
)


def test_a_place_outside_the_limits_is_said(robots):
    arm = robots / "arm"
    joint = ident.load(arm).joint("elbow")
    (note,) = (
        x for x in ident.load(arm, locked={"elbow": joint.upper + 1}).notes if "outside" in x
    )
    assert note.startswith(f"elbow is locked at {joint.upper + 1:.4g}, outside its limits ")
    assert not any("outside" in x for x in ident.load(arm, locked={"elbow": joint.upper}).notes)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("wrist=abc",), "--lock wrist=abc: is no joint with a number; write --lock JOINT"),
        (("=",), "--lock =: is no joint"),
        (("=0.3",), "--lock =0.3: is no joint"),
        (("wrist=0", "wrist=0.3"), "--lock wrist=0.3: 'wrist' has another value already"),
        (("wrist", "wrist=0.3"), "two places for one joint"),
        (("nothing",), "no joint 'nothing' to be locked; valid: elbow, shoulder, wrist, yaw"),
    ],
)
def test_what_cannot_be_locked(spoken, options, words):
    given = [word for text in options for word in ("--lock", text)]
    status, _, said = spoken("check", ROBOTS / "arm", *given)
    assert status == 1
    assert words in said


def test_a_ball_joint_is_locked_where_the_file_has_it(tmp_path, spoken):
    model = tmp_path / "ball.xml"
    model.write_text(BALL)
    assert spoken("check", model, "--lock", "ball")[0] == 0
    status, _, said = spoken("check", model, "--lock", "ball=0.3")
    assert (status, "several coordinates, so 0.3 is no place of it" in said) == (1, True)


def test_a_loop_that_locks_cannot_close_names_the_lock(spoken):
    crank = ROBOTS / "slider_crank"
    assert "lock fewer joints than theta" in spoken("check", crank, "--lock", "theta=0")[2]
    assert "are locked: alpha at 0" in spoken("check", crank, "--lock", "alpha=0")[2]


def test_a_log_may_lack_the_columns_of_a_locked_joint(tmp_path, spoken):
    shutil.copytree(ROBOTS / "arm", tmp_path / "arm")
    toml = tmp_path / "arm" / "mechanism.toml"
    names = (f'"{c}.{j}" = "{j}_{c}"' for c in ("q", "tau") for j in ("yaw", "elbow", "wrist"))
    toml.write_text(toml.read_text() + "\n[log]\n" + "\n".join(names) + "\n")
    case = plant(ident.load(ROBOTS / "arm", locked={"wrist": HELD}), motion_log("arm"))
    case.log.write(tmp_path / "run.csv")
    text = (tmp_path / "run.csv").read_text()
    for c in ("q", "tau"):
        for j in ("yaw", "elbow"):
            text = text.replace(f"{c}.{j}", f"{j}_{c}", 1)
    (tmp_path / "run.csv").write_text(text)
    words = ("check", tmp_path / "arm", tmp_path / "run.csv")
    assert spoken(*words, "--lock", f"wrist={HELD}")[0] == 0


def test_effects_of_a_locked_joint_are_left_out_with_a_note(tmp_path):
    (tmp_path / "arm.urdf").write_bytes((ROBOTS / "arm" / "arm.urdf").read_bytes())
    effects = [f'[[effect]]\nkind = "coulomb"\njoint = "{joint}"' for joint in ("elbow", "wrist")]
    (tmp_path / "mechanism.toml").write_text("\n".join(['urdf = "arm.urdf"', *effects]))
    assert len(ident.load(tmp_path).effects) == 2
    held = ident.load(tmp_path, locked={"wrist": None})
    assert [effect.label for effect in held.effects] == ["coulomb:elbow"]
    assert any(note.endswith("does not move: coulomb:wrist") for note in held.notes)


def test_one_log_without_a_hand_locks_it_in_no_other(tmp_path):
    """Of a folder; where no log has the hand's position, it is held."""
    log = ident.read_log(ROBOTS / "arm" / "run.csv")
    rows = {name: x[:50] for name, x in log.columns.items()}
    without = {name: x for name, x in rows.items() if not name.endswith(".wrist")}
    bad, good = tmp_path / "0.csv", tmp_path / "1.csv"
    ident.Log.from_arrays("bad", log.t[:50], without).write(bad)
    mechanism = ident.load(ROBOTS / "arm")
    assert _unlogged_hands(mechanism, [tmp_path]) == ("wrist",)
    (tmp_path / "00.csv").write_text("no log\n")
    ident.Log.from_arrays("good", log.t[:50], rows).write(good)
    assert _unlogged_hands(mechanism, [tmp_path]) == ()
