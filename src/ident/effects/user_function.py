"""What kinds of effects from a user's Python function have in common, at joints and at frames."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ident.effects.effect import Unknown
from ident.errors import MechanismError, line_of
from ident.lazy import lazy

if TYPE_CHECKING:
    import casadi as ca
else:
    ca = lazy("casadi")

Shapes = tuple[Mapping[str, float], tuple[Unknown, ...]]  # starts by name, and the entries


def members_of(
    kind: str, function: Callable[..., Any], shapes: Shapes, file: Path | None, module: str
) -> dict[str, Any]:
    """Return the members of a class of a kind, as they are whatever the function describes.

    Args:
        kind: its name; function: that describes it.
        shapes: starts and entries of the function's keyword arguments.
        file: that the function was read from, if it was; module: that the class belongs to.
    """
    starting, entries = shapes
    return {
        "__doc__": inspect.getdoc(function) or "A user's own effect.",
        "__module__": module,
        "kind": kind,
        "function": staticmethod(function),
        "starting": starting,
        "shapes": entries,
        "file": file,
        "source": file.name if file else "a function of one's own",
    }


def split_unit(key: str) -> tuple[str, str]:
    """Return the name and the unit of a key such as "k [N m/rad]"; "?" without one."""
    name, _, unit = key.partition(" [")
    return name, unit.removesuffix("]") or "?"


def compiled_columns(kind: str, inputs: Sequence[ca.SX], columns: ca.SX) -> ca.Function:
    """Return expressions of a user as a function of its inputs.

    Raises:
        MechanismError: for an expression with other symbols than the inputs.
    """
    try:
        return ca.Function("columns", [*inputs], [ca.densify(columns)])
    except Exception as error:  # of CasADi, whatever its type
        raise MechanismError(
            f"effect '{kind}': its expression has other symbols than those of s: {line_of(error)}"
        ) from None
