"""All notebooks run, and carry outputs that are of no one machine."""

from __future__ import annotations

import tempfile
from pathlib import Path

import nbformat
import pytest
from execute import FOLDER, NOTEBOOKS, executed


def named(path: Path) -> str:
    return path.stem


@pytest.mark.parametrize("path", NOTEBOOKS, ids=named)
def test_it_runs(path, tmp_path, monkeypatch):
    monkeypatch.setenv("JUPYTER_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
    before = path.read_bytes()
    notebook = executed(path)
    streams = [out for cell in notebook.cells for out in cell.get("outputs", ())]
    assert not [out for out in streams if out.get("name") == "stderr"]
    assert path.read_bytes() == before


@pytest.mark.parametrize("path", NOTEBOOKS, ids=named)
def test_its_outputs_are_there(path):
    """`python tests/notebooks/execute.py` writes them."""
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    outputs = [out for cell in cells for out in cell.outputs]
    assert {out.output_type for out in outputs} <= {"stream", "execute_result", "display_data"}
    assert not [out for out in outputs if out.get("name") == "stderr"]
    assert any("image/png" in out.get("data", {}) for out in outputs)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=named)
def test_it_names_no_machine(path):
    text = path.read_text(encoding="utf-8")
    for place in (FOLDER.parent, Path.home(), tempfile.gettempdir(), "/home/", "/Users/", "0x7f"):
        assert str(place) not in text


def test_there_are_some():
    assert "hidden_friction" in [path.stem for path in NOTEBOOKS]
