"""Presentation has words and drawings: it imports no solver, and calls no verb but to draw."""

import ast
from pathlib import Path

SHOW = Path(__file__).resolve().parents[2] / "src" / "ident" / "show"
SOLVERS = ("scipy.linalg", "scipy.optimize", "clarabel", "ident.information.linear")
VERBS = {
    "identify",
    "diagnose",
    "complete",
    "residual_of",
    "integrate",
    "excite",
    "gather",
    "estimate",
}


def imported(file: Path) -> set[str]:
    """Full names of all that a module imports, inside functions too."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def test_presentation_imports_no_solver_and_no_verb():
    offences = []
    for file in SHOW.rglob("*.py"):
        for name in imported(file):
            verb = name.startswith("ident.") and name.rpartition(".")[2] in VERBS
            if name.startswith(SOLVERS) or verb:
                offences.append(f"{file.name} imports {name}")
    assert not offences
