"""The user's own MuJoCo model with other numbers: no other byte of the file is touched.

A joint is found by its name; its body's inertia is what the machine's link has, less the bodies
that are fixed to it, which keep theirs. Only what the file compiles to otherwise is changed: a
number that is right already, from a default class perhaps, keeps its text.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ident.errors import IdentError, MechanismError, near
from ident.export.edit import Element, XmlEdit
from ident.export.laws import Translation
from ident.export.machine import Body, Machine, possible
from ident.export.mjcf import Numbers, actuator, bias_of, joint_attributes
from ident.export.rollout import mujoco_module
from ident.files import regular
from ident.mechanism.description import words

EQUAL = 1e-9  # numerics: relative difference below which a number of the file is right already
SIZE = 1e-3  # numerics: [m] of a body, by which a change of its centre is measured
DEGREES = 180 / np.pi  # range: of a radian
JOINTS = ("joint", "freejoint")
PLACE = 1e-6  # numerics: [m, 1] by which a joint's place in a file may differ from the machine's
# range: coordinates of MuJoCo's free (0) and ball (1) joints as a mechanism names them
SEVERAL = {0: ("x", "y", "z", "rz", "ry", "rx"), 1: ("rz", "ry", "rx")}
LAST = ".rx"


class LikeMjcf:
    """A user's file, with joints and bodies that belong to a machine's."""

    def __init__(self, path: Path, machine: Machine) -> None:
        module = mujoco_module()
        self.path, self.machine = path, machine
        self.data = regular(path).read_bytes()
        try:
            self.spec = module.MjSpec.from_file(str(path))
            self.model = _compiled_without_files(self.spec, path)
        except ValueError as error:
            raise IdentError(f"{path}: MuJoCo refuses it: {' '.join(str(error).split())}") from None
        edit = XmlEdit(self.data, str(path))
        if edit.root.iter("include"):
            raise IdentError(
                f"{path}: includes other files, which --like does not change; give the file that "
                "contains the bodies"
            )
        self.radian = _angle(edit.root) == "radian"
        model = self.model
        self.index = {_name(model, j): j for j in range(model.njnt)}
        # of a joint of several coordinates, by the names that they have as joints
        self.several = {
            f"{name}.{word}": j
            for name, j in self.index.items()
            for word in SEVERAL.get(int(model.jnt_type[j]), ())
        }
        self._check_names()
        self.frames = self._frames()

    @property
    def step(self) -> float:
        """Its step [s]."""
        return float(self.model.opt.timestep)

    @property
    def soft(self) -> float | None:
        """None: its softness stays as it is."""
        return None

    def _check_names(self) -> None:
        names = [*self.index]
        missing = [x for x in self.machine.by_joint if x not in self.index | self.several]
        if missing:
            pairs = ", ".join(f"{name} → {near(name, names) or '?'}" for name in missing)
            raise MechanismError(
                f"--like {self.path}: has no joint {', '.join(missing)}; nearest: {pairs}; rename "
                "them in the mechanism's file, or give another --like"
            )

    def _frames(self) -> dict[str, pin.SE3]:
        """Return the frame of every link in that of its body, by joint.

        Raises:
            MechanismError: where the file's joints are in other places than the machine's.
        """
        module, model = mujoco_module(), self.model
        names = [link.joint.name for link in self.machine.links]
        tree, result = self.machine.drawing.model, list[list[pin.SE3]]()
        random = np.random.default_rng(0)
        for q in (np.zeros(tree.nq), random.uniform(-0.5, 0.5, tree.nq)):
            data, own_data = module.MjData(model), tree.createData()
            data.qpos[:] = model.qpos0
            values = {link.joint.name: float(q[link.joint.index]) for link in self.machine.links}
            for name, j in self.index.items():
                self._set(data.qpos[model.jnt_qposadr[j] :], name, int(model.jnt_type[j]), values)
            module.mj_kinematics(model, data)
            pin.forwardKinematics(tree, own_data, q)
            frames = []
            for link in self.machine.links:
                body = int(model.jnt_bodyid[self._joint_of(link.joint.name)])
                R, p = data.xmat[body].reshape(3, 3).copy(), data.xpos[body].copy()
                frames.append(
                    pin.SE3(R, p).inverse() * own_data.oMi[tree.getJointId(link.joint.name)]
                )
            result.append(frames)
        for name, one, other in zip(names, *result, strict=True):
            last = self._is_last(name)
            if last and np.abs((one.inverse() * other).homogeneous - np.eye(4)).max() > PLACE:
                raise MechanismError(
                    f"--like {self.path}: joint '{name}' is in another place, or turns another "
                    "way, than that of the machine: the file is of another machine"
                )
        return dict(zip(names, result[0], strict=True))

    def _is_last(self, name: str) -> bool:
        """Return whether a joint is the last of its body, whose frame then is the link's."""
        model, j = self.model, self._joint_of(name)
        if name in self.several and not name.endswith(LAST):
            return False
        body = int(model.jnt_bodyid[j])
        return j == int(model.body_jntadr[body]) + int(model.body_jntnum[body]) - 1

    def _joint_of(self, name: str) -> int:
        """Return the number of the file's joint that has a coordinate."""
        return self.index[name] if name in self.index else self.several[name]

    @staticmethod
    def _set(qpos: np.ndarray, name: str, kind: int, values: Mapping[str, float]) -> None:
        """Set the coordinates of a joint of the file, which begin in `qpos`."""
        words_of = SEVERAL.get(kind)
        if words_of is None:
            qpos[0] = values.get(name, qpos[0])
        elif f"{name}.{words_of[-1]}" in values:
            at = {word: values[f"{name}.{word}"] for word in words_of}
            turn = pin.Quaternion(pin.rpy.rpyToMatrix(at["rx"], at["ry"], at["rz"])).coeffs()
            moved = [at[x] for x in "xyz"] if kind == 0 else []
            qpos[: len(words_of) + 1] = [*moved, turn[3], *turn[:3]]

    def text(self, translation: Translation, numbers: Numbers) -> bytes:
        """Return the file's text with the numbers of the machine."""
        edit = XmlEdit(self.data, str(self.path))
        joints = {
            name: element
            for world in edit.root.iter("worldbody")
            for element in [item for tag in JOINTS for item in world.iter(tag)]
            if (name := _element_name(element))
        }
        if numbers.step != self.step:
            option = edit.root.find("option")
            if option is None:
                edit.insert(edit.root, "option", {"timestep": words([numbers.step])})
            else:
                edit.set(option, "timestep", words([numbers.step]))
        for link in self.machine.links:
            name = link.joint.name
            laws = translation.laws[name]
            element = joints.get(_name(self.model, self._joint_of(name)))
            if element is None:  # an element that a replicate or an attach makes
                raise IdentError(
                    f"--like {self.path}: joint '{name}' is in no <joint> of the file itself"
                )
            if name in self.index:
                self._joint(edit, element, joint_attributes(laws, link.offset), name)
            elif joint_attributes(laws, link.offset):
                raise IdentError(
                    f"--like {self.path}: '{name}' is one coordinate of a joint of several, which "
                    "has no friction, spring or rotor of its own; leave its effects out"
                )
            if self._is_last(name):
                self._body(edit, element, name)
        self._actuators(edit, translation, numbers)
        return edit.result()

    # --- joints ---------------------------------------------------------------------------------

    def _joint(self, edit: XmlEdit, element: Element, wanted: dict[str, str], name: str) -> None:
        model, j = self.model, self.index[name]
        dof = int(model.jnt_dofadr[j])
        hinge = int(model.jnt_type[j]) == 3
        degrees = DEGREES if hinge and not self.radian else 1.0
        poly = getattr(model, "dof_dampingpoly", np.zeros((model.nv, 2)))[dof]
        stiff = getattr(model, "jnt_stiffnesspoly", np.zeros((model.njnt, 2)))[j]
        now = {
            "damping": [float(model.dof_damping[dof]), *poly],
            "frictionloss": [float(model.dof_frictionloss[dof])],
            "armature": [float(model.dof_armature[dof])],
            "stiffness": [float(model.jnt_stiffness[j]), *stiff],
        }
        spring = False
        kinds = {
            "damping": ("viscous", "drag"), "frictionloss": ("coulomb",),
            "armature": ("rotor_inertia",), "stiffness": ("spring", "cable"),
        }  # fmt: skip
        for key, present in now.items():
            if key not in wanted and not any(self.machine.speaks_of(k, name) for k in kinds[key]):
                continue
            new = [float(x) for x in wanted.get(key, "0").split()]
            both = np.zeros((2, 3))
            both[0, : len(present)], both[1, : len(new)] = present, new
            scale = np.abs(both).max()
            if np.abs(both[0] - both[1]).max() > EQUAL * scale:
                edit.set(element, key, words(new))
            spring |= key == "stiffness" and bool(np.any(new))
        if spring:
            at = int(model.jnt_qposadr[j])
            new_rest, old = float(wanted["springref"]), float(model.qpos_spring[at])
            if abs(new_rest - old) > EQUAL * max(abs(new_rest), abs(old)):
                edit.set(element, "springref", words([new_rest * degrees]))
        offset = self.machine.by_joint[name].offset
        if offset:
            at = int(model.jnt_qposadr[j])
            ref = float(model.qpos0[at]) - offset
            edit.set(element, "ref", words([ref * degrees]))

    # --- bodies ---------------------------------------------------------------------------------

    def _body(self, edit: XmlEdit, joint: Element, name: str) -> None:
        body = joint.parent
        assert body is not None
        model = self.model
        at = int(model.jnt_bodyid[self._joint_of(name)])
        link = self.machine.by_joint[name]
        total_inertia = _shifted(self.machine.total(link), self.frames[name])
        fixed = np.zeros(10)
        for child in range(at + 1, model.nbody):
            if int(model.body_parentid[child]) == at and not model.body_jntnum[child]:
                fixed += self._fixed(child)
        present = self._present(at)
        wanted = total_inertia - fixed
        if not possible(wanted):
            wanted = present if np.allclose(total_inertia, present + fixed, rtol=EQUAL) else wanted
        scale = np.abs(present).max() or 1.0
        if np.abs(wanted - present).max() <= EQUAL * scale:
            return
        if not possible(wanted):
            raise IdentError(
                f"--like {self.path}: body '{model.body(at).name}' with the bodies fixed to it is "
                "lighter than these alone; give these less, or write a file anew without --like"
            )
        self._write_inertia(edit, body, Body.of(wanted))

    def _fixed(self, body: int) -> np.ndarray:
        """Return the ten parameters of a fixed body and those fixed to it, in its parent."""
        model = self.model
        total = self._present(body)
        for child in range(body + 1, model.nbody):
            if int(model.body_parentid[child]) == body and not model.body_jntnum[child]:
                total = total + self._fixed(child)
        w, x, y, z = (float(value) for value in model.body_quat[body])
        pose = pin.SE3(pin.Quaternion(w, x, y, z).matrix(), np.array(model.body_pos[body]))
        return _shifted(total, pose)

    def _present(self, body: int) -> np.ndarray:
        """Return the ten parameters of a body as the file has it, in its frame."""
        model = self.model
        w, x, y, z = (float(value) for value in model.body_iquat[body])
        R = pin.Quaternion(w, x, y, z).matrix()
        inertia = R @ np.diag(model.body_inertia[body]) @ R.T
        return _dynamic(float(model.body_mass[body]), np.array(model.body_ipos[body]), inertia)

    def _write_inertia(self, edit: XmlEdit, body: Element, new: Body) -> None:
        full = [*new.six]
        inertial = body.find("inertial")
        compiler = edit.root.find("compiler")
        if compiler is not None and compiler.attributes.get("inertiafromgeom") == "true":
            edit.set(compiler, "inertiafromgeom", "auto")
        values = {"pos": words(new.centre), "mass": words([new.mass])}
        if inertial is None:
            edit.insert(body, "inertial", {**values, "fullinertia": words(full)})
            return
        diagonal = "diaginertia" in inertial.attributes and not np.any(full[3:])
        turned = [key for key in ("quat", "axisangle", "xyaxes", "zaxis", "euler")
                  if key in inertial.attributes]  # fmt: skip
        old = _numbers(inertial.attributes.get("pos", "0 0 0"))
        for key, value in values.items():
            if key != "pos" or np.abs(old - new.centre).max() > EQUAL * SIZE:
                edit.set(inertial, key, value)
        for key in turned:
            edit.remove(inertial, key)
        if diagonal:
            edit.set(inertial, "diaginertia", words(full[:3]))
            return
        edit.remove(inertial, "diaginertia")
        edit.set(inertial, "fullinertia", words(full))

    # --- actuators ------------------------------------------------------------------------------

    def _actuators(self, edit: XmlEdit, translation: Translation, numbers: Numbers) -> None:
        """Change the drives' numbers where the machine knows its drives, or holds a constant."""
        section = edit.root.find("actuator")
        elements = {} if section is None else {
            child.attributes.get("joint", ""): child for child in section.children
        }  # fmt: skip
        for link in self.machine.links:
            name = link.joint.name
            laws = translation.laws[name]
            constant = bias_of(laws)
            drives = ("servo", "motor_current", "motor_voltage")
            known = any((name,) in self.machine.values.get(kind, {}) for kind in drives)
            if not known and not constant and laws.gain == 1.0:
                continue
            wanted = actuator(self.machine, link, laws, constant, 0.0, numbers.step)
            tag = wanted.pop("tag")
            element = elements.get(name)
            if element is None:
                if section is None:
                    raise IdentError(
                        f"--like {self.path}: joint '{name}' has no actuator, which would hold its "
                        "constant torque or its drive; add <actuator><motor …/></actuator>"
                    )
                edit.insert(section, tag, wanted, last=True)
                continue
            if element.tag != tag:
                raise IdentError(
                    f"--like {self.path}: the actuator of joint '{name}' is a <{element.tag}>, its "
                    f"drive was found to be a <{tag}>; change the element's name"
                )
            for key in ("kp", "kv", "forcerange", "gainprm", "biastype", "biasprm"):
                if key in wanted:
                    edit.set(element, key, wanted[key])


def _name(model: Any, j: int) -> str:
    """Return the name of a joint as the reader has it: one without a name gets its body's."""
    return str(model.joint(j).name or f"{model.body(int(model.jnt_bodyid[j])).name}_joint")


def _element_name(element: Element) -> str:
    """Return the same of a joint's element, nothing of one without a name in a nameless body."""
    if name := element.attributes.get("name", ""):
        return name
    body = element.parent.attributes.get("name", "") if element.parent else ""
    return f"{body}_joint" if body else ""


def _numbers(text: str) -> np.ndarray:
    return np.array([float(x) for x in text.split()])


def _shifted(pi: np.ndarray, placement: pin.SE3) -> np.ndarray:
    """Return ten parameters in a frame in which their own is at `placement`."""
    body = Body.of(pi).at(placement)
    return _dynamic(body.mass, body.centre, body.inertia)


def _dynamic(m: float, c: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    L = inertia + m * (c @ c * np.eye(3) - np.outer(c, c))
    return np.array([m, *(m * c), L[0, 0], L[0, 1], L[1, 1], L[0, 2], L[1, 2], L[2, 2]])


def _angle(root: Element) -> str:
    return next(
        (c.attributes["angle"] for c in root.children
         if c.tag == "compiler" and "angle" in c.attributes), "degree",
    )  # fmt: skip


def _compiled_without_files(spec: Any, path: Path) -> Any:
    """Compile a model; where meshes or textures are missing here, as the reader does."""
    try:
        return spec.compile()
    except ValueError as error:
        if "opening file" not in str(error):
            raise
    from ident.formats.mjcf import _without_missing_files

    return _without_missing_files(path)[0]
