"""mechanism.toml written, with further effects or known values.

What the user wrote stays as it is, comments included: as little of the text is changed as will do.
"""

from __future__ import annotations

import codecs
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import tomlkit

from ident.effects import KINDS, Effect
from ident.effects.effect import Estimates
from ident.errors import MechanismError
from ident.files import write_all
from ident.mechanism.description import Description, description_of
from ident.mechanism.load import source_of, stated
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.parameters import Covariance


def add_effects(mechanism: Mechanism, effects: Sequence[Effect]) -> Path:
    """Append effects to the mechanism.toml, which a bare URDF gets beside it; return its path.

    One that was there with known values is replaced. Python files are copied beside it.
    """
    path = mechanism.toml or mechanism.urdf.parent / "mechanism.toml"
    if mechanism.toml is None and path.exists():
        raise MechanismError(
            f"{path}: is there already; give it (or its folder) instead of {mechanism.urdf.name}"
        )
    new = {effect.label for effect in effects}
    others = [effect for effect in mechanism.effects if effect.label not in new]
    replace(mechanism, effects=(*others, *effects)).check_required()
    document = _document(mechanism)
    tables = document.get("effect")
    if not isinstance(tables, tomlkit.items.AoT):  # [[effect]] does not fit behind an array in line
        tables = _array(document.pop("effect", []))
        document["effect"] = tables
    for i, effect in reversed(list(enumerate(mechanism.effects[: len(tables)]))):
        if effect.label in new:
            del tables[i]
    files: dict[str, bytes] = {}
    for effect in effects:
        file = _file_in_folder(path.parent, effect, files)
        tables.append(tomlkit.item(_effect_table(effect, effect.values, file)))
    write_all(path.parent, {**files, path.name: tomlkit.dumps(document).encode()})
    return path


def _file_in_folder(folder: Path, effect: Effect, files: dict[str, bytes]) -> str | None:
    """Return the path of an effect's file within a mechanism's folder, where it is copied if it is
    not, as results' folders are written again; None of an effect of the library.
    """
    if effect.file and effect.file.resolve().is_relative_to(folder.resolve()):
        return Path(os.path.relpath(effect.file, folder)).as_posix()
    definition = definition_file(effect)
    if definition is None:
        return None
    target = folder / definition[0]
    if target.exists() and target.read_bytes() != definition[1]:
        files.setdefault(definition[0], target.read_bytes())
    return _copied(files, *definition, effect.kind)


def folder_files(
    mechanism: Mechanism,
    urdf: bytes,
    effects: Sequence[tuple[Effect, Mapping[str, float]]],
    unknown: Sequence[str] | None,
    estimates: Mapping[str, Estimates],
    covariance: Covariance | None = None,
) -> dict[str, bytes]:
    """Return a mechanism folder's files by name, its mechanism.toml taken over from a mechanism.

    `urdf` is the content of the URDF, or of the file in its place; `effects` come with their known
    values; `unknown` None leaves [parameters] as they are; of `estimates` a law's file is written.
    """
    document = _document(mechanism)
    source = source_of(mechanism)
    urdf_name = mechanism.urdf.name
    if source.format != "urdf":  # mechanism.toml takes over the loops of the file
        if b"<robot" not in urdf:
            urdf = description_of(urdf, mechanism.urdf).urdf
        elif urdf == mechanism.urdf.read_bytes():  # as it is there, without what is beside it
            urdf = source.urdf
        urdf_name = mechanism.urdf.with_suffix(".urdf").name
        _spell_out(document, mechanism, source)
    if start := mechanism.found_start:  # the loops need not be assembled from afar again
        joints, table = document.get("joints", {}), tomlkit.inline_table()
        table.update(start | {**joints.get("start", {})})
        document.setdefault("joints", tomlkit.table())["start"] = table
    document["urdf"] = urdf_name
    if unknown is None and document.get("parameters", {}).get("unknown") == []:
        unknown = mechanism.unknown  # of the folder of a fit, in which all is known
    if mechanism.idle and unknown is None and "unknown" not in document.get("parameters", {}):
        document.setdefault("parameters", tomlkit.table())["unknown"] = [*mechanism.unknown]
    if unknown is not None:
        document["parameters"] = {"unknown": list(unknown)}
    files = {urdf_name: urdf}
    if covariance is not None:
        document.setdefault("parameters", {})["covariance"] = "covariance.csv"
        files["covariance.csv"] = covariance.csv()
    else:
        document.get("parameters", {}).pop("covariance", None)
    for closure in document.get("closure", []):
        if "file" in closure and mechanism.toml is not None:
            file = mechanism.toml.parent / str(closure["file"])
            closure["file"] = _copied(files, file.name, file.read_bytes(), str(closure["name"]))
    for key in ("effect", "drives"):  # all effects are written, drives among them
        document.pop(key, None)
    tables = []
    for effect, values in effects:
        definition = definition_file(effect, estimates.get(effect.label, {}))
        name = None if definition is None else _copied(files, *definition, effect.kind)
        tables.append(_effect_table(effect, values, name))
    if tables:
        document["effect"] = _array(tables)
    files["mechanism.toml"] = tomlkit.dumps(document).encode()
    return files


def understood_files(mechanism: Mechanism) -> dict[str, bytes]:
    """Return the files of a folder that states what was understood of a mechanism's file: a URDF,
    and a mechanism.toml with its loops, passive joints and the start that closes them.
    """
    effects = [(effect, effect.values) for effect in mechanism.effects]
    return folder_files(mechanism, source_of(mechanism).urdf, effects, None, {})


def _document(mechanism: Mechanism) -> tomlkit.TOMLDocument:
    if mechanism.toml is not None:
        raw = mechanism.toml.read_bytes()  # not as text, which would change the ends of lines
        document = tomlkit.parse(raw.removeprefix(codecs.BOM_UTF8))
    else:
        document = tomlkit.document()
        document["urdf"] = mechanism.urdf.name
    joints = document.get("joints", {})
    if missing := {k: x for k, x in mechanism.locked.items() if k not in joints.get("locked", {})}:
        locked = tomlkit.inline_table()
        locked.update({**joints.get("locked", {}), **missing})
        document.setdefault("joints", tomlkit.table())["locked"] = locked
    if {*mechanism.unmeasured} - {*joints.get("unmeasured", [])}:
        document.setdefault("joints", tomlkit.table())["unmeasured"] = [*mechanism.unmeasured]
    return document


def _array(tables: Iterable[Mapping[str, Any]]) -> tomlkit.items.AoT:
    array = tomlkit.aot()
    for table in tables:
        array.append(tomlkit.item({**table}))
    return array


def _effect_table(effect: Effect, values: Mapping[str, float], file: str | None) -> dict[str, Any]:
    words = {
        "kind": effect.kind, "file": file,
        "frame" if effect.sits == "frame" else "joint": ",".join(effect.joints),
        "signal": effect.signal,
        "per": "" if effect.log else effect.per, "log": effect.log,
    }  # fmt: skip
    settings = {name: effect.values[name] for name in effect.settings if name in effect.values}
    numbers = {name: float(value) for name, value in {**settings, **values}.items()}
    return {**{key: word for key, word in words.items() if word}, **numbers}


def definition_file(effect: Effect, estimates: Estimates | None = None) -> tuple[str, bytes] | None:
    """Return name and content of the file that defines an effect; None of one of the library."""
    if effect.kind in KINDS:
        return None
    definition = effect.source_file(estimates or {})
    if definition is None:
        raise MechanismError(
            f"effect '{effect.label}': its function is in no file, so no mechanism.toml can name "
            "it; write the function into a .py file and read it with ident.read_user_effect"
        )
    return definition


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
        massless = {*source.auxiliary, *(motor.link for motor in mechanism.motors)}
        asked = [link for link in mechanism.bodies.links if link not in massless]
        document.setdefault("parameters", tomlkit.table())["unknown"] = asked
    if source.motors and "motors" not in document:
        document["motors"] = {name: dict(ratios) for name, ratios in source.motors.items()}
    if tables := [*source.closures, *document.pop("closure", [])]:
        document["closure"] = _array(tables)


def _copied(files: dict[str, bytes], name: str, content: bytes, owner: str) -> str:
    if files.get(name, content) != content:
        name = f"{owner}_{name}"
    files[name] = content
    return name
