"""Imports between the subpackages go one way, inside functions too."""

import ast
from pathlib import Path

import pytest

BASE = {
    "errors",
    "files",
    "progress",
    "tables",
    "text",
    "display",
    "plugins",
}  # modules that all may use
ON_TOP = {"show", "chart", "page", "view"}  # presentation, until no kernel module renders itself
ORDER = [
    "information",
    "pool",
    "log",
    "solve",
    "effects",
    "mechanism",
    "formats",
    "motion",
    "equations",
    "likelihood",
    "residual",
    "fit",
    "compare",
    "diagnosis",
    "simulate",
    "excite",
    "montecarlo",
    "demo",
    "explore",
    "streams",
    "cli",
]
LEAVES = {"pool", "information"}  # these import nothing else
SOURCE = Path(__file__).resolve().parents[1] / "src" / "ident"


def imported(tree: ast.AST) -> set[str]:
    """Subpackages of ident that are imported, wherever, but not under TYPE_CHECKING."""
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            node.body = []
    modules = [n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
    modules += [a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names]
    return {m.split(".")[1] for m in modules if m.startswith("ident.")}


@pytest.mark.parametrize(
    "file", sorted(SOURCE.glob("*/**/*.py")), ids=lambda f: f"{f.parent.name}/{f.name}"
)
def test_imports_point_one_way(file):
    own = file.relative_to(SOURCE).parts[0]
    found = imported(ast.parse(file.read_text(encoding="utf-8"))) - {own}
    before = set() if own in LEAVES else set(ORDER[: ORDER.index(own)] if own in ORDER else ORDER)
    allowed = BASE | ON_TOP | before
    assert found <= allowed, f"{own} imports {sorted(found - allowed)}"
