"""Files written: mechanism.toml with further effects or known values, inertias of a URDF.

What the user wrote stays as it is, comments included: as little of the text is changed as will do.
"""

from __future__ import annotations

import codecs
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import tomlkit
from lxml import etree

from ident.effects import KINDS, Effect
from ident.errors import MechanismError
from ident.files import write_all
from ident.mechanism.description import Description, description_of, read_description, words
from ident.mechanism.load import stated
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import COUNT, about_origin, join, split
from ident.mechanism.urdf import PRODUCTS, UrdfText, numbers

TERMS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
UPPER = np.triu_indices(3)


def add_effects(mechanism: Mechanism, effects: Sequence[Effect]) -> Path:
    """Append effects to the mechanism.toml, which a bare URDF gets beside it; return its path.

    An effect that was there with known values is replaced.
    """
    path = mechanism.toml or mechanism.urdf.parent / "mechanism.toml"
    if mechanism.toml is None and path.exists():
        raise MechanismError(
            f"{path}: is there already; give it (or its folder) instead of {mechanism.urdf.name}"
        )
    document = _document(mechanism)
    tables = document.get("effect")
    if not isinstance(tables, tomlkit.items.AoT):  # [[effect]] does not fit behind an array in line
        tables = _array(document.pop("effect", []))
        document["effect"] = tables
    new = {effect.label for effect in effects}
    for i, effect in reversed(list(enumerate(mechanism.effects[: len(tables)]))):
        if effect.label in new:
            del tables[i]
    for effect in effects:
        file = _own_file(effect)
        beside = None if file is None else Path(os.path.relpath(file, path.parent)).as_posix()
        tables.append(tomlkit.item(_effect_table(effect, effect.values, beside)))
    write_all(path.parent, {path.name: tomlkit.dumps(document).encode()})
    return path


def folder_files(
    mechanism: Mechanism,
    urdf: bytes,
    effects: Sequence[tuple[Effect, Mapping[str, float]]],
    unknown: Sequence[str] | None,
) -> dict[str, bytes]:
    """Return a mechanism folder's files by name, its mechanism.toml taken over from a mechanism.

    `urdf` is the content of the URDF, or of the file in its place; `effects` come with their known
    values; `unknown` is for [parameters], where None leaves it as it is.
    """
    document = _document(mechanism)
    source = read_description(mechanism.urdf)
    urdf_name = mechanism.urdf.name
    if source.format != "urdf":  # mechanism.toml takes over the loops of the file
        urdf = description_of(urdf, mechanism.urdf).urdf
        urdf_name = mechanism.urdf.with_suffix(".urdf").name
        _spell_out(document, mechanism, source)
    document["urdf"] = urdf_name
    if unknown is not None:
        document["parameters"] = {"unknown": list(unknown)}
    files = {urdf_name: urdf}
    for closure in document.get("closure", []):
        if "file" in closure and mechanism.toml is not None:
            file = mechanism.toml.parent / str(closure["file"])
            closure["file"] = _copied(files, file, str(closure["name"]))
    document.pop("effect", None)
    tables = []
    for effect, values in effects:
        own = _own_file(effect)
        name = None if own is None else _copied(files, own, effect.kind)
        tables.append(_effect_table(effect, values, name))
    if tables:
        document["effect"] = _array(tables)
    files["mechanism.toml"] = tomlkit.dumps(document).encode()
    return files


def _document(mechanism: Mechanism) -> tomlkit.TOMLDocument:
    if mechanism.toml is not None:
        raw = mechanism.toml.read_bytes()  # not as text, which would change the ends of lines
        return tomlkit.parse(raw.removeprefix(codecs.BOM_UTF8))
    document = tomlkit.document()
    document["urdf"] = mechanism.urdf.name
    return document


def _array(tables: Iterable[Mapping[str, Any]]) -> tomlkit.items.AoT:
    array = tomlkit.aot()
    for table in tables:
        array.append(tomlkit.item({**table}))
    return array


def _effect_table(effect: Effect, values: Mapping[str, float], file: str | None) -> dict[str, Any]:
    settings = {name: effect.values[name] for name in effect.settings if name in effect.values}
    table: dict[str, Any] = {"kind": effect.kind}
    table |= {} if file is None else {"file": file}
    table |= {"joint": ",".join(effect.joints)} if effect.joints else {}
    return table | {name: float(value) for name, value in {**settings, **values}.items()}


def _own_file(effect: Effect) -> Path | None:
    if effect.kind in KINDS:
        return None
    if effect.file is None:
        raise MechanismError(
            f"effect '{effect.label}': its function is in no file, so no mechanism.toml can name "
            "it; write the function into a .py file and read it with ident.read_user_effect"
        )
    return effect.file


def _spell_out(document: tomlkit.TOMLDocument, mechanism: Mechanism, source: Description) -> None:
    data = stated(document, source)
    document.setdefault("gravity", data["gravity"])
    if data["joints"]:
        joints = tomlkit.table()
        for key, value in data["joints"].items():
            joints[key] = value
            if isinstance(value, dict):
                joints[key] = tomlkit.inline_table()
                joints[key].update(value)
        document["joints"] = joints
    if source.auxiliary and "unknown" not in document.get("parameters", {}):
        asked = [link for link in mechanism.bodies.links if link not in source.auxiliary]
        document.setdefault("parameters", tomlkit.table())["unknown"] = asked
    if tables := [*source.closures, *document.pop("closure", [])]:
        document["closure"] = _array(tables)


def _copied(files: dict[str, bytes], file: Path, owner: str) -> str:
    content, name = file.read_bytes(), file.name
    if files.get(name, content) != content:
        name = f"{owner}_{name}"
    files[name] = content
    return name


def fixed_parameters(robot: etree._Element, link: str) -> np.ndarray:
    """Return the ten dynamic parameters (10,) that links fixed to `link` add to its body."""
    total = np.zeros(COUNT)
    links = {element.get("name"): element for element in robot.findall("link")}
    for joint in robot.findall("joint"):
        if joint.get("type") != "fixed" or joint.find("parent").get("link") != link:
            continue
        child = joint.find("child").get("link")
        pi = _own_parameters(links[child]) + fixed_parameters(robot, child)
        if np.any(pi):
            inertia = pin.Inertia.FromDynamicParameters(pi)
            total += _placement(joint.find("origin")).act(inertia).toDynamicParameters()
    return total


def _own_parameters(link: etree._Element) -> np.ndarray:
    inertial = link.find("inertial")
    if inertial is None:
        return np.zeros(COUNT)
    place = _placement(inertial.find("origin"))
    I = np.zeros((3, 3))  # noqa: E741
    I[UPPER] = [numbers(inertial.find("inertia"), key, "0", 1, "")[0] for key in TERMS]
    I = place.rotation @ (I + np.triu(I, 1).T) @ place.rotation.T  # noqa: E741
    m = numbers(inertial.find("mass"), "value", "0", 1, "")[0]
    moments = m * place.translation
    # not by pin.Inertia, which refuses the tensors of impossible bodies; files have them
    return join(m, moments, I + about_origin(m, moments))


def _placement(origin: etree._Element | None) -> pin.SE3:
    if origin is None:
        return pin.SE3.Identity()
    rpy = numbers(origin, "rpy", "0 0 0", 3, "")
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(numbers(origin, "xyz", "0 0 0", 3, "")))


def set_inertial(text: UrdfText, link: etree._Element, pi: np.ndarray) -> None:
    """Give a link ten dynamic parameters (10,) in its frame, by as few changes as will do.

    A link that has no `<inertial>` gets one.
    """
    m, moments, L = split(pi)
    centre = moments / m if m else np.zeros(3)
    terms = dict(zip(TERMS, (L - about_origin(m, moments))[UPPER], strict=True))
    inertial = link.find("inertial")
    if inertial is None:
        lines = [
            "<inertial>",
            f'  <origin xyz="{words(centre)}" rpy="0 0 0"/>',
            f'  <mass value="{words([m])}"/>',
            "  <inertia " + " ".join(f'{key}="{words([x])}"' for key, x in terms.items()) + "/>",
            "</inertial>",
        ]
        if np.any(pi):
            text.insert(link, lines)
        return
    origin = inertial.find("origin")
    if origin is not None:
        new = _other(origin, "xyz", centre, "0 0 0") | _other(origin, "rpy", np.zeros(3), "0 0 0")
        text.set(origin, new)
    elif np.any(centre):
        text.insert(inertial, [f'<origin xyz="{words(centre)}" rpy="0 0 0"/>'])
    mass, tensor = inertial.find("mass"), inertial.find("inertia")
    text.set(mass, _other(mass, "value", [m], ""))
    new = {}
    for key, value in terms.items():
        new |= _other(tensor, key, [value], "0" if key in PRODUCTS else "")
    text.set(tensor, new)


def _other(
    element: etree._Element, key: str, values: Sequence[float] | np.ndarray, default: str
) -> dict[str, str]:
    if numbers(element, key, default, len(values), "") == [float(x) for x in values]:
        return {}
    return {key: words(values)}
