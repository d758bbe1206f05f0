"""All notebooks run, and carry outputs that are of no one machine. They assert what they claim."""

from __future__ import annotations

import tempfile
from pathlib import Path

import nbformat
import pytest
from execute import FOLDER, NOTEBOOKS, executed, missing
from nbclient import NotebookClient

NAMES = {
    "pendulum", "slider_crank", "hidden_effect", "hidden_friction", "your_own_mechanism",
    "real_arm", "own_effect", "hidden_law", "servo",
}  # fmt: skip
LARGEST = 1_000_000  # bytes
# the computations of these are run by other tests: examples/hidden_friction.py, truth/test_tx40*,
# truth/test_user_effects.py and laws/
SLOW = ("hidden_friction", "real_arm", "own_effect", "hidden_law")
RUN = [pytest.param(p, marks=[pytest.mark.slow] * (p.stem in SLOW), id=p.stem) for p in NOTEBOOKS]


def named(path: Path) -> str:
    return path.stem


def outputs(notebook):
    return [out for cell in notebook.cells for out in cell.get("outputs", ())]


@pytest.mark.parametrize("path", RUN)
def test_it_runs(path, tmp_path, monkeypatch):
    if reason := missing(path):
        pytest.skip(reason)
    if path.stem == "your_own_mechanism":
        pytest.importorskip("mujoco")
    monkeypatch.setenv("JUPYTER_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
    before = path.read_bytes()
    notebook = executed(path, {"runs=8": "runs=2"})  # of a simulation study
    assert not [out for out in outputs(notebook) if out.get("name") == "stderr"]
    assert path.read_bytes() == before
    stored = [out.output_type for out in outputs(nbformat.read(path, as_version=4))]
    assert [out.output_type for out in outputs(notebook)] == stored


@pytest.mark.parametrize("path", NOTEBOOKS, ids=named)
def test_its_outputs_are_there(path):
    """`python tests/notebooks/execute.py` writes them."""
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    found = outputs(notebook)
    assert {out.output_type for out in found} <= {"stream", "execute_result", "display_data"}
    assert not [out for out in found if out.get("name") == "stderr"]
    assert any("image/png" in out.get("data", {}) for out in found)
    assert any("assert " in cell.source for cell in cells)
    assert path.stat().st_size < LARGEST


@pytest.mark.parametrize("path", NOTEBOOKS, ids=named)
def test_it_begins_with_how_long_it_takes(path):
    first = nbformat.read(path, as_version=4).cells[0]
    assert first.cell_type == "markdown"
    assert first.source.startswith("# ")
    assert all(words in " ".join(first.source.split()) for words in ("Reading: ", "Running: "))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=named)
def test_it_names_no_machine(path):
    notebook = nbformat.read(path, as_version=4)
    for out in outputs(notebook):
        out.get("data", {}).pop("image/png", None)  # letters at random may spell anything
    text = nbformat.writes(notebook)
    for place in (FOLDER.parent, Path.home(), tempfile.gettempdir(), "/home/", "/Users/", "0x7f"):
        assert str(place) not in text


@pytest.mark.parametrize("path", NOTEBOOKS, ids=named)
def test_its_links_lead_somewhere(path):
    notebook = nbformat.read(path, as_version=4)
    text = "\n".join(cell.source for cell in notebook.cells if cell.cell_type == "markdown")
    links = [part.split(")")[0] for part in text.split("](")[1:]]
    links += [part for part in text.split("`") if part.endswith(".ipynb")]
    for link in (link for link in links if not link.startswith("http")):
        assert (FOLDER / link).exists(), link


def test_all_are_there():
    assert {path.stem for path in NOTEBOOKS} == NAMES


def test_without_measurements_the_real_arm_ends_in_words(tmp_path, monkeypatch):
    monkeypatch.setenv("IDENT_DATA", str(tmp_path))
    monkeypatch.setenv("JUPYTER_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
    path = FOLDER / "real_arm.ipynb"
    assert "staubli_tx40/tx40.csv" in missing(path)
    notebook = nbformat.read(path, as_version=4)
    del notebook.cells[2:]
    client = NotebookClient(notebook, kernel_name="python3", allow_errors=True)
    client.execute(cwd=str(FOLDER))
    (end,) = outputs(notebook)
    assert end.ename == "NoData"
    assert len(end.traceback) == 1
    assert "set IDENT_DATA" in end.traceback[0]
