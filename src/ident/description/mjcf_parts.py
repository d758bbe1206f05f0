"""Parts of a compiled MuJoCo model: what bodies look like, what drives joints, what is left out."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from ident.description.document import Shape, words

if TYPE_CHECKING:
    import mujoco

SHOWN = 2  # the last group of shapes that MuJoCo shows unasked
SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH = range(2, 8)  # mjtGeom
EFFECTS = {  # what of a joint is an effect here
    "damping": "viscous", "frictionloss": "coulomb", "armature": "rotor_inertia",
    "stiffness": "spring",
}  # fmt: skip


def shapes_of(model: mujoco.MjModel, body: int, offset: pin.SE3, folder: Path) -> list[Shape]:
    """What a body looks like, by the shapes that a URDF has.

    Args:
        model: compiled.
        body: its number.
        offset: of MuJoCo's body frame in the link's.
        folder: of the model's file, to which meshes' names are relative.
    """
    found = []
    first = int(model.body_geomadr[body])
    for g in range(first, first + int(model.body_geomnum[body])):
        if model.geom_group[g] > SHOWN:
            continue
        kind, size = int(model.geom_type[g]), model.geom_size[g]
        at = offset * pose_of(model.geom_pos[g], model.geom_quat[g])
        if kind == SPHERE:
            found.append(Shape("sphere", {"radius": words(size[:1])}, at))
        elif kind in (CAPSULE, CYLINDER):  # a capsule is shown without its caps
            along = {"radius": words(size[:1]), "length": words(2 * size[1:2])}
            found.append(Shape("cylinder", along, at))
        elif kind in (ELLIPSOID, BOX):  # an ellipsoid as the box around it
            found.append(Shape("box", {"size": words(2 * size)}, at))
        elif kind == MESH and (file := _mesh_file(model, int(model.geom_dataid[g]), folder)):
            mesh = int(model.geom_dataid[g])
            at = at * pose_of(model.mesh_pos[mesh], model.mesh_quat[mesh]).inverse()
            scale = words(model.mesh_scale[mesh])
            found.append(Shape("mesh", {"filename": file, "scale": scale}, at))
    return found


def _mesh_file(model: mujoco.MjModel, mesh: int, folder: Path) -> str:
    at = int(model.mesh_pathadr[mesh])
    path = bytes(model.paths[at:]).split(b"\0")[0].decode() if at >= 0 else ""
    file = folder / path
    return Path(os.path.relpath(file, folder)).as_posix() if path and file.is_file() else ""


def undriven(model: mujoco.MjModel) -> list[int]:
    """Joints that nothing drives; none, where the file has no actuator at all."""
    driven = set()
    for kind, (target, _) in zip(model.actuator_trntype, model.actuator_trnid, strict=True):
        if kind in (0, 1):  # a joint
            driven.add(int(target))
        elif kind == 3:  # a tendon
            first = int(model.tendon_adr[target])
            wraps = range(first, first + int(model.tendon_num[target]))
            driven |= {int(model.wrap_objid[w]) for w in wraps if model.wrap_type[w] == 1}
    return [j for j in range(model.njnt) if j not in driven] if driven else []


def left_out(model: mujoco.MjModel, joints: Sequence[str]) -> list[str]:
    """What of the joints is no part of the mechanism, and which effect it would be, in words."""
    dofs = model.jnt_dofadr
    values: dict[str, Any] = {
        "damping": model.dof_damping[dofs], "frictionloss": model.dof_frictionloss[dofs],
        "armature": model.dof_armature[dofs], "stiffness": model.jnt_stiffness,
    }  # fmt: skip
    notes = []
    for word, effect in EFFECTS.items():
        having = [joints[int(j)] for j in np.flatnonzero(values[word])]
        if having:
            notes.append(
                f"{word} of {', '.join(having)} is not taken over; to identify it: --with "
                + (effect if len(having) > 1 else f"{effect}:{having[0]}")
            )
    return notes


def pose_of(position: np.ndarray, wxyz: Sequence[float] = (1.0, 0.0, 0.0, 0.0)) -> pin.SE3:
    """A placement from MuJoCo's position and quaternion."""
    w, x, y, z = (float(value) for value in wxyz)
    rotation = pin.Quaternion(w, x, y, z).normalized().matrix()
    return pin.SE3(rotation, np.array(position, dtype=float))
