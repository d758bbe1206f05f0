"""mechanism.toml written: an effect added, or a whole folder with everything identified as known.

What the user wrote stays as it is, comments included.
"""

from __future__ import annotations

import codecs
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import tomlkit

from ident.description.document import Source
from ident.description.urdf import read_source, source_of
from ident.effects import Effect, UserEffect
from ident.errors import MechanismError
from ident.files import write_all
from ident.mechanism.mechanism import Mechanism
from ident.mechanism.settings import Settings, with_source


def effect_table(
    effect: Effect, values: Mapping[str, float], file: str | None = None
) -> tomlkit.items.Table:
    """`[[effect]]` of an effect, with its settings and the values of parameters that are known.

    Args:
        effect: the effect.
        values: by short name.
        file: of a user's own effect, relative to the folder.
    """
    table = tomlkit.table()
    table["kind"] = effect.kind
    if file is not None:
        table["file"] = file
    if effect.joints:
        table["joint"] = ",".join(effect.joints)
    settings = {name: effect.values[name] for name in effect.settings if name in effect.values}
    for name, value in {**settings, **values}.items():
        table[name] = float(value)
    return table


def own_file(effect: Effect) -> Path | None:
    """The Python file of a user's own effect.

    Raises:
        MechanismError: for one whose function came from no file.
    """
    if not isinstance(effect, UserEffect):
        return None
    if effect.file is None:
        raise MechanismError(
            f"effect '{effect.label}': its function is in no file, so no mechanism.toml can name "
            "it; write the function into a .py file and read it with ident.read_user_effect"
        )
    return effect.file


def document_of(mechanism: Mechanism) -> tomlkit.TOMLDocument:
    """The mechanism's own mechanism.toml, or a new one for a bare URDF."""
    if mechanism.toml is not None:
        raw = mechanism.toml.read_bytes()  # not as text, which would change the ends of lines
        return tomlkit.parse(raw.removeprefix(codecs.BOM_UTF8))
    document = tomlkit.document()
    document["urdf"] = mechanism.urdf.name
    return document


def add_effects(mechanism: Mechanism, effects: Sequence[Effect]) -> Path:
    """Append effects to the mechanism.toml; a bare URDF gets one beside it.

    One that was there with known values is replaced.

    Returns:
        The file written.

    Raises:
        MechanismError: if a bare URDF's folder has a mechanism.toml of something else.
    """
    path = mechanism.toml or mechanism.urdf.parent / "mechanism.toml"
    if mechanism.toml is None and path.exists():
        raise MechanismError(
            f"{path}: is there already; give it (or its folder) instead of {mechanism.urdf.name}"
        )
    document = document_of(mechanism)
    tables = document.get("effect", tomlkit.aot())
    if "effect" not in document or not isinstance(tables, tomlkit.items.AoT):
        present = document.pop("effect", [])  # written in line: a [[effect]] would not fit behind
        tables = tomlkit.aot()
        for each in present:
            tables.append(tomlkit.item({**each}))
        document["effect"] = tables
    new = {effect.label for effect in effects}
    for i in reversed(range(len(tables))):
        if i < len(mechanism.effects) and mechanism.effects[i].label in new:
            del tables[i]
    for effect in effects:
        file = own_file(effect)
        beside = None if file is None else Path(os.path.relpath(file, path.parent)).as_posix()
        tables.append(effect_table(effect, effect.values, beside))
    write_all(path.parent, {path.name: tomlkit.dumps(document).encode()})
    return path


def folder_files(
    mechanism: Mechanism,
    urdf: bytes,
    effects: Sequence[tuple[Effect, Mapping[str, float]]],
    unknown: Sequence[str] | None,
) -> dict[str, bytes]:
    """A mechanism folder's files by name.

    Args:
        mechanism: whose mechanism.toml is taken over.
        urdf: the URDF's content, or that of the file in its place.
        effects: with the values that are known of each.
        unknown: for [parameters]; None leaves it as it is.
    """
    document = document_of(mechanism)
    source = read_source(mechanism.urdf)
    urdf_name = mechanism.urdf.name
    if source.format != "urdf":  # what the file says of loops is said in mechanism.toml from now on
        urdf = source_of(urdf, mechanism.urdf).urdf
        urdf_name = mechanism.urdf.with_suffix(".urdf").name
        _spell_out(document, mechanism, source)
    document["urdf"] = urdf_name
    if unknown is not None:
        document["parameters"] = {"unknown": list(unknown)}
    if "effect" in document:
        del document["effect"]
    files = {urdf_name: urdf}
    for closure in document.get("closure", []):
        if closure.get("kind") == "function" and mechanism.toml is not None:
            file = mechanism.toml.parent / str(closure["file"])
            closure["file"] = _copied(files, file, str(closure["name"]))
    if effects:
        tables = tomlkit.aot()
        for effect, values in effects:
            own = own_file(effect)
            name = None if own is None else _copied(files, own, effect.kind)
            tables.append(effect_table(effect, values, name))
        document["effect"] = tables
    files["mechanism.toml"] = tomlkit.dumps(document).encode()
    return files


def _spell_out(document: tomlkit.TOMLDocument, mechanism: Mechanism, source: Source) -> None:
    """Everything that a MuJoCo model or an SDF says beside its bodies and joints."""
    settings = with_source(Settings("", Path(), Path(), joints=document.get("joints", {})), source)
    if "gravity" not in document:
        document["gravity"] = list(settings.gravity or ())
    joints = tomlkit.table()
    for key, value in settings.joints.items():
        if isinstance(value, dict):
            inline = tomlkit.inline_table()
            inline.update(value)
            joints[key] = inline
        else:
            joints[key] = value
    if settings.joints:
        document["joints"] = joints
    asked = [link for link in mechanism.bodies.links if link not in source.auxiliary]
    if source.auxiliary and "unknown" not in document.get("parameters", {}):
        document.setdefault("parameters", tomlkit.table())["unknown"] = asked
    tables = tomlkit.aot()
    for table in (*source.closures, *document.pop("closure", [])):
        tables.append(tomlkit.item({**table}))
    if len(tables):
        document["closure"] = tables


def _copied(files: dict[str, bytes], file: Path, owner: str) -> str:
    """The name under which a Python file, kept elsewhere perhaps, is in the folder now."""
    content, name = file.read_bytes(), file.name
    if files.get(name, content) != content:
        name = f"{owner}_{name}"
    files[name] = content
    return name
