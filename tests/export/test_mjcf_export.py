"""MuJoCo models: every parameter through the file and back, and the motion of the machine."""

import difflib
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from every_effect import every_effect
from public_robots import public_robot

import ident
from ident.export.export import export
from ident.export.fitted import FIT_DURATION, bare, error_of, exact_motion, fit_numbers
from ident.export.laws import felt_inertia, nominal_motion
from ident.export.machine import machine_of
from ident.export.mjcf import WORDS, Numbers, spring_of, write_mjcf
from ident.export.target import Job, translated
from ident.log import Log

KINDS = ("viscous", "coulomb", "rotor_inertia")


def machine(robots, name):
    mechanism = ident.load(robots / name)
    labels = {effect.label for effect in mechanism.effects}
    for kind in KINDS:
        for joint in mechanism.driven:
            if f"{kind}:{joint}" not in labels:
                mechanism = mechanism.with_effect(f"{kind}:{joint}")
    random = np.random.default_rng(5)
    values = {n: float(random.uniform(0.03, 0.15)) for e in mechanism.effects for n in e.names}
    return mechanism, values


@pytest.mark.parametrize("name", ["arm", "four_bar", "five_bar", "slider_crank"])
def test_every_parameter_through_the_file_and_back(name, robots, tmp_path):
    mechanism, values = machine(robots, name)
    made = export(mechanism, "mjcf", values=values, fitted=False, out=tmp_path / "x.xml")
    (path,) = made.write()
    assert made.lost == ()
    model = mujoco.MjModel.from_xml_path(str(path))
    for joint in mechanism.driven:
        at = model.joint(joint).dofadr[0]
        assert model.dof_damping[at] == pytest.approx(values[f"viscous.{joint}.Fv"], rel=1e-9)
        assert model.dof_frictionloss[at] == pytest.approx(values[f"coulomb.{joint}.Fc"], rel=1e-9)
        assert model.dof_armature[at] == pytest.approx(
            values[f"rotor_inertia.{joint}.Ia"], rel=1e-9
        )
    again = ident.load(path)
    heavy = [link.name for link in made.machine.links if not link.body.none]
    for link in heavy:
        own, new = (m.prior[m.bodies.columns(link)] for m in (mechanism, again))
        np.testing.assert_allclose(new, own, rtol=1e-9, atol=1e-9 * np.abs(own).max())
    np.testing.assert_allclose(again.model.gravity.linear, mechanism.model.gravity.linear)
    assert again.degrees_of_freedom == mechanism.degrees_of_freedom


def test_every_effect_through_the_file_and_back(robots):
    """MuJoCo's inverse dynamics of the file are the torques of the model with all effects."""
    mechanism, values, states = every_effect(robots)
    made = export(mechanism, "mjcf", values=values, fitted=False)
    assert made.lost == ()
    model = mujoco.MjModel.from_xml_string(made.text)
    data = mujoco.MjData(model)
    for q, v, a, tau in states:
        for i, joint in enumerate(mechanism.driven):
            at = model.joint(joint)
            data.qpos[at.qposadr], data.qvel[at.dofadr], data.qacc[at.dofadr] = q[i], v[i], a[i]
        mujoco.mj_inverse(model, data)
        for i, joint in enumerate(mechanism.driven):
            force, drive = data.qfrc_inverse[model.joint(joint).dofadr[0]], model.actuator(joint)
            control = (force - drive.biasprm[0]) / (drive.gainprm[0] or 1.0)
            assert control == pytest.approx(tau[i], rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(("name", "most"), [("arm", 1e-4), ("four_bar", 1e-3)])
def test_another_motion_than_the_fitted_one(name, most, robots):
    mechanism, values = machine(robots, name)
    made = export(mechanism, "mjcf", values=values)
    (e,) = nominal_motion(bare(made.machine)).experiments
    columns = {f"q.{j}": e.y[::-1, mechanism.joint_index[j]] for j in mechanism.driven}
    other = exact_motion(made.machine, Log.from_arrays("other", e.t, columns))
    text = made.text.encode()
    errors = error_of(text, made.translation.laws, made.machine, other)
    assert max(errors.values()) < most


# a heavy frame that tilts, with a light crank on it that drives a toggle and a ram: at 1 ms the
# crank is off by what no friction makes
LINKS = {  # parent, joint, its kind, origin and axis; place and mass of the centre, and inertia
    "frame": ("base", "tilt", "revolute", "0 0 0", "0 -1 0", "-.05 0 .3", 8, ".3 .4 .15"),
    "disc": ("frame", "crank", "revolute", "-.35 0 .35", "0 -1 0", ".02 0 0", .8, "6e-4 .001 6e-4"),
    "rod": ("disc", "big_end", "revolute", ".05 0 0", "0 -1 0", ".22 0 0", 0.6, "2e-4 .01 .01"),
    "upper": ("frame", "top", "revolute", "0 0 .6", "0 -1 0", ".125 0 0", 0.7, "2e-4 38e-4 38e-4"),
    "lower": ("upper", "knee", "revolute", ".25 0 0", "0 -1 0", ".125 0 0", .7, "2e-4 38e-4 38e-4"),
    "body": ("frame", "ram", "prismatic", "0 0 0", "0 0 1", "0 0 -.04", 2.0, ".004 .004 .002"),
}  # fmt: skip
PRESS_TOML = """urdf = "press.urdf"
[joints]
passive = ["big_end", "top", "knee", "ram"]
start = { big_end = 0.05, top = -1.0, knee = -1.1, ram = 0.17 }
[[closure]]
name = "knee_pin"
kind = "point"
a = { link = "rod", xyz = [0.45, 0, 0] }
b = { link = "upper", xyz = [0.25, 0, 0] }
axes = "xz"
[[closure]]
name = "ram_pin"
kind = "point"
a = { link = "lower", xyz = [0.25, 0, 0] }
b = { link = "body", xyz = [0, 0, 0] }
axes = "xz"
"""


def press(folder):
    """The press, and the values of its friction and of the spring of its ram."""
    text = '<robot name="press"><link name="base"/>'
    for link, (parent, joint, kind, origin, axis, centre, mass, inertia) in LINKS.items():
        xx, yy, zz = inertia.split()
        text += (
            f'<link name="{link}"><inertial><origin xyz="{centre}"/><mass value="{mass}"/>'
            f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="{joint}" type="{kind}"><parent link="{parent}"/><child link="{link}"/>'
            f'<origin xyz="{origin}"/><axis xyz="{axis}"/>'
            '<limit lower="-9" upper="9" velocity="9" effort="99"/></joint>'
        )
    folder.mkdir()
    (folder / "press.urdf").write_text(f"{text}</robot>")
    (folder / "mechanism.toml").write_text(PRESS_TOML)
    mechanism = ident.load(folder).with_effect("spring:ram")
    values = {"spring.ram.k": 400.0, "spring.ram.b": -80.0}
    for joint, Fc, Fv in (("tilt", 1.5, 0.8), ("crank", 0.12, 0.03)):
        mechanism = mechanism.with_effect(f"coulomb:{joint}").with_effect(f"viscous:{joint}")
        values |= {f"coulomb.{joint}.Fc": Fc, f"viscous.{joint}.Fv": Fv}
    return mechanism, values


def test_no_joint_moves_worse_for_the_sake_of_another(tmp_path):
    """Friction of the heavy frame was fitted to the light crank, with 8 times the frame's error."""
    mechanism, values = press(tmp_path / "press")
    (e,) = nominal_motion(mechanism).experiments
    columns = {f"q.{j}": e.y[::-1, mechanism.joint_index[j]] for j in mechanism.driven}
    errors = []
    reference = Log.from_arrays("other", e.t, columns)
    other = exact_motion(machine_of(mechanism, values), reference, 2.0)
    for fitted in (False, True):
        made = export(mechanism, "mjcf", values=values, fitted=fitted)
        laws = made.translation.laws
        errors.append(error_of(made.text.encode(), laws, made.machine, other))
    physical, written = errors
    assert all(written[joint] < 1.2 * x + 1e-6 for joint, x in physical.items())
    assert laws["tilt"].coulomb == pytest.approx(1.5, rel=0.02)


def test_the_note_states_the_motion_that_was_not_fitted(robots):
    """Stribeck friction, which MuJoCo lacks, has fitted numbers in its place."""
    mechanism, values = machine(robots, "four_bar")
    inertia = felt_inertia(machine_of(mechanism, values))["crank"]
    values |= {"viscous.crank.Fv": 1.5 * inertia, "coulomb.crank.Fc": 3 * inertia}
    mechanism = mechanism.with_effect("stribeck:crank")
    values |= {"stribeck.crank.Fs": 4 * inertia, "stribeck.crank.vs": 0.1}
    machine_ = machine_of(mechanism, values)
    translation = translated(Job(machine_, None, Path("x.xml")), WORDS)
    exact = exact_motion(machine_)
    numbers = Numbers(1e-3, 2e-3)
    fit = fit_numbers(translation, numbers, exact)
    _, test = exact.parts(FIT_DURATION)
    measured = [
        error_of(write_mjcf(x, n), x.laws, machine_, test)["crank"]
        for x, n in ((translation, numbers), (fit.translation, fit.numbers))
    ]
    assert fit.errors == {"crank": pytest.approx(tuple(measured))}
    assert measured[1] < 0.8 * measured[0]
    (note,) = fit.notes
    before, after = (f"crank {1e3 * x:.2g} mrad" for x in measured)
    assert f"off by {after} instead of {before} rms" in note


def test_numbers_of_joints_that_gain_nothing_stay_physical(robots):
    mechanism, values = machine(robots, "arm")
    mechanism = mechanism.with_effect("stribeck:shoulder")
    values |= {"stribeck.shoulder.Fs": 0.5, "stribeck.shoulder.vs": 0.2}
    machine_ = machine_of(mechanism, values)
    translation = translated(Job(machine_, None, Path("x.xml")), WORDS)
    fit = fit_numbers(translation, Numbers(1e-3, 2e-3), exact_motion(machine_))
    assert set(fit.physical) == {*mechanism.driven} - {"shoulder"}
    before, after = fit.errors["shoulder"]
    assert after < 0.8 * before
    for joint in fit.physical:
        assert fit.translation.laws[joint] == translation.laws[joint]
        assert fit.errors[joint][1] < 1.1 * fit.errors[joint][0] + 1e-6
    assert f"physical values of {', '.join(fit.physical)} stay" in fit.notes[0]


def test_a_polynomial_of_the_position_is_mujocos():
    stiffness, rest = spring_of((0.3, -1.2, 0.4, 2.0))
    q = np.linspace(-1, 1, 9)
    x = q - rest
    wanted = 0.3 - 1.2 * q + 0.4 * q**2 + 2.0 * q**3
    np.testing.assert_allclose(sum(k * x ** (i + 1) for i, k in enumerate(stiffness)), wanted)


LIKE = """<mujoco model="one">
  <!-- kept -->
  <worldbody>
    <body name="l" pos="0 0 1">
      <joint name="j" axis="0 1 0" damping="0.5"   range="-90 90"/>  <!-- a joint -->
      <inertial pos="0 0 .2" mass="2" diaginertia=".1 .1 .01"/>
      <geom type="sphere" size=".1"/>
      <body name="tip" pos="0 0 .4">
        <inertial pos="0 0 0" mass=".1" diaginertia=".01 .01 .01"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="j"/>
  </actuator>
</mujoco>
"""


def changed_lines(before, after):
    both = difflib.ndiff(before.splitlines(), after.splitlines())
    return [line for line in both if line[:1] in "+-"]


def test_like_changes_only_the_lines_that_change(tmp_path):
    path = tmp_path / "one.xml"
    path.write_text(LIKE)
    mechanism = ident.load(path)
    effects = ["viscous:j", "coulomb:j", "spring:j"]
    for effect in effects:
        mechanism = mechanism.with_effect(effect)
    values = {"viscous.j.Fv": 0.5, "coulomb.j.Fc": 0.0, "spring.j.k": 0.0, "spring.j.b": 0.0}

    def made(**more):
        given = {**values, **more}
        return export(mechanism, "mjcf", like=path, values=given, fitted=False,
                      out=tmp_path / "new.xml").text  # fmt: skip

    assert made() == LIKE
    text = made(**{"spring.j.k": 2.0, "spring.j.b": -1.0, "coulomb.j.Fc": 0.25})
    lines = changed_lines(LIKE, text)
    assert len(lines) == 2
    assert all("<joint" in line for line in lines)
    assert "<!-- a joint -->" in text
    model = mujoco.MjModel.from_xml_string(text)
    assert model.qpos_spring[0] == pytest.approx(0.5)  # in degrees in the file
    heavier = made(**{"l.m": 3.0})
    assert [line for line in changed_lines(LIKE, heavier) if "<inertial" not in line] == []
    own = mujoco.MjModel.from_xml_string(heavier)
    assert own.body_mass.sum() == pytest.approx(3.0)


FLOATING = """<mujoco model="two">
  <asset><mesh name="m" file="missing.stl"/></asset>
  <worldbody>
    <body name="base" pos="0 0 1" quat="1 0 0 0.3">
      <freejoint/>
      <inertial pos="0 0 .2" mass="2" diaginertia=".1 .1 .01"/>
      <geom type="mesh" mesh="m"/>
      <body name="leg" pos="0 0.1 0" quat="0.707107 0.707107 0 0">
        <inertial pos="0 0 -.2" mass="1" diaginertia=".02 .02 .001"/>
        <joint axis="0 1 0"/>
        <body name="foot" pos="0 0 -.4">
          <inertial pos="0 0 0" mass=".2" diaginertia=".001 .001 .001"/>
          <joint name="ankle" type="ball"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="leg_joint"/></actuator>
</mujoco>
"""


def test_like_of_a_floating_machine_with_nameless_joints_and_missing_meshes(tmp_path):
    path = tmp_path / "two.xml"
    path.write_text(FLOATING.replace('joint="leg_joint"', 'jointinparent="ankle"'))
    mechanism = ident.load(path)
    assert export(mechanism, "mjcf", like=path, out=tmp_path / "x.xml", fitted=False).text == (
        path.read_text()
    )
    heavier = {f"{link}.m": x for link, x in (("base", 3.0), ("leg", 1.5), ("foot", 0.25))}
    made = export(
        mechanism.with_effect("viscous:leg_joint"), "mjcf", like=path, fitted=False,
        values={**heavier, "viscous.leg_joint.Fv": 0.5}, out=tmp_path / "x.xml",
    )  # fmt: skip
    lines = changed_lines(path.read_text(), made.text)
    assert len(lines) == 8
    assert all("<inertial" in x or "<joint axis" in x for x in lines)
    (out,) = made.write()
    again = ident.load(out)
    for name, mass in heavier.items():
        at = again.bodies.columns(name.partition(".")[0])
        assert again.prior[at][0] == pytest.approx(mass, rel=1e-12)


def test_like_with_other_names_says_the_nearest(tmp_path):
    path = tmp_path / "one.xml"
    path.write_text(LIKE)
    mechanism = ident.load(path)
    other = tmp_path / "other.xml"
    other.write_text(LIKE.replace('="j"', '="J"'))
    with pytest.raises(ident.MechanismError, match="nearest: j → J"):
        export(mechanism, "mjcf", like=other, out=tmp_path / "new.xml")


def test_what_cannot_be_said_has_its_size(robots):
    mechanism, values = machine(robots, "arm")
    mechanism = mechanism.with_effect("ripple:elbow")
    ripple = {"ripple.elbow.A": 0.3, "ripple.elbow.B": 0.4, "ripple.elbow.N": 9.0}
    made = export(mechanism, "mjcf", values={**values, **ripple}, fitted=False)
    (lost,) = made.lost
    assert (lost.label, lost.where) == ("ripple:elbow", "elbow")
    assert lost.largest <= 0.55
    assert lost.before == pytest.approx(0.5 / np.sqrt(2), rel=0.2)


def test_what_a_link_does_on_its_own_is_listed_with_its_angle(robots):
    mechanism, values = machine(robots, "arm")
    for label in ("elasticity:elbow", "backlash:shoulder", "position_friction:elbow"):
        mechanism = mechanism.with_effect(label)
    soft = {
        "elasticity.elbow.compliance": 0.01, "elasticity.elbow.damping": 0.5,
        "backlash.shoulder.width": 0.02, "position_friction.elbow.F1": 0.1,
        "position_friction.elbow.F2": 0.0,
    }  # fmt: skip
    made = export(mechanism, "mjcf", values={**values, **soft}, fitted=False)
    lost = {each.label: each for each in made.lost}
    assert lost["backlash:shoulder"].position == pytest.approx(0.01)
    assert 1e-3 < lost["elasticity:elbow"].position < 0.2  # a load of 0.1 to 20 N m
    assert lost["position_friction:elbow"].torque > 0


def test_urdf_says_two_numbers_and_lists_the_rest(robots, tmp_path):
    mechanism, values = machine(robots, "arm")
    made = export(mechanism, "urdf", values=values, out=tmp_path / "x.urdf")
    assert {each.label for each in made.lost} == {f"rotor_inertia:{j}" for j in mechanism.driven}
    source = mechanism.urdf.read_text()
    lines = changed_lines(source, made.text)
    assert all("<dynamics" in line for line in lines)
    assert len(lines) == len(mechanism.driven)


def test_a_transmission_names_its_joint_again(robots, tmp_path):
    mechanism = ident.load(robots / "arm")
    text = mechanism.urdf.read_text()
    again = '<transmission name="t"><joint name="elbow"/></transmission></robot>'
    (tmp_path / "arm.urdf").write_text(text.replace("</robot>", again))
    mechanism = ident.load(tmp_path / "arm.urdf").with_effect("viscous:elbow")
    made = export(mechanism, "urdf", values={"viscous.elbow.Fv": 0.7}, out=tmp_path / "x.urdf")
    root = ElementTree.fromstring(made.text)
    (dynamics,) = root.iter("dynamics")
    assert dynamics.get("damping") == "0.7"
    assert dynamics in list(next(x for x in root.findall("joint") if x.get("name") == "elbow"))


def test_loops_are_refused_where_there_are_none(robots):
    mechanism, values = machine(robots, "four_bar")
    with pytest.raises(ident.MechanismError, match="export to mjcf or c"):
        export(mechanism, "urdf", values=values)


def test_public_robots(tmp_path):
    for name in ("ur5", "panda"):
        mechanism = ident.load(public_robot(name, tmp_path / name))
        text = export(mechanism, "mjcf", fitted=False).text
        model = mujoco.MjModel.from_xml_string(text)
        assert model.nv == mechanism.model.nv


def test_a_servo_arm_follows_the_commands_of_a_log(robots):
    """With its delay from the first step of each window on: 12 to 63 mrad without."""
    mechanism = ident.load(robots / "servo_arm")
    planted = {  # of robots/servo_arm/README.md; kd with viscous friction, the delay with a hold
        "yaw": (20.0, 0.5, 0.12, 0.012), "shoulder": (25.0, 0.62, 0.15, 0.014),
        "elbow": (14.0, 0.31, 0.08, 0.008),
    }  # fmt: skip
    names = ("servo.{}.kp", "servo.{}.kd", "coulomb.{}.Fc", "rotor_inertia.{}.Ia")
    values = {name.format(joint): x for joint, numbers in planted.items()
              for name, x in zip(names, numbers, strict=True)}  # fmt: skip
    values["command_delay.yaw,shoulder,elbow.d"] = 0.0084
    log = ident.read_log(robots / "servo_arm" / "other.csv")
    part = Log.from_arrays("part", log.t[:600], {n: x[:600] for n, x in log.columns.items()})
    made = export(mechanism, "mjcf", values=values, log=part, replayed=True, fitted=False)
    (run,) = made.replays.runs["MuJoCo"]
    assert max(error.rms for error in run.errors.values()) < 2e-3
    assert dict(made.fixed)["servo:elbow"] == "a position actuator"


def test_a_step_too_long_for_the_drive(robots):
    mechanism, values = machine(robots, "arm")
    mechanism = mechanism.with_effect("servo:wrist")
    drive = {"servo.wrist.kp": 500.0, "servo.wrist.kd": 1.0}
    with pytest.raises(ident.IdentError, match=r"at most --step"):
        export(mechanism, "mjcf", values={**values, **drive}, step=0.05, fitted=False)


def test_unknown_targets_settings_and_files(robots, tmp_path):
    mechanism, values = machine(robots, "arm")
    for arguments, text in (
        ({"to": "mjfc"}, "mjcf"),
        ({"to": "mjcf", "speed": 3}, "no setting 'speed'"),
        ({"to": "mjcf", "step": 0.0}, "between 0 and 1"),
        ({"to": "mjcf", "like": tmp_path / "no.xml"}, "no such file"),
        ({"to": "mjcf", "values": {"viscous.elbow.Fw": 1.0}}, "no parameter"),
        ({"to": "mjcf", "without": ["payload:tool"]}, "no effect"),
    ):
        with pytest.raises(ident.IdentError, match=text):
            export(mechanism, **{"values": values, **arguments})


def test_a_public_urdf_that_says_the_same_is_the_same(tmp_path):
    mechanism = ident.load(public_robot("panda", tmp_path / "panda"))
    path = tmp_path / "panda" / "panda.urdf"
    out = tmp_path / "new.urdf"
    assert export(mechanism, "urdf", like=path, out=out).text == path.read_text()
    heavier = {"panda_link3.m": 4.0}
    text = export(mechanism, "urdf", like=path, out=out, values=heavier).text
    lines = changed_lines(path.read_text(), text)
    assert 0 < len(lines) <= 6
    assert all("<mass" in x or "<inertia" in x or "<origin" in x for x in lines)
