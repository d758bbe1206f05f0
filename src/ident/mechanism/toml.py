"""Checked access to the tables of a mechanism.toml: every fault is named with its place."""

from __future__ import annotations

import codecs
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ident.errors import MechanismError, near, one_of
from ident.files import regular

HUGE = 1e30  # numbers from which products overflow


def is_number(value: object) -> bool:
    """Return whether a value is a finite number with whose products one can still count."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < HUGE


@dataclass(frozen=True)
class TomlTable:
    """A table of the file, and the place that messages name."""

    where: str
    data: Mapping[str, Any] = field(default_factory=dict)

    def __contains__(self, key: str) -> bool:
        return key in self.data

    def error(self, text: str) -> MechanismError:
        """Return the error of this place."""
        return MechanismError(f"{self.where}: {text}")

    def check(self, *valid: str) -> None:
        """Refuse a key that nothing reads: it would be ignored silently otherwise."""
        for key in self.data:
            if key not in valid:
                raise self.error(f"unknown key '{key}'; {one_of(key, valid)}")

    def table(self, key: str) -> TomlTable:
        """Return the table `[key]`, empty if it is missing."""
        if not isinstance(self.data.get(key, {}), dict):
            raise self.error(f"[{key}] must be a table, given: {self.data[key]!r}")
        return TomlTable(f"{self.where}: [{key}]", self.data.get(key, {}))

    def tables(self, key: str) -> list[TomlTable]:
        """Return all tables `[[key]]`."""
        tables = self.data.get(key, [])
        if not isinstance(tables, list) or not all(isinstance(each, dict) for each in tables):
            raise self.error(f"write every {key} as a table [[{key}]]")
        return [
            TomlTable(f"{self.where}: {key} {i}", each) for i, each in enumerate(tables, start=1)
        ]

    def text(self, key: str, default: str | None = None) -> str:
        """Return a text that is not empty; required unless there is a default."""
        value = self.data.get(key, default)
        if value is None:
            instead = f" ('{meant}' instead?)" if (meant := near(key, self.data)) else ""
            raise self.error(f"has no key '{key}'{instead}; write {key} = \"…\"")
        if not isinstance(value, str) or not value:
            raise self.error(f"{key} = {value!r}; a text in quotes is expected")
        return value

    def number(self, key: str, default: float | None = None) -> float:
        """Return a finite number; required unless there is a default."""
        value = self.data.get(key, default)
        if value is None:
            raise self.error(f"has no key '{key}'; write {key} = <number>")
        if not is_number(value):
            raise self.error(f"{key} = {value!r}; a finite number is expected")
        return float(value)

    def vector(
        self, key: str, count: int = 0, default: tuple[float, ...] | None = None
    ) -> tuple[float, ...]:
        """Return `count` finite numbers, any number of them for count 0."""
        value = self.data.get(key, None if default is None else list(default))
        good = isinstance(value, list) and all(map(is_number, value))
        if not isinstance(value, list) or not good or (count and len(value) != count):
            need = f"{count} finite numbers" if count else "finite numbers"
            raise self.error(f"{key} = {value!r}; a list of {need} is expected")
        return tuple(float(x) for x in value)

    def words(self, key: str) -> tuple[str, ...]:
        """Return a list of texts, empty if it is missing."""
        value = self.data.get(key, [])
        if not isinstance(value, list) or not all(isinstance(word, str) for word in value):
            raise self.error(f"{key} = {value!r}; a list of texts is expected")
        return tuple(value)


def read_toml(path: Path) -> TomlTable:
    """Return the top level of a TOML file."""
    try:
        data = tomllib.loads(regular(path).read_bytes().removeprefix(codecs.BOM_UTF8).decode())
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
    return TomlTable(str(path), data)
