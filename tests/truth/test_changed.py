"""A mechanism in which everything is known: what a new log shows is what has changed."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from tempfile import mkdtemp

import numpy as np
import pytest
from diagnosed import planted

import ident
from ident import Diagnosis, Fit, Log, Mechanism, MechanismError, Noise
from ident.assess.fit import assess_fit
from ident.faults.data_checks import Health
from ident.finding import Finding
from ident.fit.files import fit_json
from ident.fit.values import BaseValue, Change, Changes
from ident.request import Step
from identification import motion_log, plant, robot

WORDS = ("m", "mx", "my", "mz", "Lxx", "Lxy", "Lyy", "Lxz", "Lyz", "Lzz")
VALUES = (0.5, 0.04, 0.005, 0.01, 1e-3, 0.0, 4e-3, 0.0, 0.0, 4e-3)
LOAD = {f"payload.hand.{word}": value for word, value in zip(WORDS, VALUES, strict=True)}


@cache
def identified() -> Mechanism:
    """What `ident identify --out` writes: all is known."""
    folder = mkdtemp()
    planted().fit(cutoff="auto").write(folder)
    return ident.load(f"{folder}/identified")


def known(mechanism: Mechanism) -> dict[str, float]:
    """Values of all its effects."""
    effects = mechanism.effects
    return {
        n: e.values[p.name] for e in effects for n, p in zip(e.names, e.parameters, strict=True)
    }


@cache
def log(new: str = "", **values: float) -> Log:
    """A log of the identified machine after something has changed."""
    free = identified()
    if new:
        free = free.with_effect(new)
    noise = [Noise("tau", 0.01, relative=True)]
    now = known(identified()) | {name.replace("_", "."): value for name, value in values.items()}
    now |= LOAD if new.startswith("payload") else {}
    return ident.simulate(free, motion_log("arm", 100.0, 8.0), values=now, noise=noise, seed=5)[0]


def diagnosed(*given: object, **values: float) -> Diagnosis:
    mechanism = identified()
    motion = ident.complete(mechanism, log(*given, **values))
    return ident.diagnose(ident.identify(mechanism, motion))


def test_nothing_has_changed():
    d = diagnosed()
    assert d.verdict == "nothing"
    assert d.fit.rank == 0


def test_nothing_is_compared_where_nothing_is_unknown_and_the_data_are_wrong():
    mechanism, logged = identified(), log()
    columns = {**logged.columns, "tau.elbow": 3 * logged.columns["tau.elbow"]}
    motion = ident.complete(mechanism, Log.from_arrays("scaled.csv", logged.t, columns))
    fit = ident.identify(mechanism, motion).since(planted().fit(cutoff="auto"))
    assert fit.health.findings
    assert fit.changes is not None
    assert not fit.changes.changed


def test_what_a_named_load_explains_is_no_fault_of_the_data():
    """By the model without it, the wrist seemed to read another unit."""
    d = diagnosed("payload:hand")
    wrong = Finding("scale", "tau.wrist: reads 1.5 times", "check its unit", ("tau.wrist",), 1.5)
    d.fit.__dict__["health"] = Health((wrong,))
    assert d.health.good
    assert str(wrong) in d.fit.warnings
    assert str(wrong) not in d.notes
    assert str(wrong) in replace(d, health=Health((wrong,))).notes


def test_the_errors_of_the_earlier_fit_are_no_change(tmp_path):
    """The earlier log was short and its torques noisy; the present ones are not."""
    short = plant(
        robot("arm").with_effect("viscous").with_effect("coulomb"), motion_log("arm", 100.0, 4.0),
        noise=[Noise("tau", 0.03, relative=True)], seed=1,
    )  # fmt: skip
    short.fit(cutoff="auto").write(tmp_path)
    mechanism = ident.load(tmp_path / "identified")
    exact = [Noise("tau", 0.001, relative=True)]
    motion = motion_log("arm", 100.0, 8.0)
    now = ident.simulate(short.mechanism, motion, values=short.values, noise=exact, seed=5)[0]
    verdicts = [
        ident.diagnose(ident.identify(model, ident.complete(model, now))).verdict
        for model in (mechanism, replace(mechanism, covariance=None))
    ]
    assert verdicts[0] == "nothing"
    assert verdicts[1] != "nothing"


@cache
def unmoved() -> ident.Motion:
    """A motion of the unchanged machine."""
    return ident.complete(identified(), log())


def test_errors_of_what_is_not_in_the_model_are_left_out():
    less = identified().without("coulomb:elbow")
    d = ident.diagnose(ident.identify(less, ident.complete(less, log())))
    assert d.best is not None
    assert d.best.label == "coulomb:elbow"


def test_a_grown_mechanism_and_its_fit_keep_the_errors_of_what_they_know(tmp_path):
    errors = identified().covariance
    history = ident.grow(identified(), unmoved())
    history.write(tmp_path / "grown")
    assert ident.load(tmp_path / "grown").covariance.names == errors.names
    free = identified().with_effect("coulomb:elbow")
    ident.identify(free, unmoved()).write(tmp_path / "fit")
    now = ident.load(tmp_path / "fit/identified").covariance
    assert set(now.names) == set(errors.names)
    at, before = now.names.index("viscous.elbow.Fv"), errors.names.index("viscous.elbow.Fv")
    assert now.matrix[at, at] == errors.matrix[before, before]
    assert "coulomb.elbow.Fc" not in ident.load(tmp_path / "fit").covariance.names


@pytest.mark.parametrize("wrong", ["a,b\n1,2\n", "parameter,x\nx,high\n", "parameter,x\nx,nan\n"])
def test_a_covariance_that_is_none(wrong, tmp_path):
    planted().fit(cutoff="auto").write(tmp_path)
    (tmp_path / "identified/covariance.csv").write_text(wrong)
    with pytest.raises(MechanismError, match=r"covariance\.csv"):
        ident.load(tmp_path / "identified")


def test_a_payload_picked_up(tmp_path):
    d = diagnosed("payload:hand")
    assert d.best is not None
    assert d.best.label == "payload:hand"
    for name, value in LOAD.items():
        found = d.candidates[0].fit[name]
        assert abs(found.value - value) < 4 * found.stderr + 1e-4
    d.write(tmp_path)  # in the 3-D picture it is at the joint that moves the hand
    assert '"marks": {"wrist": "payload:hand"}' in (tmp_path / "report.html").read_text()


def test_nothing_else_has_changed_where_friction_under_load_has_a_new_load(tmp_path):
    under_load = robot("arm").with_effect("viscous").with_effect("coulomb")
    under_load = under_load.with_effect("load_friction:shoulder")
    noise = [Noise("tau", 0.01, relative=True)]
    motion = motion_log("arm", 100.0, 8.0)
    plant(under_load, motion, noise=noise, seed=1).fit(cutoff="auto").write(tmp_path)
    mechanism = ident.load(tmp_path / "identified")
    true, values = mechanism.with_effect("payload:hand"), known(mechanism) | LOAD
    made = ident.simulate(true, motion, values=values, noise=noise, seed=51)[0]
    d = ident.diagnose(ident.identify(mechanism, ident.complete(mechanism, made)))
    assert [member.label for member in d.selection.named] == ["payload:hand"]


@pytest.mark.parametrize("value", [0.9, 0.3], ids=["more", "less"])
def test_a_friction_that_changed(value, tmp_path):
    before = known(identified())["coulomb.elbow.Fc"]
    d = diagnosed("coulomb:elbow", coulomb_elbow_Fc=value)
    assert d.best is not None
    assert d.best.label == "coulomb:elbow"
    assert d.rivals == ()
    first = d.candidates[0]
    assert first.known == {"coulomb.elbow.Fc": before}
    assert first.parameters[0].value == pytest.approx(value, rel=0.02)
    assert f"The model has it, as Fc = {before:.4g} N m: that must have changed." in d.text
    assert json.loads(json.dumps(d.json()))["candidates"][0]["known"] == first.known
    labels = [effect.label for effect in (d.fit.mechanism + d.best).effects]
    assert labels == [effect.label for effect in d.fit.mechanism.effects]


def test_a_model_grows_where_it_has_changed(tmp_path):
    mechanism = identified()
    motion = ident.complete(mechanism, log("coulomb:elbow", coulomb_elbow_Fc=0.9))
    history = ident.grow(mechanism, motion)
    assert [effect.label for effect in history.added] == ["coulomb:elbow"]
    history.write(tmp_path / "grown")
    grown = {effect.label: effect.values for effect in ident.load(tmp_path / "grown").effects}
    assert grown.pop("coulomb:elbow") == {}
    assert all(grown.values())
    saved = ident.read_fit(tmp_path / "grown/fit.json", mechanism)
    assert saved.point.values["coulomb.elbow.Fc"] == pytest.approx(0.9, rel=0.02)
    errors = ident.compare(saved, motion=motion).errors
    (mine,) = errors.values()
    assert mine["elbow"].rms == pytest.approx(history.fit.train["elbow"].rms, rel=1e-6)


def test_a_correction_that_changed():
    mechanism = ident.load(planted().mechanism.urdf.parent)
    mechanism = mechanism.with_effect("encoder_offset:shoulder", {"delta": 0.02})
    values = {"encoder_offset.shoulder.delta": 0.05}
    mechanism = replace(mechanism, unknown=())
    moved = motion_log("arm", 100.0, 8.0)
    noise = [Noise("tau", 0.01, relative=True)]
    true = mechanism + mechanism.effects[0].freed
    made = ident.simulate(true, moved, values=values, noise=noise, seed=5)[0]
    d = ident.diagnose(ident.identify(mechanism, ident.complete(mechanism, made)))
    assert d.best is not None
    first = d.candidates[0]
    assert "encoder_offset:shoulder" in {d.best.label, *(e.label for e in d.rivals)}
    offset = next(e for e in d.candidates if e.effect.label == "encoder_offset:shoulder")
    assert offset.parameters[0].value == pytest.approx(0.05, abs=2e-3)
    assert np.isfinite(first.fall)


def test_only_what_is_known_is_freed():
    mechanism = identified()
    free = mechanism.with_effect("coulomb:elbow")
    with pytest.raises(MechanismError, match="'coulomb:elbow' already"):
        free.with_effect("coulomb:elbow")
    with pytest.raises(MechanismError, match="'coulomb:elbow' already"):
        mechanism.with_effect("coulomb:elbow", {"Fc": 0.1})


FRICTION = {
    f"{kind}.{joint}": value
    for kind, joint, value in (
        ("viscous", "yaw.Fv", 1.2), ("viscous", "shoulder.Fv", 1.5), ("viscous", "elbow.Fv", 0.5),
        ("viscous", "wrist.Fv", 0.02), ("coulomb", "yaw.Fc", 2.0), ("coulomb", "shoulder.Fc", 2.5),
        ("coulomb", "elbow.Fc", 0.9), ("coulomb", "wrist.Fc", 0.04),
    )
}  # fmt: skip
NOISE = (Noise("tau", 0.01, relative=True), Noise("q", 1e-5))


def later(folder, seed: int = 0, **change: float) -> Fit:
    """A fit of another motion of the same machine, compared with one of an earlier log."""
    mechanism = robot("arm").with_effect("viscous").with_effect("coulomb")
    first = plant(mechanism, motion_log("arm", 100.0, 8.0), FRICTION, noise=NOISE, seed=100 + seed)
    first.fit(cutoff="auto").write(folder)
    again = ident.load(folder)
    assert set(again.unknown) == set(mechanism.unknown)
    assert again.name == mechanism.name
    assert not any(effect.values for effect in again.effects)
    values = {name: x + change.get(name, 0.0) for name, x in first.values.items()}
    how = {"noise": NOISE, "seed": 500 + seed, "columns": ("q", "tau")}
    log = ident.simulate(mechanism, motion_log("arm", 100.0, 10.0, 5.0), values=values, **how)[0]
    fit = ident.identify(again, ident.complete(again, log))
    return fit.since(ident.read_fit(folder, again))


@pytest.mark.parametrize("seed", range(10))
def test_no_parameter_is_named_where_none_changed(tmp_path, seed):
    changes = later(tmp_path, seed).changes
    assert changes is not None
    assert changes.changed == ()
    assert len(changes.compared) == 30
    assert changes.apart == ()


def test_the_parameter_that_changed(tmp_path):
    fit = later(tmp_path, **{"viscous.elbow.Fv": 0.5})
    assert fit.changes is not None
    (only,) = fit.changes.changed
    assert only.after.name == "viscous.elbow.Fv"
    assert only.before.value == pytest.approx(0.5, abs=4 * only.before.stderr)
    assert only.after.value == pytest.approx(1.0, abs=4 * only.after.stderr)
    assert assess_fit(fit).verdict == "changed"
    assert assess_fit(fit).next == Step("diagnose", known=True)
    assert "one thing changed since " in " ".join(str(fit).split())
    assert str(fit.changes).strip().startswith("One thing changed since ")


def test_the_shape_of_an_effect_is_no_change_by_itself():
    friction = ident.effect("stribeck", "elbow")
    both = [[BaseValue(name, x, 0.01, "") for x in (1.0, 2.0)] for name in friction.names]
    changes = Changes("old", tuple(Change(a, b, 70.0, friction) for a, b in both))
    assert [each.after.name for each in changes.changed] == ["stribeck.elbow.Fs"]


def test_a_load_that_was_picked_up(tmp_path):
    fit = later(tmp_path, **{f"hand.{word}": x for word, x in zip(WORDS, VALUES, strict=True)})
    assert fit.changes is not None
    assert len(fit.changes.changed) > 4
    assert all("hand." in each.after.name for each in fit.changes.changed)
    words = " ".join(str(fit).split())
    assert "of hand" in words or "on hand" in words
    entries = fit_json(fit)["changes"]["compared"]
    assert sum(each["changed"] for each in entries) == len(fit.changes.changed)


def test_an_effect_that_the_model_lacks_is_no_unchanged_machine(tmp_path):
    mechanism = robot("arm").with_effect("viscous")
    first = plant(mechanism, motion_log("arm", 100.0, 8.0), noise=NOISE, seed=1)
    first.fit(cutoff="auto").write(tmp_path)
    again = ident.load(tmp_path)
    rubs = mechanism.with_effect("coulomb:elbow")
    values = {**first.values, "coulomb.elbow.Fc": 1.5}
    log = ident.simulate(rubs, motion_log("arm", 100.0, 10.0, 5.0), values=values, noise=NOISE)[0]
    fit = ident.identify(again, ident.complete(again, log))
    text = " ".join(str(fit.since(ident.read_fit(tmp_path, again))).split())
    assert "in elbow an effect that the model does not contain" in text
    assert "Nothing has changed" not in text


def test_the_folder_of_a_fit_grows(tmp_path):
    """What is written from it has its unknowns, not the known values."""
    planted().fit(cutoff="auto").write(tmp_path / "fit")
    mechanism = ident.load(tmp_path / "fit").without("coulomb:elbow")
    history = ident.grow(mechanism, ident.complete(mechanism, planted().log))
    history.write(tmp_path / "grown")
    assert ident.load(tmp_path / "grown").unknown == mechanism.unknown
