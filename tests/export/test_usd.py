"""USD stages, read back by Pixar's library and computed by Pinocchio."""

import numpy as np
import pinocchio as pin
import pytest

import ident
from ident.export.export import export

pxr = pytest.importorskip("pxr")
from pxr import Gf, Usd, UsdGeom, UsdPhysics  # noqa: E402


def stage_of(text):
    stage = Usd.Stage.CreateInMemory()
    assert stage.GetRootLayer().ImportFromString(text)
    return stage


def rotation(quaternion):
    return np.array(Gf.Matrix3d(Gf.Quatd(quaternion))).T


def placement(joint, i):
    position = getattr(joint, f"GetLocalPos{i}Attr")().Get()
    return pin.SE3(
        rotation(getattr(joint, f"GetLocalRot{i}Attr")().Get()), np.array(position, dtype=float)
    )


def model_of(stage, joints):
    """The tree of a stage, written by the schema's own words: body frames at joints' frame 1."""
    model, index = pin.Model(), dict[str, int]()
    scene = next(p for p in stage.Traverse() if p.IsA(UsdPhysics.Scene))
    gravity = UsdPhysics.Scene(scene)
    model.gravity.linear = gravity.GetGravityMagnitudeAttr().Get() * np.array(
        gravity.GetGravityDirectionAttr().Get(), dtype=float
    )
    (base,) = (p for p in stage.Traverse() if p.IsA(UsdPhysics.FixedJoint))
    fixed = str(UsdPhysics.Joint(base).GetBody1Rel().GetTargets()[0])
    after = {fixed: pin.SE3.Identity()}  # of a body's frame in its joint's moving frame
    index[fixed] = 0
    for name in joints:
        prim = next(p for p in stage.Traverse() if p.GetName() == name)
        joint = UsdPhysics.Joint(prim)
        above, body = (
            [str(path) for path in rel.GetTargets()]
            for rel in (joint.GetBody0Rel(), joint.GetBody1Rel())
        )
        (parent,) = above
        kind = pin.JointModelRX() if prim.IsA(UsdPhysics.RevoluteJoint) else pin.JointModelPX()
        at = after[parent] * placement(joint, 0)
        index[body[0]] = model.addJoint(index[parent], kind, at, name)
        after[body[0]] = placement(joint, 1).inverse()
        mass = UsdPhysics.MassAPI(stage.GetPrimAtPath(body[0]))
        axes = rotation(mass.GetPrincipalAxesAttr().Get())
        I = axes @ np.diag(mass.GetDiagonalInertiaAttr().Get()) @ axes.T  # noqa: E741
        inertia = pin.Inertia(
            mass.GetMassAttr().Get(), np.array(mass.GetCenterOfMassAttr().Get(), float), I
        )
        model.appendBodyToJoint(index[body[0]], inertia, after[body[0]])
    return model


def described(robots, name):
    mechanism = ident.load(robots / name)
    for joint in mechanism.driven:
        for kind in ("viscous", "coulomb", "spring", "rotor_inertia"):
            if f"{kind}:{joint}" not in {e.label for e in mechanism.effects}:
                mechanism = mechanism.with_effect(f"{kind}:{joint}")
    numbers = {n: 0.1 + 0.01 * i for e in mechanism.effects for i, n in enumerate(e.names)}
    return mechanism, numbers


def test_torques_are_pinocchios(robots):
    mechanism, numbers = described(robots, "arm")
    made = export(mechanism, "usd", values=numbers)
    names = [link.joint.name for link in made.machine.links]
    model = model_of(stage_of(made.text), names)
    draws = np.random.default_rng(0)
    for _ in range(5):
        q, v, a = draws.normal(size=(3, mechanism.model.nq))
        own = pin.rnea(mechanism.model, mechanism.model.createData(), q, v, a)
        np.testing.assert_allclose(pin.rnea(model, model.createData(), q, v, a), own, atol=2e-5)


def test_laws_are_those_of_physx_in_degrees(robots):
    mechanism, numbers = described(robots, "arm")
    stage = stage_of(export(mechanism, "usd", values=numbers).text)
    prim = next(p for p in stage.Traverse() if p.GetName() == "elbow")
    assert "PhysxJointAxisAPI:angular" in prim.GetMetadata("apiSchemas").GetAppliedItems()

    def value(name):
        return prim.GetAttribute(name).Get()

    axis = "physxJointAxis:angular"
    assert value(f"{axis}:armature") == pytest.approx(numbers["rotor_inertia.elbow.Ia"])
    assert value(f"{axis}:dynamicFrictionEffort") == pytest.approx(numbers["coulomb.elbow.Fc"])
    viscous = np.radians(numbers["viscous.elbow.Fv"])
    assert value(f"{axis}:viscousFrictionCoefficient") == pytest.approx(viscous)
    drive = UsdPhysics.DriveAPI(prim, "angular")
    k, b = (numbers[f"spring.elbow.{name}"] for name in ("k", "b"))
    assert drive.GetStiffnessAttr().Get() == pytest.approx(np.radians(k))
    assert drive.GetTargetPositionAttr().Get() == pytest.approx(np.degrees(-b / k))


@pytest.mark.parametrize("name", ["four_bar", "slider_crank"])
def test_loops_close_at_the_poses_of_the_bodies(robots, name):
    mechanism = ident.load(robots / name)
    stage = stage_of(export(mechanism, "usd").text)
    cache = UsdGeom.XformCache()
    closing = [p for p in stage.Traverse() if p.GetName().endswith("_closure")]
    assert len(closing) == len(mechanism.closures)
    for prim in closing:
        joint = UsdPhysics.Joint(prim)
        assert joint.GetExcludeFromArticulationAttr().Get()
        places = []
        for i, rel in enumerate((joint.GetBody0Rel(), joint.GetBody1Rel())):
            local = Gf.Vec3d(getattr(joint, f"GetLocalPos{i}Attr")().Get())
            targets = rel.GetTargets()
            world = (
                cache.GetLocalToWorldTransform(stage.GetPrimAtPath(targets[0]))
                if targets
                else Gf.Matrix4d(1.0)
            )
            places.append(np.array(world.Transform(local)))
        np.testing.assert_allclose(*places, atol=1e-6)


def test_what_it_cannot_say_is_listed(robots):
    mechanism = ident.load(robots / "arm").with_effect("stribeck:elbow")
    made = export(mechanism, "usd", values={"stribeck.elbow.Fs": 0.3, "stribeck.elbow.vs": 0.1})
    assert [lost.label for lost in made.lost] == ["stribeck:elbow"]
