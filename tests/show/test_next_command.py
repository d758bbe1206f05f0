"""The step that goes on from a result, as a line of the shell: it runs as it is printed."""

import shlex
from dataclasses import replace

import ident
from helpers import ROBOTS
from ident.assess.fit import assess_fit
from ident.cli.lines import ShellRequest, place_of
from ident.excite import Separation
from ident.request import PYTHON, Step, python_line
from ident.show.diagnosis import card as diagnosis_card
from ident.show.fit import card

COMPARE, DIAGNOSE, MONITOR = Step("compare"), Step("diagnose"), Step("monitor")


def given(options=(), out="", logs=("a  b.csv", "c.csv"), like=(), mechanism="my arm", fit=""):
    """What a running command was asked for."""
    return ShellRequest(mechanism, tuple(logs), tuple(options), tuple(like), fit, out)


def words(request, step):
    return shlex.split(request.line(step))


def test_names_with_blanks_stay_in_one_piece():
    request = given(["--with", "coulomb"], out="o 1")
    held = replace(request, validate=("held back.csv",))
    assert words(held, MONITOR)[2:] == [
        "my arm", "held back.csv", "--like", "a  b.csv", "--like", "c.csv", "--with", "coulomb",
    ]  # fmt: skip
    assert words(request, COMPARE)[-2:] == ["--fit", "o 1/fit.json"]


def test_normal_running_stays_what_a_command_was_given_as_such():
    line = replace(given(like=("normal.csv",)), validate=("new.csv",)).line(MONITOR)
    assert line == "ident monitor 'my arm' new.csv --like normal.csv"


def test_no_command_names_a_file_that_is_not_known():
    assert given(out="out").line(MONITOR) == ""
    assert words(given(out="out"), COMPARE)[2:5] == ["my arm", "a  b.csv", "c.csv"]


def test_options_of_a_fit_and_logs_held_back_stay_in_the_next_one():
    request = replace(given(out="fit"), of_fit=("--consistent",), validate=("held.csv",))
    identify = words(request, Step("identify", consistent=True))
    assert identify[5:] == ["--consistent", "--validate", "held.csv", "--out", "fit_2"]
    assert words(request, Step("grow"))[5:] == ["--validate", "held.csv", "--out", "grown"]
    assert "--consistent" not in words(request, DIAGNOSE)


def test_no_command_where_the_verb_does_not_take_the_options():
    spaced, held = given(["--spacing", "0.1"]), {"validate": ("held.csv",)}
    assert replace(spaced, **held).line(MONITOR) == ""
    assert spaced.line(DIAGNOSE).endswith("--spacing 0.1")
    assert replace(given(["--lock", "wrist"]), **held).line(MONITOR).endswith("--lock wrist")


def test_planned_limits_are_rounded_inwards_for_every_reader():
    ranges = (("lift", -1.23456, 2.0999), ("turn", 0.0, 0.7))
    step = Step("excite", range=ranges, speed=(("lift", 3.1416), ("turn", 0.5)))
    line = given().line(step)
    assert "--range lift=-1.23:2.09 --range turn=0:0.7" in line
    assert "--speed lift=3.14 --speed turn=0.5" in line
    python = python_line(step)
    assert "range={'lift': (-1.23, 2.09), 'turn': (0.0, 0.7)}" in python
    assert "speed={'lift': 3.14, 'turn': 0.5}" in python


def made(folder):
    for name in ("mechanism.toml", "fit.json", "identified/mechanism.toml"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()


def test_what_an_incomplete_model_lacks_grows_where_it_is_unknown(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    made(tmp_path / "fit")
    request = given(mechanism="fit/identified", logs=["new.csv"])
    assert request.line(Step("grow")) == "ident grow fit new.csv --out grown"


def test_the_cause_of_a_change_is_looked_for_with_known_bodies(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    request = given(logs=("new.csv",))
    assert request.line(DIAGNOSE) == "ident diagnose 'my arm' new.csv"
    made(tmp_path / "my arm")
    assert request.line(DIAGNOSE) == "ident diagnose 'my arm/identified' new.csv"


def test_what_was_given_with_stays_in_the_command_that_adds():
    options = ["--with", "viscous", "--lock", "wrist", "--with", "my own.py:bump:elbow"]
    request = given([*options, "--allow-code"])
    add = Step("add", ("spring:elbow",))
    assert words(request, add)[3:] == [
        "viscous", "my own.py:bump:elbow", "spring:elbow", "--allow-code",
    ]  # fmt: skip
    law = Step("add", ("spring:elbow",), ("law.py:law:wrist",))
    assert words(given(options, out="o 1"), law)[-2] == "o 1/law.py:law:wrist"
    planned = words(request, Step("excite"))
    assert planned[3:] == [*options, "--allow-code", "--out", "next.csv"]
    absolute = given(["--absolute", "--cutoff", "8"], out="out")
    assert words(absolute, COMPARE)[-1] == "--absolute"


def test_a_step_has_a_line_for_every_reader():
    """A command for a terminal, Python for a notebook."""
    arm = ident.load(ROBOTS / "arm")
    fit = ident.identify(arm, ident.complete(arm, ident.read_log(ROBOTS / "arm" / "run.csv")))
    step = assess_fit(fit).next
    assert (step.verb, step.effects) == ("identify", ("viscous", "coulomb"))  # it rubs
    added = '.with_effect("viscous").with_effect("coulomb")'
    assert card(fit).command == f"ident.identify(fit.mechanism{added}, fit.motion)"
    assert eval(card(fit).command, {"ident": ident, "fit": fit})  # it runs as it stands
    shell = words(given(logs=["run.csv"]), step)
    assert shell[4:8] == ["--with", "viscous", "--with", "coulomb"]


def test_what_is_offered_overwrites_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    request = given(out="last")
    assert words(request, Step("identify"))[-2:] == ["--out", "last_2"]  # not yet written
    (tmp_path / "last_2").mkdir()
    (tmp_path / "next.csv").touch()
    assert words(request, Step("identify"))[-1] == "last_3"
    assert words(request, Step("excite"))[-1] == "next_2.csv"


def test_the_present_folder_is_a_mechanism_too(monkeypatch):
    monkeypatch.chdir(ROBOTS / "arm")
    mechanism = ident.load(".")
    assert place_of(mechanism.toml, mechanism.urdf) == "."


def test_what_has_changed_since_a_fit_is_diagnosed_with_its_bodies():
    options = ["--with", "coulomb", "--lock", "wrist"]
    request = given(options, logs=("new.csv",), fit="last month")
    known = words(request, Step("diagnose", known=True))
    assert known[2:] == ["last month/identified", "new.csv", "--lock", "wrist"]
    assert words(request, DIAGNOSE)[2] == "my arm"


def test_after_growth_the_folder_that_was_written_is_used():
    added = tuple(f"coulomb:j{i}" for i in range(21))
    request = given(["--lock", "wrist"], out="grown", logs=("run.csv",))
    explore = words(request, Step("explore", grown=added))
    assert explore[2:] == ["grown", "run.csv", "--lock", "wrist"]
    planned = words(request, Step("excite", ("cable:j1",), grown=added, around=True))
    assert planned[2:] == [
        "grown", "--lock", "wrist", "--with", "cable:j1", "--around", "run.csv", "--out",
        "next.csv",
    ]  # fmt: skip
    assert words(request, Step("add", ("cable:j1",), grown=added))[2:] == ["grown", "cable:j1"]
    not_written = words(replace(request, folder=""), Step("add", ("cable:j1",), grown=added))
    assert not_written[2:] == ["my arm", *added, "cable:j1"]


def test_a_planned_motion_has_the_ranges_and_speeds_of_the_experiment():
    step = Step(
        "excite", range=(("elbow", -0.5, 1.25),), speed=(("elbow", 0.085),), around=True,
        as_logged=True, duration=46.0,
    )  # fmt: skip
    line = words(given(), step)
    assert line[3:] == [
        "--around", "a  b.csv", "--as-logged", "--range", "elbow=-0.5:1.25", "--speed",
        "elbow=0.085", "--duration", "46", "--out", "next.csv",
    ]  # fmt: skip
    assert "limits=ident.Limits(range={'elbow': (-0.5, 1.25)}" in PYTHON.line(step)


def test_a_step_of_a_diagnosis_in_python_keeps_the_effects_of_its_model():
    """It runs as it stands: `fit` may be another one than the one that was diagnosed."""
    arm = ident.load(ROBOTS / "arm").with_effect("viscous").with_effect("coulomb:yaw")
    arm = arm.with_effect("coulomb:shoulder").with_effect("coulomb:elbow")
    motion = ident.complete(arm, ident.read_log(ROBOTS / "arm" / "run.csv"))
    diagnosis = ident.diagnose(ident.identify(arm, motion))
    line = diagnosis_card(diagnosis).command
    assert line == (
        'ident.identify(diagnosis.fit.mechanism.with_effect("coulomb:wrist"), diagnosis.fit.motion)'
    )
    labels = {
        x.label for x in eval(line, {"ident": ident, "diagnosis": diagnosis}).mechanism.effects
    }
    assert labels >= {"viscous:elbow", "coulomb:yaw", "coulomb:wrist"}


def test_a_plan_that_separates_nothing_says_so():
    apart = Separation("spring:a", "viscous:a", 0.2, (0.1, 0.1), ("N m/rad", "N m s/rad"))
    assert "does not separate" not in str(apart)
    assert "does not separate them" in str(replace(apart, share=0.0))


def test_drives_of_a_command_go_with_what_is_added():
    """`ident add` writes effects alone: a machine whose drives are options is identified."""
    options = ("--drive", "servo", "--drive", "lift:kp=56,limit=3", "--with", "viscous")
    request = given(options, logs=("run.csv",), mechanism="arm.urdf")
    command = request.line(Step("add", ("backlash:pan",)))
    words = "--drive servo --drive lift:kp=56,limit=3 --with viscous --with backlash:pan"
    assert command.startswith(f"ident identify arm.urdf run.csv {words} --out ")
    freed = request.line(Step("add", ("servo:lift",)))
    assert "--drive lift:limit=3 --with viscous" in freed
    assert "servo:lift" not in freed
