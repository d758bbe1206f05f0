"""Joints that are held at a coordinate: one body with their parent, in every result."""

import json

import numpy as np
import pinocchio as pin
import pytest

import ident
from helpers import ROBOTS
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
