"""Files written whole or not at all, and users' Python files run."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import secrets
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import BinaryIO

from ident.errors import IdentError


@contextlib.contextmanager
def whole(path: Path) -> Iterator[BinaryIO]:
    """A stream whose content appears under `path` only when the block ends without an error."""
    # same folder, so that the last step is one rename; not tempfile, whose files are private
    part = _beside(path, "part")
    try:
        with part.open("xb") as stream:
            yield stream
        os.replace(part, path)
    finally:
        _remove(part)


def write_all(folder: Path, contents: Mapping[str, bytes | Path]) -> list[Path]:
    """Files of a folder by relative name, all or none of them; a path is a file to be moved there.

    All are written beside their place, then renamed; where that fails midway, the files that stood
    there before are put back, and what is new (folders too) is taken away.

    Raises:
        IdentError: if the folder cannot be made or written; then no file of it has changed.
    """
    paths = [folder / name for name in contents]
    made: list[Path] = []
    undo = contextlib.ExitStack()
    with contextlib.ExitStack() as scraps:  # runs whether it succeeds or not, after `undo`
        try:
            for path in paths:
                _make_folder(path.parent, made)
                if path.is_dir():
                    raise IsADirectoryError(21, "is a folder", str(path))
            parts = [_beside(path, "part") for path in paths]
            for part, content in zip(parts, contents.values(), strict=True):
                scraps.callback(_remove, part)
                if isinstance(content, Path):
                    os.replace(content, part)
                else:
                    part.write_bytes(content)
            for part, path in zip(parts, paths, strict=True):
                old = _beside(path, "old")
                scraps.callback(_remove, old)
                if path.exists():
                    shutil.copy2(path, old)
                    undo.callback(os.replace, old, path)
                else:
                    undo.callback(_remove, path)
                os.replace(part, path)
        except BaseException as error:
            with contextlib.suppress(BaseException):  # the first error is the one to tell of
                undo.close()
            scraps.close()
            for each in reversed(made):
                with contextlib.suppress(OSError):
                    each.rmdir()
            if isinstance(error, OSError):
                raise _unwritable(error, folder) from None
            raise
    return paths


def module_of(file: Path) -> ModuleType:
    """A user's Python file, run; whatever it raises passes through."""
    spec = importlib.util.spec_from_file_location(f"user_{file.stem}", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def check_writable(folder: Path) -> None:
    """Refuse, before long work, a folder into which nothing could be written; leaves no trace.

    Raises:
        IdentError: if the folder cannot be made, or no file in it.
    """
    if folder.is_file():
        raise IdentError(f"{folder}: is a file; give the name of a folder")
    made: list[Path] = []
    try:
        _make_folder(folder, made)
        probe = _beside(folder / "probe", "part")
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise _unwritable(error, folder) from None
    finally:
        for each in reversed(made):
            with contextlib.suppress(OSError):
                each.rmdir()


def _unwritable(error: OSError, folder: Path) -> IdentError:
    return IdentError(
        f"{error.filename or folder}: cannot be written ({error.strerror or error}); "
        "name a folder that you may write"
    )


def _beside(path: Path, suffix: str) -> Path:
    return path.with_name(f".{path.name}.{secrets.token_hex(4)}.{suffix}")


def _make_folder(folder: Path, made: list[Path]) -> None:
    """Makes a folder and its parents; those that were not there are appended to `made`."""
    missing = [each for each in (folder, *folder.parents) if not each.exists()]
    for each in reversed(missing):
        each.mkdir(exist_ok=True)
        made.append(each)


def _remove(path: Path) -> None:
    with contextlib.suppress(OSError):
        path.unlink()
