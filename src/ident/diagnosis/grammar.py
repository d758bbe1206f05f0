"""The terms of which formulas are made: functions of a signal, and products of two of them.

A term with a name is a law of the literature; the others are steps on the way to one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from ident.effects.formula import Scale, Term

PROBE = Term(
    (
        "q_o", "q_o**2", "q_o**3", "sin(2*q_o)", "cos(2*q_o)", "sin(3*q_o)", "cos(3*q_o)",
        "q*q_o", "v*q_o", "sign(v)*q_o", "v_o", "sign(v_o)",
    ),
)  # fmt: skip
"""Columns that show whether another joint's signals matter."""
Powers = tuple[tuple[str, float], ...]


def terms(signals: frozenset[str], rotational: bool) -> Iterator[Term]:
    """Yield all terms of some signals of a joint, `q_o` and `v_o` being another joint's.

    Args:
        signals: those that formulas may use.
        rotational: whether the joint turns: positions of others do not repeat.
    """
    if "q" in signals:
        yield from _of_position(rotational)
    if "v" in signals:
        yield from _of_speed("v")
    if {"q", "v"} <= signals:
        for f in _factors("q", rotational):
            yield _product(f, "sign(v)", (), "position_dependent_friction")
            yield _product(f, "v", (("v", 1),), "position_dependent_friction")
    if {"load", "v"} <= signals:
        yield from _of_load()
    if "a" in signals:
        yield from _of_rates(signals)
    if {"t", "v"} <= signals:
        for f in _of_time():
            yield f
            if f.known_as == "disturbance":
                continue
            yield _product(f, "sign(v)", (), "running_in")
            yield _product(f, "v", (("v", 1),), "running_in")
            yield _product(f, "q", (("q", 1),), "")
    if "q_o" in signals:
        yield from _of_two(rotational)


def _of_position(rotational: bool) -> Iterator[Term]:
    q, b, c = (("q", 1),), Scale("b", "angle"), Scale("c", "share")
    yield Term(("q", "1"), (), "spring", q)
    yield Term(("q**2",), (), "", (("q", 2),))
    yield Term(("q**3",), (), "hardening_spring", (("q", 3),))
    yield Term(("abs(q)",), (), "", q)
    place, width = Scale("q0", "place", "q"), Scale("x0", "width", "q")
    yield Term(("(q - q0)**3",), (place,), "hardening_spring", (("q", 3),))
    yield Term(("abs(q - q0)",), (place,), "", q)
    yield Term(("q - q0 + abs(q - q0)",), (place,), "end_stop", q)
    yield Term(("q0 - q + abs(q - q0)",), (place,), "end_stop", q)
    yield Term(("(q - q0 + abs(q - q0))**2",), (place,), "bump_stop", (("q", 2),))
    yield Term(("(q0 - q + abs(q - q0))**2",), (place,), "bump_stop", (("q", 2),))
    yield Term(("(q - q0 + abs(q - q0))**3",), (place,), "bump_stop", (("q", 3),))
    yield Term(("(q0 - q + abs(q - q0))**3",), (place,), "bump_stop", (("q", 3),))
    yield Term(("exp(q/x0)",), (width,), "bump_stop")
    yield Term(("exp(-q/x0)",), (width,), "bump_stop")
    yield Term(("tanh((q - q0)/x0)",), (place, width), "saturating_spring")
    yield Term(("1/(1 + ((q - q0)/x0)**2)",), (place, width), "magnetic_spring")
    yield Term(("(q - q0)/(1 + ((q - q0)/x0)**2)**2",), (place, width), "magnetic_spring", q)
    yield Term(("exp(-((q - q0)/x0)**2)",), (place, width), "magnetic_detent")
    yield Term(("(q - q0)*exp(-((q - q0)/x0)**2)",), (place, width), "magnetic_detent", q)
    yield Term(("(q - q0)/sqrt((q - q0)**2 + x0**2)",), (place, width), "toggle_spring")
    yield Term(("sqrt((q - q0)**2 + x0**2)",), (place, width), "toggle_spring", q)
    wave = Scale("n", "wave", "q")
    yield Term(("sin(n*q)", "cos(n*q)"), (wave,), "cam")
    yield Term(("sin(n*q)", "cos(n*q)", "sin(2*n*q)", "cos(2*n*q)"), (wave,), "magnetic_detent")
    yield Term(("abs(sin(n*q + b))",), (wave, b), "cam")
    yield Term(("sign(sin(n*q + b))",), (wave, b), "cam")
    if rotational:  # levers
        yield Term(("sin(q)", "cos(q)"), (), "weight_counterbalance")
        yield Term(("sin(q + b)/sqrt(1 + c*cos(q + b))",), (b, c), "gas_spring")
        yield Term(
            ("sin(q + b)", "sin(q + b)/sqrt(1 + c*cos(q + b))"), (b, c), "spring_counterbalance"
        )
        yield Term(("sin(q + b)*sqrt(1 + c*cos(q + b))",), (b, c), "spring_counterbalance")
        yield Term(("sin(q + b)/(1 + c*cos(q + b))",), (b, c), "gas_spring")
        yield Term(("sin(2*q)", "cos(2*q)"), (), "cam")
        yield Term(("tan(q/2)",), (), "toggle_spring")


def _of_speed(v: str) -> Iterator[Term]:
    one, width, p = ((v, 1.0),), Scale("v0", "width", v), Scale("p", "power")
    yield Term((v,), (), "viscous", one)
    yield Term((f"sign({v})",), (), "coulomb")
    yield Term((f"{v}*abs({v})",), (), "drag", ((v, 2),))
    yield Term((f"{v}**3",), (), "drag", ((v, 3),))
    yield Term((f"abs({v})",), (), "asymmetric_friction", one)
    yield Term((f"{v}**2",), (), "", ((v, 2),))
    yield Term((f"sign({v})*abs({v})**p",), (p,), "fluid_drag")  # its coefficient: at 1 rad/s
    yield Term((f"sign({v})*exp(-({v}/v0)**2)",), (width,), "stribeck")
    yield Term((f"sign({v})*exp(-abs({v})/v0)",), (width,), "stribeck_exponential")
    yield Term((f"sign({v})/(1 + ({v}/v0)**2)",), (width,), "stribeck_lorentz")
    yield Term((f"sign({v})/(1 + abs({v})/v0)",), (width,), "stribeck_hyperbolic")
    yield Term((f"sign({v})*(1 - tanh(abs({v})/v0))",), (width,), "stribeck_tanh")
    yield Term((f"{v}/(abs({v}) + v0)",), (width,), "saturating_friction")
    yield Term((f"tanh({v}/v0)",), (width,), "saturating_friction")
    yield Term((f"{v}/sqrt({v}**2 + v0**2)",), (width,), "saturating_friction")
    yield Term((f"{v}/(1 + ({v}/v0)**2)",), (width,), "eddy_current_drag", one)
    yield Term((f"{v}*exp(-({v}/v0)**2)",), (width,), "", one)
    yield Term((f"{v}*exp(-abs({v})/v0)",), (width,), "", one)
    yield Term((f"sign({v})*log(1 + abs({v})/v0)",), (width,), "eyring_friction")


def _of_load() -> Iterator[Term]:
    load, width = (("load", 1),), Scale("l0", "width", "load")
    yield Term(("load",), (), "torque_gain", load)
    yield Term(("abs(load)",), (), "", load)
    yield Term(("abs(load)*sign(v)",), (), "load_friction", load)
    yield Term(("load + abs(load)*sign(v)",), (), "worm_gear", load)
    yield Term(("load - abs(load)*sign(v)",), (), "worm_gear", load)
    yield Term(("sign(v) + sign(load)",), (), "worm_gear")
    yield Term(("sign(v) - sign(load)",), (), "worm_gear")
    yield Term(("load**2*sign(v)",), (), "load_friction", (("load", 2),))
    yield Term(("sqrt(abs(load))*sign(v)",), (), "load_friction", (("load", 0.5),))
    yield Term(("tanh(load/l0)*sign(v)",), (width,), "load_friction")
    yield Term(("tanh(abs(load)/l0)*sign(v)",), (width,), "load_friction")
    yield Term(("abs(load)*v",), (), "load_dependent_viscous", (("load", 1), ("v", 1)))
    yield Term(("load*v",), (), "", (("load", 1), ("v", 1)))
    stribeck = Scale("v0", "width", "v")
    yield Term(("abs(load)*sign(v)*exp(-(v/v0)**2)",), (stribeck,), "load_dependent_stribeck", load)
    yield Term(("abs(load)*v/(abs(v) + v0)",), (stribeck,), "load_friction", load)


def _of_rates(signals: frozenset[str]) -> Iterator[Term]:
    if "a" in signals:
        yield Term(("a",), (), "rotor_inertia", (("a", 1),))
    if {"a", "v"} <= signals:
        yield Term(("a*abs(v)",), (), "", (("a", 1), ("v", 1)))
        yield Term(("a*v",), (), "", (("a", 1), ("v", 1)))
        yield Term(("abs(a)*sign(v)",), (), "inertial_friction", (("a", 1),))
    if {"a", "q"} <= signals:
        yield Term(("a*q",), (), "varying_inertia", (("a", 1), ("q", 1)))
        yield Term(("a*q**2",), (), "varying_inertia", (("a", 1), ("q", 2)))
        yield Term(("a*sin(q)", "a*cos(q)"), (), "varying_inertia", (("a", 1),))


def _of_time() -> tuple[Term, ...]:
    tau = Scale("t0", "width", "t")
    wave = Scale("n", "wave", "t")
    return (
        Term(("t",), (), "drift", (("t", 1),)),
        Term(("exp(-t/t0)",), (tau,), "running_in"),
        Term(("1/(1 + t/t0)",), (tau,), "running_in"),
        Term(("sqrt(t)",), (), "drift", (("t", 0.5),)),
        Term(("log(1 + t/t0)",), (tau,), "drift"),
        Term(("sin(n*t)", "cos(n*t)"), (wave,), "disturbance"),
    )


def _factors(q: str, rotational: bool) -> Iterator[Term]:
    place, width = Scale("q0", "place", q), Scale("x0", "width", q)
    yield Term((q,), (), "", ((q, 1),))
    yield Term((f"{q}**2",), (), "", ((q, 2),))
    yield Term((f"({q} - q0)**2",), (place,), "", ((q, 2),))
    yield Term((f"abs({q})",), (), "", ((q, 1),))
    yield Term((f"abs({q} - q0)",), (place,), "", ((q, 1),))
    yield Term((f"exp({q}/x0)",), (width,))
    yield Term((f"exp(-{q}/x0)",), (width,))
    yield Term((f"exp(-(({q} - q0)/x0)**2)",), (place, width))
    yield Term((f"tanh(({q} - q0)/x0)",), (place, width))
    wave = Scale("n", "wave", q)
    yield Term((f"sin(n*{q})", f"cos(n*{q})"), (wave,))
    if rotational:
        yield Term((f"sin({q})", f"cos({q})"))
        yield Term((f"sin(2*{q})", f"cos(2*{q})"))


def _product(f: Term, word: str, powers: Powers, name: str) -> Term:
    """Return a term times another signal."""
    if word == "1":
        return replace(f, known_as=name or f.known_as)
    columns = tuple(
        f"({c})*{word}" if " " in c and not c.startswith(("exp", "sin", "cos", "abs", "tanh"))
        else f"{c}*{word}" for c in f.columns
    )  # fmt: skip
    return Term(columns, f.scales, name, (*f.powers, *powers))


def _of_two(rotational: bool) -> Iterator[Term]:
    """Yield terms of two joints' positions and speeds."""
    for f in _factors("q_o", rotational):
        yield _product(f, "1", (), "cross_coupling")
        for word, powers in (
            ("q", (("q", 1.0),)), ("sign(v)", ()), ("v", (("v", 1.0),)), ("v_o", (("v_o", 1.0),)),
        ):  # fmt: skip
            yield _product(f, word, powers, "cross_coupling")
    if rotational:
        for a in ("sin(q)", "cos(q)"):
            yield Term((f"{a}*sin(q_o)", f"{a}*cos(q_o)"), (), "cross_coupling")
        yield Term(("sin(q - q_o)", "cos(q - q_o)"), (), "cross_coupling")
        yield Term(("sin(q + q_o)", "cos(q + q_o)"), (), "cross_coupling")
    yield Term(("q - q_o",), (), "cross_coupling", (("q", 1),))
    yield Term(("(q - q_o)**3",), (), "cross_coupling", (("q", 3),))
    yield Term(("q**2*q_o",), (), "cross_coupling", (("q", 2), ("q_o", 1)))
    yield Term(("q**2*q_o**2",), (), "cross_coupling", (("q", 2), ("q_o", 2)))
    yield Term(("v_o",), (), "cross_coupling", (("v_o", 1),))
    yield Term(("sign(v_o)",), (), "cross_coupling")
    yield Term(("v*v_o",), (), "cross_coupling", (("v", 1), ("v_o", 1)))
    yield Term(("v_o*abs(v_o)",), (), "cross_coupling", (("v_o", 2),))
    yield Term(("sign(v - v_o)",), (), "cross_coupling")
    yield Term(("sign(v + v_o)",), (), "cross_coupling")
