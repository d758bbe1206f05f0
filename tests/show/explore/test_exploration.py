"""The ladder by hand: adding, removing, going back, undoing, saving; without any page."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from explored import given, grown, judged, screened

import ident
from helpers import ROBOTS
from ident import IdentError
from ident.show.board import top
from ident.show.ladder import cells, changed


def test_an_effect_is_added_and_the_error_falls():
    e = grown("viscous:elbow")
    assert [x.label for x in e.mechanism.effects] == ["viscous:elbow"]
    assert changed(e.now) == "+ viscous friction in elbow"
    assert e.now.errors["elbow"].rms < 0.5 * e.rungs[0].errors["elbow"].rms
    assert not e.candidates
    assert len(given().rungs) == 1  # what was there before has not changed


def test_the_fit_is_the_one_that_identify_makes():
    e = grown("viscous:elbow")
    mechanism = ident.load(ROBOTS / "arm").with_effect("viscous:elbow")
    motion = ident.complete(mechanism, ROBOTS / "arm" / "run.csv")
    fit = ident.identify(mechanism, motion, estimator="least-squares")
    for joint, error in fit.held_out.items():
        assert e.fit.held_out[joint].rms == pytest.approx(error.rms, rel=1e-9)
    assert e.fit["viscous.elbow.Fv"].value == pytest.approx(fit["viscous.elbow.Fv"].value)


def test_removing_leads_to_the_same_model_and_a_further_rung():
    e = grown("viscous:elbow").without("viscous:elbow")
    assert e.mechanism.effects == ()
    assert [changed(rung) for rung in e.rungs] == [
        "nothing added",
        "+ viscous friction in elbow",
        "− viscous friction in elbow",
    ]
    for joint, error in e.rungs[0].errors.items():
        assert e.now.errors[joint].rms == pytest.approx(error.rms, rel=1e-9)


def test_back_to_a_rung_and_undone():
    e = grown("viscous:elbow")
    back = e.at(0)
    assert back.now is e.rungs[0]
    assert back.candidates  # known since before
    assert back.undone.rungs is e.rungs
    assert e.undone.rungs is screened().rungs
    assert given().undone is given()
    assert e.at(1) is e


def test_an_effect_whose_shape_was_searched_sets_out_from_there():
    e = screened()
    shape = next(x.shape for x in e.candidates if x.label == "stribeck:wrist")
    now = e.with_effect("stribeck:wrist")
    assert now.fit.point.values["stribeck.wrist.vs"] == pytest.approx(shape["vs"], rel=0.3)


def test_a_joint_whose_error_has_grown_is_marked():
    e = grown("viscous:elbow").with_effect("coulomb:elbow")
    words = {bar.joint: bar.words for bar in top(e).bars}
    assert "(larger)" in words["wrist"]
    assert "(larger)" not in words["elbow"]
    assert all("noise" in each for each in words.values())


def test_a_known_effect_can_be_set_free():
    mechanism = ident.load(ROBOTS / "arm").with_effect("viscous:elbow", {"Fv": 0.5})
    motion = ident.complete(mechanism, ROBOTS / "arm" / "run.csv")
    e = ident.Exploration.of(mechanism, motion).screened()
    found = next(x for x in e.candidates if x.label == "viscous:elbow")
    assert not found.present
    now = e.with_effect(found.effect)
    assert now.fit["viscous.elbow.Fv"].value == pytest.approx(
        grown("viscous:elbow").fit["viscous.elbow.Fv"].value, rel=1e-6
    )


@pytest.mark.parametrize(
    ("verb", "words"),
    [
        (lambda e: e.with_effect("viscous:elbo"), "did you mean 'elbow'"),
        (lambda e: e.with_effect("viscous:elbow").with_effect("viscous:elbow"), "already"),
        (lambda e: e.without("viscous:elbow"), "has no effect"),
        (lambda e: e.at(3), "there is no rung 3"),
        (lambda e: e.write(ROBOTS / "arm"), "name another folder"),
    ],
)
def test_what_cannot_be_is_one_line(verb, words):
    with pytest.raises(IdentError, match=words) as caught:
        verb(given())
    assert "\n" not in str(caught.value)


def test_one_kind_at_several_joints_is_one_rung():
    e = given()
    labels = ["viscous:elbow", "viscous:shoulder"]
    both = e.with_effect(labels)
    assert changed(both.now) == "+ viscous friction in elbow and shoulder"
    assert [each.label for each in both.now.added] == labels
    assert both.undone.rungs is e.rungs


def test_saved_it_is_a_mechanism_for_the_next_log(tmp_path):
    e = grown("viscous:elbow")
    files = e.write(tmp_path / "out")
    own = {"arm.urdf", "mechanism.toml", "fit.json", "multipliers.csv"}
    assert {f.name for f in files} == own | {"covariance.csv"}  # of identified/
    assert {f.name for f in files if f.parent == tmp_path / "out"} == own
    mechanism = ident.load(tmp_path / "out")
    assert [x.label for x in mechanism.effects] == ["viscous:elbow"]
    saved = ident.read_fit(tmp_path / "out" / "fit.json", mechanism)
    value = e.fit["viscous.elbow.Fv"].value
    content = json.loads((tmp_path / "out" / "fit.json").read_text())
    assert content["effects"][0]["parameters"][0]["value"] == pytest.approx(value)
    assert saved.mechanism.effects
    motion = ident.complete(mechanism, ROBOTS / "arm" / "run.csv")
    fit = ident.identify(mechanism, motion, estimator="least-squares")
    assert fit["viscous.elbow.Fv"].value == pytest.approx(value, rel=1e-9)


def test_judged_it_is_saved_as_grow_saves_it(tmp_path):
    e = judged()
    assert e.diagnosis.verdict == "missing"
    assert e.judged() is e
    names = {file.name for file in e.write(tmp_path)}
    assert {"mechanism.toml", "fit.json", "diagnosis.json", "report.html"} <= names
    assert e.diagnosis.best.label in (tmp_path / "report.html").read_text()


def test_it_prints_as_a_ladder():
    e = grown("viscous:elbow")
    lines = str(e).splitlines()
    assert lines[0].split() == ["model", *given().fit.motion.independent]
    assert lines[2].startswith("+ viscous friction in elbow")
    assert cells(e.now.errors, ["elbow"])[0] in lines[2]


def test_the_noun_needs_no_page():
    code = (
        "import sys, ident, ident.cli.app; from ident.assess.exploration import Exploration; "
        "bad = {'websockets', 'bokeh', 'viser', 'matplotlib'} & set(sys.modules); "
        "sys.exit(str(bad) if bad else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
