"""A MuJoCo model (MJCF) as a URDF with closures, from what MuJoCo's own compiler makes of it.

Pinocchio reads MJCF too, but not all of it as MuJoCo does: several joints of one body lose their
names, and limits of sliding joints are read as degrees.

    body frame = parent · body pose · Π [ T(anchor) · joint motion(q − ref) · T(−anchor) ]

A URDF's link has its origin at its joint: at the anchor of the body's last one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ident.description.document import Document, Limits, Solid, Source
from ident.description.mjcf_closures import closures_of
from ident.description.mjcf_file import compiled
from ident.description.mjcf_parts import left_out, pose_of, shapes_of, undriven
from ident.errors import MechanismError

if TYPE_CHECKING:
    import mujoco

HINGE, SLIDE = 3, 2  # mjtJoint


def read_mjcf(path: Path, data: bytes) -> Source:
    """A MuJoCo model's bodies, joints and equalities.

    Args:
        path: of the file; what it includes is beside it.
        data: its text.

    Raises:
        MechanismError: if MuJoCo is not installed or refuses the file, and for what has no
            counterpart here: ball and free joints, equalities of tendons and flexible bodies.
    """
    model, said = compiled(path, data)
    source = Reader(model, str(path)).source()
    return replace(source, notes=(*said, *source.notes))


@dataclass(frozen=True, eq=False)
class Reader:
    """One compiled model and what is made of it; bodies and joints by MuJoCo's numbers."""

    model: mujoco.MjModel
    where: str

    def source(self) -> Source:
        """All of it."""
        document = Document(self.model_name, "written from a MuJoCo model")
        document.link("world")
        for body in range(1, self.model.nbody):
            self._add(document, body)
        closures, said = closures_of(
            self.model, self.names, self.joint_names, self.offsets, self.where
        )
        passive = tuple(self.joint_names[j] for j in undriven(self.model))
        gx, gy, gz = self.model.opt.gravity
        return Source(
            urdf=document.text(),
            format="mjcf",
            closures=closures,
            passive=passive,
            start={
                self.joint_names[j]: float(self.model.qpos0[self.model.jnt_qposadr[j]])
                for j in range(self.model.njnt)
            },
            gravity=(float(gx), float(gy), float(gz)),
            auxiliary=tuple(name for links in self.steps.values() for name in links),
            notes=(*self._notes(passive), *said),
        )

    @cached_property
    def model_name(self) -> str:
        """The model's own, or the file's."""
        first = bytes(self.model.names).split(b"\0")[0].decode()
        return first if first not in ("", "MuJoCo Model") else Path(self.where).stem

    @cached_property
    def names(self) -> list[str]:
        """The links' names; a body without one gets a number."""
        named = [self.model.body(i).name for i in range(self.model.nbody)]
        return [name or _free(f"body_{i}", named) for i, name in enumerate(named)]

    @cached_property
    def joint_names(self) -> list[str]:
        """The joints' names; one without a name gets its body's."""
        named = [self.model.joint(j).name for j in range(self.model.njnt)]
        for j, name in enumerate(named):
            if not name:
                named[j] = _free(f"{self.names[self.model.jnt_bodyid[j]]}_joint", named)
        return named

    @cached_property
    def steps(self) -> Mapping[int, list[str]]:
        """The massless links between a body's joints, by body."""
        found = {}
        for body in range(self.model.nbody):
            joints = self.joints(body)[:-1]
            found[body] = [_free(f"{self.joint_names[j]}_link", self.names) for j in joints]
        return found

    @cached_property
    def offsets(self) -> list[pin.SE3]:
        """By body, where its MuJoCo frame stands in its link's."""
        anchors = [self.joints(body)[-1:] for body in range(self.model.nbody)]
        return [_shift(-self.model.jnt_pos[j[0]]) if j else pin.SE3.Identity() for j in anchors]

    def joints(self, body: int) -> list[int]:
        """A body's joints, in the order in which they act."""
        first = int(self.model.body_jntadr[body])
        return list(range(first, first + int(self.model.body_jntnum[body])))

    def _add(self, document: Document, body: int) -> None:
        m, joints = self.model, self.joints(body)
        parent = int(m.body_parentid[body])
        placement = self.offsets[parent] * pose_of(m.body_pos[body], m.body_quat[body])
        links = [self.names[parent], *self.steps[body], self.names[body]]
        for name in self.steps[body]:
            document.link(name)
        inertia = Solid(float(m.body_mass[body]), np.zeros(3), np.diag(m.body_inertia[body]))
        own = self.offsets[body] * pose_of(m.body_ipos[body], m.body_iquat[body])
        shapes = shapes_of(m, body, self.offsets[body], Path(self.where).parent)
        document.link(self.names[body], inertia.moved(own), shapes)
        if not joints:
            ends = (self.names[parent], self.names[body])
            document.joint(_free(f"{ends[1]}_fixed", self.joint_names), "fixed", ends, placement)
        for k, j in enumerate(joints):
            kind = int(m.jnt_type[j])
            if kind not in (HINGE, SLIDE):
                what, remedy = (
                    ("a free joint", "fix its body to the world, or state it as three slides and")
                    if kind == 0
                    else ("a ball joint", "state it as")
                )
                raise MechanismError(
                    f"{self.where}: body '{self.names[body]}' has {what}, whose orientation is no "
                    f"column of a log; {remedy} three hinges in one body"
                )
            axis, ref = m.jnt_axis[j], float(m.qpos0[m.jnt_qposadr[j]])
            turn = pin.exp3(-ref * axis) if kind == HINGE else np.eye(3)
            back = pin.SE3(turn, np.zeros(3) if kind == HINGE else -ref * axis)
            at = placement * _shift(m.jnt_pos[j]) * back
            limits = self._limits(j)
            name = "prismatic" if kind == SLIDE else "revolute"
            if kind == HINGE and not np.isfinite(limits.lower):
                name = "continuous"
            document.joint(self.joint_names[j], name, (links[k], links[k + 1]), at, axis, limits)
            placement = _shift(-m.jnt_pos[j])

    def _limits(self, j: int) -> Limits:
        m = self.model
        effort = float(m.jnt_actfrcrange[j][1]) if m.jnt_actfrclimited[j] else np.inf
        if not m.jnt_limited[j]:
            return Limits(effort=effort)
        return Limits(float(m.jnt_range[j][0]), float(m.jnt_range[j][1]), effort=effort)

    def _notes(self, passive: tuple[str, ...]) -> list[str]:
        notes = []
        if passive:
            notes.append(
                f"{', '.join(passive)}: no actuator, so passive (no torque); [joints] passive in a "
                "mechanism.toml says otherwise"
            )
        notes += left_out(self.model, self.joint_names)
        away = [self.names[i] for i, at in enumerate(self.offsets) if np.any(at.translation)]
        if away:
            notes.append(f"{', '.join(away)}: the link's origin is at its joint, not at the body's")
        return notes


def _free(name: str, taken: list[str]) -> str:
    while name in taken:
        name += "_"
    return name


def _shift(by: np.ndarray) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array(by, dtype=float))
