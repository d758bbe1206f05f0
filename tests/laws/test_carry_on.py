"""What a user does with a law: added, written, read back, compared; and files of earlier laws."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest

import ident
from helpers import ROBOTS
from ident.diagnosis.diagnosis import of_one_form
from ident.diagnosis.result import Law
from ident.effects.curve import Curve
from ident.effects.formula import Formula, Scale, Term
from ident.effects.library import parse
from ident.errors import FitError, MechanismError
from ident.show.diagnosis_report import write_instead

MAGNET = Term(("1/(1 + ((q - q0)/x0)**2)",), (Scale("q0", "place", "q"), Scale("x0", "width", "q")))
AT = {"q0": (0.9, -2.0, 3.0), "x0": (0.35, 0.05, 5.0)}


def magnet() -> Formula:
    return Formula(("elbow",), terms=(MAGNET,), found=AT)


@pytest.fixture(scope="module")
def fit() -> ident.Fit:
    mechanism = ident.load(ROBOTS / "arm").with_effect("viscous").with_effect("coulomb")
    mechanism = mechanism + magnet()
    return ident.identify(mechanism, ident.complete(mechanism, ROBOTS / "arm" / "run.csv"))


def test_a_fit_with_a_law_is_written_and_read_back(fit, tmp_path):
    fit.write(tmp_path / "out")
    assert (tmp_path / "out" / "law_elbow.py").exists()
    plain = ident.load(ROBOTS / "arm")
    with pytest.raises(FitError, match="pass --allow-code"):
        ident.read_fit(tmp_path / "out", plain)
    saved = ident.read_fit(tmp_path / "out", plain, allow_code=True)
    for name in ("law.elbow.k", "law.elbow.q0", "law.elbow.x0"):
        assert saved.point.values[name] == pytest.approx(fit.point.values[name])
    again = ident.load(tmp_path / "out" / "identified", allow_code=True)
    assert "law:elbow" in [effect.label for effect in again.effects]
    (errors,) = ident.compare(saved, motion=fit.motion).errors.values()
    (own,) = ident.compare(fit, motion=fit.motion).errors.values()
    assert errors["elbow"].rms == pytest.approx(own["elbow"].rms, rel=1e-4)


def test_a_file_elsewhere_is_not_run(fit, tmp_path):
    fit.write(tmp_path / "out")
    path = tmp_path / "out" / "fit.json"
    path.write_text(path.read_text().replace('"law_elbow.py"', '"../law_elbow.py"'))
    with pytest.raises(FitError, match="none of the library"):
        ident.read_fit(path, ident.load(ROBOTS / "arm"), allow_code=True)


def test_a_law_is_added_as_an_effect_is():
    law = object.__new__(Law)
    object.__setattr__(law, "effect", magnet())
    arm = ident.load(ROBOTS / "arm")
    assert (arm + law).effects[-1].names == ("law.elbow.k", "law.elbow.q0", "law.elbow.x0")


def test_values_on_the_command_line():
    assert parse("curve:elbow:q:pieces=8") == ("curve", ("elbow",), "q", {"pieces": 8.0}, "")
    assert parse("coupling:a,b:Im=1,Fcm=2")[3] == {"Im": 1, "Fcm": 2}
    assert ident.load(ROBOTS / "arm").with_effect("curve:elbow:q:pieces=8").effects[0].pieces == 8
    for text in ("curve:elbow:q:pieces=x", "curve:elbow:q:pieces=", "curve:elbow:q:pieces=2,=3"):
        with pytest.raises(MechanismError, match=r"write curve:elbow:q:|no parameter"):
            ident.load(ROBOTS / "arm").with_effect(text)


def test_units_of_a_prismatic_joint_beside_a_revolute_one():
    curve = Curve(("swing", "lift"), signal="q*q").placed([True, False])
    assert curve.units[0] == "N m/rad"
    assert curve.units[-1] == "m"


def test_a_curve_of_temperature_reads_the_column_of_its_joint():
    assert Curve(("elbow",), signal="temperature*v").reads() == ("temperature.elbow",)


def test_files_of_earlier_laws_are_removed_unless_the_model_uses_them(tmp_path):
    names = ("law_elbow.py", "law_wrist.py", "curve_wrist.csv", "law_mine.py", "notes.csv")
    for name in names:
        (tmp_path / name).write_text("x = 1\n")
    entries = [
        {"effect": f"{name}:law:j"} for name in ("law_elbow.py", "law_wrist.py", "notes.csv")
    ]
    old = {"laws": entries, "curves": [{"file": "curve_wrist.csv"}]}
    (tmp_path / "diagnosis.json").write_text(json.dumps(old))
    effects = (SimpleNamespace(file=tmp_path / "law_elbow.py"),)
    d = SimpleNamespace(fit=SimpleNamespace(mechanism=SimpleNamespace(effects=effects)))
    write_instead(d, tmp_path, {"diagnosis.json": b"{}"})
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {"law_elbow.py", "law_mine.py", "notes.csv", "diagnosis.json"}
    (tmp_path / "diagnosis.json").write_text("[1]")
    assert write_instead(d, tmp_path, {"diagnosis.json": b"{}"})


def test_laws_of_two_joints_get_one_form_where_both_can_have_it():
    from ident.diagnosis.laws import FoundLaw

    def fitted(text: str, joint: str, loss: float) -> SimpleNamespace:
        formula = Formula((joint,), terms=(Term((text,)),))
        return SimpleNamespace(
            formula=formula, loss=np.array([loss]), refit=SimpleNamespace(G=2.0 - loss)
        )

    def law(joint: str, own: tuple[str, float], *rivals: tuple[str, float]) -> FoundLaw:
        first, *others = (fitted(text, joint, x) for text, x in (own, *rivals))
        rest = ("explained", "limit", "distance", "front", "replaced", "regression")
        return FoundLaw(
            fitted=first, joint=joint, rivals=tuple(others), bounds={}, gain=0.5, nearest="spring",
            **dict.fromkeys(rest),
        )  # fmt: skip

    a = law("elbow", ("q**3", 1.0), ("abs(q)", 1.01))
    b = law("wrist", ("abs(q)", 1.0), ("q**3", 1.5), ("q**2", 1.02))
    one = of_one_form([a, b])
    assert [each.fitted.formula.text for each in one] == ["k*abs(q)", "k*abs(q)"]
    assert [r.formula.text for r in one[0].rivals] == ["k*q**3"]
    assert one[0].gain == 0.5 * 0.99
    assert one[1] is b
    c = law("yaw", ("q**2", 1.0))
    assert of_one_form([a, c]) == [a, c]
    assert of_one_form([a]) == [a]
    assert of_one_form([]) == []
