"""How a report was made: the command, the versions, the files that went in."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Sequence
from contextvars import ContextVar
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from ident.show.html.elements import code, definitions, paragraph, table
from ident.show.html.page import Section

running: ContextVar[str] = ContextVar("running", default="")  # the command line, where there is one
PACKAGES = ("ident", "pin", "casadi", "numpy", "scipy", "clarabel", "bokeh")


def origin(files: Sequence[Path], logs: Sequence[tuple[str, str]]) -> Section:
    """How to get the same again.

    Args:
        files: of the mechanism.
        logs: names and SHA-256 of the logs' bytes, "" where one was made in memory.
    """
    rows = [["file", "SHA-256"]]
    rows += [[file.name, _sha256(file)] for file in files]
    rows += [[name, digest or "made in memory"] for name, digest in logs]
    command = running.get()
    first = code(command) if command else paragraph("Made in Python, by no command.")
    versions = {name: _version(name) for name in PACKAGES}
    versions["Python"] = f"{platform.python_version()} on {platform.system()} {platform.machine()}"
    return Section("How to reproduce", (first, table(rows, "What went in"), definitions(versions)))


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def _sha256(file: Path) -> str:
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError:
        return "gone since"
