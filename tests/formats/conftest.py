"""Fixtures for reading small files, and for holding what an error says to the house rules."""

import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from ident.errors import LogError
from ident.log import Column, Log, read_log


@pytest.fixture
def csv(tmp_path: Path) -> Callable[..., Path]:
    """`csv("t,q\\n0,1")`: a file of that text, run.csv where no other name is given."""

    def write(content: bytes | str, name: str = "run.csv") -> Path:
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


@pytest.fixture
def read(csv: Callable[..., Path]) -> Callable[..., Log]:
    """The log in a file of that text."""

    def of(content: bytes | str, columns: Mapping[str, Column] | None = None) -> Log:
        return read_log(csv(content), columns)

    return of


@pytest.fixture
def refused() -> Callable[..., str]:
    """`refused(path, says)`: LogError, one line, with the file and all of `says`; returns it."""

    def check(
        path: Path, says: tuple[str, ...], columns: Mapping[str, Column] | None = None
    ) -> str:
        with pytest.raises(LogError) as caught:
            read_log(path, columns)
        message = str(caught.value)
        assert len(message.splitlines()) == 1
        missing = [part for part in (path.name, *says) if part not in message]
        assert not missing, f"{missing} not in {message!r}"
        return message

    return check


@pytest.fixture
def install(tmp_path, monkeypatch):
    """`install(module, text, entries)`: a package on the path, with entry points of ident."""
    site = tmp_path / "site"

    def installed(module: str, text: str, entries: dict[str, str]) -> Path:
        info = site / f"{module}-1.0.dist-info"
        info.mkdir(parents=True)
        (site / f"{module}.py").write_text(text)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
        lines = [f"{name} = {value}" for name, value in entries.items()]
        (info / "entry_points.txt").write_text("\n".join(["[ident.formats]", *lines]))
        monkeypatch.syspath_prepend(site)
        return site

    yield installed
    for module in [name for name in sys.modules if name.startswith("made_")]:
        del sys.modules[module]
