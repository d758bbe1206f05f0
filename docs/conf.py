"""Sphinx: Markdown pages as they stand here, and what `making` makes of the code."""

import os
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from making.api import as_rst, reference  # noqa: E402
from making.commands import commands  # noqa: E402
from making.library import library  # noqa: E402

import ident  # noqa: E402

project = "ident"
author = copyright = "the ident developers"
version = release = ident.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["making"]
myst_heading_anchors = 3
highlight_language = "none"
pygments_style, pygments_dark_style = "default", "github-dark"

html_theme = "furo"
html_title = f"ident {version}"
html_copy_source = html_show_sourcelink = html_show_sphinx = False
html_static_path = ["static"]
html_css_files = ["ident.css"]
html_show_search_summary = False  # pages that are opened as files may not read each other
smartquotes = False  # --with stays --with

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_class_signature = "separated"
napoleon_use_ivar = True
napoleon_use_rtype = False
toc_object_entries = False
python_maximum_signature_line_length = 88
suppress_warnings = ["ref.python"]  # attributes of one name in several nouns


def _generate(app) -> None:
    """Pages that say what the code says, so that they cannot say anything else."""
    folder = HERE / "generated"
    folder.mkdir(exist_ok=True)
    pages = {
        "commands.md": commands(),
        "library.md": library(folder),
        "reference.rst": reference(),
        "changelog.md": "```{include} ../../CHANGELOG.md\n```\n",
        "contributing.md": "```{include} ../../CONTRIBUTING.md\n```\n",
    }
    for name, text in pages.items():
        path = folder / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def _docstring(app, what, name, thing, options, lines) -> None:
    lines[:] = as_rst(lines)


def setup(app) -> None:
    """Before pages are read; and docstrings before napoleon reads them."""
    app.connect("builder-inited", _generate)
    app.connect("autodoc-process-docstring", _docstring, priority=1)
