"""Errors of the predicted torque, joint by joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ident.tables import percent


@dataclass(frozen=True)
class Error:
    """Of one joint: rms [N m | N], relative ‖τ − τ̂‖/‖τ‖ (None where nothing was measured)."""

    rms: float
    relative: float | None
    unit: str


@dataclass(frozen=True, eq=False)
class Squares:
    """Sums of squares a coordinate (d,): of the error, of the measured torque; and rows."""

    error: np.ndarray
    torque: np.ndarray
    rows: np.ndarray

    def __add__(self, other: Squares) -> Squares:
        return Squares(self.error + other.error, self.torque + other.torque, self.rows + other.rows)

    def errors(self, names: Sequence[str], units: Sequence[str]) -> dict[str, Error]:
        """By joint."""
        found = {}
        for u, (name, unit) in enumerate(zip(names, units, strict=True)):
            rms = float(np.sqrt(self.error[u] / max(self.rows[u], 1)))
            relative = (
                float(np.sqrt(self.error[u] / self.torque[u])) if self.torque[u] > 0 else None
            )
            found[name] = Error(rms, relative, unit)
        return found


def error_rows(named: Mapping[str, Mapping[str, Error]]) -> list[list[str]]:
    """One row a joint, two columns (rms, relative) a set of errors."""
    titles = [title for title in named if named[title]]
    joints = list(dict.fromkeys(joint for title in titles for joint in named[title]))
    rows = [["joint", *(cell for title in titles for cell in (title, ""))]]
    for joint in joints:
        row = [joint]
        for title in titles:
            error = named[title].get(joint)
            row += ["", ""] if error is None else [
                f"{error.rms:.3g} {error.unit}", percent(error.relative)
            ]  # fmt: skip
        rows.append(row)
    return rows
