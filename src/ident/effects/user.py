"""Effects of one's own, from CasADi expressions of the signals.

    def bump(s, w=(0.1, 0.01, 1.0)):                      # a shape: start, lowest, highest
        return {"A": ca.exp(-(((s.q - 0.3) / w) ** 2))}   # torque = A · column

`s` has q, v, a, tau, lam and t, as `SIGNALS` says. With several joints the torque acts on the
first, and each signal but t is a vector: s.q[0], s.q[1] …
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import casadi as ca
import numpy as np
from scipy.stats import qmc

from ident.effects.base import Bounds, Effect, Shape
from ident.effects.signals import Signals
from ident.errors import MechanismError

SIGNALS = {
    "q": "coordinate [rad | m]",
    "v": "its rate",
    "a": "its acceleration",
    "tau": "torque that the model predicts for the joint [N m | N]",
    "lam": "what of it the links ask for, in a closure's own joint |λ| [N m | N]",
}
STARTS = 12  # of the search, for each shape
UserFunction = Callable[..., Mapping[str, Any]]


class UserEffect(Effect):
    """Base of the classes that `user_effect` makes."""

    function: ClassVar[UserFunction]
    starting: ClassVar[Mapping[str, tuple[float, float, float]]]
    file: ClassVar[Path | None] = None
    fewest: ClassVar[int] = 1  # joints whose signals the function asks for

    def __post_init__(self) -> None:
        """Check the joints before anything else."""
        if len(self.joints) < self.fewest:
            raise MechanismError(
                f"effect '{self.kind}' looks at {self.fewest} joint(s), given: "
                f"{', '.join(self.joints) or 'none'}; write "
                f"{self.kind}:{','.join(['joint'] * self.fewest)}"
            )
        compiled_of(type(self), len(self.joints))
        super().__post_init__()

    @property
    def arity(self) -> int:  # type: ignore[override]
        """As many joints as are given."""
        return len(self.joints)

    def columns(self, s: Signals) -> np.ndarray:
        """E (n, joints, unknowns): the function's columns at the first joint, 0 at the others.

        Raises:
            MechanismError: where the function is not finite.
        """
        n, compiled = len(s.t), compiled_of(type(self), len(self.joints))
        asked = (s.torque, s.load) if self.implicit else (np.zeros_like(s.q),) * 2
        shape = np.array([s.shape[each.name] for each in self.shapes]).reshape(-1, 1)
        found = compiled(
            *(x.T for x in (s.q, s.v, s.a, *asked)), (s.t - s.t[0])[None], np.tile(shape, n)
        )
        E = np.zeros((*s.q.shape, len(self.unknowns)))
        E[:, 0] = found.full().T
        if not np.isfinite(E).all():
            at = int(np.argmin(np.isfinite(E).all(axis=(1, 2))))
            raise MechanismError(
                f"effect '{self.label}': its function is {E[at, 0]} at t = {s.t[at]:.4g} s, where "
                f"q = {s.q[at, 0]:.4g}, v = {s.v[at, 0]:.4g}; make it finite for every motion"
            )
        return E

    def bounds(self, s: Signals) -> Bounds:
        """As the function's keyword arguments give them."""
        return {name: (low, high) for name, (_, low, high) in self.starting.items()}

    def starts(self, s: Signals) -> list[Shape]:
        """The given start, and points spread evenly between the bounds."""
        if not self.starting:
            return [{}]
        k = len(self.starting)
        shares = qmc.Halton(k, scramble=False).random(STARTS * k + 1)[1:]
        spread = [
            {
                name: float(low + x * (high - low))
                for x, (name, (_, low, high)) in zip(share, self.starting.items(), strict=True)
            }
            for share in shares
        ]
        return [{name: start for name, (start, _, _) in self.starting.items()}, *spread]


def returned(kind: type[UserEffect], joints: int) -> tuple[dict[str, ca.SX], list[ca.SX]]:
    """The function's columns by unknown, and the symbols that they are of.

    Raises:
        MechanismError: if it fails or returns anything but one expression an unknown.
    """
    symbols = {name: ca.SX.sym(name, joints) for name in SIGNALS}
    t, shapes = ca.SX.sym("t"), {name: ca.SX.sym(name) for name in kind.starting}
    try:
        returned = kind.function(SimpleNamespace(**symbols, t=t), **shapes)
        named = {str(name): ca.SX(column) for name, column in returned.items()}
    except Exception as error:  # it is the user's code
        raise MechanismError(
            f"effect '{kind.kind}': its function fails: {said(error)}; it is given s with "
            f"{', '.join(SIGNALS)}, t and returns {{'unknown': CasADi expression}}"
        ) from None
    for name, column in named.items():
        if not name.isidentifier() or column.shape != (1, 1):
            raise MechanismError(
                f"effect '{kind.kind}': its function returns {column.shape[0]} × "
                f"{column.shape[1]} numbers for the unknown '{name}'; valid: one expression for "
                "each name (of several joints take one: s.q[0])"
            )
    if not named:
        raise MechanismError(f"effect '{kind.kind}': its function returns no unknown")
    return named, [*symbols.values(), t, ca.vertcat(*shapes.values())]


@cache
def compiled_of(kind: type[UserEffect], joints: int) -> ca.Function:
    """(q, v, a, tau, lam (joints each), t, shapes) → columns (unknowns,)."""
    named, inputs = returned(kind, joints)
    column = ca.densify(ca.vertcat(*named.values()))
    try:
        return ca.Function("columns", inputs, [column])
    except Exception as error:  # symbols that are not those it was given
        raise MechanismError(
            f"effect '{kind.kind}': its expression has other symbols than those of s: {said(error)}"
        ) from None


def said(error: BaseException) -> str:
    """An exception of the user's code in one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
