"""Imports go one way: between packages in a stated order, between files without a circle."""

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[1] / "src"
ORDER = (
    ("errors", "progress", "display", "request", "lazy", "threads"),
    ("files", "text", "finding"),
    ("information", "pool"),  # know no robot
    ("log",),
    ("effects",),
    ("mechanism",),
    ("formats",),
    ("motion",),
    ("equations",),
    ("faults",),
    ("fit",),
    ("simulate",),
    ("diagnosis",),
    ("export",),
    ("excite",),
    ("montecarlo",),
    ("streams",),
    ("assess",),
    ("show",),
    ("public",),
    ("ident",),
    ("cli",),
    ("__main__",),
)
RANK = {name: rank for rank, names in enumerate(ORDER) for name in names}


def imports() -> dict[str, set[str]]:
    """Modules that each module imports, wherever the import stands, type checking included."""
    files = {}
    for file in (SOURCE / "ident").rglob("*.py"):
        name = ".".join(file.relative_to(SOURCE).with_suffix("").parts)
        files[name.removesuffix(".__init__")] = file
    found: dict[str, set[str]] = {}
    for module, file in files.items():
        names = []
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names += [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names += [f"{node.module}.{alias.name}" for alias in node.names]
        targets = {name if name in files else name.rpartition(".")[0] for name in names}
        found[module] = {name for name in targets if name in files} - {module}
    return found


def test_imports_go_one_way():
    graph = imports()
    package = {module: module.split(".")[min(1, module.count("."))] for module in graph}
    offences = [
        f"{module} imports {name}"
        for module, names in graph.items()
        for name in names
        if RANK[package[module]] < RANK[package[name]]
    ]
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as circle:
        offences.append(" → ".join(circle.args[1]))
    assert not offences
