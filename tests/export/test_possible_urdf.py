"""identified.urdf: bodies that a simulator takes, torques within the noise of the fit's."""

import json

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from lxml import etree
from public_robots import noisy_log, public_robot

import ident
from ident.fit.files import identified_urdf
from ident.mechanism.parameters import COUNT, pseudo_inertia


def loaded(urdf: bytes) -> mujoco.MjModel:
    robot = etree.fromstring(urdf)
    etree.strip_elements(robot, "visual", "collision", with_tail=False)  # no meshes here
    return mujoco.MjModel.from_xml_string(etree.tostring(robot).decode())


def impossible(pi: np.ndarray) -> bool:
    return any(np.linalg.eigvalsh(pseudo_inertia(one))[0] < 0 for one in pi.reshape(-1, COUNT))


@pytest.mark.parametrize("name", ["pendulum", "slider_crank"])
def test_links_that_move_without_mass_get_the_least_body(name, robots):
    """Frames of a universal joint and of absolute coordinates: the torques are as they were."""
    mechanism = ident.load(robots / name)
    fit = ident.identify(mechanism, ident.complete(mechanism, robots / name / "run.csv"))
    least, urdf = fit.least_bodies, identified_urdf(fit)
    model = loaded(urdf)
    massless = {link.get("name") for link in etree.parse(mechanism.urdf).iter("link")
                if link.find("inertial") is None} & {*mechanism.bodies.links}  # fmt: skip
    assert {*least.links} == massless
    assert all(0 < model.body(link).mass[0] == least.mass for link in least.links)
    assert all(link.encode() in urdf.partition(b"<link")[0] for link in least.links)
    # the torques of the file, by Pinocchio's own reading of it, in the loop's own coordinates
    exact = identified_urdf(fit, possible=False)
    changed, given = (pin.buildModelFromXML(text.decode()) for text in (urdf, exact))
    data, own, e = changed.createData(), given.createData(), fit.motion.experiments[0]
    d = len(e.independent)
    change = [
        e.pinv[k, :, -d:].T
        @ (pin.rnea(changed, data, e.q[k], e.v[k], e.a[k])
           - pin.rnea(given, own, e.q[k], e.v[k], e.a[k]))
        for k in np.flatnonzero(e.usable)[::7]
    ]  # fmt: skip
    rms = np.sqrt(np.mean(np.square(change), axis=0))
    nearest = 0.0 if fit.possible is None else max(fit.possible.difference.values())
    np.testing.assert_allclose(rms, [*least.difference.values()], rtol=0.1, atol=2 * nearest + 1e-5)
    size = np.sqrt(np.mean(e.tau**2)) if e.tau.size else 1.0  # exact logs
    assert max(least.difference.values()) < 1e-5 * size


def test_a_base_that_cannot_be_has_no_inertia(tmp_path, robots):
    """A flat rod of 1 mg, as public files have it at their root: MuJoCo refuses it."""
    flat = (
        b'<inertial><mass value="1e-6"/><inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0"'
        b' izz="3e-6"/></inertial>'
    )
    text = (robots / "arm" / "arm.urdf").read_bytes()
    assert b'<link name="world"/>' in text
    file = tmp_path / "arm.urdf"
    file.write_bytes(
        text.replace(b'<link name="world"/>', b'<link name="world">' + flat + b"</link>")
    )
    mechanism = ident.load(file)
    fit = ident.identify(mechanism, ident.complete(mechanism, robots / "arm" / "run.csv"))
    assert loaded(identified_urdf(fit)).nv == 4
    assert flat in identified_urdf(fit, possible=False)


@pytest.mark.parametrize("name", ["arm", "four_bar", "five_bar"])
def test_mujoco_takes_the_shipped_robots(name, robots):
    mechanism = ident.load(robots / name).with_effect("viscous").with_effect("coulomb")
    fit = ident.identify(mechanism, ident.complete(mechanism, robots / name / "run.csv"))
    assert impossible(fit.dynamic_parameters) == (fit.possible is not None)
    loaded(identified_urdf(fit))


@pytest.mark.parametrize("name", ["ur5", "panda"])
def test_public_robots_keep_their_torques_within_the_noise(name, tmp_path):
    mechanism = ident.load(public_robot(name, tmp_path / name))
    motion = ident.complete(mechanism, noisy_log(mechanism, name, {}))
    fit = ident.identify(mechanism, motion)
    assert fit.possible is not None
    path = fit.write_urdf(tmp_path / "identified.urdf")
    loaded(path.read_bytes())
    # the torques of the file, by Pinocchio's own reading of it
    (tmp_path / name / f"{name}.urdf").write_bytes(path.read_bytes())
    changed = ident.load(tmp_path / name)
    model = pin.buildModelFromUrdf(str(path))
    if model.nv != mechanism.model.nv:  # with fingers, which are held here
        model = changed.model
    data = model.createData()
    e = motion.experiments[0]
    tau = np.array([pin.rnea(model, data, *x) for x in zip(e.q, e.v, e.a, strict=True)])
    (own,) = fit.predict()
    rms = np.sqrt(np.mean((tau - own.predicted)[e.usable] ** 2, axis=0))
    for i, joint in enumerate(motion.independent):
        assert rms[i] < 0.5 * fit.train[joint].rms
        assert rms[i] == pytest.approx(fit.possible.difference[joint], rel=0.3)
    assert not fit.possible.findings


def test_real_robots_are_taken(shared_data):
    for place, log in (("staubli_tx40/tx40.urdf", "staubli_tx40/tx40.csv"),
                       ("kuka_kr300", "kuka_kr300/A.csv")):  # fmt: skip
        mechanism = ident.load(shared_data / place).with_effect("viscous").with_effect("coulomb")
        fit = ident.identify(mechanism, ident.complete(mechanism, shared_data / log))
        assert len(fit.possible.links) == 6
        loaded(identified_urdf(fit))


def test_a_change_beyond_the_error_is_said(robots):
    """Known torques without noise: whatever possible bodies change is more than the fit leaves."""
    mechanism = ident.load(robots / "arm").with_effect("viscous").with_effect("coulomb")
    fit = ident.identify(mechanism, ident.complete(mechanism, robots / "arm" / "run.csv"))
    beyond = {j for j, rms in fit.possible.difference.items() if rms > fit.possible.residual[j]}
    named = {j for each in fit.possible.findings for j in each.where}
    assert named == beyond


def test_both_are_in_fit_json_and_read_back(robots, tmp_path):
    mechanism = ident.load(robots / "arm")
    fit = ident.identify(mechanism, ident.complete(mechanism, robots / "arm" / "run.csv"))
    fit.write(tmp_path)
    data = json.loads((tmp_path / "fit.json").read_text())
    assert set(data["possible"]["parameters"]) == set(fit.columns.names)
    saved = ident.read_fit(tmp_path, mechanism)
    assert impossible(saved.point.pi)
    assert not impossible(saved.possible.pi)
    np.testing.assert_allclose(saved.possible.pi, fit.problem.point_at(fit.possible.x).pi)
    # the folder for further logs keeps the fit's own torques
    known = ident.load(tmp_path / "identified")
    model, data = known.model, known.model.createData()
    q = np.full(model.nq, 0.3)
    one = pin.rnea(model, data, q, q, q)
    from ident.mechanism.parameters import rigid_forces

    other = rigid_forces(mechanism.model, q[None], q[None], q[None], fit.dynamic_parameters)[0]
    np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-6)
