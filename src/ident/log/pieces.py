"""A log that is opened, but not read: its rows come in pieces, as read_log would have them."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl

from ident.errors import LogError
from ident.log.bag import is_bag
from ident.log.columns import Column, renamed
from ident.log.log import Log
from ident.log.read import check_kind, named, reading, split
from ident.log.sources import CsvSource, ParquetSource, Source, WholeSource

HEAD = 1 << 16  # bytes of a text from which its number of rows is guessed


@dataclass(frozen=True, eq=False)
class Pieces:
    """A recorded experiment on disk. Made by `open_log`.

    Attributes:
        path: of the file; name: what messages and tables call it.
        mapping: ident's names to the file's columns.
        source: of its rows.
        columns: ident's names of all columns of numbers, t among them.
    """

    path: Path
    name: str
    mapping: Mapping[str, Column]
    source: Source
    columns: tuple[str, ...]

    @property
    def rows(self) -> int:
        """Of the file, repeated time stamps among them."""
        return self.source.rows

    @property
    def sha256(self) -> str:
        """Of the file's bytes."""
        return self.source.sha256

    def piece(self, first: int, stop: int, only: Collection[str] | None = None) -> Log:
        """The samples of the rows first … stop − 1, checked and repaired as `read_log` does.

        Args:
            first, stop: rows, from 0; ten or more.
            only: columns that are needed; others may be missing.

        Raises:
            LogError: where `read_log` would, and if a column holds numbers here and text elsewhere.
        """
        wanted, mapping = None, self.mapping
        if only is not None:
            mapping = {name: source for name, source in mapping.items() if name in only}
            wanted = {mapping[name].column if name in mapping else name for name in only}
        with reading(self.path):
            table = self.source.table(first, min(stop, self.rows), wanted)
        found = renamed(table, mapping)
        if only is not None:
            kept = {name: x for name, x in found.columns.items() if name in only}
            found = replace(found, columns=kept)
        elif other := sorted(set(found.columns) ^ set(self.columns)):
            raise LogError(
                f"{self.path}: column {other[0]!r} holds numbers in some rows and text in others "
                f"(from {table.where(0)} on); leave cells empty where there is no value"
            )
        return Log._checked(self.name, found, mapping.get("t"), self.sha256)


def open_log(
    path: str | os.PathLike[str],
    columns: Mapping[str, Column] | None = None,
    *,
    topic: str | None = None,
) -> Pieces:
    """Open a log as `read_log` reads it; its rows stay on disk, except for an archive or a bag.

    Args:
        path: of the file or bag.
        columns: ident's names to the file's columns.
        topic: of a bag.

    Returns:
        The log in pieces. Files of text were looked at once, to know where rows begin.

    Raises:
        LogError: for what can be seen without reading all values: one line.
    """
    path, topics = split(Path(path), topic)
    check_kind(path, topics)
    mapping = dict(columns or {})
    with reading(path):
        source = _source(path, topics)
        head = renamed(source.table(0, min(source.rows, 1024), None), mapping)
    return Pieces(path, named(path, topics), mapping, source, tuple(head.columns))


def _source(path: Path, topics: list[str]) -> Source:
    if is_bag(path):
        return WholeSource(path, tuple(topics))
    if path.suffix.lower() == ".csv":
        return CsvSource.of(path)
    if path.suffix.lower() == ".parquet":
        return ParquetSource.of(path)
    return WholeSource(path, ())


def likely_rows(path: str | os.PathLike[str]) -> int:
    """How many rows a log has, by its size, without reading it; 0 for what it cannot tell.

    Args:
        path: of a file or bag, which need not be there.
    """
    path = Path(path)
    try:
        if path.suffix.lower() == ".parquet":
            return int(pl.scan_parquet(path).select(pl.len()).collect().item())
        if path.suffix.lower() == ".csv":
            with path.open("rb") as stream:
                head = stream.read(HEAD)
            lines = head.count(b"\n")
            return int(path.stat().st_size * lines / max(len(head), 1))
        if path.suffix.lower() == ".npz":
            with np.load(path, allow_pickle=False) as arrays:
                return len(arrays[arrays.files[0]])
    except Exception:  # whoever reads it says what is wrong with it
        return 0
    return 0
