"""What `monitor` writes: CSV files that only grow, line by whole line."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path

from ident.errors import IdentError
from ident.mechanism import Mechanism
from ident.streams import Alarm, Snapshot
from ident.streams.online import Forces

PARAMETERS = ("t", "quantity", "value", "stderr", "unit", "state")
ALARMS = ("onset", "detected", "named", "verdict", "suspects", "evidence", "text")


class Record(AbstractContextManager["Record"]):
    """parameters.csv, multipliers.csv and alarms.csv of a folder; nothing where there is none.

    Args:
        folder: is made if it is not there.
        mechanism: whose multipliers are written.

    Raises:
        IdentError: if a file cannot be written, or has other columns already.
    """

    def __init__(self, folder: Path | None, mechanism: Mechanism) -> None:
        self._files: dict[str, Growing] = {}
        if folder is None:
            return
        folder.mkdir(parents=True, exist_ok=True)
        names = mechanism.kinematics.multipliers if mechanism.closures else ()
        headers = {"parameters": PARAMETERS, "alarms": ALARMS}
        if names:
            headers["multipliers"] = ("t", *names, *(f"{name}.stderr" for name in names))
        for name, header in headers.items():
            self._files[name] = Growing(folder / f"{name}.csv", header)

    def __exit__(self, *_: object) -> None:
        for each in self._files.values():
            each.close()

    def snapshot(self, found: Snapshot) -> None:
        """Its parameters and errors."""
        self._write("parameters", _parameter_rows(found))

    def multipliers(self, found: Forces | None) -> None:
        """λ of some samples."""
        if found is not None:
            self._write("multipliers", _multiplier_rows(found))

    def alarm(self, found: Alarm) -> None:
        """An alarm."""
        said = (found.onset, found.detected, found.named, found.verdict)
        row = (*said, " ".join(found.suspects), found.evidence, found.headline)
        self._write("alarms", [row])

    def _write(self, name: str, rows: Iterable[Sequence[object]]) -> None:
        if name in self._files:
            self._files[name].write(rows)


class Growing:
    """A CSV file to whose end lines are written; begun with its header, or gone on with.

    Args:
        path: of the file.
        header: its columns.

    Raises:
        IdentError: if it cannot be written, or has other columns already.
    """

    def __init__(self, path: Path, header: Sequence[str]) -> None:
        first = _text([header])
        try:
            self._stream = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o666)
            before = os.read(self._stream, len(first))
            size = os.fstat(self._stream).st_size
            cut = size > 0 and os.pread(self._stream, 1, size - 1) != b"\n"
        except OSError as error:
            raise IdentError(
                f"{path}: cannot be written ({error.strerror}); name a folder that you may write"
            ) from None
        if before not in (b"", first):
            raise IdentError(
                f"{path}: has other columns than would be written; remove it, or name another "
                "folder"
            )
        os.write(self._stream, b"\n" if cut else b"" if before else first)

    def write(self, rows: Iterable[Sequence[object]]) -> None:
        """Appends rows, all at once."""
        os.write(self._stream, _text(rows))

    def close(self) -> None:
        """No more rows."""
        os.close(self._stream)


def _parameter_rows(found: Snapshot) -> list[tuple[object, ...]]:
    """A row a parameter, then the errors by joint, under `PARAMETERS`."""
    t, held = repr(found.t), found.held
    rows: list[tuple[object, ...]] = [
        (
            t, v.name, repr(v.value), "" if v.stderr is None else repr(v.stderr), v.unit,
            "held" if v.name in held else "identified" if v.identifiable else "prior",
        )
        for v in found.parameters
    ]  # fmt: skip
    for state, errors in (("all", found.errors), ("ahead", found.ahead)):
        rows += [(t, f"error.{name}", repr(e.rms), "", e.unit, state) for name, e in errors.items()]
    return rows


def _multiplier_rows(found: Forces) -> list[list[object]]:
    """A row a sample; a multiplier that is not determined has empty cells."""
    each = zip(found.t.tolist(), found.values.tolist(), found.stderr.tolist(), strict=True)
    return [[t, *("" if x != x else x for x in (*values, *errors))] for t, values, errors in each]


def _text(rows: Iterable[Sequence[object]]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode()
