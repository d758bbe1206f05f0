"""The terms of which formulas are made: functions of a signal, and products of two of them.

A term with a name is a law of the literature; the others are steps on the way to one. In the tables
x is a position: of the own joint, of another one, or their sum or difference. Constants within a
term have one meaning each (`CONSTANTS`); several columns, each with a coefficient, stand between
semicolons.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from ident.effects.formula import Scale, Term, factor

PROBE = Term(
    (
        "q_o", "q_o**2", "q_o**3", "sin(2*q_o)", "cos(2*q_o)", "sin(3*q_o)", "cos(3*q_o)",
        "q*q_o", "v*q_o", "sign(v)*q_o", "v_o", "sign(v_o)",
        *(f"{f}({n}*(q {s} q_o))" for s in "+-" for n in (2, 4) for f in ("sin", "cos")),
    ),
)  # fmt: skip
"""Columns that show whether another joint's signals matter."""

CONSTANTS = {  # by name (`Scale.of`, signal): x stands for the term's position
    "x0": ("width", "x"), "q0": ("place", "x"), "q1": ("beyond", "x"), "n": ("wave", "x"),
    "v0": ("width", "v"), "l0": ("width", "load"), "t0": ("width", "t"), "w": ("wave", "t"),
    "T0": ("width", "temperature"), "b": ("angle", ""), "c": ("share", ""),
    "m": ("exponent", ""), "p": ("power", ""),
}  # fmt: skip
Table = tuple[tuple[str, str], ...]
WAVE = "sin(n*x); cos(n*x)"
# factors of products; of rotational joints alone where they are plain sines
FACTORS = (
    "x", "x**2", "(x - q0)**2", "abs(x)", "abs(x - q0)", "exp(x/x0)", "exp(-x/x0)",
    "exp(-((x - q0)/x0)**2)", "tanh((x - q0)/x0)", WAVE,
)  # fmt: skip
TURNING = ("sin(x); cos(x)", "sin(2*x); cos(2*x)")
POSITION: Table = (
    (WAVE, "cam"),
    ("x; 1", "spring"),
    ("x**2", ""),
    ("x**3", "hardening_spring"),
    ("abs(x)", ""),
    ("(x - q0)**3", "hardening_spring"),
    ("abs(x - q0)", ""),
    ("sign(x - q0)*abs(x - q0)**p", "hardening_spring"),
    ("x - q0 + abs(x - q0)", "end_stop"),
    ("q0 - x + abs(x - q0)", "end_stop"),
    ("(x - q0 + abs(x - q0))**2", "bump_stop"),
    ("(q0 - x + abs(x - q0))**2", "bump_stop"),
    ("(x - q0 + abs(x - q0))**3", "bump_stop"),
    ("(q0 - x + abs(x - q0))**3", "bump_stop"),
    ("(x - q0 + abs(x - q0))**p", "bump_stop"),
    ("(q0 - x + abs(x - q0))**p", "bump_stop"),
    ("exp(x/x0)", "bump_stop"),
    ("exp(-x/x0)", "bump_stop"),
    ("exp(x/x0) - exp((q0 - x)/x0)", "bump_stop"),
    ("1/(x - q1)", "air_gap"),
    ("1/(x - q1)**2", "air_gap"),
    ("tanh((x - q0)/x0)", "saturating_spring"),
    ("abs(x - q0 + x0) - abs(x - q0 - x0)", "saturating_spring"),
    ("2*(x - q0) - abs(x - q0 + x0) + abs(x - q0 - x0)", "spring_with_play"),
    ("1/(1 + ((x - q0)/x0)**2)", "magnetic_spring"),
    ("(x - q0)/(1 + ((x - q0)/x0)**2)**2", "magnetic_spring"),
    ("exp(-((x - q0)/x0)**2)", "magnetic_detent"),
    ("(x - q0)*exp(-((x - q0)/x0)**2)", "magnetic_detent"),
    ("(x - q0)/sqrt((x - q0)**2 + x0**2)", "toggle_spring"),
    ("sqrt((x - q0)**2 + x0**2)", "toggle_spring"),
    ("sin(n*x); cos(n*x); sin(2*n*x); cos(2*n*x)", "magnetic_detent"),
    ("abs(sin(n*x + b))", "cam"),
    ("sign(sin(n*x + b))", "cam"),
    ("exp(m*cos(n*x + b))", "cam"),
)
LEVERS: Table = (
    ("a*sin(x); a*cos(x)", "varying_inertia"),
    ("sin(x); cos(x)", "weight_counterbalance"),
    ("sin(x + b)/sqrt(1 + c*cos(x + b))", "gas_spring"),
    ("sin(x + b)/(1 + c*cos(x + b))", "gas_spring"),
    ("sin(x + b); sin(x + b)/sqrt(1 + c*cos(x + b))", "spring_counterbalance"),
    ("sin(x + b)*sqrt(1 + c*cos(x + b))", "spring_counterbalance"),
    ("sin(2*x); cos(2*x)", "cam"),
    ("tan(x/2)", "toggle_spring"),
)
SPEED: Table = (
    ("v", "viscous"),
    ("sign(v)", "coulomb"),
    ("v*abs(v)", "drag"),
    ("v**3", "drag"),
    ("abs(v)", "asymmetric_friction"),
    ("v**2", ""),
    ("sign(v)*abs(v)**p", "fluid_drag"),  # its coefficient: at 1 rad/s
    ("sign(v)*exp(-(v/v0)**2)", "stribeck"),
    ("sign(v)*exp(-abs(v)/v0)", "stribeck_exponential"),
    ("sign(v)/(1 + (v/v0)**2)", "stribeck_lorentz"),
    ("sign(v)/(1 + abs(v)/v0)", "stribeck_hyperbolic"),
    ("sign(v)*(1 - tanh(abs(v)/v0))", "stribeck_tanh"),
    ("v/(abs(v) + v0)", "saturating_friction"),
    ("tanh(v/v0)", "saturating_friction"),
    ("v/sqrt(v**2 + v0**2)", "saturating_friction"),
    ("v/(1 + (v/v0)**2)", "eddy_current_drag"),
    ("v*exp(-(v/v0)**2)", ""),
    ("v*exp(-abs(v)/v0)", ""),
    ("sign(v)*log(1 + abs(v)/v0)", "eyring_friction"),
)
LOAD: Table = (
    ("load", "torque_gain"),
    ("abs(load)", ""),
    ("sign(load)", "worm_gear"),
    ("abs(load)*sign(v)", "load_friction"),
    ("load + abs(load)*sign(v)", "worm_gear"),
    ("load - abs(load)*sign(v)", "worm_gear"),
    ("sign(v) + sign(load)", "worm_gear"),
    ("sign(v) - sign(load)", "worm_gear"),
    ("load**2*sign(v)", "load_friction"),
    ("sqrt(abs(load))*sign(v)", "load_friction"),
    ("abs(load)**p*sign(v)", "load_friction"),
    ("tanh(load/l0)*sign(v)", "load_friction"),
    ("tanh(abs(load)/l0)*sign(v)", "load_friction"),
    ("abs(load)*v", "load_dependent_viscous"),
    ("load*v", ""),
    ("abs(load)*sign(v)*exp(-(v/v0)**2)", "load_dependent_stribeck"),
    ("abs(load)*v/(abs(v) + v0)", "load_friction"),
)
RATES: Table = (
    ("a", "rotor_inertia"),
    ("a*abs(v)", ""),
    ("a*v", ""),
    ("abs(a)*sign(v)", "inertial_friction"),
    ("a*x", "varying_inertia"),
    ("a*x**2", "varying_inertia"),
)
TIME: Table = (
    ("t", "drift"),
    ("exp(-t/t0)", "running_in"),
    ("1/(1 + t/t0)", "running_in"),
    ("sqrt(t)", "drift"),
    ("log(1 + t/t0)", "drift"),
)
TEMPERATURE = ("temperature", "temperature**2", "exp(-temperature/T0)")
VARYING: Table = (("1", ""), ("sign(v)", "running_in"), ("v", "running_in"), ("x", ""), (WAVE, ""))
TWO = (
    "v_o", "sign(v_o)", "q*v_o", "q*sign(v_o)", "v*v_o", "v_o*abs(v_o)", "q**2*q_o", "q**2*q_o**2",
)  # fmt: skip
OF_ONE_TYPE = ("sign(v - v_o)", "sign(v + v_o)", "(q - q_o)**3")  # of two joints of one type
BOTH_TURN = tuple(f"{f}(q)*sin(q_o); {f}(q)*cos(q_o)" for f in ("sin", "cos"))


def terms(
    signals: frozenset[str], rotational: bool, second_rotational: bool = True
) -> Iterator[Term]:
    """Yield all terms of some signals of a joint.

    Args:
        signals: `q` alone; `q` and `v` for q, v, a and t, with `load` and `temperature` where they
            are known; or `q_o` for signals of another joint, with the own q and v.
        rotational, second_rotational: whether the joint turns, and the other one: other positions
            do not repeat.
    """
    factors = (*FACTORS, *(TURNING if rotational else ()))
    if "q_o" in signals:
        same_type = rotational == second_rotational
        factors = (*FACTORS, *(TURNING if second_rotational else ()))
        for x in ("q_o", *(("q + q_o", "q - q_o") if same_type else ())):
            yield from (term(text, "cross_coupling", x) for text in factors)
        for text in factors:
            for other in ("q", "sign(v)", "v", "v_o"):
                yield term(product(text, other), "cross_coupling", "q_o")
        both = (
            *(OF_ONE_TYPE if same_type else ()),
            *(BOTH_TURN if rotational and second_rotational else ()),
        )
        yield from (term(text, "cross_coupling") for text in (*TWO, *both))
        return
    for table in (POSITION, LEVERS if rotational else ()):
        yield from (term(text, name) for text, name in table)
    if "v" not in signals:
        return
    for table in (SPEED, RATES):
        yield from (term(text, name) for text, name in table)
    for text in factors:
        for other in ("sign(v)", "v"):
            yield term(product(text, other), "position_dependent_friction")
    if "load" in signals:
        yield from (term(text, name) for text, name in LOAD)
    yield term("sin(w*t); cos(w*t)", "disturbance")
    varying = (*VARYING, *((("load", "torque_gain"),) if "load" in signals else ()))
    for text, name in TIME:
        for other, also in varying:
            yield term(product(other, text), also if other != "1" else name)
    for text in TEMPERATURE if "temperature" in signals else ():
        for other, _ in varying:
            yield term(product(other, text), "thermal_friction" if "v" in other else "")


def product(a: str, b: str) -> str:
    """Return each column of the first text times the second."""
    if a == "1":
        return b
    return "; ".join(f"{factor(column)}*{b}" for column in a.split("; "))


def term(text: str, name: str, x: str = "q") -> Term:
    """Return the term of a text, with a position in the place of x."""
    words = [w for w in dict.fromkeys(re.findall(r"\b[A-Za-z]\w*\b", text)) if w in CONSTANTS]
    of = ((word, *CONSTANTS[word]) for word in words)
    scales = tuple(Scale(word, kind, x if signal == "x" else signal) for word, kind, signal in of)
    place = x if x.isidentifier() else f"({x})"
    return Term(tuple(re.sub(r"\bx\b", place, text).split("; ")), scales, name)


PLAIN_WAVE = term(WAVE, "cam")
