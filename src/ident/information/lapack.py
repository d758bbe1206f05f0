"""LAPACK's functions as SciPy has them, without the rest of SciPy.

`scipy.linalg` is half of the time in which a command starts: it imports NumPy's tests and f2py. Its
extension module alone takes milliseconds; where it is not found, `scipy.linalg.lapack` is the same.
"""

from __future__ import annotations

import importlib.util
import sys
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import scipy


def extension(name: str) -> ModuleType:
    """Return a compiled module of `scipy.linalg`, without the package; the package's own where it
    is not found. The package finds it, if it is imported later.
    """
    full = f"scipy.linalg.{name}"
    if full in sys.modules:
        return sys.modules[full]
    folder = Path(scipy.__file__).parent / "linalg"
    for suffix in EXTENSION_SUFFIXES:
        spec = importlib.util.spec_from_file_location(full, folder / f"{name}{suffix}")
        if spec and spec.loader and Path(str(spec.origin)).exists():
            module = importlib.util.module_from_spec(spec)
            sys.modules[full] = module
            spec.loader.exec_module(module)
            return module
    return importlib.import_module(full)


lapack: Any = extension("_flapack")


def cholesky_banded(bands: np.ndarray) -> np.ndarray:
    """Return the lower bands (w, n) of the Cholesky factor of a symmetric matrix, whose own lower
    bands these are; raises LinAlgError if it is not positive definite.
    """
    factor, failed = lapack.dpbtrf(bands, lower=1)
    if failed:
        raise np.linalg.LinAlgError(f"leading minor {failed} is not positive definite")
    return np.asarray(factor)


def solve_cholesky_banded(factor: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return x of L Lᵀ x = b, L as `cholesky_banded` returns it, b (n,) or (n, m)."""
    x, _ = lapack.dpbtrs(factor, b, lower=1)
    return np.asarray(x)
