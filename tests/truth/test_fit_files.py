"""fit.json, multipliers.csv, identified.urdf, identified/ and report.html, read back by others."""

import io
import json
import os
import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
import polars as pl
import pytest
from lxml import etree

import ident
from helpers import J, tree_urdf, write_mechanism
from ident import IdentError, Log, Noise
from ident.finding import note
from ident.fit.files import identified_urdf
from ident.mechanism.parameters import regressor
from identification import motion_log, plant, robot
from pages import charts, read_page, reading, titles

NAMES = ["arm", "four_bar", "five_bar", "slider_crank", "pendulum"]
NOISE = [Noise("tau", 0.01, relative=True)]


def identified(name, *effects, rate=100.0):
    mechanism = robot(name)
    for kind in effects:
        mechanism = mechanism.with_effect(kind)
    case = plant(mechanism, motion_log(name, rate), noise=NOISE, seed=1)
    return case, case.fit()


def other_motion(case):
    """The log's motion run backwards: other velocities at the same places."""
    columns = {
        name: (-x[::-1] if name.startswith("v.") else x[::-1])
        for name, x in case.log.columns.items()
    }
    log = Log.from_arrays("backwards.csv", case.log.t, columns)
    return ident.complete(case.mechanism, log, cutoff=None)


def assert_same_prediction(one, other, tolerance=1e-9):
    for a, b in zip(one, other, strict=True):
        assert a.joints == b.joints
        scale = np.abs(a.predicted).max()
        np.testing.assert_allclose(b.predicted, a.predicted, atol=tolerance * scale)


# --- fit.json ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_fit_json_gives_the_same_model(name, tmp_path):
    case, fit = identified(name, "viscous", "coulomb")
    fit.write(tmp_path)
    saved = ident.read_fit(tmp_path / "fit.json", robot(name))  # without effects: they are in it
    np.testing.assert_allclose(
        saved.dynamic_parameters, fit.dynamic_parameters, rtol=1e-12, atol=1e-15
    )
    motion = other_motion(case)
    own = ident.compare(fit, motion=motion)
    theirs = ident.compare(saved, motion=motion)
    (a,), (b,) = own.predictions.values(), theirs.predictions.values()
    assert_same_prediction(a, b)
    (e,), (f,) = own.errors.values(), theirs.errors.values()
    for joint in e:
        assert f[joint].rms == pytest.approx(e[joint].rms, rel=1e-9)


def test_values_of_a_fit_that_was_read_are_found_by_name(tmp_path):
    _, fit = identified("arm", "viscous")
    fit.write(tmp_path)
    saved = ident.read_fit(tmp_path, fit.mechanism)
    for name in ("viscous.elbow.Fv", "hand.m", fit.base_parameters[0].name):
        if name == "hand.m" and name not in fit.mechanism.bodies.names:
            continue
        assert saved[name].value == pytest.approx(fit[name].value)
        assert saved[name].stderr == pytest.approx(fit[name].stderr)
    with pytest.raises(KeyError, match=r"viscous\.elbow\.Fv"):
        saved["viscous.elbow.Fw"]


def test_fit_json_with_centroidal_names(tmp_path):
    mechanism = robot("arm")
    mechanism = replace(mechanism, unknown=tuple(n for n in mechanism.unknown if "hand" in n))
    fit = plant(mechanism, motion_log("arm", 100.0), noise=NOISE).fit()
    assert any(v.name == "hand.Ixx" for v in fit.parameters)
    fit.write(tmp_path)
    saved = ident.read_fit(tmp_path / "fit.json", mechanism)
    np.testing.assert_allclose(saved.dynamic_parameters, fit.dynamic_parameters, atol=1e-14)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("kind", "values"), [("stribeck", {}), ("hysteresis", {}), ("spring", {"k": 3.0, "b": 1.0})]
)
def test_an_effect_that_the_fit_lacks_is_no_force(kind, values, tmp_path):
    case, fit = identified("arm", "viscous", "coulomb")
    fit.write(tmp_path)
    more = ident.effects[kind](("elbow",), values)  # known, where it has values
    saved = ident.read_fit(tmp_path / "fit.json", robot("arm") + more)
    log = case.log.columns
    still = np.where(np.arange(len(case.log.t)) < 9, 0.0, log["v.elbow"])  # 0/0, if divided by 0
    log = Log.from_arrays("still.csv", case.log.t, {**log, "v.elbow": still})
    for smoothing in ("auto", None):
        motion = ident.complete(case.mechanism, log, cutoff=None, smoothing=smoothing)
        (a,), (b,) = ident.compare(fit, saved, motion=motion).predictions.values()
        np.testing.assert_allclose(a.predicted, b.predicted, atol=1e-9)


def test_fit_json_has_what_the_contract_says(tmp_path):
    _, fit = identified("five_bar", "viscous")
    fit.write(tmp_path)
    text = (tmp_path / "fit.json").read_text()
    assert "NaN" not in text
    assert "Infinity" not in text
    data = json.loads(text)
    assert data["schema"] == "ident.fit/1"
    assert (data["mechanism"], data["logs"], data["samples"]) == ("five_bar", ["five_bar.csv"], 400)
    first = data["parameters"][0]
    assert set(first) >= {"name", "value", "stderr", "unit", "identifiable", "prior"}
    assert first["name"] == "left_proximal.m"
    assert first["stderr"] is None
    assert set(data["base_parameters"][0]) >= {"name", "value", "stderr", "unit"}
    assert [(e["kind"], e["joint"]) for e in data["effects"]] == [
        ("viscous", "left"), ("viscous", "right"),
    ]  # fmt: skip
    assert data["effects"][0]["parameters"][0]["name"] == "viscous.left.Fv"
    assert data["multipliers"]["names"] == ["tip.x", "tip.y", "tip.z"]
    assert data["multipliers"]["unit"] == ["N"] * 3
    assert data["multipliers"]["basis"] == "free"
    assert data["multipliers"]["file"] == "multipliers.csv"
    assert set(data["error"]["train"]) == {"left", "right"}
    assert set(data["error"]["train"]["left"]) == {"rms", "relative", "unit"}
    assert data["error"]["validation"] == {}
    assert data["rank"] == fit.rank == len(data["base_parameters"])
    assert data["condition_number"] == pytest.approx(fit.condition_number)
    assert isinstance(data["warnings"], list)


@pytest.mark.parametrize(
    ("text", "what"),
    [("{", "no JSON"), ("[]", "schema"), ('{"schema": "x"}', "schema"),
     ('{"schema": "ident.fit/1"}', "no complete fit.json")],
)  # fmt: skip
def test_a_file_that_is_no_fit_is_refused(text, what, tmp_path):
    (tmp_path / "fit.json").write_text(text)
    with pytest.raises(ident.FitError, match=what):
        ident.read_fit(tmp_path / "fit.json", robot("arm"))


def test_a_fit_of_another_mechanism_is_refused(tmp_path):
    _, fit = identified("four_bar")
    fit.write(tmp_path)
    with pytest.raises(ident.FitError):
        ident.read_fit(tmp_path / "fit.json", robot("arm"))


# --- the URDF ----------------------------------------------------------------------------------


def rnea(urdf, mechanism, states):
    """Torques of Pinocchio's own reading of a URDF, in the mechanism's order of joints."""
    model = pin.buildModelFromUrdf(str(urdf))
    model.gravity = mechanism.model.gravity
    assert list(model.names) == list(mechanism.model.names)
    data = model.createData()
    return np.array([pin.rnea(model, data, *state) for state in zip(*states, strict=True)])


def of_fit(fit, states):
    return regressor(fit.mechanism.model, *states) @ fit.dynamic_parameters


def exact_urdf(fit, folder):
    """The URDF with the fit's own bodies, which need not be possible."""
    path = folder / "x.urdf"
    path.write_bytes(identified_urdf(fit, possible=False))
    return path


def states_of(mechanism, n=30):
    rng = np.random.default_rng(7)
    return [rng.normal(size=(n, mechanism.model.nv)) * s for s in (1.5, 2.0, 4.0)]


@pytest.mark.parametrize("name", ["arm", "four_bar", "five_bar"])
def test_the_identified_urdf_is_the_fit(name, tmp_path):
    """On the open tree: where all ten of a body are free, its torques are those of the fit."""
    _, fit = identified(name)
    path = exact_urdf(fit, tmp_path)
    states = states_of(fit.mechanism)
    torque = of_fit(fit, states)
    found = rnea(path, fit.mechanism, states)
    if fit.mechanism.closures:  # masses may be shifted along what no motion of the loop feels
        motion = ident.complete(fit.mechanism, plant(fit.mechanism, motion_log(name, 100.0)).log)
        (e,) = motion.experiments
        states = [x[::10] for x in (e.q, e.v, e.a)]
        Z = e.pinv[::10, :, -len(motion.independent) :]
        torque = np.einsum("nij,ni->nj", Z, of_fit(fit, states))
        found = np.einsum("nij,ni->nj", Z, rnea(path, fit.mechanism, states))
    np.testing.assert_allclose(found, torque, atol=1e-9 * np.abs(torque).max())


def test_links_fixed_to_a_body_keep_their_inertia(tmp_path):
    joints = [J("a", axis="0 1 0"), J("f", "fixed", None, "a"), J("b", axis="1 0 0", parent="f")]
    mechanism, _, fit = random_tree(tmp_path, tree_urdf(joints, seed=2))
    path = exact_urdf(fit, tmp_path)
    states = states_of(mechanism)
    torque = of_fit(fit, states)
    np.testing.assert_allclose(
        rnea(path, mechanism, states), torque, atol=1e-9 * np.abs(torque).max()
    )
    before = etree.fromstring(tree_urdf(joints, seed=2).encode())
    after = etree.parse(str(path)).getroot()
    fixed = [r.find("link[@name='f_link']/inertial/mass").get("value") for r in (before, after)]
    assert fixed[0] == fixed[1]


def test_a_fixed_link_heavier_than_its_body(tmp_path):
    """The body found is lighter than the link fixed to it is said to be."""
    joints = [J("a", axis="0 1 0"), J("f", "fixed", None, "a"), J("b", axis="1 0 0", parent="f")]
    urdf = tree_urdf(joints, seed=2)
    heavy = re.sub(r'(name="f_link".*?<mass value=")[^"]*', r"\g<1>50", urdf, flags=re.S)
    assert heavy != urdf
    _, case, _ = random_tree(tmp_path, urdf)
    other = ident.load(write_mechanism(tmp_path / "heavy", heavy))
    fit = ident.identify(other, ident.complete(other, case.log, cutoff=None))
    states = states_of(other)
    path = exact_urdf(fit, tmp_path)
    torque = of_fit(fit, states)
    np.testing.assert_allclose(rnea(path, other, states), torque, atol=1e-8 * np.abs(torque).max())


def test_massless_priors(tmp_path):
    """Links without <inertial>: their masses are not identified, but their first moments are."""
    joints = [J("a", axis="0 1 0"), J("b", axis="1 0 0", parent="a")]
    urdf = tree_urdf(joints, seed=2)
    bare = re.sub(r"<inertial>.*?</inertial>", "", urdf, flags=re.S)
    _, case, _ = random_tree(tmp_path, urdf)
    mechanism = ident.load(write_mechanism(tmp_path / "bare", bare))
    fit = ident.identify(mechanism, ident.complete(mechanism, case.log, cutoff=None))
    assert max(error.relative for error in fit.train.values()) < 1e-8
    path = exact_urdf(fit, tmp_path)
    states = states_of(mechanism)
    torque = of_fit(fit, states)
    np.testing.assert_allclose(
        rnea(path, mechanism, states), torque, atol=1e-9 * np.abs(torque).max()
    )


def random_tree(tmp_path, urdf):
    mechanism = ident.load(write_mechanism(tmp_path / "tree", urdf))
    rng = np.random.default_rng(0)
    t, columns = np.arange(500) / 100, {}
    for joint in mechanism.joints:
        w, phase = rng.uniform(2, 7, 3), rng.uniform(0, 6, 3)
        angle = np.outer(t, w) + phase
        columns[f"q.{joint.name}"] = 0.5 * np.sin(angle).sum(axis=1)
        columns[f"v.{joint.name}"] = 0.5 * np.cos(angle) @ w
        columns[f"a.{joint.name}"] = -0.5 * np.sin(angle) @ w**2
    case = plant(mechanism, Log.from_arrays("log.csv", t, columns))
    return mechanism, case, case.fit()


def test_all_else_of_the_urdf_stays(tmp_path, robots):
    _, fit = identified("arm")
    path = exact_urdf(fit, tmp_path)
    before, after = (etree.parse(str(p)).getroot() for p in (robots / "arm" / "arm.urdf", path))
    for root in (before, after):
        for link in root.iter("link"):
            for element in link.findall("inertial"):
                link.remove(element)
    clean = [re.sub(r"\s+", " ", etree.tostring(r).decode()) for r in (before, after)]
    assert clean[0] == clean[1]


# --- the folder of what was identified ---------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_the_identified_folder_predicts_the_same(name, tmp_path):
    case, fit = identified(name, "viscous", "coulomb")
    fit.write(tmp_path)
    known = ident.load(tmp_path / "identified")
    assert (known.unknown, known.name) == ((), fit.mechanism.name)
    assert len(known.effects) == len(fit.mechanism.effects)
    if name == "pendulum":  # the fixture drives its angle, the file does not
        known = replace(known, driven=case.mechanism.driven, passive=case.mechanism.passive)
    log, said = ident.simulate(known, motion_log(name, 100.0))
    assert_same_prediction(
        fit.predict(ident.complete(fit.mechanism, log, cutoff=None)), [said], 1e-8
    )


def test_what_is_picked_up_later_is_found(tmp_path):
    """Everything known from the first log; in a second one the arm holds a tool."""
    case, fit = identified("arm", "viscous")
    fit.write(tmp_path)
    known = ident.load(tmp_path / "identified")
    loaded = replace(known, unknown=tuple(n for n in known.bodies.names if n.startswith("hand.")))
    values = dict(case.values) | {"hand.m": case.values["hand.m"] + 0.4}
    log, _ = ident.simulate(case.mechanism, motion_log("arm", 100.0), values=values)
    again = ident.identify(loaded, ident.complete(loaded, log, cutoff=None))
    found = {v.name: v.value for v in again.parameters}
    before = fit.dynamic_parameters[30]
    assert found["hand.m"] == pytest.approx(before + 0.4, abs=0.05)


# --- whole or not at all -----------------------------------------------------------------------


FILES = {"fit.json", "multipliers.csv", "identified.urdf", "report.html"}


def test_files_are_written_all_or_none(tmp_path):
    _, fit = identified("five_bar")
    out = tmp_path / "out"
    (out / "report.html").mkdir(parents=True)  # a folder where a file should go
    with pytest.raises(IdentError, match=r"report\.html"):
        fit.write(out)
    assert [p.name for p in out.iterdir()] == ["report.html"]
    (out / "report.html").rmdir()
    written = fit.write(out)
    assert {p.name for p in out.iterdir() if p.is_file()} == FILES
    assert (out / "identified" / "mechanism.toml").is_file()
    assert {p.resolve() for p in written} == {p.resolve() for p in out.rglob("*") if p.is_file()}


def test_a_failed_write_leaves_the_old_files(tmp_path, monkeypatch):
    _, fit = identified("five_bar")
    fit.write(tmp_path)
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    real, calls = os.replace, []

    def failing(source, target):
        calls.append(target)
        if len(calls) == 4:
            raise OSError(28, "No space left on device", str(target))
        real(source, target)

    changed = replace(fit, findings=(note("another"),))
    monkeypatch.setattr(os, "replace", failing)
    with pytest.raises(IdentError, match="No space left"):
        changed.write(tmp_path)
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before


# --- multipliers.csv ---------------------------------------------------------------------------


def multipliers(fit, folder):
    fit.write(folder)
    return pl.read_csv(io.BytesIO((folder / "multipliers.csv").read_bytes()))


def test_multipliers_file_holds_the_multipliers(tmp_path):
    _, fit = identified("slider_crank")
    table = multipliers(fit, tmp_path)
    assert table.columns == ["t", "ball.x", "ball.y", "ball.z"]
    ((t, values),) = fit.multipliers
    np.testing.assert_array_equal(table["t"].to_numpy(), t)
    np.testing.assert_array_equal(table.drop("t").to_numpy(), values)


def test_redundant_multipliers_are_empty(tmp_path):
    _, fit = identified("four_bar")
    table = multipliers(fit, tmp_path)
    empty = {name for name in table.columns if table[name].null_count() == len(table)}
    assert empty == {"pin.y", "pin.rx", "pin.ry"}
    assert table["pin.x"].null_count() == 0
    assert any("pin.y, pin.rx, pin.ry are not determined" in said for said in fit.warnings)


def test_several_logs_are_told_apart(tmp_path):
    mechanism = robot("five_bar")
    case = plant(mechanism, motion_log("five_bar", 100.0))
    logs = [
        Log.from_arrays(name, case.log.t[:n], {k: x[:n] for k, x in case.log.columns.items()})
        for name, n in (("a.csv", 200), ("b.csv", 150))
    ]
    fit = ident.identify(mechanism, ident.complete(mechanism, logs, cutoff=None))
    table = multipliers(fit, tmp_path)
    assert table.columns == ["t", "tip.x", "tip.y", "tip.z", "log"]
    assert table.group_by("log").len().sort("log").rows() == [("a.csv", 200), ("b.csv", 150)]


# --- the report --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_the_report_is_whole_and_stands_alone(name, tmp_path):
    _, fit = identified(name, "viscous")
    fit.write(tmp_path)
    page = read_page(tmp_path / "report.html")
    text = reading(page)
    assert fit.mechanism.name in text
    for each in fit.effects:
        assert each.parameters[0].name in text
    assert len(charts(page)) >= 3
    for title in ("Error of the predicted torque", "What was understood", "How to reproduce"):
        assert title in titles(page)
    assert ("Multipliers" in titles(page)) == bool(fit.mechanism.closures)


def test_the_report_escapes_what_it_is_given(tmp_path):
    case, fit = identified("four_bar", "viscous")
    nasty = '<script>alert("x")</script>&'
    log = Log.from_arrays(nasty, case.log.t, dict(case.log.columns))
    mechanism = replace(fit.mechanism, name=nasty)
    named = ident.identify(mechanism, ident.complete(mechanism, log, cutoff=None))
    named = replace(named, findings=(note(nasty),))
    named.write(tmp_path)
    page = read_page(tmp_path / "report.html")
    assert reading(page).count(nasty) >= 3
    assert nasty not in (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<script" not in named._repr_html_()
    assert "<script" not in ident.compare(named)._repr_html_()


def test_the_same_fit_writes_the_same_bytes(tmp_path):
    """Nothing random and no date, so that results can be compared and kept."""
    _, fit = identified("five_bar")
    files = []
    for name in ("a", "b"):
        fit.write(tmp_path / name)
        files.append((tmp_path / name / "fit.json").read_bytes())
    assert files[0] == files[1]
