"""`ident.explore` in a notebook: executed as Jupyter does, with a rich display."""

from __future__ import annotations

import nbformat
from nbclient import NotebookClient

from helpers import ROBOTS

SOURCE = """\
import ident
mechanism = ident.load({folder!r})
board = ident.explore(mechanism, {log!r})
"""
CLICK = "board.act({'do': 'add', 'label': 'viscous:elbow'})\nprint(board.exploration)"


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
    (html,) = [out["data"]["text/html"] for out in shown if "text/html" in out.get("data", {})]
    assert '<iframe src="http://127.0.0.1:' in html
    assert "+ viscous:elbow" in clicked[0]["text"]
    assert not [out for out in (*made, *shown, *clicked) if out.get("name") == "stderr"]
