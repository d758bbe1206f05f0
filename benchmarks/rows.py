"""Rows of a long benchmark, kept one by one: parts can be run apart and read again."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any


def kept(rows: Iterable[Any], file: Path | None) -> Iterator[Any]:
    """Pass on rows, dataclasses of plain values, each a line of a file as soon as it is there."""
    for row in rows:
        if file is not None:
            with file.open("a") as stream:
                stream.write(json.dumps(asdict(row)) + "\n")
        yield row


def rows_of(files: Sequence[Path], kind: type) -> list[Any]:
    """Return the rows of a kind that files hold."""
    lines = (line for path in files for line in path.read_text().splitlines())
    return [kind(**json.loads(line)) for line in lines]
