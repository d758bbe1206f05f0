"""Files written whole or not at all."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import BinaryIO

from ident.errors import IdentError


@contextlib.contextmanager
def whole(path: Path) -> Iterator[BinaryIO]:
    """A stream whose content appears under `path` only when the block ends without an error."""
    # same folder, so that the last step is one rename; not tempfile, whose files are private
    part = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    try:
        with part.open("xb") as stream:
            yield stream
        os.replace(part, path)
    finally:
        with contextlib.suppress(OSError):
            part.unlink()


def write_all(folder: Path, contents: Mapping[str, bytes]) -> list[Path]:
    """Files of a folder by relative name: all are written beside their place, then all renamed.

    Raises:
        IdentError: if the folder cannot be made or written; then no file of it has changed.
    """
    parts: list[tuple[Path, Path]] = []
    try:
        for name, content in contents.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            if path.is_dir():
                raise IsADirectoryError(21, "is a folder", str(path))
            part = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
            parts.append((part, path))
            part.write_bytes(content)
        for part, path in parts:
            os.replace(part, path)
    except OSError as error:
        raise IdentError(
            f"{error.filename or folder}: cannot be written ({error.strerror}); give --out a folder "
            "that you may write"
        ) from None
    finally:
        for part, _ in parts:
            with contextlib.suppress(OSError):
                part.unlink()
    return [path for _, path in parts]
