"""Cells and stretches as a few arrays, and back."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ident.fit.accumulate import Cell
from ident.solve.factor import Factor
from ident.solve.free import Freed
from ident.solve.stretch import Part, Stretch


def packed(cells: Iterable[Cell]) -> dict[str, np.ndarray]:
    """Arrays by name, those of each coordinate together, as their cells have the same columns."""
    by: dict[int, list[Cell]] = {}
    for cell in cells:
        by.setdefault(cell.coordinate, []).append(cell)
    found: dict[str, np.ndarray] = {"coordinates": np.array(sorted(by), dtype=int)}
    for u, mine in by.items():
        found[f"{u}.key"] = np.array([(c.experiment, c.block) for c in mine])
        found[f"{u}.support"] = mine[0].support
        found[f"{u}.numbers"] = np.array([(c.tau, *c.span) for c in mine])
        for name in ("factor", "rest"):
            some = [(i, f) for i, c in enumerate(mine) if (f := getattr(c, name)).rows]
            found[f"{u}.{name}.at"] = np.array([(i, f.rows) for i, f in some], dtype=int)
            found[f"{u}.{name}.rho"] = np.array([f.rho for _, f in some])
            found[f"{u}.{name}.d"] = np.array([f.d for _, f in some])
            found[f"{u}.{name}.R"] = np.array([f.R for _, f in some])
    return found


def unpacked(arrays: Mapping[str, Any]) -> list[Cell]:
    """The cells in arrays that `packed` made."""
    cells = []
    for u in map(int, arrays["coordinates"]):
        key, numbers, support = (arrays[f"{u}.{each}"] for each in ("key", "numbers", "support"))
        factor, rest = (_factors(arrays, f"{u}.{each}", support) for each in ("factor", "rest"))
        empty = Factor.empty(len(support))
        for i, ((log, block), (tau, first, last)) in enumerate(zip(key, numbers, strict=True)):
            told, still = factor.get(i, empty), rest.get(i, empty)
            span = float(first), float(last)
            cells.append(Cell(int(log), int(block), u, told, still, support, float(tau), span))
    return cells


def _factors(arrays: Mapping[str, Any], name: str, support: np.ndarray) -> dict[int, Factor]:
    at, rho, d, R = (arrays[f"{name}.{each}"] for each in ("at", "rho", "d", "R"))
    k = len(support)
    found = {}
    for (i, rows), rho_i, d_i, R_i in zip(
        at.reshape(-1, 2), rho, d.reshape(-1, k), R.reshape(-1, k, k), strict=True
    ):
        for array in (d_i, R_i):
            array.flags.writeable = False
        found[int(i)] = Factor(R_i, d_i, float(rho_i), int(rows))
    return found


def packed_stretches(stretches: Mapping[int, Stretch]) -> dict[str, np.ndarray]:
    """Arrays by name, of each log's stretch."""
    found = {"stretches": np.array(sorted(stretches), dtype=int)}
    for log, s in stretches.items():
        name, factors = f"stretch.{log}", s.freed.factors
        each = [*factors.values()]
        found |= {
            f"{name}.knots": np.array([(part.left, part.right) for part in s.parts]),
            f"{name}.X": np.array([part.X for part in s.parts]),
            f"{name}.Y": np.array([part.Y for part in s.parts]),
            f"{name}.shape": np.array(s.shape),
            f"{name}.scale": np.array(s.scale),
            f"{name}.begins": s.freed.begins,
            f"{name}.balance": s.freed.balance,
            f"{name}.at": np.array([(i, f.rows) for i, f in factors.items()], dtype=int),
            f"{name}.rho": np.array([f.rho for f in each]),
            f"{name}.d": np.array([f.d for f in each]),
            f"{name}.R": np.array([f.R for f in each]),
        }
    return found


def unpacked_stretches(arrays: Mapping[str, Any]) -> dict[int, Stretch]:
    """The stretches in arrays that `packed_stretches` made, by log."""
    found = {}
    for log in map(int, arrays["stretches"]):
        name = f"stretch.{log}"
        knots, X, Y, begins, balance = (
            arrays[f"{name}.{each}"] for each in ("knots", "X", "Y", "begins", "balance")
        )
        parts = tuple(
            Part(int(left), int(right), x, y)
            for (left, right), x, y in zip(knots, X, Y, strict=True)
        )
        width, m, k = map(int, arrays[f"{name}.shape"])
        freed = Freed(begins, k, _factors(arrays, name, np.arange(k)), balance)
        found[log] = Stretch(parts, freed, (width, m, k), float(arrays[f"{name}.scale"]))
    return found
