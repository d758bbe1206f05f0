"""Rods that turn about themselves: an ankle of two motors and two rods with balls at both ends."""

import numpy as np
import pinocchio as pin
import pytest

import ident
from ident.errors import MotionError
from ident.mechanism.idle import spins
from ident.mechanism.parameters import DYNAMIC
from ident.mechanism.write import understood_files
from ident.motion.motion import prescribed

BODY = (
    '<link name="{}"><inertial><mass value="{}"/><origin xyz="{}"/><inertia ixx="{}" ixy="0" '
    'ixz="0" iyy="{}" iyz="0" izz="{}"/></inertial></link>'
)
JOINT = (
    '<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/><origin xyz="{}"/>'
    '<axis xyz="{}"/></joint>'
)
LOOP = (
    '<constraint name="{0}" type="spherical"><parent link="rod_{0}"/><parent_origin xyz="0 0 {1}"/>'
    '<child link="foot"/><child_origin xyz="-0.05 {2} 0"/></constraint>'
)
SIDES = {"l": (0.04, 0.2), "r": (-0.04, 0.26)}  # m: across, height of the motor


def ankle(passive_toe=False):
    parts = [
        '<link name="world"/>', BODY.format("cross", 0.05, "0 0 0", 1e-5, 1e-5, 1e-5),
        BODY.format("foot", 0.8, "0.01 0 -0.05", 0.001, 0.004, 0.004),
        JOINT.format("pitch", "continuous", "world", "cross", "0 0 0", "0 1 0"),
        JOINT.format("roll", "continuous", "cross", "foot", "0 0 0", "1 0 0"),
    ]  # fmt: skip
    for side, (y, z) in SIDES.items():
        crank = f"crank_{side}"
        parts += [
            BODY.format(crank, 0.08, "-0.02 0 0", 2e-5, 2e-5, 2e-5),
            BODY.format(f"rod_{side}", 0.06, f"0 0 {-z / 2}", 3e-4, 3e-4, 2e-6),
            JOINT.format(
                f"m_{side}", "continuous", "world", f"crank_{side}", f"0 {y} {z}", "0 1 0"
            ),
            JOINT.format(
                f"ball_{side}", "ball", f"crank_{side}", f"rod_{side}", "-0.05 0 0", "1 0 0"
            ),
            LOOP.format(side, -z, y),
        ]
    if passive_toe:
        parts += [
            BODY.format("toe", 0.1, "0.05 0 0", 1e-4, 1e-4, 1e-4),
            JOINT.format("toe_joint", "continuous", "foot", "toe", "0.1 0 0", "0 1 0"),
        ]
    drives = "".join(
        f'<transmission name="t{side}"><joint name="m_{side}"/></transmission>' for side in SIDES
    )
    return f'<robot name="ankle">{"".join(parts)}{drives}</robot>'


@pytest.fixture
def load(tmp_path):
    def read(text):
        (tmp_path / "ankle.urdf").write_text(text)
        return ident.load(tmp_path / "ankle.urdf")

    return read


def test_a_rods_own_turn_is_held(load):
    mechanism = load(ankle())
    assert mechanism.degrees_of_freedom == 2
    assert mechanism.driven == ("m_l", "m_r")
    assert sorted(name.partition(".")[0] for name in mechanism.idle) == ["ball_l", "ball_r"]
    assert not spins(mechanism)
    gone = {"mx", "my", "Lzz", "Lxy", "Lxz", "Lyz"}
    for rod in ("rod_l", "rod_r"):
        kept = {name.rpartition(".")[2] for name in mechanism.unknown if name.startswith(f"{rod}.")}
        assert kept == {*DYNAMIC} - gone
    assert any("rod_l" in note and "turn about themselves" in note for note in mechanism.notes)


def test_the_motors_log_identifies_it(load):
    """Torques of slender rods do not depend on how these turn about themselves."""
    mechanism = load(ankle())
    t = np.arange(0, 10, 0.01)
    phase = np.outer(t, 2 * np.pi * np.array([0.31, 0.53, 0.87]))
    known = np.zeros((3, len(t), 2))
    for i, factors in enumerate(([0.12, 0.06, 0.03], [0.05, -0.11, 0.04])):
        w = phase[1] / t[1]
        known[0, :, i] = np.sin(phase) @ factors
        known[1, :, i] = np.cos(phase) * w @ factors
        known[2, :, i] = -np.sin(phase) * w**2 @ factors
    e = prescribed(mechanism, "run", t, ("m_l", "m_r"), known).experiments[0]
    data = mechanism.model.createData()
    f = np.array([pin.rnea(mechanism.model, data, *x) for x in zip(e.q, e.v, e.a, strict=True)])
    Z = e.pinv[:, :, -2:]
    torques = np.einsum("niu,ni->nu", Z, f)
    columns = {f"q.{name}": known[0, :, i] for i, name in enumerate(e.independent)}
    columns |= {f"tau.{name}": torques[:, i] for i, name in enumerate(e.independent)}
    motion = ident.complete(mechanism, ident.Log.from_arrays("run", t, columns))
    fit = ident.identify(mechanism, motion)
    assert max(error.relative for error in fit.train.values()) < 1e-4


def test_a_real_passive_freedom_stays_an_error(load):
    mechanism = load(ankle(passive_toe=True))
    assert mechanism.degrees_of_freedom == 3
    assert len(mechanism.idle) == 2
    t = np.linspace(0, 2, 200)
    columns = {f"{kind}.m_{side}": np.sin(t) for kind in ("q", "tau") for side in SIDES}
    with pytest.raises(MotionError, match=r"q\.toe_joint"):
        ident.complete(mechanism, ident.Log.from_arrays("run", t, columns))


def test_the_written_folder_holds_the_same_angles(load, tmp_path):
    mechanism = load(ankle())
    folder = tmp_path / "out"
    folder.mkdir()
    for name, content in understood_files(mechanism).items():
        (folder / name).write_bytes(content)
    again = ident.load(folder)
    assert again.locked == mechanism.locked
    assert again.unknown == mechanism.unknown
    np.testing.assert_allclose(again.assembled, mechanism.assembled, atol=1e-6)
