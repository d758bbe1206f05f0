"""Which logs a folder holds."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from ident.errors import LogError
from ident.log.bag import SUFFIXES, is_bag
from ident.log.read import READERS


def is_folder_of_logs(path: Path) -> bool:
    """Whether a path is a folder, and not a ROS 2 bag."""
    return path.is_dir() and not is_bag(path)


def logs_in(folder: str | os.PathLike[str]) -> list[Path]:
    """The logs in a folder, by name: all that is a log by its suffix or is a ROS 2 bag.

    What is hidden is left out, and so is what is in folders inside. A file that turns out to be no
    log is for the reader to refuse.

    Args:
        folder: of the logs.

    Raises:
        LogError: if there are none.
    """
    folder = Path(folder)
    try:
        seen = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    except OSError as error:
        raise LogError(
            f"{folder}: cannot be looked into ({error.strerror}); name a folder of logs"
        ) from None
    found = [p for p in seen if is_bag(p) or (p.suffix.lower() in READERS and p.is_file())]
    if not found:
        valid = ", ".join((*READERS, *SUFFIXES))
        raise LogError(f"{folder}: holds no log; valid: files of {valid}, or ROS 2 bags")
    return found


def expanded(paths: Iterable[str | os.PathLike[str]]) -> list[Path]:
    """Logs, and in place of every folder the logs in it; each file once.

    Args:
        paths: of logs and folders.

    Raises:
        LogError: for a folder that has none.
    """
    found: dict[Path, Path] = {}
    for path in map(Path, paths):
        for each in logs_in(path) if is_folder_of_logs(path) else [path]:
            found.setdefault(each.resolve(), each)
    return list(found.values())


def names_of(paths: Iterable[Path]) -> list[str]:
    """What logs are called beside each other: run.csv of a second folder is run.csv (2).

    >>> names_of([Path("a/run.csv"), Path("b/run.csv")])
    ['run.csv', 'run.csv (2)']
    """
    seen: dict[str, int] = {}
    found = []
    for path in paths:
        name = path.name or str(path)
        seen[name] = seen.get(name, 0) + 1
        found.append(name if seen[name] == 1 else f"{name} ({seen[name]})")
    return found
