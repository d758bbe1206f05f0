"""Units of signals, and of expressions of them."""

from __future__ import annotations

import ast
from collections.abc import Mapping

UNITS: Mapping[str, tuple[str, str]] = {  # at a rotational and at a linear joint
    "q": ("rad", "m"), "v": ("rad/s", "m/s"), "a": ("rad/s²", "m/s²"), "t": ("s", "s"),
    "load": ("N m", "N"), "temperature": ("°C", "°C"),
}  # fmt: skip
Powers = Mapping[str, float]  # of signals


def dimension(text: str, of: Mapping[str, Powers] | None = None) -> Powers:
    """Return the powers of signals in the unit of a text, given those of its constants."""
    return _dimension(ast.parse(text or "1", mode="eval").body, of or {})


def _dimension(node: ast.expr, of: Mapping[str, Powers]) -> Powers:
    match node:
        case ast.Name(id=name):
            return {name: 1.0} if name.removesuffix("_o") in UNITS else of.get(name, {})
        case ast.UnaryOp(operand=x) | ast.Call(func=ast.Name(id="abs"), args=[x]):
            return _dimension(x, of)
        case ast.Call(func=ast.Name(id="sqrt"), args=[x]):
            return scaled(_dimension(x, of), 0.5)
        case ast.BinOp(left=x, op=ast.Pow(), right=ast.Constant(value=power)):
            return scaled(_dimension(x, of), power)  # type: ignore[arg-type]
        case ast.BinOp(left=x, op=ast.Mult() | ast.Div() as op, right=y):
            found = dict(_dimension(x, of))
            for name, power in _dimension(y, of).items():
                found[name] = found.get(name, 0) + (power if isinstance(op, ast.Mult) else -power)
            return {name: power for name, power in found.items() if power}
        case ast.BinOp(left=x, op=ast.Add() | ast.Sub()):
            return _dimension(x, of)
    return {}  # a number, a power that is searched, sin, cos, exp, …


def scaled(powers: Powers, by: float) -> Powers:
    """Return the powers of a power."""
    return {name: by * power for name, power in powers.items()}


def unit_of(powers: Powers, turns: bool, second: bool, force: float = 0.0) -> str:
    """Return the unit of a power of force times powers of signals.

    Args:
        powers: of the signals.
        turns, second: whether the joint turns, and the other one.
        force: power of the joint's torque or force.
    """
    own = "N m" if turns else "N"
    found = {own: force}
    for signal, power in powers.items():
        place = 0 if (second if signal.endswith("_o") else turns) else 1
        unit = own if signal == "load" else UNITS[signal.removesuffix("_o")][place]
        base, _, time = unit.replace("°C", "K").partition("/")
        found[base] = found.get(base, 0.0) + power
        if time:
            found["s"] = found.get("s", 0.0) - power * (2 if "²" in time else 1)
    over = [_raised(u, p) for u, p in found.items() if p > 0]
    under = [_raised(u, -p, " " in u) for u, p in found.items() if p < 0]
    top = " ".join(over) or "1"
    return f"{top}/({' '.join(under)})" if len(under) > 1 else "/".join([top, *under])


def _raised(unit: str, power: float, bracket: bool = False) -> str:
    mark = {1.0: "", 2.0: "²", 3.0: "³"}.get(power, f"^{power:g}")
    return f"({unit}){mark}" if bracket or (mark and " " in unit) else f"{unit}{mark}"
