"""Effects of one's own, from CasADi expressions.

    def bump(s, w=(0.1, 0.01, 1.0)):                 # w: start, lowest, highest: searched
        return {"A": ca.exp(-((s.q - 0.3) / w) ** 2)}     # torque = A · column

`s` has q, v, a, tau, lam (the load, |λ| in a closure's joint) and t. With several joints the torque
acts on the first, and s.q[1] … are those of the others.
"""

from __future__ import annotations

import inspect
import runpy
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from ident.effects.base import Bounds, Effect, Shape, Unknown
from ident.effects.signals import Signals
from ident.errors import MechanismError, one_of

SIGNALS = ("q", "v", "a", "tau", "lam")
UserFunction = Callable[..., Mapping[str, Any]]


class UserEffect(Effect):
    """Base of the classes that `user_effect` makes."""

    function: ClassVar[UserFunction]
    starting: ClassVar[Mapping[str, tuple[float, float, float]]]
    file: ClassVar[Path | None] = None

    @property
    def arity(self) -> int:  # type: ignore[override]
        """As many as are given, one at least."""
        return max(1, len(self.joints))

    def columns(self, s: Signals) -> np.ndarray:
        """E: the user's columns at the first joint; the others are only looked at."""
        compiled, _ = compiled_of(type(self), len(self.joints))
        lam = s.load if self.implicit else np.zeros_like(s.q)
        tau = s.torque if self.implicit else np.zeros_like(s.q)
        shape = [np.full((1, len(s.t)), s.shape[each.name]) for each in self.shapes]
        found = compiled.map(len(s.t))(
            s.q.T,
            s.v.T,
            s.a.T,
            tau.T,
            lam.T,
            s.t[None],
            np.concatenate([*shape, np.empty((0, len(s.t)))]),
        ).full()
        E = np.zeros((*s.q.shape, len(self.unknowns)))
        E[:, 0] = found.T
        return E

    def bounds(self, s: Signals) -> Bounds:
        """As the function's keyword arguments give them."""
        return {name: (low, high) for name, (_, low, high) in self.starting.items()}

    def starts(self, s: Signals) -> list[Shape]:
        """The given start, and two on either side of it."""
        if not self.starting:
            return [{}]
        found = []
        for share in (0.0, -0.5, 0.5, -0.9, 0.9):
            found.append(
                {
                    name: start + (abs(share) * ((high if share > 0 else low) - start))
                    for name, (start, low, high) in self.starting.items()
                }
            )
        return found


def compiled_of(kind: type[UserEffect], joints: int) -> tuple[ca.Function, tuple[str, ...]]:
    """The user's columns of `joints` joints as a function, and the unknowns' names.

    Raises:
        MechanismError: if the function fails or returns anything but named CasADi expressions.
    """
    symbols = {name: ca.SX.sym(name, joints) for name in SIGNALS}
    t, shapes = ca.SX.sym("t"), ca.SX.sym("s", len(kind.starting))
    given = {name: shapes[i] for i, name in enumerate(kind.starting)}
    try:
        returned = kind.function(SimpleNamespace(**symbols, t=t), **given)
        named = {str(name): ca.SX(column) for name, column in returned.items()}
        column = ca.vertcat(*named.values())
        inputs = [*symbols.values(), t, shapes]
        compiled = ca.Function("columns", inputs, [ca.densify(column)])
    except Exception as error:  # it is the user's code
        what = " ".join(str(error).split())[:200]
        raise MechanismError(
            f"effect '{kind.kind}': its function fails: {type(error).__name__}: {what}; it is "
            "given s with q, v, a, tau, lam, t and returns {'unknown': CasADi expression}"
        ) from None
    if column.shape != (len(named), 1) or not named:
        raise MechanismError(
            f"effect '{kind.kind}': its function returns {column.shape[0]} numbers for the "
            f"unknowns {', '.join(named) or 'none'}; valid: one expression each"
        )
    return compiled, tuple(named)


def user_effect(name: str, function: UserFunction, file: Path | None = None) -> type[UserEffect]:
    """A kind of effect from a function of signals; `mechanism + Kind(("elbow",))` adds it.

    Args:
        name: of the kind, as in parameters' names.
        function: `s -> {unknown: column}`, CasADi expressions of s.q, s.v, s.a, s.tau, s.lam, s.t
            of one joint (of several: s.q[0] …); keyword arguments (start, low, high) are shape
            parameters, which are searched.
        file: where it was read from.

    Raises:
        MechanismError: if the function cannot be used.
    """
    if not name.isidentifier():
        raise MechanismError(f"effect '{name}': give a name of letters, digits and _")
    starting = {}
    for key, parameter in list(inspect.signature(function).parameters.items())[1:]:
        start = parameter.default
        if not (isinstance(start, tuple) and len(start) == 3):
            raise MechanismError(
                f"effect '{name}': {key} = {start!r}; give its start and bounds: "
                f"{key}=(start, lowest, highest)"
            )
        starting[key] = tuple(float(x) for x in start)
    members: dict[str, Any] = {
        "__doc__": inspect.getdoc(function) or "A user's own effect.",
        "__module__": __name__,
        "kind": name,
        "function": staticmethod(function),
        "starting": starting,
        "file": file,
        "shapes": tuple(Unknown(key, ("?", "?"), "of the user's function") for key in starting),
        "signature": "as the user's expression has it",
        "source": str(file.name) if file else "the user's function",
    }
    kind = type(name, (UserEffect,), members)
    for joints in (1, 2, 3):  # a function of two joints' signals fails with one
        try:
            _, names = compiled_of(kind, joints)
            break
        except MechanismError:
            if joints == 3:
                raise
    symbols = {each: ca.SX.sym(each, joints) for each in SIGNALS}
    shapes = {key: ca.SX.sym(key) for key in starting}
    columns = function(SimpleNamespace(**symbols, t=ca.SX.sym("t")), **shapes)
    kind.unknowns = tuple(Unknown(each, ("?", "?"), "of the user's function") for each in names)
    kind.equation = " + ".join(f"{each} ({columns[each]})" for each in names)
    used = {x.name().split("_")[0] for x in ca.symvar(ca.vertcat(*map(ca.SX, columns.values())))}
    kind.implicit = bool({"tau", "lam"} & used)
    return kind


def read_user_effect(file: Path, name: str) -> type[UserEffect]:
    """The effect that a Python file's function `name` describes; runs the file.

    Raises:
        MechanismError: if the file cannot be run or has no such function.
    """
    try:
        found = runpy.run_path(str(file))
    except OSError as error:
        raise MechanismError(f"{file}: cannot be read: {error.strerror}; check the path") from None
    except Exception as error:  # it is the user's code
        raise MechanismError(f"{file}: fails: {type(error).__name__}: {error}") from None
    functions = {key: each for key, each in found.items() if inspect.isfunction(each)}
    if name not in functions:
        raise MechanismError(f"{file}: has no function '{name}'; {one_of(name, functions)}")
    return user_effect(name, functions[name], file)
