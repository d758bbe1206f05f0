"""`diagnose` and `grow` as commands: what they print, what they write, what they refuse."""

from __future__ import annotations

import json
import shlex
import shutil
import subprocess
import sys
import tomllib
from contextvars import copy_context
from pathlib import Path

import numpy as np
import pytest
from test_outputs import failing, snapshot

import ident as api
from ident.cli.options import RunOptions
from ident.diagnosis import laws
from ident.streams import many_logs
from identification import motion_log, plant, robot

NOISE = (api.Noise("tau", 0.02, relative=True), api.Noise("q", 1e-5))
FRICTION = ("viscous", "coulomb")
LACKING = ("viscous", "coulomb:yaw", "coulomb:shoulder", "coulomb:wrist")


@pytest.fixture(scope="module")
def arm_folder(tmp_path_factory, robots: Path) -> Path:
    """The arm's folder with a log of it that has friction in every joint."""
    folder = tmp_path_factory.mktemp("logged") / "arm"
    folder.mkdir()
    for name in ("arm.urdf", "mechanism.toml"):
        shutil.copy(robots / "arm" / name, folder)
    mechanism = robot("arm")
    for effect in FRICTION:
        mechanism = mechanism.with_effect(effect)
    values = {"viscous.elbow.Fv": 0.3, "coulomb.elbow.Fc": 0.6}
    case = plant(mechanism, motion_log("arm", 100.0, 8.0), values, noise=NOISE, seed=3)
    case.log.write(folder / "run.csv")
    return folder


def given(*effects: str) -> list[str]:
    return [word for effect in effects for word in ("--with", effect)]


def test_diagnose_names_what_is_missing_and_writes_it(arm_folder, tmp_path, done):
    out = tmp_path / "out"
    before = snapshot(arm_folder)
    outcome = done("diagnose", arm_folder, arm_folder / "run.csv", *given(*LACKING), "--out", out)
    assert snapshot(arm_folder) == before
    assert ". Missing: " in " ".join(outcome.out.split())
    assert "○ before" in outcome.out
    assert "ident add " in outcome.out
    data = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    assert data["verdict"] == "missing"
    best = data["candidates"][0]
    named = [data["best"], *best["rivals"]]
    assert {"effect": "coulomb", "joints": ["elbow"]} in named
    assert data["logs"] == ["run.csv"]
    assert {path.name for path in out.iterdir()} == {"diagnosis.json", "report.html"}
    assert f"note: wrote {out}" in outcome.err
    assert "report.html" in outcome.err


@pytest.mark.parametrize(
    "joints", [("elbow", "wrist", "yaw"), pytest.param(("wrist", "elbow"), marks=pytest.mark.slow)]
)
def test_laws_that_are_found_before_ctrl_c_are_kept(robots, tmp_path, monkeypatch, ident, joints):
    log = api.read_log(robots / "arm" / "run.csv")
    magnet = 0.86 / (1 + ((log.columns["q.elbow"] - 0.9) / 0.39) ** 2)
    columns = log.columns | {"tau.elbow": log.columns["tau.elbow"] + magnet}
    api.Log.from_arrays("magnet", log.t, columns).write(tmp_path / "magnet.csv")
    search = laws._law

    def interrupted(selection, last, joint, *rest):
        if joint != "elbow":
            raise KeyboardInterrupt
        return search(selection, last, joint, *rest)

    monkeypatch.setattr(laws, "_law", interrupted)
    monkeypatch.setattr(laws, "_joints", lambda *_: list(joints))
    out = tmp_path / "out"
    outcome = ident(
        "diagnose", robots / "arm", tmp_path / "magnet.csv", *given(*FRICTION), "--out", out
    )
    assert outcome.status == 130
    written = {x.name for x in out.iterdir()}
    assert {"diagnosis.json", "report.html"} <= written
    if joints[0] == "wrist":  # none is found yet
        assert "interrupted before the laws of wrist, elbow" in outcome.err
        assert "missing: cable:elbow" in outcome.out  # in whose place the law would be
    else:
        assert "interrupted before the laws of wrist;" in outcome.err
        assert "but a formula explains it: torque of elbow = " in " ".join(outcome.out.split())
        assert "law_elbow.py" in written
        assert f"{tmp_path / 'out'}/law_elbow.py" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.parametrize("out", [(), ("--out", "out")], ids=["printed", "written"])
def test_verdicts_before_ctrl_c_are_printed(arm_folder, tmp_path, monkeypatch, ident, out):
    logs = tmp_path / "logs"
    logs.mkdir()
    for name in ("a", "b", "c"):
        (logs / f"{name}.csv").write_bytes((arm_folder / "run.csv").read_bytes())
    monkeypatch.chdir(tmp_path)

    def verdict(_, task):
        if task[0] == "c.csv":
            raise KeyboardInterrupt
        return many_logs.Verdict(task[0], 2500, "nothing")

    monkeypatch.setattr(many_logs, "_verdict", verdict)
    words = "diagnose", arm_folder, logs, *given("viscous"), "--jobs", "1", *out
    outcome = ident(*words)
    assert outcome.status == 130
    assert "a.csv" in outcome.out
    assert "b.csv" in outcome.out
    assert "1 of 3 logs are left; go on with: ident diagnose" in outcome.err
    assert f"{logs / 'c.csv'} --with viscous" in outcome.err
    assert (tmp_path / "out" / "logs.csv").is_file() is bool(out)


def test_the_command_to_copy_tells_rivals_apart(robots, tmp_path, done):
    """Friction in one bearing of a four-bar whose crank swings a little: which one is open."""
    mechanism = api.load(robots / "four_bar")
    t = np.arange(0.0, 10.0, 0.004)
    q = {"q.crank": np.pi / 2 + 0.26 * np.sin(5 * t) + 0.05 * np.sin(11.5 * t)}
    noise = api.Noise("tau", 0.1), api.Noise("q", 1e-5)
    hidden = mechanism.with_effect("coulomb:rocker")
    swing = api.Log.from_arrays("swing", t, q)
    made = api.simulate(hidden, swing, values={"coulomb.rocker.Fc": 0.06}, noise=noise)[0]
    made.write(tmp_path / "swing.csv")
    text = done("diagnose", robots / "four_bar", tmp_path / "swing.csv").out
    assert "which this data cannot tell apart" in " ".join(text.split())
    (line,) = (line for line in text.splitlines() if line.startswith("  ident "))
    words = shlex.split(line)
    assert words[:3] == ["ident", "excite", str(robots / "four_bar")]
    assert words[3] == "--separate"
    assert "Next: log a motion that tells" in " ".join(text.split())
    out = tmp_path / "next.csv"
    done(*words[1:-1], out, "--tries", 1, "--harmonics", 3)
    assert out.is_file()


def test_diagnose_of_a_whole_model_is_no_failure_and_is_reproducible(arm_folder, done):
    words = ("diagnose", arm_folder, arm_folder / "run.csv", *given(*FRICTION), "--seed", "5")
    outcome = done(*words)
    assert "Nothing is missing" in " ".join(outcome.out.split())
    assert done(*words).out == outcome.out


def test_a_folder_of_a_fit_is_fitted_anew_and_told_what_has_changed(arm_folder, tmp_path, done):
    """What changed is no cause there, since everything is fitted anew: `identified` finds it."""
    done("identify", arm_folder, arm_folder / "run.csv", *given(*FRICTION), "--out", tmp_path)
    mechanism = api.load(tmp_path)
    values = {"viscous.elbow.Fv": 0.3, "coulomb.elbow.Fc": 1.2}
    later = plant(mechanism, motion_log("arm", 100.0, 8.0), values, noise=NOISE, seed=4)
    later.log.write(tmp_path / "later.csv")
    outcome = done("diagnose", tmp_path, tmp_path / "later.csv")
    note = outcome.err.replace("\n", " ")
    assert "all parameters were fitted anew; " in note
    assert "dry friction in elbow" in note.partition("fitted anew")[2]
    assert f"ident diagnose {tmp_path}/identified {tmp_path}/later.csv" in note


def test_identify_says_that_a_channel_has_the_wrong_sign(arm_folder, tmp_path, done):
    log = api.read_log(arm_folder / "run.csv")
    wrong = {**log.columns, "tau.elbow": -log.columns["tau.elbow"]}
    api.Log.from_arrays("wrong", log.t, wrong).write(tmp_path / "wrong.csv")
    for name, expected in ((arm_folder / "run.csv", False), (tmp_path / "wrong.csv", True)):
        got = done("identify", str(arm_folder), str(name))
        assert ("tau.elbow: the sign is against that of q.elbow" in got.err) is expected


def test_grow_prints_the_ladder_and_writes_a_mechanism(arm_folder, tmp_path, done):
    out, log = tmp_path / "grown", arm_folder / "run.csv"
    before = snapshot(arm_folder)
    words = given(*LACKING)
    outcome = done("grow", arm_folder, log, *words, "--validate", log, "--out", out)
    assert snapshot(arm_folder) == before
    lines = outcome.out.splitlines()
    head = next(i for i, line in enumerate(lines) if line.startswith("effect"))
    assert lines[head].split() == ["effect", "yaw", "shoulder", "elbow", "wrist"]
    assert lines[head + 1].startswith("nothing added")
    assert lines[head + 2].startswith("  on run.csv")
    rungs = [line for line in lines if line.startswith("+ ")]
    assert rungs
    assert "elbow" in rungs[0]
    files = {path.name for path in out.iterdir()}
    assert files >= {
        "mechanism.toml", "arm.urdf", "fit.json", "multipliers.csv", "diagnosis.json",
        "report.html", "grow.json",
    }  # fmt: skip
    tables = tomllib.loads((out / "mechanism.toml").read_text(encoding="utf-8"))["effect"]
    assert all(set(table) == {"kind", "joint"} for table in tables)  # nothing is filled in
    assert (out / "arm.urdf").read_bytes() == (arm_folder / "arm.urdf").read_bytes()
    done("identify", out, log)
    done("compare", out, log, "--fit", out / "fit.json")
    fit = api.identify(api.load(out), api.complete(api.load(out), api.read_log(log)))
    known, truth = api.load(out / "identified"), dict(fit.point.values)
    assert not known.unknown
    for effect in known.effects:
        for name, value in zip(effect.names, effect.values.values(), strict=True):
            np.testing.assert_allclose(value, truth[name], rtol=0.05, atol=1e-3)
    text = done("excite", out, "--duration", 6, "--periods", 1, "--tries", 1, "--harmonics", 2)
    assert "planned with the values and friction of the fit" in text.err
    left = json.loads((out / "fit.json").read_text())["error"]["unfiltered"]
    assert f"noise of yaw {left['yaw']['rms']:.3g}, " in text.out


def test_grow_where_nothing_is_missing_has_one_rung(arm_folder, done):
    outcome = done("grow", arm_folder, arm_folder / "run.csv", *given(*FRICTION))
    assert any(line.startswith("nothing added") for line in outcome.out.splitlines())
    assert "Left: noise of the sensors" in " ".join(outcome.out.split())
    assert not [line for line in outcome.out.splitlines() if line.startswith("+ ")]


OWN = """import casadi as ca


def bump(s):
    return {"A": ca.exp(-((s.q) ** 2))}
"""


def test_grow_takes_own_effects_along(arm_folder, tmp_path, done):
    (tmp_path / "mine.py").write_text(OWN)
    out = tmp_path / "grown"
    effects = given(*FRICTION, f"{tmp_path / 'mine.py'}:bump:elbow")
    log = arm_folder / "run.csv"
    done("grow", arm_folder, log, *effects, "--allow-code", "--out", out)
    assert (out / "mine.py").read_text() == OWN
    (tmp_path / "mine.py").unlink()
    done("check", out, "--allow-code")


@pytest.mark.parametrize("command", ["diagnose", "grow"])
@pytest.mark.parametrize(
    ("effect", "words"),
    [
        (("viscus:elbow",), ("viscus", "did you mean 'viscous'?")),
        (("viscous:elbwo",), ("elbwo", "did you mean 'elbow'?")),
        (("coulomb:yaw", "coulomb:yaw"), ("has the effect 'coulomb:yaw' already",)),
        (("mine.py:bump:elbow",), ("mine.py", "--allow-code")),
    ],
)
def test_effects_that_cannot_be(command, effect, words, arm_folder, refused):
    refused(words, command, arm_folder, arm_folder / "run.csv", *given(*effect))


@pytest.mark.parametrize("command", ["diagnose", "grow"])
def test_inputs_that_cannot_be(command, arm_folder, tmp_path, refused, ident):
    log = arm_folder / "run.csv"
    refused(("none.csv",), command, arm_folder, tmp_path / "none.csv")
    refused(("no_such",), command, tmp_path / "no_such", log)
    refused(("--cutoff fast",), command, arm_folder, log, "--cutoff", "fast")
    (tmp_path / "file").touch()
    out = tmp_path / "file" / "out"
    refused(("cannot be written",), command, arm_folder, log, "--out", out)
    assert ident(command, arm_folder).status == 2
    assert ident(command, arm_folder, log, "--seed", "-1").status == 2


@pytest.mark.parametrize("own", ["folder", "toml", "urdf"])
def test_grow_never_replaces_the_mechanism_it_started_from(own, arm_folder, refused):
    given_as = {"folder": "", "toml": "mechanism.toml", "urdf": "arm.urdf"}[own]
    before = snapshot(arm_folder)
    log = arm_folder / "run.csv"
    words = ("of the mechanism itself", "ident add")
    refused(words, "grow", arm_folder / given_as, log, "--out", arm_folder)
    assert snapshot(arm_folder) == before


def test_a_full_disk_leaves_nothing_half_written(arm_folder, tmp_path, monkeypatch, ident):
    out = tmp_path / "out"
    failing(monkeypatch, "replace", "report.html", OSError)
    outcome = ident("diagnose", arm_folder, arm_folder / "run.csv", *given(*FRICTION), "--out", out)
    assert outcome.status == 1
    assert "No space left on device" in outcome.err.splitlines()[-1]
    assert not out.exists()


def test_json_is_one_line_with_the_content_of_the_file(arm_folder, tmp_path, ident):
    log, out = arm_folder / "run.csv", tmp_path / "out"
    words = ("diagnose", arm_folder, log, *given(*LACKING), "--json", "--alpha", "0.02")
    outcome = ident(*words, "--fail-on", "nothing", "--fail-on", "missing", "--out", out)
    assert outcome.status == 3
    assert outcome.out.count("\n") == 1
    data = json.loads(outcome.out)
    assert data == json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    assert data["decision"]["alpha"] == 0.02
    assert len(data["candidates"]) == data["judged"]
    first = data["candidates"][0]
    gains = {each["effect"]: each["gain"] for each in data["decision"]["candidates"]}
    label = f"{first['effect']}:{','.join(first['joints'])}"
    assert first["gain"] == pytest.approx(gains[label])  # one meaning of the word
    assert all("gain" not in each and each["rise"] > 0 for each in data["together"])
    where = next(each for each in data["where"] if each["joint"] == first["joint"])
    assert where["relative"] == first["error_before"]
    assert where["relative_after"] == first["error_after"]
    assert first["fall"] == pytest.approx(1 - first["error_after"] / first["error_before"])


@pytest.mark.parametrize("command", ["check", "identify"])
def test_other_commands_print_json_too(command, arm_folder, done):
    outcome = done(command, arm_folder, arm_folder / "run.csv", "--json")
    assert json.loads(outcome.out)["schema"].startswith("ident.")


def test_what_decides_is_refused_before_the_work(arm_folder, tmp_path, refused):
    log = arm_folder / "run.csv"
    refused(("alpha = 0", "0.01 to 0.5"), "diagnose", arm_folder, log, "--alpha", "0")
    refused(("--resume", "--out"), "grow", arm_folder, log, "--resume")
    refused(("growing.json",), "grow", arm_folder, log, "--resume", "--out", tmp_path / "no")


def test_grow_goes_on_where_it_was(arm_folder, tmp_path):
    mechanism = api.load(arm_folder)
    for effect in LACKING:
        mechanism = mechanism.with_effect(effect)
    motion = api.complete(mechanism, arm_folder / "run.csv")
    whole = api.grow(mechanism, motion)
    steps = []

    def stop(step):
        steps.append(step)
        if step.added and step.fit is not None:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        api.grow(mechanism, motion, checkpoint=tmp_path, step=stop)
    assert (tmp_path / "growing.json").is_file()
    again = api.grow(mechanism, motion, checkpoint=tmp_path, resume=True)
    again.write(tmp_path)
    assert not (tmp_path / "growing.json").exists()
    assert [str(step) for step in again.steps] == [str(step) for step in whole.steps]
    with pytest.raises(api.FitError, match="growing"):
        api.grow(mechanism, motion, checkpoint=tmp_path, resume=True)


@pytest.mark.parametrize("moment", ["candidates_of", "conclude"])
def test_ctrl_c_in_grow_keeps_what_is_fitted(moment, arm_folder, tmp_path, monkeypatch, ident):
    """Before the second fit, and after the last one; then it goes on."""

    def stop(*_, **__):
        raise KeyboardInterrupt

    log, out = arm_folder / "run.csv", tmp_path / "out"
    words = "grow", arm_folder, log, *given(*LACKING), "--out", out
    with monkeypatch.context() as patched:
        patched.setattr(sys.modules["ident.diagnosis.grow"], moment, stop)
        outcome = ident(*words)
    assert outcome.status == 130
    assert "--resume" in outcome.err.splitlines()[-1]
    assert json.loads((out / "fit.json").read_text())["mechanism"] == "arm"
    assert {"growing.json", "mechanism.toml", "arm.urdf"} <= {path.name for path in out.iterdir()}
    outcome = ident(*words, "--resume")
    assert outcome.status == 0
    assert "Left: noise of the sensors" in " ".join(outcome.out.split())
    assert not (out / "growing.json").exists()


def test_ctrl_c_in_the_next_experiment_keeps_the_diagnosis(
    arm_folder, tmp_path, monkeypatch, ident
):
    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("ident.assess.experiment._suggestions", stop)
    words = "diagnose", arm_folder, arm_folder / "run.csv", *given(*LACKING)
    outcome = ident(*words, "--out", tmp_path)
    assert outcome.status == 130
    assert json.loads((tmp_path / "diagnosis.json").read_text())["verdict"] == "missing"
    assert "the next experiment" in outcome.err.splitlines()[-1]


def test_ctrl_c_says_how_to_go_on(arm_folder, tmp_path, monkeypatch, ident):
    def stop(*_, **__):
        raise KeyboardInterrupt

    log, out = arm_folder / "run.csv", tmp_path / "out"
    monkeypatch.setattr(sys.modules["ident.diagnosis.grow"], "candidates_of", stop)
    outcome = ident("grow", arm_folder, log)
    assert "note: with --out DIR" in outcome.err
    assert outcome.err.rstrip().endswith(f"begin again with: ident grow {arm_folder} {log}")
    monkeypatch.setattr("ident.diagnosis.diagnose", stop)
    outcome = ident("diagnose", arm_folder, log, "--out", out)
    assert (outcome.status, outcome.out) == (130, "")
    look = f"ident compare {arm_folder} {log} --fit {out / 'fit.json'}"
    assert look in outcome.err
    again = f"ident diagnose {arm_folder} {log} --out {out}"
    assert outcome.err.rstrip().endswith(f"begin again with: {again}")
    assert "where it fails" in ident(*look.split()[1:]).out


def test_files_of_grow_are_complete_where_nobody_reads(arm_folder, tmp_path):
    words = "grow", arm_folder, arm_folder / "run.csv", *given(*FRICTION), "--out", tmp_path / "out"
    command = [sys.executable, "-m", "ident", *map(str, words)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as run:
        run.stdout.close()
        said = run.stderr.read()
    assert run.returncode in (0, 141)
    assert b"Traceback" not in said
    files = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"fit.json", "diagnosis.json", "report.html", "mechanism.toml"} <= files
    assert "growing.json" not in files


@pytest.mark.parametrize("verb", ["identify", "diagnose", "grow", "compare"])
def test_notes_follow_the_result(verb, arm_folder, tmp_path, done):
    out, log, more = tmp_path / "out", arm_folder / "run.csv", given(*FRICTION)
    if verb == "compare":
        done("identify", arm_folder, log, "--out", tmp_path / "fit")
        more = ["--fit", tmp_path / "fit"]
    words = [sys.executable, "-m", "ident", verb, arm_folder, log, *more, "--out", out]
    both = subprocess.run(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=True)
    lines = both.stdout.decode().splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("note: "))
    assert first > 3
    assert f"note: wrote {out}" in lines[first]
    assert "report.html" in lines[first]
    assert len(lines[first:]) <= 2
    assert all(line.startswith("note: ") for line in lines[first:])


def test_what_follows_a_fit_is_filtered_alike_unless_told_otherwise(arm_folder, tmp_path, done):
    """With a joint held the fit is of another model, and nothing follows from it."""
    log, fit = arm_folder / "run.csv", tmp_path / "fit"
    done("identify", arm_folder, log, *given("viscous:elbow"), "--cutoff", "5", "--out", fit)
    copy_context().run(_follow, arm_folder, log, fit)  # options leave what a command was given


def _follow(arm_folder, log, fit):
    for folder in (fit, fit / "identified"):
        for asked, cutoff in (("auto", 5.0), ("4", 4.0), ("none", None)):
            model = RunOptions(mechanism=folder, cutoff=asked)
            model, since = model.as_fitted(model.load([log]))
            assert model.treatment["cutoff"] == cutoff
            assert since is not None
    locked = RunOptions(mechanism=fit / "identified", lock=["wrist"])
    locked, since = locked.as_fitted(locked.load([log]))
    assert (locked.treatment["cutoff"], since) == ("auto", None)
    new = RunOptions(mechanism=arm_folder)
    assert new.as_fitted(new.load([log])) == (new, None)
