"""`ident.explore` in a notebook: executed as Jupyter does, with a rich display."""

from __future__ import annotations

import nbformat
import pytest
from nbclient import NotebookClient

from helpers import ROBOTS

pytest.importorskip("panel")

SOURCE = """\
import ident
mechanism = ident.load({folder!r})
board = ident.explore(mechanism, {log!r})
"""
CLICK = "await board.toggle('viscous:elbow', False)\nprint(board.exploration)"


def test_it_runs_and_is_displayed(tmp_path, monkeypatch):
    for name in ("JUPYTER_RUNTIME_DIR", "IPYTHONDIR"):
        monkeypatch.setenv(name, str(tmp_path))
    source = SOURCE.format(folder=str(ROBOTS / "arm"), log=str(ROBOTS / "arm" / "run.csv"))
    cells = [nbformat.v4.new_code_cell(text) for text in (source, "board", CLICK)]
    notebook = nbformat.v4.new_notebook(cells=cells)
    NotebookClient(
        notebook,
        timeout=300,
        kernel_name="python3",
        resources={"metadata": {"path": str(tmp_path)}},
    ).execute()
    made, shown, clicked = (cell.outputs for cell in notebook.cells)
    kinds = {kind for out in shown for kind in out.get("data", {})}
    assert "text/html" in kinds
    assert "application/vnd.holoviews_exec.v0+json" in kinds
    assert "12.5 %" in clicked[0]["text"]
    scripts = "".join(str(out) for out in made)
    assert "Bokeh" in scripts
    assert not [out for out in (*made, *shown, *clicked) if out.get("name") == "stderr"]
