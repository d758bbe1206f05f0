"""Base parameters as a person reads them: `link_2.Lzz + 0.05 link_3.m + …`."""

from __future__ import annotations

import numpy as np

from ident.equations.columns import Columns
from ident.solve.rank import Base


def base_names(columns: Columns, base: Base) -> list[str]:
    """One expression an independent column: the unknown and what is regrouped with it."""
    return [
        " ".join(
            [
                columns.names[own],
                *(
                    _term(float(base.K[i, j]), columns.names[other])
                    for j, other in enumerate(base.dependent)
                    if base.K[i, j] != 0.0
                ),
            ]
        )
        for i, own in enumerate(base.independent)
    ]


def _term(coefficient: float, name: str) -> str:
    nearest = round(coefficient)
    if nearest and abs(coefficient - nearest) < 1e-9:
        coefficient = float(nearest)
    size = abs(coefficient)
    number = "" if size == 1.0 else f"{size:.6g} "
    return f"{'-' if coefficient < 0 else '+'} {number}{name}"


def absorbed_by(columns: Columns, base: Base) -> dict[str, str]:
    """For every dependent unknown what carries it, or that nothing in this motion feels it."""
    found = {}
    for j, other in enumerate(base.dependent):
        carriers = [columns.names[base.independent[i]] for i in np.flatnonzero(base.K[:, j])]
        found[columns.names[other]] = ", ".join(carriers)
    return found
