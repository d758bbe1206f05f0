"""mechanism.toml written: an effect added, or a whole folder with everything identified as known.

What the user wrote stays as it is, comments included.
"""

from __future__ import annotations

import codecs
from collections.abc import Mapping, Sequence
from pathlib import Path

import tomlkit

from ident.effects import Effect
from ident.errors import MechanismError
from ident.files import write_all
from ident.mechanism.mechanism import Mechanism


def effect_table(effect: Effect, values: Mapping[str, float]) -> tomlkit.items.Table:
    """`[[effect]]` of an effect, with the values of unknowns that are known."""
    table = tomlkit.table()
    table["kind"] = effect.kind
    table["joint"] = ",".join(effect.joints)
    for name, value in values.items():
        table[name] = float(value)
    return table


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
    for effect in effects:
        tables.append(effect_table(effect, effect.values))
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
        urdf: the URDF's content.
        effects: with the values that are known of each.
        unknown: for [parameters]; None leaves it as it is.
    """
    document = document_of(mechanism)
    document["urdf"] = mechanism.urdf.name
    if unknown is not None:
        document["parameters"] = {"unknown": list(unknown)}
    if "effect" in document:
        del document["effect"]
    if effects:
        tables = tomlkit.aot()
        for effect, values in effects:
            tables.append(effect_table(effect, values))
        document["effect"] = tables
    files = {mechanism.urdf.name: urdf}
    for closure in document.get("closure", []):
        if closure.get("kind") == "function" and mechanism.toml is not None:
            file = mechanism.toml.parent / str(closure["file"])
            content = file.read_bytes()
            name = file.name  # it may be kept elsewhere; the copy stays in the folder
            if files.get(name, content) != content:
                name = f"{closure['name']}_{name}"
            closure["file"] = name
            files[name] = content
    files["mechanism.toml"] = tomlkit.dumps(document).encode()
    return files
