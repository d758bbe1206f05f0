"""MuJoCo's equalities as closures: connect is a point, weld is fixed, a joint's line is linear."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import pinocchio as pin

from ident.description.document import place_table
from ident.description.mjcf_parts import pose_of
from ident.errors import MechanismError

if TYPE_CHECKING:
    import mujoco

CONNECT, WELD, JOINT = 0, 1, 2  # mjtEq
SITE = 6  # mjtObj
KINDS = {3: "tendon", 4: "flex"}


def closures_of(
    model: mujoco.MjModel,
    links: Sequence[str],
    joints: Sequence[str],
    offsets: Sequence[pin.SE3],
    where: str,
) -> tuple[tuple[dict[str, Any], ...], list[str]]:
    """The tables [[closure]] of a model's equalities, and notes.

    Args:
        model: compiled.
        links: names by body.
        joints: names by joint.
        offsets: by body, where MuJoCo's body frame stands in the link's.
        where: names the file in messages.

    Raises:
        MechanismError: for kinds that are no closure here.
    """
    found, notes = [], []
    for e in range(model.neq):
        name = model.equality(e).name or f"equality_{e + 1}"
        if not model.eq_active0[e]:
            notes.append(f"equality '{name}' is inactive and left out")
            continue
        kind = int(model.eq_type[e])
        if kind == JOINT:
            table = _linear(model, e, joints, f"{where}: equality '{name}'")
        elif kind in (CONNECT, WELD):
            table = _frames(model, e, links, offsets)
        else:
            raise MechanismError(
                f"{where}: equality '{name}' is of kind {KINDS.get(kind, kind)}; valid: connect, "
                'weld, joint; set active="false", and write a [[closure]] in a mechanism.toml'
            )
        found.append({"name": name, **table})
    return tuple(found), notes


def _frames(
    model: mujoco.MjModel, e: int, links: Sequence[str], offsets: Sequence[pin.SE3]
) -> dict[str, Any]:
    kind, data = int(model.eq_type[e]), model.eq_data[e]
    ids = [int(model.eq_obj1id[e]), int(model.eq_obj2id[e])]
    if int(model.eq_objtype[e]) == SITE:
        bodies = [int(model.site_bodyid[i]) for i in ids]
        at = [pose_of(model.site_pos[i], model.site_quat[i]) for i in ids]
    elif kind == CONNECT:
        bodies, at = ids, [pose_of(data[0:3]), pose_of(data[3:6])]
    else:  # the anchor in body 2, and where that is in body 1
        bodies, at = ids, [pose_of(data[3:6], data[6:10]), pose_of(data[0:3])]
    if kind == CONNECT:
        at = [pose_of(each.translation) for each in at]
    a, b = (
        place_table(links[body], offsets[body] * place)
        for body, place in zip(bodies, at, strict=True)
    )
    if kind == CONNECT:
        a, b = ({"link": end["link"], "xyz": end["xyz"]} for end in (a, b))
    return {"kind": "point" if kind == CONNECT else "fixed", "a": a, "b": b}


def _linear(model: mujoco.MjModel, e: int, joints: Sequence[str], where: str) -> dict[str, Any]:
    """q1 − ref1 = c0 + c1 (q2 − ref2), MuJoCo's with its higher terms zero."""
    one, two = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
    c0, c1, *higher = (float(x) for x in model.eq_data[e][:5])
    if two < 0 or c1 == 0:
        raise MechanismError(
            f"{where} holds joint '{joints[one]}' where it is; remove the joint from its body"
        )
    if any(higher):
        raise MechanismError(
            f"{where} is a curve, polycoef = {[c0, c1, *higher]}; only straight ones are read: "
            "write it as a [[closure]] of kind function"
        )
    ref = [float(model.qpos0[model.jnt_qposadr[j]]) for j in (one, two)]
    return {
        "kind": "linear",
        "joints": [joints[one], joints[two]],
        "ratios": [1.0, -c1],
        "offset": ref[0] + c0 - c1 * ref[1],
    }
