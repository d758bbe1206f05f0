"""Every term of the grammar: finite columns, units, and a file that gives the same torque."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import ident
from ident.diagnosis.grammar import term, terms
from ident.effects import Signals
from ident.effects.formula import Formula

OWN = frozenset({"q", "load", "temperature"})
TWO = frozenset({"q_o"})
CASES = [
    pytest.param(term, joints, rotational, id=f"{term.columns[0]}-{rotational}")
    for joints, signals in ((("j.1-a",), OWN), (("j.1-a", '2b"""/..'), TWO))
    for rotational in (True, False)
    for term in terms(signals, rotational)
]


def signals(joints: int) -> Signals:
    """Noise, away from standstill."""
    rng = np.random.default_rng(0)
    q, v, a, load = rng.normal(size=(4, 50, joints))
    v += np.sign(v)
    return Signals(
        t=5.0 + np.arange(50) / 10, q=q, v=v, a=a, still=np.full(joints, 1e-3),
        predicted=lambda: (load, load), extra={"temperature.j.1-a": 20 + np.arange(50) / 5},
    )  # fmt: skip


@pytest.mark.parametrize(("term", "joints", "rotational"), CASES)
def test_its_file_gives_its_torque(term, joints, rotational, tmp_path):
    formula = Formula(joints, {}, rotational, terms=(term,))
    s = signals(len(joints))
    shape = dict(formula.starts(s)[0])
    s = replace(s, shape=shape)
    E = formula.columns(s)
    assert np.isfinite(E).all()
    assert all(unit for unit in formula.units)
    path = tmp_path / "law.py"
    bounds = formula.bounds(s)
    found = replace(formula, found={n: (x, *bounds[n]) for n, x in shape.items()})
    constants = {p.name: (shape.get(p.name, 1.0), 0.1) for p in formula.parameters}
    _, content = found.source_file(constants)
    path.write_bytes(content)
    kind = ident.read_user_effect(path, "law", allow_code=True)
    own = kind(joints, {}, rotational)
    np.testing.assert_allclose(own.columns(s)[:, 0], E[:, 0], rtol=1e-5, atol=1e-9)
    slow = replace(s, v=s.v * 2e-4, still=np.full(len(joints), 1e-3))  # the same sign at standstill
    np.testing.assert_allclose(
        own.columns(slow)[:, 0], formula.columns(slow)[:, 0], rtol=1e-5, atol=1e-9
    )
    assert (own.informed(slow) == formula.informed(slow)).all()
    assert kind.__doc__.count("±") == len(constants)


@pytest.mark.parametrize(
    ("text", "units"),
    [
        ("x; 1", ("N m/rad", "N m")),
        ("v", ("N m s/rad",)),
        ("v*abs(v)", ("N m s²/rad²",)),
        ("load", ("1",)),
        ("load**2*sign(v)", ("1/(N m)",)),
        ("sqrt(abs(load))", ("(N m)^0.5",)),
        ("load*v", ("s/rad",)),
        ("a", ("N m s²/rad",)),
        ("v*t", ("N m/rad",)),
        ("sqrt(t)", ("N m/s^0.5",)),
        ("temperature*v", ("N m s/(K rad)",)),
        ("(x - q0)/sqrt((x - q0)**2 + x0**2)", ("N m", "rad")),
        ("sqrt((x - q0)**2 + x0**2)", ("N m/rad", "rad")),
        ("q_o", ("N m/m",)),  # of a prismatic joint beside a revolute one
        ("v_o*q", ("N m s/(m rad)",)),
    ],
)
def test_units(text, units):
    joints = ("j", "k") if "_o" in text else ("j",)
    formula = Formula(joints, {}, True, terms=(term(text, ""),), second_rotational=False)
    assert set(formula.units) == set(units)
