"""A MuJoCo model (MJCF) as a URDF with closures, from what MuJoCo's own compiler makes of it.

Pinocchio reads MJCF too, but not all of it as MuJoCo does: several joints of one body lose their
names, and limits of sliding joints are read as degrees.

    body frame = parent · body pose · Π [ T(anchor) · joint motion(q - ref) · T(-anchor) ]

A URDF's link has its origin at its joint: at the anchor of the body's last one.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from ident.errors import MechanismError
from ident.files import regular
from ident.mechanism.chains import pose_start
from ident.mechanism.description import MOST_JOINTS, Description, parse_xml, words
from ident.mechanism.urdf import RigidBody, UrdfWriter, Visual, effect_notes, place_table

if TYPE_CHECKING:
    import mujoco

DOT = 1e-3  # range: [m] radius of a sphere in the place of a missing mesh
DEEPEST = 20  # work: includes within includes
SHOWN = 2  # range: the last group of shapes that MuJoCo shows unasked
FREE, BALL, SLIDE, HINGE = range(4)  # mjtJoint
SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH = range(2, 8)  # mjtGeom
CONNECT, WELD, JOINT, TENDON = range(4)  # mjtEq
OF_JOINT = 1  # range: mjtWrap, of fixed tendons
SITE = 6  # range: mjtObj
BY_JOINT, BY_TENDON = (0, 1), 3  # range: mjtTrn


def read_mjcf(path: Path, data: bytes) -> Description:
    """Read a MuJoCo model's bodies, joints and equalities; what it includes is beside `path`."""
    model, warnings = _compiled(path, data)
    return _MjcfModel(model, path).description(warnings)


def _compiled(path: Path, data: bytes) -> tuple[mujoco.MjModel, list[str]]:
    try:
        import mujoco
    except ImportError:
        raise MechanismError(
            f'{path}: reading MuJoCo models needs MuJoCo: pip install "ident[mjcf]", or give a URDF'
        ) from None
    _check_includes(path, data, path.parent.resolve(), ())
    warnings: list[str] = []
    notes: list[str] = []
    before = getattr(mujoco, "get_mju_user_warning", lambda: None)()  # not in every version
    mujoco.set_mju_user_warning(warnings.append)  # else it writes a MUJOCO_LOG.TXT
    try:
        try:
            model = mujoco.MjModel.from_xml_path(str(path))
        except ValueError as error:
            if "opening file" not in str(error):
                raise
            model, notes = _without_missing_files(path)
    except Exception as error:  # a compiler given anything: every fault is the file's
        what = " ".join(str(error).split())[:300]
        raise MechanismError(f"{path}: MuJoCo refuses it: {what or type(error).__name__}") from None
    finally:
        mujoco.set_mju_user_warning(before)
    if model.nflex:
        raise MechanismError(f"{path}: has flexible bodies (flex); a mechanism is of rigid ones")
    if model.njnt > MOST_JOINTS:
        raise MechanismError(f"{path}: {model.njnt} joints; a mechanism has at most {MOST_JOINTS}")
    return model, [*notes, *(f"MuJoCo: {' '.join(warning.split())}" for warning in warnings)]


def _without_missing_files(path: Path) -> tuple[mujoco.MjModel, list[str]]:
    """Compile a model whose meshes or textures are not on this machine; dots are in their place.

    Kinematics and every stated inertia are as with them. An inertia that MuJoCo would take from a
    missing shape is next to nothing.
    """
    import mujoco

    spec = mujoco.MjSpec.from_file(str(path))

    def missing(assets: Iterable[Any], folder: str) -> dict[str, Any]:
        """Return assets with a file that is not there, by name."""
        named = [(asset, Path(asset.file)) for asset in assets if asset.file]
        place = path.parent / folder
        return {
            asset.name or file.stem: asset
            for asset, file in named
            if not (place / (file.name if spec.strippath else file)).is_file()
        }

    meshes, textures = missing(spec.meshes, spec.meshdir), missing(spec.textures, spec.texturedir)
    assets = [*meshes.values(), *textures.values()]
    files = [asset.file for asset in assets]
    for geom in [geom for geom in spec.geoms if geom.meshname in meshes]:
        geom.type, geom.size, geom.meshname = mujoco.mjtGeom.mjGEOM_SPHERE, [DOT, 0, 0], ""
    for material in spec.materials:
        material.textures = ["" if name in textures else name for name in material.textures]
    for asset in assets:
        spec.delete(asset)
    model = spec.compile()
    return model, [
        f"{len(files)} files of meshes and textures are missing, the first {files[0]}: a link "
        "without <inertial> has next to no mass in the prior"
    ]


def _check_includes(path: Path, data: bytes, folder: Path, above: tuple[Path, ...]) -> None:
    if len(above) > DEEPEST or path.resolve() in above:
        raise MechanismError(f"{path}: includes itself; remove that <include>")
    for include in parse_xml(data, str(path)).iter("include"):
        name = include.get("file") or ""
        place = f"{path}:{include.sourceline}: includes '{name}'"
        file = (folder / name).resolve()  # MuJoCo: of the main file's folder
        if folder not in file.parents:
            raise MechanismError(f"{place}, outside of the model's folder; copy it into that")
        try:
            inside = regular(file).read_bytes()
        except OSError as error:
            raise MechanismError(f"{place}, which cannot be read: {error.strerror}") from None
        _check_includes(file, inside, folder, (*above, path.resolve()))


class _MjcfModel:
    """One compiled model; bodies and joints by MuJoCo's numbers."""

    def __init__(self, model: mujoco.MjModel, path: Path) -> None:
        self.model, self.path = model, path
        links = [model.body(i).name for i in range(model.nbody)]
        self.links = [name or _free(f"body_{i}", links) for i, name in enumerate(links)]
        # one without a name gets its body's
        self.joints = [model.joint(j).name for j in range(model.njnt)]
        for j, name in enumerate(self.joints):
            if not name:
                body = self.links[model.jnt_bodyid[j]]
                self.joints[j] = _free(f"{body}_joint", self.joints)
        # by body, massless links between its joints, and where MuJoCo's frame is in its link's
        self.steps, self.offsets = [], []
        for body in range(model.nbody):
            joints = self.joints_of(body)
            self.steps.append([_free(f"{self.joints[j]}_link", self.links) for j in joints[:-1]])
            anchor = model.jnt_pos[joints[-1]] if joints else np.zeros(3)
            self.offsets.append(_pose(-anchor))

    def joints_of(self, body: int) -> range:
        """Return a body's joints, in the order in which they act."""
        first = int(self.model.body_jntadr[body])
        return range(first, first + int(self.model.body_jntnum[body]))

    def description(self, warnings: list[str]) -> Description:
        """Return the model as a URDF with closures."""
        m = self.model
        name = bytes(m.names).split(b"\0")[0].decode()
        urdf = UrdfWriter(
            name if name not in ("", "MuJoCo Model") else self.path.stem,
            "written from a MuJoCo model",
        )
        urdf.link("world")
        for body in range(1, m.nbody):
            self._add(urdf, body)
        closures, notes = self._closures()
        passive = tuple(self.joints[j] for j in self._undriven())
        gx, gy, gz = map(float, m.opt.gravity)
        return Description(
            urdf=urdf.text(),
            format="mjcf",
            closures=tuple(closures),
            passive=passive,
            start={name: x for j in range(m.njnt) for name, x in self._start(j).items()},
            gravity=(gx, gy, gz),
            auxiliary=tuple(name for links in self.steps for name in links),
            motors=self._motors(),
            notes=(*warnings, *self._notes(passive), *notes),
        )

    def _ref(self, j: int) -> float:
        """Return where a joint starts; one of several coordinates starts where its body is."""
        scalar = self.model.jnt_type[j] in (SLIDE, HINGE)
        return float(self.model.qpos0[self.model.jnt_qposadr[j]]) if scalar else 0.0

    def _start(self, j: int) -> dict[str, float]:
        """Return where a joint starts, in the key `start` if there is one, as in models that
        `ident export` writes; a free one, where its body is in the world.
        """
        m, name = self.model, self.joints[j]
        if m.jnt_type[j] == BALL:
            return {}
        if m.jnt_type[j] != FREE:
            keys = [m.key(k).name for k in range(m.nkey)]
            if "start" not in keys:
                return {name: self._ref(j)}
            return {name: float(m.key_qpos[keys.index("start")][m.jnt_qposadr[j]])}
        pose = m.qpos0[m.jnt_qposadr[j] :][:7]
        return pose_start(name, _pose(pose[:3], pose[3:]))

    def _add(self, urdf: UrdfWriter, body: int) -> None:
        m, joints = self.model, self.joints_of(body)
        parent = int(m.body_parentid[body])
        placement = self.offsets[parent] * _pose(m.body_pos[body], m.body_quat[body])
        links = [self.links[parent], *self.steps[body], self.links[body]]
        for name in self.steps[body]:
            urdf.link(name)
        inertia = RigidBody(float(m.body_mass[body]), np.zeros(3), np.diag(m.body_inertia[body]))
        inertial = self.offsets[body] * _pose(m.body_ipos[body], m.body_iquat[body])
        urdf.link(self.links[body], inertia.expressed_at(inertial), self._visuals(body))
        if not joints:
            name = _free(f"{links[1]}_fixed", self.joints)
            urdf.joint(name, "fixed", (links[0], links[1]), placement)
        for k, j in enumerate(joints):
            kind, axis, limits = int(m.jnt_type[j]), m.jnt_axis[j], self._limits(j)
            if kind == FREE:  # its coordinates count from the world, not from where the body is
                origin = pin.SE3.Identity()
                urdf.joint(self.joints[j], "floating", (links[k], links[k + 1]), origin)
                continue
            if kind == BALL:
                at = placement * _pose(m.jnt_pos[j])
                urdf.joint(self.joints[j], "ball", (links[k], links[k + 1]), at)
                placement = _pose(-m.jnt_pos[j])
                continue
            name = {SLIDE: "prismatic", HINGE: "revolute"}[kind]
            if kind == HINGE and "lower" not in limits:
                name = "continuous"
            step = -self._ref(j) * axis
            back = pin.SE3(pin.exp3(step), np.zeros(3)) if kind == HINGE else _pose(step)
            at = placement * _pose(m.jnt_pos[j]) * back
            urdf.joint(self.joints[j], name, (links[k], links[k + 1]), at, axis, **limits)
            placement = _pose(-m.jnt_pos[j])

    def _limits(self, j: int) -> dict[str, float]:
        m = self.model
        limits = {"effort": float(m.jnt_actfrcrange[j][1])} if m.jnt_actfrclimited[j] else {}
        ends = dict(zip(("lower", "upper"), map(float, m.jnt_range[j]), strict=True))
        return {**limits, **ends} if m.jnt_limited[j] else limits

    def _visuals(self, body: int) -> list[Visual]:
        m, visuals = self.model, []
        first = int(m.body_geomadr[body])
        for g in range(first, first + int(m.body_geomnum[body])):
            if m.geom_group[g] > SHOWN:
                continue
            kind, size = int(m.geom_type[g]), m.geom_size[g]
            at = self.offsets[body] * _pose(m.geom_pos[g], m.geom_quat[g])
            if kind == SPHERE:
                visuals.append(Visual("sphere", {"radius": words(size[:1])}, at))
            elif kind in (CAPSULE, CYLINDER):  # a capsule is shown without its caps
                along = {"radius": words(size[:1]), "length": words(2 * size[1:2])}
                visuals.append(Visual("cylinder", along, at))
            elif kind in (ELLIPSOID, BOX):  # an ellipsoid as the box around it
                visuals.append(Visual("box", {"size": words(2 * size)}, at))
            elif kind == MESH and (file := self._mesh_file(mesh := int(m.geom_dataid[g]))):
                at = at * _pose(m.mesh_pos[mesh], m.mesh_quat[mesh]).inverse()
                scale = words(m.mesh_scale[mesh])
                visuals.append(Visual("mesh", {"filename": file, "scale": scale}, at))
        return visuals

    def _mesh_file(self, mesh: int) -> str:
        at, folder = int(self.model.mesh_pathadr[mesh]), self.path.parent
        path = bytes(self.model.paths[at:]).split(b"\0")[0].decode() if at >= 0 else ""
        if not path or not (folder / path).is_file():
            return ""
        return Path(os.path.relpath(folder / path, folder)).as_posix()

    def _motors(self) -> dict[str, dict[str, float]]:
        """Return the motors that pull fixed tendons, by actuator: the sum of joints that turns it,
        and each joint that has an actuator of its own beside them.
        """
        m, motors, driven = self.model, dict[str, dict[str, float]](), set[str]()
        for a, (kind, (target, _)) in enumerate(
            zip(m.actuator_trntype, m.actuator_trnid, strict=True)
        ):
            if kind in BY_JOINT:
                driven.add(self.joints[int(target)])
            if kind != BY_TENDON:
                continue
            first = int(m.tendon_adr[target])
            wraps = range(first, first + int(m.tendon_num[target]))
            if any(m.wrap_type[w] != OF_JOINT for w in wraps):
                continue
            ratios = {self.joints[int(m.wrap_objid[w])]: float(m.wrap_prm[w]) for w in wraps}
            name = m.actuator(a).name or m.tendon(int(target)).name or f"motor_{a + 1}"
            motors[_free(name, self.joints)] = {j: x for j, x in ratios.items() if x}
        moved = {joint for ratios in motors.values() for joint in ratios}
        return motors | {name: {name: 1.0} for name in self.joints if name in driven & moved}

    def _undriven(self) -> list[int]:
        m, driven = self.model, set()
        for kind, (target, _) in zip(m.actuator_trntype, m.actuator_trnid, strict=True):
            if kind in BY_JOINT:
                driven.add(int(target))
            elif kind == BY_TENDON:
                first = int(m.tendon_adr[target])
                wraps = range(first, first + int(m.tendon_num[target]))
                driven |= {int(m.wrap_objid[w]) for w in wraps if m.wrap_type[w] == 1}
        scalar = [j for j in range(m.njnt) if m.jnt_type[j] in (SLIDE, HINGE)]
        return [j for j in scalar if j not in driven] if driven else []

    def _notes(self, passive: tuple[str, ...]) -> list[str]:
        m, notes = self.model, []
        limited = [
            self.joints[j] for j in range(m.njnt) if m.jnt_type[j] == BALL and m.jnt_limited[j]
        ]
        if limited:
            notes.append(
                f"ranges of ball joints are not taken over: {', '.join(limited)} (a cone, which no "
                "limit of an angle is)"
            )
        if passive:
            notes.append(
                f"{', '.join(passive)}: no actuator, so passive (no torque); [joints] passive in a "
                "mechanism.toml says otherwise"
            )
        values = {  # properties of a joint that are effects here
            "damping": m.dof_damping[m.jnt_dofadr],
            "frictionloss": m.dof_frictionloss[m.jnt_dofadr],
            "armature": m.dof_armature[m.jnt_dofadr],
            "stiffness": m.jnt_stiffness,
        }
        notes += effect_notes(
            {word: [self.joints[int(j)] for j in np.flatnonzero(x)] for word, x in values.items()}
        )
        shifted = [self.links[i] for i, at in enumerate(self.offsets) if np.any(at.translation)]
        if shifted:
            notes.append(
                f"{', '.join(shifted)}: the link's origin is at its joint, not at the body's"
            )
        return notes

    # --- equalities -----------------------------------------------------------------------------

    def _closures(self) -> tuple[list[dict[str, Any]], list[str]]:
        m, closures, notes = self.model, [], []
        for e in range(m.neq):
            name = m.equality(e).name or f"equality_{e + 1}"
            where = f"{self.path}: equality '{name}'"
            kind = int(m.eq_type[e])
            if not m.eq_active0[e]:
                notes.append(f"equality '{name}' is inactive and left out")
            elif kind == JOINT:
                closures.append({"name": name, **self._linear(e, where)})
            elif kind in (CONNECT, WELD):
                closures.append({"name": name, **self._frames(e)})
            elif kind == TENDON:
                closures.append({"name": name, **self._tendons(e, where)})
            else:
                raise MechanismError(
                    f"{where} is of flexible bodies; valid: connect, weld, joint, tendon; set "
                    'active="false", and write a [[closure]] in a mechanism.toml'
                )
        return closures, notes

    def _frames(self, e: int) -> dict[str, Any]:
        m = self.model
        kind, data = int(m.eq_type[e]), m.eq_data[e]
        bodies = [int(m.eq_obj1id[e]), int(m.eq_obj2id[e])]
        if int(m.eq_objtype[e]) == SITE:
            at = [_pose(m.site_pos[i], m.site_quat[i]) for i in bodies]
            bodies = [int(m.site_bodyid[i]) for i in bodies]
        elif kind == CONNECT:
            at = [_pose(data[0:3]), _pose(data[3:6])]
        else:  # the anchor in body 2, and where that is in body 1
            at = [_pose(data[3:6], data[6:10]), _pose(data[0:3])]
        a, b = (
            place_table(self.links[body], self.offsets[body] * place)
            for body, place in zip(bodies, at, strict=True)
        )
        if kind == CONNECT:
            a, b = ({"link": end["link"], "xyz": end["xyz"]} for end in (a, b))
        return {"kind": "point" if kind == CONNECT else "fixed", "a": a, "b": b}

    def _linear(self, e: int, where: str) -> dict[str, Any]:
        one, two = int(self.model.eq_obj1id[e]), int(self.model.eq_obj2id[e])
        c0, c1, *higher = (float(x) for x in self.model.eq_data[e][:5])
        if two < 0 or c1 == 0:
            raise MechanismError(
                f"{where} holds joint '{self.joints[one]}' where it is; remove the joint from its "
                "body"
            )
        if any(higher):  # q₁ − r₁ = Σ c (q₂ − r₂)ᵏ as a polynomial of q₂
            curve = np.polynomial.Polynomial([c0, c1, *higher])
            curve = curve(np.polynomial.Polynomial([-self._ref(two), 1.0])) + self._ref(one)
            return {
                "kind": "polynomial",
                "joints": [self.joints[one], self.joints[two]],
                "coefficients": [float(c) for c in curve.coef],
            }
        return {
            "kind": "linear",
            "joints": [self.joints[one], self.joints[two]],
            "ratios": [1.0, -c1],
            "offset": self._ref(one) + c0 - c1 * self._ref(two),
        }

    def _tendons(self, e: int, where: str) -> dict[str, Any]:
        """Return L₁ − L₁₀ = c₀ + c₁ (L₂ − L₂₀) of fixed tendons, each a sum of joints."""
        m = self.model
        c0, c1, *higher = (float(x) for x in m.eq_data[e][:5])
        both = [int(m.eq_obj1id[e]), int(m.eq_obj2id[e])]
        both = both if both[1] >= 0 else both[:1]
        if any(higher) and len(both) > 1:
            what = f"is a curve of tendons, polycoef = {[c0, c1, *higher]}; only straight ones are"
            raise MechanismError(f"{where} {what} read: write a [[closure]] of kind function")
        total, offset = dict[str, float](), c0
        for tendon, factor in zip(both, (1.0, -c1), strict=False):
            first, offset = (
                int(m.tendon_adr[tendon]),
                offset + factor * float(m.tendon_length0[tendon]),
            )
            for wrap in range(first, first + int(m.tendon_num[tendon])):
                if m.wrap_type[wrap] != OF_JOINT:
                    what = f"ties the spatial tendon '{m.tendon(tendon).name}'; only fixed ones are"
                    raise MechanismError(f"{where} {what} read; write a [[closure]] by hand")
                joint = self.joints[int(m.wrap_objid[wrap])]
                total[joint] = total.get(joint, 0.0) + factor * float(m.wrap_prm[wrap])
        total = {joint: ratio for joint, ratio in total.items() if ratio}
        if len(total) < 2:
            raise MechanismError(
                f"{where} holds joint '{next(iter(total), '')}' where it is; remove the joint from "
                "its body"
            )
        return {
            "kind": "linear", "joints": [*total], "ratios": [*total.values()], "offset": offset,
        }  # fmt: skip


def _free(name: str, used: list[str]) -> str:
    while name in used:
        name += "_"
    return name


def _pose(position: np.ndarray, wxyz: Sequence[float] = (1.0, 0.0, 0.0, 0.0)) -> pin.SE3:
    w, x, y, z = (float(value) for value in wxyz)
    rotation = pin.Quaternion(w, x, y, z).normalized().matrix()
    return pin.SE3(rotation, np.array(position, dtype=float))
