"""A machine as a USD stage with UsdPhysics, for Isaac Sim and other users of PhysX.

Bodies stand at the assembled configuration; a joint's zero is where its two frames agree. Armature
and friction are attributes of PhysX's schema for a joint's axis, per degree where that schema
counts in degrees. A closure is one more joint, outside the articulation. Numbers of a body are of
single precision in UsdPhysics.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin

from ident.errors import IdentError
from ident.export.laws import JointLaws, Translation, Vocabulary
from ident.export.machine import Body, Link, Machine
from ident.export.target import Job, Product, Target, translated
from ident.mechanism.closures import FrameClosure

ABSENT = 'writing USD needs Pixar\'s library: pip install "ident[usd]"'
PHYSX = "PhysxJointAxisAPI"  # armature and friction of an axis
STATE = "PhysicsJointStateAPI"  # position at the start
JOINTS = {
    "point": "SphericalJoint", "revolute": "RevoluteJoint", "prismatic": "PrismaticJoint",
    "fixed": "FixedJoint", "universal": "Joint",
}  # fmt: skip
WORDS = Vocabulary(
    {"viscous": "physxJointAxis:viscousFrictionCoefficient",
     "coulomb": "physxJointAxis:dynamicFrictionEffort",
     "rotor_inertia": "physxJointAxis:armature", "spring": "drive:physics:stiffness",
     "servo": "drive:physics:stiffness and damping",
     "payload": "PhysicsMassAPI", "gravity_tilt": "physics:gravityDirection",
     "geometry": "physics:localPos0"},
    {kind: word.removesuffix("Joint") + "Joint" for kind, word in JOINTS.items()}, degree=1,
)  # fmt: skip


def usd_modules() -> Any:
    """Return the modules of Pixar's library, or raise one line that says what to install."""
    try:
        from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdPhysics
    except ImportError:
        raise IdentError(ABSENT) from None
    return SimpleNamespace(Gf=Gf, Sdf=Sdf, Tf=Tf, Usd=Usd, UsdGeom=UsdGeom, UsdPhysics=UsdPhysics)


def write(job: Job) -> Product:
    """Return the stage of a job, as text."""
    pxr = usd_modules()
    translation = translated(job, WORDS)
    notes = ["masses, centres and inertias have the seven digits of UsdPhysics"]
    notes += [
        f"{name}: a constant torque of {laws.position[0]:.3g} is left out, as there is no spring"
        for name, laws in translation.laws.items()
        if laws.position and not _stiffness(laws)
    ]
    notes += [
        f"{name}: an axis has one drive here, which is the spring; the servo's gains are left out"
        for (name,) in job.machine.values.get("servo", {})
        if _stiffness(translation.laws[name])
    ]
    return Product({job.out.name: _Stage(pxr, translation).text()}, translation, tuple(notes))


class _Stage:
    """A stage that is being written."""

    def __init__(self, pxr: Any, translation: Translation) -> None:
        self.pxr, self.translation = pxr, translation
        self.machine: Machine = translation.machine
        self.stage = pxr.Usd.Stage.CreateInMemory()
        self._identifiers: dict[str, str] = {}
        names = [link.name for link in self.machine.links]
        root = self.machine.mechanism.model.frames[1].name
        self.base = f"{root}_base" if root in names else root
        self.root = "/" + pxr.Tf.MakeValidIdentifier(self.machine.name)

    def text(self) -> bytes:
        """Return the text of the stage."""
        pxr, stage = self.pxr, self.stage
        pxr.UsdGeom.SetStageUpAxis(stage, pxr.UsdGeom.Tokens.z)
        pxr.UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        pxr.UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
        root = pxr.UsdGeom.Xform.Define(stage, self.root).GetPrim()
        stage.SetDefaultPrim(root)
        pxr.UsdPhysics.ArticulationRootAPI.Apply(root)
        self._gravity()
        self._base()
        for link, pose in zip(self.machine.links, self._poses(), strict=True):
            self._link(link, pose)
            self._joint(link, self.translation.laws[link.joint.name])
        for closure in self.machine.drawing.closures:
            assert isinstance(closure, FrameClosure)
            self._loop(closure)
        data: str = stage.ExportToString(addSourceFileComment=False)
        return data.encode()

    def identifier(self, name: str) -> str:
        """Return the name of a link or joint as USD takes it, another one for each name."""
        if name not in self._identifiers:
            valid = self.pxr.Tf.MakeValidIdentifier(name)
            while valid in self._identifiers.values():
                valid += "_"
            self._identifiers[name] = valid
        return self._identifiers[name]

    def _gravity(self) -> None:
        scene = self.pxr.UsdPhysics.Scene.Define(self.stage, f"{self.root}/physics_scene")
        size = float(np.linalg.norm(self.machine.gravity))
        direction = self.machine.gravity / size if size else np.array([0.0, 0.0, -1.0])
        scene.CreateGravityDirectionAttr(self._vector(direction))
        scene.CreateGravityMagnitudeAttr(size)

    def _base(self) -> None:
        """Fix a body to the world: PhysX begins an articulation at a body, not at the world."""
        prim = self.pxr.UsdGeom.Xform.Define(self.stage, self._path(self.base)).GetPrim()
        self.pxr.UsdPhysics.RigidBodyAPI.Apply(prim)
        mass = self.pxr.UsdPhysics.MassAPI.Apply(prim)  # of any size, as it never moves
        mass.CreateMassAttr(1.0)
        mass.CreateDiagonalInertiaAttr(self._vector(np.ones(3)))
        still = pin.SE3.Identity()
        self._connection("FixedJoint", f"{self.base}_fixed", (None, still), (self.base, still))

    def _poses(self) -> list[pin.SE3]:
        """Return the poses of the links' frames in the world, at the assembled configuration."""
        model = self.machine.drawing.model
        data = model.createData()
        pin.forwardKinematics(model, data, self.machine.start)
        return [data.oMi[i + 1].copy() for i in range(len(self.machine.links))]

    def _link(self, link: Link, pose: pin.SE3) -> None:
        pxr = self.pxr
        xform = pxr.UsdGeom.Xform.Define(self.stage, self._path(link.name))
        xform.AddTranslateOp().Set(pxr.Gf.Vec3d(*map(float, pose.translation)))
        xform.AddOrientOp(pxr.UsdGeom.XformOp.PrecisionDouble).Set(
            self._quaternion(pose.rotation, pxr.Gf.Quatd)
        )
        pxr.UsdPhysics.RigidBodyAPI.Apply(xform.GetPrim())
        body = Body.of(self.machine.total(link))
        if body.none:
            return
        moments, axes = np.linalg.eigh(body.inertia)
        if np.linalg.det(axes) < 0:
            axes[:, 0] = -axes[:, 0]
        mass = pxr.UsdPhysics.MassAPI.Apply(xform.GetPrim())
        mass.CreateMassAttr(body.mass)
        mass.CreateCenterOfMassAttr(self._vector(body.centre))
        mass.CreateDiagonalInertiaAttr(self._vector(moments))
        mass.CreatePrincipalAxesAttr(self._quaternion(axes, pxr.Gf.Quatf))

    def _joint(self, link: Link, laws: JointLaws) -> None:
        pxr, joint = self.pxr, link.joint
        kind = "RevoluteJoint" if joint.rotational else "PrismaticJoint"
        turned = _to_axis(link.axis)
        above = self.base if link.parent < 0 else self.machine.links[link.parent].name
        prim = self._connection(
            kind, joint.name, (above, link.placement * turned), (link.name, turned)
        )
        prim.CreateAxisAttr(pxr.UsdPhysics.Tokens.x)
        per = np.degrees(1.0) if joint.rotational else 1.0  # units of USD per rad or m
        for value, create in (
            (joint.lower, prim.CreateLowerLimitAttr), (joint.upper, prim.CreateUpperLimitAttr)
        ):  # fmt: skip
            if np.isfinite(value):
                create(float(value * per))
        axis = "angular" if joint.rotational else "linear"
        if start := self.machine.start[joint.index]:
            prim.GetPrim().AddAppliedSchema(f"{STATE}:{axis}")
            self._attribute(prim, f"state:{axis}:physics:position", start * per)
        servo = self.machine.values.get("servo", {}).get((joint.name,))
        if k := _stiffness(laws):
            drive = pxr.UsdPhysics.DriveAPI.Apply(prim.GetPrim(), axis)
            drive.CreateTypeAttr(pxr.UsdPhysics.Tokens.force)
            drive.CreateStiffnessAttr(k / per)
            drive.CreateTargetPositionAttr(float(-laws.position[0] / k * per))
        elif servo:
            drive = pxr.UsdPhysics.DriveAPI.Apply(prim.GetPrim(), axis)
            drive.CreateTypeAttr(pxr.UsdPhysics.Tokens.force)
            drive.CreateStiffnessAttr(servo["kp"] / per)
            drive.CreateDampingAttr(servo["kd"] / per)
            if np.isfinite(joint.effort):
                drive.CreateMaxForceAttr(float(joint.effort))
        terms = {
            "armature": laws.armature, "viscousFrictionCoefficient": laws.viscous / per,
            "dynamicFrictionEffort": laws.coulomb, "staticFrictionEffort": laws.coulomb,
        }  # fmt: skip
        if np.isfinite(joint.velocity) and joint.velocity > 0:
            terms["maxJointVelocity"] = float(joint.velocity * per)
        if any(terms.values()):
            prim.GetPrim().AddAppliedSchema(f"{PHYSX}:{axis}")
        for name, value in terms.items():
            if value:
                self._attribute(prim, f"physxJointAxis:{axis}:{name}", value)

    def _attribute(self, joint: Any, name: str, value: float) -> None:
        """Write an attribute of PhysX's schemas, which Pixar's library does not know."""
        kind = self.pxr.Sdf.ValueTypeNames.Float
        joint.GetPrim().CreateAttribute(name, kind, False).Set(float(value))

    def _loop(self, closure: FrameClosure) -> None:
        turned = (
            pin.SE3.Identity()
            if closure.kind == "universal"
            else _to_axis(np.array([0.0, 0.0, 1.0]))
        )
        ends = [
            (self.base if frame.joint == 0 else frame.link, frame.placement * turned)
            for frame in closure.frames
        ]
        prim = self._connection(JOINTS[closure.kind], f"{closure.name}_closure", *ends)
        prim.CreateExcludeFromArticulationAttr(True)
        if closure.kind in ("revolute", "prismatic", "point"):
            prim.CreateAxisAttr(self.pxr.UsdPhysics.Tokens.x)
        if closure.kind == "universal":  # turns about x of one frame and y of the other
            for axis in ("transX", "transY", "transZ", "rotZ"):
                limit = self.pxr.UsdPhysics.LimitAPI.Apply(prim.GetPrim(), axis)
                limit.CreateLowAttr(1.0)  # low above high: locked
                limit.CreateHighAttr(-1.0)

    def _connection(
        self,
        kind: str,
        name: str,
        first: tuple[str | None, pin.SE3],
        second: tuple[str | None, Any],
    ) -> Any:
        """Return a joint of a kind between frames of two bodies, None: the world."""
        path = f"{self.root}/joints/{self.identifier(name)}"
        prim = getattr(self.pxr.UsdPhysics, kind).Define(self.stage, path)
        for i, (link, placement) in enumerate((first, second)):
            if link is not None:
                getattr(prim, f"CreateBody{i}Rel")().SetTargets([self._path(link)])
            getattr(prim, f"CreateLocalPos{i}Attr")(self._vector(placement.translation))
            getattr(prim, f"CreateLocalRot{i}Attr")(
                self._quaternion(placement.rotation, self.pxr.Gf.Quatf)
            )
        return prim

    def _path(self, link: str) -> str:
        return f"{self.root}/{self.identifier(link)}"

    def _vector(self, x: np.ndarray) -> Any:
        return self.pxr.Gf.Vec3f(*map(float, x))

    def _quaternion(self, R: np.ndarray, kind: Any) -> Any:
        x, y, z, w = map(float, pin.Quaternion(R).coeffs())
        return kind(w, x, y, z)


def _to_axis(axis: np.ndarray) -> pin.SE3:
    """Return the frame whose x is an axis (3,)."""
    R = pin.Quaternion.FromTwoVectors(np.array([1.0, 0.0, 0.0]), axis).toRotationMatrix()
    return pin.SE3(R, np.zeros(3))


def _stiffness(laws: JointLaws) -> float:
    return laws.position[1] if len(laws.position) > 1 else 0.0


USD = Target("usd", "a USD stage", ".usda", WORDS, write)
