"""Runs notebooks. As a command: writes the outputs of all in notebooks/ anew.

python tests/notebooks/execute.py
"""

from __future__ import annotations

from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode

FOLDER = Path(__file__).resolve().parents[2] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def executed(path: Path) -> NotebookNode:
    """The notebook with fresh outputs, run where it is; `CellExecutionError` at the first failure.

    Times of day and the kernel's own version are left out of what is returned.
    """
    notebook = nbformat.read(path, as_version=4)
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
    return notebook


def main() -> None:
    for path in NOTEBOOKS:
        notebook = executed(path)
        nbformat.write(notebook, path)
        print(path.relative_to(FOLDER.parent))


if __name__ == "__main__":
    main()
