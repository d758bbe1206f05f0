"""Runs notebooks. As a command: writes the outputs of all in notebooks/ anew, or of those named.

python tests/notebooks/execute.py [NAME…]
"""

from __future__ import annotations

import base64
import io
import os
import sys
from collections.abc import Mapping
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode
from PIL import Image

FOLDER = Path(__file__).resolve().parents[2] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
COLOURS = 48  # of a picture; lines with soft edges look the same
NEEDS = {"real_arm": "staubli_tx40/tx40.csv"}  # measurements that are not in this repository


def missing(path: Path) -> str:
    """Why a notebook cannot be run here; empty if it can."""
    data = Path(os.environ.get("IDENT_DATA", FOLDER.parents[1] / "shared" / "data"))
    needed = NEEDS.get(path.stem)
    if needed is None or (data / needed).is_file():
        return ""
    return f"{path.stem}: no {needed} in {data}; set IDENT_DATA to the folder that holds it"


def executed(path: Path, changes: Mapping[str, str] | None = None) -> NotebookNode:
    """The notebook with fresh outputs, run where it is; `CellExecutionError` at the first failure.

    `changes` replace words of the code: less work where the outputs are not kept. Times of day and
    the kernel's own version are left out of what is returned; pictures are small.
    """
    notebook = nbformat.read(path, as_version=4)
    for cell in notebook.cells if changes else ():
        for word, other in changes.items():
            cell.source = cell.source.replace(word, other)
    client = NotebookClient(
        notebook,
        timeout=300,
        kernel_name="python3",
        resources={"metadata": {"path": str(path.parent)}},
        record_timing=False,
    )
    client.execute()
    notebook.metadata = {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    for cell in notebook.cells:
        if "outputs" in cell:  # a bar of progress leaves an empty one, if the machine is slow
            cell.outputs = [o for o in cell.outputs if o.get("data") != {"text/plain": ""}]
        for output in cell.get("outputs", ()):
            if "image/png" in output.get("data", {}):
                output.data["image/png"] = small(output.data["image/png"])
    return notebook


def small(png: str) -> str:
    """A picture in base64 with few colours; itself where that is no smaller."""
    picture = Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB")
    stream = io.BytesIO()
    few = picture.quantize(COLOURS, dither=Image.Dither.NONE)
    few.save(stream, format="png", optimize=True)
    return min(base64.b64encode(stream.getvalue()).decode(), png.replace("\n", ""), key=len)


def main(names: list[str]) -> None:
    if "IDENT_DATA" in os.environ:  # outputs show it: not the folders of whoever runs this
        data = os.path.relpath(os.environ["IDENT_DATA"], FOLDER)
        os.chdir(FOLDER)
        os.environ["IDENT_DATA"] = data
    for path in NOTEBOOKS:
        if names and path.stem not in names:
            continue
        if reason := missing(path):
            print(reason)
            continue
        notebook = executed(path)
        nbformat.write(notebook, path)
        print(path.relative_to(FOLDER.parent))


if __name__ == "__main__":
    main(sys.argv[1:])
