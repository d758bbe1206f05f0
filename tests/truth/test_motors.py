"""Motors that do not sit at the joints, against the inverse dynamics of Pinocchio."""

import numpy as np
import pytest
from motor_logs import MACHINES, SUM

import ident
from ident.assess.check import data_findings
from ident.errors import MechanismError
from ident.log import Log

PALLETIZER = MACHINES["palletizer"]
TOML = """urdf = "arm.urdf"
[motors]
j2 = "j2"
m3 = "j2 + j3"
[log]
"q.m3" = "q.j3"
"tau.m3" = "tau.j3"
"""
COMMON = ("viscous", "coulomb", "rotor_inertia")


def folder(tmp_path, machine=PALLETIZER, toml=TOML, off=0.15):
    (tmp_path / "arm.urdf").write_text(machine.urdf(off))
    (tmp_path / "mechanism.toml").write_text(toml)
    return tmp_path


def run_of(machine, seed):
    columns = machine.log(seed)
    return Log.from_arrays("run", columns.pop("t"), columns)


def with_common(mechanism):
    for kind in COMMON:
        mechanism = mechanism.with_effect(kind)
    return mechanism


def test_friction_and_rotors_of_motors_are_fitted_and_named_as_theirs(tmp_path):
    # rotors are separable only where bodies are known
    mechanism = ident.load(folder(tmp_path, toml=TOML + "[parameters]\nunknown = []\n", off=0.0))
    mechanism = with_common(mechanism).with_calibration("exact")
    fit = ident.identify(mechanism, ident.complete(mechanism, run_of(PALLETIZER, 1)))
    values = {p.name: p for effect in fit.effects for p in effect.parameters}
    names = ("j1", "j2", "m3")
    for kind, name, truth in (
        ("viscous", "Fv", PALLETIZER.Fv), ("coulomb", "Fc", PALLETIZER.Fc),
        ("rotor_inertia", "Ia", PALLETIZER.Ia),
    ):  # fmt: skip
        for motor, planted in zip(names, truth, strict=True):
            p = values[f"{kind}.{motor}.{name}"]
            assert abs(p.value - planted) < 4 * p.stderr < 0.2 * planted, p


def test_motions_and_torques_are_those_of_the_matrix(tmp_path):
    mechanism = ident.load(folder(tmp_path))
    log = run_of(PALLETIZER, 2)
    state = ident.complete(mechanism, log).experiments[0]
    at = mechanism.joint_index
    m = np.stack([state.y[:, at[name]] for name in ("j1", "j2", "m3")], axis=1)
    q = np.stack([state.y[:, at[name]] for name in ("j1", "j2", "j3")], axis=1)
    assert np.abs(m - q @ SUM.T).max() < 1e-9
    assert mechanism.driven == ("j1", "j2", "m3")
    assert mechanism.passive == ("j3",)
    assert mechanism.degrees_of_freedom == 3


def test_nothing_is_missing_once_the_motors_are_stated(tmp_path):
    mechanism = ident.load(folder(tmp_path))
    motion = ident.complete(mechanism, run_of(PALLETIZER, 3))
    diagnosis = ident.diagnose(ident.identify(with_common(mechanism), motion))
    assert diagnosis.verdict == "nothing"


def test_a_bearing_that_one_motor_turns_is_no_candidate_beside_it(tmp_path):
    toml = 'urdf = "arm.urdf"\n[motors]\nm2 = "9.5 * j2"\n'
    mechanism = ident.load(folder(tmp_path, toml=toml))
    sites = {x for effect in mechanism.candidates() for x in effect.joints}
    assert "m2" in sites
    assert not sites & {"j2", "m2_rotor"}


def test_results_are_written_and_read_again(tmp_path):
    mechanism = with_common(ident.load(folder(tmp_path))).without("rotor_inertia:j1")
    motion = ident.complete(mechanism, run_of(PALLETIZER, 4))
    ident.identify(mechanism, motion).write(tmp_path / "fit")
    again = ident.load(tmp_path / "fit" / "identified")
    fit = ident.identify(again, ident.complete(again, run_of(PALLETIZER, 4)))
    assert again.driven == mechanism.driven
    assert max(fit.relative.values()) < 0.02


@pytest.mark.parametrize(
    ("kind", "lines"),
    [
        ("palletizer", 'm_j3 = "j2 + j3"'), ("difference", 'm_j3 = "-j2 + j3"'),
        ("differential", 'm_j2 = "j2 + j3" and m_j3 = "j2 - j3"'), ("belt", 'm_j2 = "2.'),
        ("none", ""), ("wrist", ""),
    ],
)  # fmt: skip
def test_a_log_of_motors_is_told_from_one_of_joints(tmp_path, kind, lines):
    machine = MACHINES[kind]
    (tmp_path / "arm.urdf").write_text(machine.urdf(0.15))
    mechanism = ident.load(tmp_path / "arm.urdf")
    findings = data_findings(mechanism, ident.complete(mechanism, run_of(machine, 100)))
    named = [x.remedy for x in findings if x.code == "motors"]
    assert len(named) == bool(lines)
    assert all(lines in remedy and '[log] "q.m_j' in remedy for remedy in named)


@pytest.mark.parametrize(
    ("rows", "word"),
    [
        ('m3 = "j2 + j3"', r'2 joints \(j2, j3\)'),
        ('m2 = "j2 + j3"\nm3 = "2 * j2 + 2 * j3"', "singular"),
        ('m3 = "j2 + j9"', "no joint 'j9'"), ('m3 = "j2-j9"', "no joint 'j9'"),
        ('j3 = "j2 + j3"', "m_j3"),
        ('m3 = "j2 +* j3"', "no sum of joints"), ("m3 = 4", "write m3"),
        ("m3 = { j3 = 0 }", "leave out"), ('m3 = "j2 / 0"', "divides by 0"),
        ('m3 = "j9-x + j3"', "no joint 'j9-x'"),
        ('m3 = { formula = "j3", kind = "ball" }', "revolute"),
    ],
)  # fmt: skip
def test_bad_motors_are_refused_with_what_is_valid(tmp_path, rows, word):
    with pytest.raises(MechanismError, match=word):
        ident.load(folder(tmp_path, toml=f'urdf = "arm.urdf"\n[motors]\n{rows}\n'))


def test_a_locked_joint_keeps_its_share_in_the_motor(tmp_path):
    mechanism = ident.load(folder(tmp_path), locked={"j2": -0.5})
    assert mechanism.driven == ("j1", "m3")
    q = mechanism.assembled
    at = {joint.name: joint.index for joint in mechanism.joints}
    assert q[at["m3"]] == pytest.approx(q[at["j3"]] - 0.5)


@pytest.mark.parametrize(
    ("formula", "ratios"),
    [
        ("j2-j3", {"j2": 1.0, "j3": -1.0}), ("j2*2 + j3", {"j2": 2.0, "j3": 1.0}),
        ("j2/4 - .5*j3", {"j2": 0.25, "j3": -0.5}), ("3/2 j2 + 2j3", {"j2": 1.5, "j3": 2.0}),
        ("-1e1*j2*3/5+j3", {"j2": -6.0, "j3": 1.0}),
    ],
)  # fmt: skip
def test_sums_are_read_as_they_are_written(tmp_path, formula, ratios):
    toml = f'urdf = "arm.urdf"\n[motors]\nj2 = "j2"\nm3 = "{formula}"\n'
    motor = ident.load(folder(tmp_path, toml=toml)).motors[1]
    assert dict(motor.ratios) == pytest.approx(ratios)


def test_a_hyphen_in_a_joints_name_is_no_minus(tmp_path):
    urdf = PALLETIZER.urdf(0.0).replace('"j3"', '"j2-3"')
    (tmp_path / "arm.urdf").write_text(urdf)
    rows = 'urdf = "arm.urdf"\n[motors]\nj2 = "j2"\nm3 = "j2 - j2-3"\n'
    (tmp_path / "mechanism.toml").write_text(rows)
    assert dict(ident.load(tmp_path).motors[1].ratios) == {"j2": 1.0, "j2-3": -1.0}


def test_fewer_motors_on_tendons_than_joints_are_a_note(tmp_path):
    pytest.importorskip("mujoco")
    inertial = '<inertial pos="0.1 0 0" mass="1" diaginertia=".01 .01 .01"/>'
    (tmp_path / "finger.xml").write_text(
        f"""<mujoco><worldbody><body><joint name="j1" axis="0 1 0"/>{inertial}
        <body pos=".3 0 0"><joint name="j2" axis="0 1 0"/>{inertial}</body></body></worldbody>
        <tendon><fixed name="sum"><joint joint="j1" coef="1"/><joint joint="j2" coef="2"/></fixed>
        </tendon><actuator><motor name="m" tendon="sum"/></actuator></mujoco>"""
    )
    mechanism = ident.load(tmp_path / "finger.xml")
    assert mechanism.motors == ()
    (note,) = [note for note in mechanism.notes if "tendons are left out" in note]
    assert "1 motor for 2 joints (j1, j2)" in note


def test_an_actuator_on_a_tendon_is_a_motor(tmp_path):
    pytest.importorskip("mujoco")
    inertial = '<inertial pos="0.1 0 0" mass="1" diaginertia=".01 .01 .01"/>'
    (tmp_path / "arm.xml").write_text(
        f"""<mujoco><worldbody><body><joint name="j1" axis="0 1 0"/>{inertial}
        <body pos=".3 0 0"><joint name="j2" axis="0 1 0"/>{inertial}</body></body></worldbody>
        <tendon><fixed name="sum"><joint joint="j1" coef="1"/><joint joint="j2" coef="2"/></fixed>
        </tendon><actuator><motor joint="j1"/><motor name="m2" tendon="sum"/></actuator></mujoco>"""
    )
    mechanism = ident.load(tmp_path / "arm.xml")
    assert (mechanism.driven, mechanism.passive) == (("j1", "m2"), ("j2",))
    assert {motor.name: dict(motor.ratios) for motor in mechanism.motors} == {
        "m2": {"j1": 1.0, "j2": 2.0}, "j1": {"j1": 1.0},
    }  # fmt: skip
