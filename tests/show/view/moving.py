"""Views of motions and multipliers that a test makes up."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from ident.display import render


def view_of(mechanism: Any, t: np.ndarray, q: np.ndarray, multipliers: np.ndarray) -> Any:
    """Return the view of a mechanism at q (n, nq) with multipliers (n, m), without residuals."""
    nothing = np.zeros((len(t), 0))
    prediction = SimpleNamespace(
        joints=(), usable=np.ones(len(t), bool), residual=nothing, measured=nothing,
        multipliers=multipliers,
    )  # fmt: skip
    moved = SimpleNamespace(name="made up", t=t, q=q)
    return render(mechanism, "view", [moved], [prediction])
