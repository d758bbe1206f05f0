"""mechanism.toml as it is read: every key checked, every fault named with its place."""

from __future__ import annotations

import codecs
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ident.description.document import Source
from ident.errors import MechanismError, near, not_there, one_of

TOP = ("urdf", "gravity", "joints", "closure", "parameters", "multipliers", "log", "effect")
GRAVITY = (0.0, 0.0, -9.81)
HUGE = 1e30
FORMATS = (".urdf", ".xml", ".mjcf", ".sdf", ".world")


@dataclass(frozen=True)
class Settings:
    """The sections of a mechanism.toml, with the place each error message names.

    `beside` are closures that the URDF's place holds itself, as MuJoCo models and SDFs may.
    """

    where: str
    folder: Path
    urdf: Path
    gravity: tuple[float, float, float] | None = None  # [m/s²], where it is given
    joints: Mapping[str, Any] = field(default_factory=dict)
    closures: tuple[Mapping[str, Any], ...] = ()
    parameters: Mapping[str, Any] = field(default_factory=dict)
    multipliers: Mapping[str, Any] = field(default_factory=dict)
    log: Mapping[str, Any] = field(default_factory=dict)
    effects: tuple[Mapping[str, Any], ...] = ()
    toml: Path | None = None
    beside: tuple[Mapping[str, Any], ...] = ()


def with_source(settings: Settings, source: Source) -> Settings:
    """The settings, and where they are silent what the mechanism's own file says."""
    given = settings.joints
    joints = {**({"passive": list(source.passive)} if source.passive else {}), **given}
    if source.start and isinstance(given.get("start", {}), dict):
        joints["start"] = {**source.start, **given.get("start", {})}
    return replace(
        settings,
        joints=joints,
        beside=source.closures,
        gravity=settings.gravity or source.gravity or GRAVITY,
    )


def read_settings(path: Path) -> Settings:
    """Settings of a folder, a mechanism.toml or a bare URDF, MuJoCo model or SDF.

    Raises:
        MechanismError: naming the file, the key and what would be valid.
    """
    if path.is_dir():
        inside = path / "mechanism.toml"
        if not inside.is_file():
            raise MechanismError(
                f"{path}: the folder has no mechanism.toml; give a URDF or add one"
            )
        path = inside
    if not path.exists():
        raise MechanismError(
            f"{path}: {not_there(path)}; give a folder, a mechanism.toml or a .urdf"
        )
    if path.suffix.lower() in FORMATS:
        return Settings(str(path), path.parent, path)
    if path.suffix.lower() != ".toml":
        raise MechanismError(
            f"{path}: is no mechanism; give a folder, a mechanism.toml, a .urdf, an .xml of "
            "MuJoCo or an .sdf"
        )
    try:
        raw = path.read_bytes().removeprefix(codecs.BOM_UTF8)
        data = tomllib.loads(raw.decode())
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        raise MechanismError(
            f"{path}: is no valid TOML: byte 0x{error.object[error.start]:02x} in line {line} "
            "is no UTF-8 text; save the file as UTF-8"
        ) from None
    except (ValueError, RecursionError) as error:
        raise MechanismError(
            f"{path}: is no valid TOML: {error or 'nested too deeply'}; see the mechanism.toml of "
            "robots/ for its form"
        ) from None
    except OSError as error:
        raise MechanismError(f"{path}: cannot be read: {error.strerror}") from None
    return _settings(data, path)


def _settings(data: dict[str, Any], path: Path) -> Settings:
    where = str(path)
    check_keys(data, TOP, where)
    if "urdf" not in data:
        raise MechanismError(f"{where}: has no key 'urdf'; write urdf = \"<name>.urdf\"")
    urdf = path.parent / text(data, "urdf", where)
    if not urdf.is_file():
        raise MechanismError(f"{where}: urdf = '{data['urdf']}': no such file in {path.parent}")
    gravity = vector(data, "gravity", where, 3, None) if "gravity" in data else None
    for key in ("joints", "parameters", "multipliers", "log"):
        if not isinstance(data.get(key, {}), dict):
            raise MechanismError(f"{where}: [{key}] must be a table, given: {data[key]!r}")
    for key in ("closure", "effect"):
        tables = data.get(key, [])
        if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
            raise MechanismError(f"{where}: write every {key} as a table [[{key}]]")
    return Settings(
        where=where,
        folder=path.parent,
        urdf=urdf,
        gravity=None if gravity is None else (gravity[0], gravity[1], gravity[2]),
        joints=data.get("joints", {}),
        closures=tuple(data.get("closure", [])),
        parameters=data.get("parameters", {}),
        multipliers=data.get("multipliers", {}),
        log=data.get("log", {}),
        effects=tuple(data.get("effect", [])),
        toml=path,
    )


def check_keys(table: Mapping[str, Any], valid: tuple[str, ...], where: str) -> None:
    """Refuse a key that nothing reads: it would be silently ignored otherwise."""
    for key in table:
        if key not in valid:
            raise MechanismError(f"{where}: unknown key '{key}'; {one_of(key, valid)}")


def text(table: Mapping[str, Any], key: str, where: str) -> str:
    """A string that must be there."""
    if key not in table:
        instead = f" ('{meant}' instead?)" if (meant := near(key, table)) else ""
        raise MechanismError(f"{where}: has no key '{key}'{instead}; write {key} = \"…\"")
    if not isinstance(table[key], str) or not table[key]:
        raise MechanismError(f"{where}: {key} = {table[key]!r}; a text in quotes is expected")
    return str(table[key])


def number(table: Mapping[str, Any], key: str, where: str, default: float | None = None) -> float:
    """A finite number."""
    if key not in table and default is not None:
        return default
    if key not in table:
        raise MechanismError(f"{where}: has no key '{key}'; write {key} = <number>")
    value = table[key]
    if not _is_number(value):
        raise MechanismError(f"{where}: {key} = {value!r}; a finite number is expected")
    return float(value)


def _is_number(value: object) -> bool:
    """A number with whose products one can still count."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < HUGE


def vector(
    table: Mapping[str, Any], key: str, where: str, count: int, default: tuple[float, ...] | None
) -> tuple[float, ...]:
    """`count` finite numbers (any number of them for count 0)."""
    if key not in table and default is not None:
        return default
    value = table.get(key)
    good = isinstance(value, list) and all(_is_number(x) for x in value)
    if not isinstance(value, list) or not good or (count and len(value) != count):
        need = f"{count} finite numbers" if count else "finite numbers"
        raise MechanismError(f"{where}: {key} = {value!r}; a list of {need} is expected")
    return tuple(float(x) for x in value)


def words(table: Mapping[str, Any], key: str, where: str) -> tuple[str, ...] | None:
    """A list of texts, or None if it is not there."""
    if key not in table:
        return None
    value = table[key]
    if not isinstance(value, list) or not all(isinstance(word, str) for word in value):
        raise MechanismError(f"{where}: {key} = {value!r}; a list of texts is expected")
    return tuple(value)
