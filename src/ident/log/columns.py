"""This robot's column names, scales and offsets: the [log] table of mechanism.toml."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ident.errors import LogError, one_of
from ident.log.cells import Array
from ident.log.table import Table


@dataclass(frozen=True)
class Column:
    """A column of the file and its way to SI units: value = scale * file + offset.

    Raises LogError where `scale` is zero or not finite, or `offset` is not finite.
    """

    column: str  # its name in the file
    scale: float = 1.0  # [SI unit / file's unit]
    offset: float = 0.0  # [SI unit]

    def __post_init__(self) -> None:
        if not (math.isfinite(self.scale) and self.scale != 0.0 and math.isfinite(self.offset)):
            raise LogError(
                f"column {self.column!r}: scale = {self.scale}, offset = {self.offset}; "
                "valid: finite numbers, scale other than 0"
            )


def renamed(table: Table, mapping: Mapping[str, Column]) -> Table:
    """The table under ident's names and in SI units; unmapped columns keep their own name.

    Raises LogError for a mapped column that the file has not, or holds no numbers in, and for a
    name that a column of the file bears already. Two columns may exchange their names.
    """
    for name, source in mapping.items():
        wanted = f"{table.file}: column {source.column!r}, [log] {name!r} in mechanism.toml,"
        if source.column in table.left_out:
            raise LogError(f"{wanted} {table.left_out[source.column]}; numbers are needed")
        if source.column not in table.columns:
            raise LogError(f"{wanted} is not in the file; {one_of(source.column, table.columns)}")
    used = {source.column for source in mapping.values()}
    for name, source in mapping.items():
        if name not in used and (name in table.columns or name in table.left_out):
            raise LogError(
                f"{table.file}: {name!r} is ambiguous: [log] in mechanism.toml makes it from "
                f"{source.column!r}, and the file has a column {name!r} too; "
                f"remove the [log] entry, or rename the file's column"
            )

    columns: dict[str, Array] = {}
    for own, x in table.columns.items():
        if own not in used:
            columns[own] = x
        for name, source in mapping.items():
            if source.column == own:
                with np.errstate(over="ignore"):  # infinite values are refused later, by place
                    columns[name] = source.scale * x + source.offset
    return replace(table, columns=columns)
