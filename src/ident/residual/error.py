"""Errors of the predicted torque, joint by joint."""

from __future__ import annotations

from collections.abc import Mapping

from ident.information.blocks import Error, Squares
from ident.text import percent

__all__ = ["Error", "Squares", "error_rows"]


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
