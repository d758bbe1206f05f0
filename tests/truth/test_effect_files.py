"""Every kind in mechanism.toml, in fit.json and in the folder of `--out`; what effects need."""

import json
from dataclasses import replace

import numpy as np
import pytest

import ident
from helpers import ROBOTS
from ident.effects import KINDS
from ident.errors import MechanismError, MotionError
from ident.fit.prediction import predict
from ident.mechanism.write import add_effects
from ident.show.laws import facts
from identification import motion_log, plant, robot

SITES = {
    "coupling": "crank,coupler", "gravity_tilt": "", "gravity_compensation": "",
    "payload": "rocker_link", "geometry": "pin.a.x", "closure_compliance": "pin",
    **{kind: "rocker_link" for kind in KINDS if KINDS[kind].sits == "frame"},
}  # fmt: skip
PLAIN = {
    "power": 1.0,
    "radius": 0.25,
    "normal": 0.0,
    "height": 0.1,
    "side": -1.0,
    "q1": 0.2,
    "vs": 0.3,
    "z0": 0.05,
    "N": 7.0,
    "T0": 20.0,
    "degree": 2.0,
    "pieces": 2.0,
    "x0": -1.0,
    "x1": 0.1,
    "x2": 1.0,
    "limit": 5.0,
    "delay": 0.004,
    "follows_velocity": 0.0,
    "linear": 0.0,
}


def copied(tmp_path, name="four_bar"):
    folder = tmp_path / name
    folder.mkdir(parents=True)
    for file in ("mechanism.toml", f"{name}.urdf"):
        (folder / file).write_bytes((ROBOTS / name / file).read_bytes())
    return folder


def on_four_bar(kind):
    """An effect of a kind on the four-bar, all its values and settings known."""
    given = {key: PLAIN[key] for key in KINDS[kind].settings}
    signal = "q" if KINDS[kind].signals else ""
    effect = ident.effect(kind, SITES.get(kind, "crank"), given, signal=signal)
    known = {p.name: PLAIN.get(p.name, 0.01) for p in effect.parameters}
    return replace(effect, values={**given, **known})


@pytest.mark.parametrize("kind", [k for k in KINDS if k != "coupling"])  # needs two drives
def test_written_and_read_back(kind, tmp_path):
    folder = copied(tmp_path)
    effect = (ident.load(folder) + on_four_bar(kind)).effects[0]
    beside = [ident.effect(*label.split(":")) for label in effect.required]
    add_effects(ident.load(folder), [*beside, effect])
    assert ident.load(folder).effects == (*beside, effect)
    key = "frame" if effect.sits == "frame" else "joint"
    assert (f'{key} = "' in (folder / "mechanism.toml").read_text()) == bool(effect.joints)
    bare = replace(effect, values={k: effect.values[k] for k in effect.settings})
    folder = copied(tmp_path / "again")
    add_effects(ident.load(folder), [*beside, bare])
    assert ident.load(folder).effects == (*beside, bare)


FITTED = [
    ("arm", "stribeck:elbow", {"Fs": 0.8, "vs": 0.3}, {}),
    ("arm", "cable:elbow", {"k0": 0.1, "k1": 0.2, "k2": 0.3, "k3": 0.4, "k4": -0.2}, {"degree": 4}),
    ("arm", "gravity_tilt", {"x": 0.03, "y": -0.02}, {}),
    ("five_bar", "coupling:left,right", {"Im": 0.005, "Fvm": 0.03, "Fcm": 0.02}, {}),
    ("four_bar", "hysteresis:closure.pin", {"sigma": 5.0, "z0": 0.05}, {}),
    ("five_bar", "geometry:tip.a.x", {"Delta": 0.005}, {}),
]


@pytest.mark.parametrize(("name", "text", "values", "settings"), FITTED, ids=lambda x: str(x)[:24])
def test_a_fit_is_written_and_read_back(name, text, values, settings, tmp_path):
    kind, _, site = text.partition(":")
    mechanism = robot(name) + ident.effect(kind, site, settings)
    (effect,) = mechanism.effects
    true = {full: values[p.name] for full, p in zip(effect.names, effect.parameters, strict=True)}
    case = plant(mechanism, motion_log(name, 100.0), true, spread=0.1)
    fit = case.fit()
    fit.write(tmp_path)
    (entry,) = json.loads((tmp_path / "fit.json").read_text())["effects"]
    assert (entry["kind"], entry["joint"]) == (kind, site)
    assert [p["name"] for p in entry["parameters"]] == list(effect.names)
    saved = ident.read_fit(tmp_path, robot(name))
    assert [each.label for each in saved.mechanism.effects] == [text]
    for full, value in true.items():
        assert saved.point.values[full] == pytest.approx(value, rel=1e-5)
    (known,) = ident.load(tmp_path / "identified").effects
    assert known.label == text
    assert known.values == pytest.approx({**values, **settings}, rel=1e-5)
    assert known.searched == ()
    (one,), (other,) = fit.predict(), predict(saved.mechanism, fit.motion, saved.point)
    np.testing.assert_allclose(other.predicted, one.predicted, atol=1e-9 * np.ptp(one.predicted))


def test_the_identified_folder_predicts_as_the_fit_does(tmp_path):
    """Corrections too: a motion read through the known offset gives the same torques."""
    mechanism = robot("arm") + ident.effect("encoder_offset", "elbow")
    case = plant(mechanism, motion_log("arm", 100.0), {"encoder_offset.elbow.delta": 0.03})
    fit = case.fit()
    fit.write(tmp_path)
    known = ident.load(tmp_path / "identified")
    made, _ = ident.simulate(known, case.log, values={})
    for joint in mechanism.driven:
        np.testing.assert_allclose(
            made.columns[f"tau.{joint}"], case.log.columns[f"tau.{joint}"], atol=1e-5
        )


# --- what effects need --------------------------------------------------------------------------


def test_temperature_friction_needs_viscous_and_its_column():
    log = motion_log("arm", 100.0)
    log = ident.Log.from_arrays(
        "arm.csv", log.t, {**log.columns, **{f"tau.{j}": 0 * log.t for j in robot("arm").driven}}
    )
    alone = robot("arm") + ident.effect("temperature_friction", "elbow")
    motion = ident.complete(alone, log, cutoff=None)
    with pytest.raises(MechanismError, match="changes 'viscous:elbow', which is not there; add it"):
        ident.identify(alone, motion)
    both = alone.with_effect("viscous:elbow")
    with pytest.raises(MotionError, match=r"no column 'temperature\.elbow'.*; log it"):
        ident.identify(both, motion)
    with pytest.raises(MotionError, match=r"temperature\.elbow"):
        ident.simulate(both, log, values={n: 0.1 for e in both.effects for n in e.names})


def test_where_effects_can_sit():
    four_bar = robot("four_bar")
    for text, says in {
        "rotor_inertia:rocker": "no driven joint 'rocker'",
        "payload:rocker": "did you mean 'rocker_link'",
        "geometry:pin.c.x": "no place 'pin.c.x'",
        "closure_compliance:crank": "no closure 'crank'",
        "gravity_tilt:crank": "the whole mechanism",
        "geometry": "write geometry:place",
        "coupling": "write coupling:joint,joint",
    }.items():
        with pytest.raises(MechanismError) as caught:
            four_bar.with_effect(text)
        assert says in str(caught.value), text
    assert [e.label for e in four_bar.with_effect("gravity_tilt").effects] == ["gravity_tilt"]
    labels = [e.label for e in four_bar.with_effect("payload").effects]
    assert labels == [f"payload:{link}" for link in four_bar.bodies.links]


@pytest.mark.parametrize("kind", KINDS)
def test_a_kind_is_described_in_full(kind):
    said = facts(KINDS[kind])
    assert {"what", "torque", "sits on", "when missing", "confused with", "source"} <= set(said)
    effect = KINDS[kind].example()
    for parameter in effect.parameters:
        (line,) = [x for x in said["unknowns" if parameter in effect.unknowns else "shapes"]
                   if x.startswith(f"{parameter.name} [")]  # fmt: skip
        assert parameter.meaning in line


def test_couplings_are_tried_where_motors_may_have_a_common_shaft():
    def pairs(name):
        found = ident.load(ROBOTS / name).candidates()
        return {each.joints for each in found if each.kind == "coupling"}

    assert pairs("arm") == {("yaw", "shoulder"), ("shoulder", "elbow"), ("elbow", "wrist")}
    assert pairs("five_bar") == {("left", "right")}
    assert pairs("slider_crank") == set()
    told = ident.load(ROBOTS / "arm").with_effect("coupling:yaw,wrist")
    assert told.effects[-1].joints == ("yaw", "wrist")


@pytest.mark.parametrize("name", ["four_bar", "five_bar"])
def test_lengths_across_the_plane_of_a_planar_loop_are_no_candidates(name):
    mechanism = ident.load(ROBOTS / name)
    tried = {e.joints[0] for e in mechanism.candidates() if e.kind == "geometry"}
    across = "z" if name == "five_bar" else "y"
    assert tried
    assert not any(place.endswith(across) for place in tried)
    assert any(mechanism.lengths[place] and place not in tried for place in mechanism.sites.place)


def test_a_place_of_a_closure_moves_in_the_axes_of_its_link():
    mechanism = ident.load(ROBOTS / "four_bar")  # whose frames are turned against the links
    moved = mechanism.displaced("pin.a.x", 0.01).displaced("pin.a.y", 0.02)
    off = {place: x - mechanism.lengths[place] for place, x in moved.lengths.items()}
    assert off["pin.a.x"] == pytest.approx(0.01)
    assert off["pin.a.y"] == pytest.approx(0.02)
    assert off["pin.a.z"] == pytest.approx(0.0)


def test_an_effect_is_not_added_without_the_one_that_it_changes(tmp_path):
    folder = copied(tmp_path)
    before = (folder / "mechanism.toml").read_bytes()
    with pytest.raises(MechanismError, match="changes 'coulomb:crank', which is not there; add it"):
        add_effects(ident.load(folder), [ident.effect("friction_width", "crank")])
    assert (folder / "mechanism.toml").read_bytes() == before
