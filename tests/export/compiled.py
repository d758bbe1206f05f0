"""Exported C headers, compiled without a warning and called."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

FLAGS = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wconversion", "-Wpedantic", "-Werror"]


def compiler() -> str:
    found = shutil.which("gcc") or shutil.which("cc")
    if found is None:
        pytest.skip("needs a C compiler, such as gcc")
    return found


def library(folder: Path, name: str, calls: Sequence[str], real: str = "double") -> ctypes.CDLL:
    """Compile a header with exported functions of the same signatures, `x_<call>`."""
    source = [f'#include "{name}.h"']
    for call in calls:
        head, _, arguments = call.partition("(")
        kind, function = head.split()
        typed = arguments.rstrip(")").split(",")
        given = ", ".join(each.split()[-1].strip("*[]") for each in typed)
        prototype = f"{kind} x_{function}({', '.join(typed)})"
        keep = "return " if kind != "void" else ""
        source += [f"{prototype};", f"{prototype} {{ {keep}{name}_{function}({given}); }}"]
    (folder / "x.c").write_text("\n".join(source).replace("REAL", real))
    subprocess.run(
        [compiler(), *FLAGS, "-shared", "-fPIC", "-o", "x.so", "x.c", "-lm"],
        cwd=folder, check=True, capture_output=True, text=True,
    )  # fmt: skip
    return ctypes.CDLL(str(folder / "x.so"))


def caller(function: object, real: str = "double") -> Callable[..., int]:
    """Return a call of a C function with NumPy arrays and numbers."""
    kind = ctypes.c_double if real == "double" else ctypes.c_float

    def call(*arguments: object) -> int:
        given = [
            each.ctypes.data_as(ctypes.c_void_p)
            if isinstance(each, np.ndarray)
            else kind(each)
            if isinstance(each, float)
            else each
            for each in arguments
        ]
        return function(*given)

    return call
