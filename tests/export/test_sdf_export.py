"""SDF models, read back by Drake's own reader of SDF."""

import numpy as np
import pinocchio as pin
import pytest
from lxml import etree

import ident
from ident.export.export import export
from ident.export.laws import nominal_motion


def described(robots, name, values=None):
    mechanism = ident.load(robots / name)
    for joint in mechanism.driven:
        for kind in ("viscous", "coulomb", "spring"):
            if f"{kind}:{joint}" not in {e.label for e in mechanism.effects}:
                mechanism = mechanism.with_effect(f"{kind}:{joint}")
    numbers = {n: 0.1 + 0.01 * i for e in mechanism.effects for i, n in enumerate(e.names)}
    return mechanism, numbers


def test_masses_are_pinocchios(robots):
    parsing = pytest.importorskip("pydrake.multibody.parsing")
    from pydrake.multibody.plant import MultibodyPlant

    mechanism, numbers = described(robots, "arm")
    made = export(mechanism, "sdf", values=numbers)
    plant = MultibodyPlant(0.0)
    parsing.Parser(plant).AddModelsFromString(made.text, "sdf")
    plant.Finalize()
    context = plant.CreateDefaultContext()
    q = np.random.default_rng(0).normal(size=plant.num_positions())
    order = [plant.GetJointByName(link.joint.name).position_start() for link in made.machine.links]
    given = np.zeros_like(q)
    given[order] = q
    plant.SetPositions(context, given)
    M = plant.CalcMassMatrix(context)[np.ix_(order, order)]
    own = pin.crba(mechanism.model, mechanism.model.createData(), q)
    np.testing.assert_allclose(M, np.triu(own) + np.triu(own, 1).T, atol=1e-9)


def test_dynamics_and_loops_are_said(robots):
    mechanism, numbers = described(robots, "four_bar")
    root = etree.fromstring(export(mechanism, "sdf", values=numbers).text.encode())
    joints = {joint.get("name"): joint for joint in root.iter("joint")}
    crank = joints["crank"].find("axis/dynamics")
    assert float(crank.findtext("damping")) == numbers["viscous.crank.Fv"]
    assert float(crank.findtext("friction")) == numbers["coulomb.crank.Fc"]
    assert float(crank.findtext("spring_stiffness")) == numbers["spring.crank.k"]
    loops = [j for name, j in joints.items() if name.endswith("_closure")]
    assert len(loops) == len(mechanism.closures)
    assert all(j.get("type") in ("ball", "revolute") for j in loops)


def test_a_tilted_gravity_is_lost_with_its_torque(robots):
    """The torque at the crank is the derivative of the bodies' potential energy along the loop."""
    mechanism = ident.load(robots / "four_bar").with_effect("gravity_tilt")
    values = {name: 0.0 for effect in mechanism.effects for name in effect.names}
    made = export(mechanism, "sdf", values=values | {"gravity_tilt.y": 0.1})
    (lost,) = made.lost
    assert (lost.label, lost.where) == ("gravity_tilt", "crank")
    assert "gravity_tilt" not in dict(made.fixed)
    (e,) = nominal_motion(mechanism).experiments
    model, change = mechanism.model, np.zeros(len(e.y))
    data = model.createData()
    tilted = made.machine.gravity - mechanism.model.gravity.linear
    mass = sum(inertia.mass for inertia in model.inertias)
    for k, q in enumerate(e.y[:, : model.nq]):
        change[k] = -mass * tilted @ pin.centerOfMass(model, data, np.ascontiguousarray(q))
    crank = mechanism.joint_index["crank"]
    speed = e.yd[:, crank]
    moving = (np.abs(speed) > 0.2 * np.abs(speed).max()) & e.usable
    moving[[0, -1]] = False
    torque = (np.gradient(change, e.t) / np.where(moving, speed, 1.0))[moving]
    assert lost.largest == pytest.approx(np.abs(torque).max(), rel=0.05)
    assert lost.torque == pytest.approx(np.sqrt(np.mean(torque**2)), rel=0.2)
