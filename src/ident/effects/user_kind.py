"""How a function of signals becomes a kind of effect."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from ident.effects.base import Unknown
from ident.effects.library import KINDS
from ident.effects.user import UserEffect, UserFunction, compiled_of, returned
from ident.errors import MechanismError

MOST = 3  # joints whose signals a function is tried with


def user_effect(name: str, function: UserFunction, file: Path | None = None) -> type[UserEffect]:
    """A kind of effect from a function of signals; `mechanism + Kind(("elbow",))` adds it.

    Args:
        name: of the kind, as in parameters' names.
        function: `s -> {unknown: column}`, CasADi expressions of s.q, s.v, s.a, s.tau, s.lam, s.t
            (from the log's first sample);
            keyword arguments with defaults (start, lowest, highest) are shapes, to be searched.
        file: where it was read from, if it was.

    Raises:
        MechanismError: if the function cannot be used.
    """
    if not name.isidentifier() or name in KINDS:
        why = "is in the library" if name in KINDS else "is no name"
        raise MechanismError(f"effect '{name}' {why}; give another of letters, digits and _")
    members: dict[str, Any] = {
        "__doc__": inspect.getdoc(function) or "A user's own effect.",
        "__module__": __name__,
        "kind": name,
        "function": staticmethod(function),
        "starting": _starting(name, function),
        "file": file,
        "signature": "as the function has it",
        "source": file.name if file else "a function of one's own",
    }
    kind: type[UserEffect] = type(name, (UserEffect,), members)
    first: MechanismError | None = None
    for joints in range(1, MOST + 1):  # a function of two joints' signals fails with one
        try:
            named, inputs = returned(kind, joints)
            break
        except MechanismError as error:
            first = first or error
    else:
        assert first is not None
        raise first
    kind.fewest = joints
    kind.shapes = tuple(Unknown(key, ("?", "?"), "of the function") for key in kind.starting)
    kind.unknowns = tuple(Unknown(key, ("?", "?"), "of the function") for key in named)
    kind.equation = " + ".join(f"{key} ({column})" for key, column in named.items())
    kind.memory = bool(ca.depends_on(ca.vertcat(*named.values()), inputs[5]))  # t from the start
    kind.implicit = bool(ca.depends_on(ca.vertcat(*named.values()), ca.vertcat(*inputs[3:5])))
    compiled_of(kind, joints)
    return kind


def _starting(name: str, function: UserFunction) -> dict[str, tuple[float, float, float]]:
    """Start and bounds of each shape, from the function's keyword arguments."""
    try:
        given = list(inspect.signature(function).parameters.items())[1:]
    except (TypeError, ValueError):
        raise MechanismError(f"effect '{name}': {function!r} is no function of s") from None
    found = {}
    for key, parameter in given:
        try:
            start, low, high = (float(x) for x in parameter.default)
        except (TypeError, ValueError):
            start, low, high = np.nan, 0.0, 0.0
        if not -np.inf < low <= start <= high < np.inf or not low < high:
            shown = "nothing" if parameter.default is parameter.empty else repr(parameter.default)
            raise MechanismError(
                f"effect '{name}': the default of {key} is {shown}; give its start and bounds: "
                f"{key}=(start, lowest, highest)"
            )
        found[key] = (start, low, high)
    return found
