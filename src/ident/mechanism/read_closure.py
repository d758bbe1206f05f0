"""One [[closure]] table of mechanism.toml as a closure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ident.errors import MechanismError, one_of
from ident.files import module_of
from ident.mechanism.closures import (
    KINDS,
    OTHER_KINDS,
    AnyClosure,
    Closure,
    Frame,
    Function,
    Linear,
)
from ident.mechanism.settings import check_keys, number, text, vector, words

KEYS = {
    "point": ("a", "b", "axes"),
    "distance": ("a", "b", "length"),
    "linear": ("joints", "ratios", "offset"),
    "function": ("file", "function"),
}


def read_closure(
    table: Mapping[str, Any],
    where: str,
    model: pin.Model,
    rotational: Mapping[str, bool],
    folder: Path,
    allow_code: bool,
) -> AnyClosure:
    """A checked closure; `rotational` tells of every joint of the tree whether it turns."""
    name, kind = text(table, "name", where), text(table, "kind", where)
    where = f"{where} ('{name}')"
    if kind not in (*KINDS, *OTHER_KINDS):
        raise MechanismError(f"{where}: kind = '{kind}'; {one_of(kind, (*KINDS, *OTHER_KINDS))}")
    check_keys(table, ("name", "kind", *KEYS.get(kind, ("a", "b"))), where)
    if kind == "linear":
        return _linear(name, table, where, rotational)
    if kind == "function":
        return Function(name, _function(table, where, folder, allow_code))
    axes = text({"axes": "xyz", **table}, "axes", where)
    if not axes or set(axes) - set("xyz") or len(set(axes)) != len(axes):
        raise MechanismError(f"{where}: axes = '{axes}'; some of the letters xyz, each once")
    length = number(table, "length", where, 0.0)
    if kind == "distance" and not length > 0:
        raise MechanismError(f"{where}: length = {length:g} m; a distance needs one above 0")
    return Closure(
        name,
        kind,
        _frame(table, "a", where, model),
        _frame(table, "b", where, model),
        axes=axes,
        length=length,
    )


def _frame(table: Mapping[str, Any], key: str, where: str, model: pin.Model) -> Frame:
    if not isinstance(table.get(key), dict):
        raise MechanismError(
            f'{where}: {key} = {table.get(key)!r}; write {key} = {{ link = "…", xyz = [0, 0, 0] }}'
        )
    inner, where = table[key], f"{where}: {key}"
    check_keys(inner, ("link", "xyz", "rpy"), where)
    xyz = np.array(vector(inner, "xyz", where, 3, (0.0, 0.0, 0.0)))
    rpy = vector(inner, "rpy", where, 3, (0.0, 0.0, 0.0))
    return find_frame(
        model, text(inner, "link", where), where, pin.SE3(pin.rpy.rpyToMatrix(*rpy), xyz)
    )


def find_frame(model: pin.Model, link: str, where: str, placement: pin.SE3) -> Frame:
    """A frame at `placement` in the link's own frame; "world" is the ground.

    Raises:
        MechanismError: if the mechanism has no such link.
    """
    links = [f.name for f in model.frames if f.type == pin.FrameType.BODY]
    if link in links:
        frame = model.frames[model.getFrameId(link, pin.FrameType.BODY)]
        return Frame(link, frame.parentJoint, frame.placement * placement)
    if link == "world":
        return Frame(link, 0, placement)
    raise MechanismError(f"{where}: no link '{link}'; {one_of(link, [*links, 'world'])}")


def _linear(
    name: str, table: Mapping[str, Any], where: str, rotational: Mapping[str, bool]
) -> Linear:
    joints = words(table, "joints", where) or ()
    ratios = vector(table, "ratios", where, 0, None)
    if len(joints) < 2 or len(ratios) != len(joints) or len(set(joints)) != len(joints):
        raise MechanismError(
            f"{where}: {len(joints)} joints and {len(ratios)} ratios; two or more different joints "
            "with one ratio each are expected"
        )
    for joint in joints:
        if joint not in rotational:
            raise MechanismError(f"{where}: no joint '{joint}'; {one_of(joint, rotational)}")
    if 0.0 in ratios:
        raise MechanismError(f"{where}: ratios = {list(ratios)}; a ratio of 0 ties nothing")
    offset = number(table, "offset", where, 0.0)
    return Linear(name, tuple(joints), tuple(ratios), offset, rotational[joints[0]])


def _function(
    table: Mapping[str, Any], where: str, folder: Path, allow_code: bool
) -> Callable[..., Any]:
    file, name = folder / text(table, "file", where), text(table, "function", where)
    if not allow_code:
        raise MechanismError(
            f"{where}: would run {file}; pass --allow-code (allow_code=True) if you trust it"
        )
    if not file.is_file():
        raise MechanismError(f"{where}: file = '{table['file']}': no such file in {folder}")
    try:
        module = module_of(file)
    except (Exception, SystemExit) as error:
        raise MechanismError(f"{where}: {file} fails: {type(error).__name__}: {error}") from None
    if not callable(getattr(module, name, None)):
        raise MechanismError(f"{where}: {file} has no function '{name}'")
    return getattr(module, name)
