"""What a command may import: its start is half of what a user of a short log waits for."""

import os
import subprocess
import sys

import pytest

IDENTIFY = "identify robots/four_bar robots/four_bar/run.csv"
TREE = "identify robots/arm robots/arm/run.csv"  # whose bodies are brought within limits
PROGRAM = """import sys
from ident.cli.app import main
sys.argv = ["ident", *sys.argv[1:]]
try:
    main()
except SystemExit:
    pass
# a module that waits for its first use is of another type
loaded = [name for name in {names} if type(sys.modules.get(name)).__name__ == "module"]
print("LOADED", *loaded)
"""
SCIENTIFIC = ["numpy", "scipy", "polars", "pinocchio", "casadi", "matplotlib", "bokeh"]
SLOW = [
    "scipy.optimize", "scipy.special", "scipy.interpolate", "scipy.stats", "scipy.signal",
    "scipy.ndimage", "polars", "matplotlib", "bokeh", "jinja2", "joblib", "yaml",
    "ident.diagnosis.null", "ident.streams.gather",
]  # fmt: skip


def loaded_by(line: str, names: list[str], cwd) -> list[str]:
    """Names of those modules that a command has loaded."""
    environment = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM.replace("{names}", repr(names)), *line.split()],
        capture_output=True, text=True, cwd=cwd, env=environment, timeout=120,
    )  # fmt: skip
    return done.stdout.rpartition("LOADED")[2].split()


@pytest.mark.parametrize("line", ["--help", "identify --help"])
def test_help_loads_nothing_scientific(line, robots):
    assert loaded_by(line, SCIENTIFIC, robots.parent) == []


def test_identify_loads_no_slow_package(robots):
    assert loaded_by(IDENTIFY, SLOW, robots.parent) == []


def test_identify_of_a_tree_loads_neither_casadi_nor_scipys_packages(robots):
    slow = [*SLOW, "casadi", "scipy.linalg", "scipy.sparse"]
    assert loaded_by(TREE, slow, robots.parent) == []


def test_a_command_has_one_thread_of_linear_algebra_unless_told_otherwise():
    program = "import os, ident.cli; print(os.environ.get('OPENBLAS_NUM_THREADS'))"
    bare = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    for given, expected in (({}, "1"), ({"OPENBLAS_NUM_THREADS": "3"}, "3"),
                            ({"OMP_NUM_THREADS": "2"}, "None")):  # fmt: skip
        done = subprocess.run(
            [sys.executable, "-c", program], env={**bare, **given}, capture_output=True, text=True
        )
        assert done.stdout.strip() == expected
