"""Every command on the robots that come with the project: what it prints, writes and finds."""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
import sys

import numpy as np
import pytest

import ident as api
from pages import read_page, reading


def number(text: str, name: str) -> float:
    """The value that a printed table gives to a name; a note may begin with "NAME ± …", too."""
    lines = (line.split() for line in text.splitlines() if line.startswith("  "))
    (value,) = [words[1] for words in lines if words[:1] == [name] and words[1] != "±"]
    return float(value)


def rows(path) -> list[list[str]]:
    with path.open(newline="") as stream:
        return list(csv.reader(stream))


# --- check -------------------------------------------------------------------------------------


def test_check_says_first_whether_a_log_can_be_used(robots, tmp_path, ident):
    """And what is most important about it, with the command to go on with."""
    head, *lines = rows(robots / "arm" / "run.csv")[:1002]
    torque, position = head.index("tau.elbow"), head.index("q.yaw")

    def first(name: str, change) -> tuple[str, str]:
        with (tmp_path / name).open("w", newline="") as stream:
            csv.writer(stream).writerows(change(list(line)) for line in (head, *lines))
        outcome = ident("check", robots / "arm", tmp_path / name)
        words, command, *_ = outcome.out.split("\n\n")
        return " ".join(words.split()), command.strip()

    def constant(at: int, value: str = "0.5"):
        return lambda line: line if line == head else [*line[:at], value, *line[at + 1 :]]

    words, command = first("good.csv", lambda line: line)
    assert words.startswith("good.csv can be used for identification of 22 of 22 base parameters: ")
    assert command.startswith(f"ident identify {robots / 'arm'} ")
    words, command = first("dead.csv", constant(torque))
    assert "It would determine" in words
    assert "look at this first: dead.csv: tau.elbow: always 0.5" in words
    assert "--unmeasured elbow --out " in command
    words, _ = first("still.csv", constant(position))
    assert "of 22 base parameters" in words
    assert "22 of 22" not in words
    empty = [line[0] for line in lines[40:60]]
    words, _ = first("holes.csv", lambda x: [x[0], *[""] * (len(x) - 1)] if x[0] in empty else x)
    assert f"look at this first: holes.csv: 20 of {len(lines)} rows have no value but" in words
    words, command = first("plan.csv", lambda line: line[:torque] + line[torque + 1 :])
    assert words.startswith("plan.csv cannot be used for identification: it has no tau.elbow;")
    assert command.startswith("ident identify ")
    assert "--unmeasured elbow --out " in command
    words, command = first("empty.csv", constant(torque, ""))
    assert "identification: it has no values of tau.elbow; with them it would" in words
    assert "--unmeasured elbow --out " in command
    words, command = first("zero.csv", constant(torque, "0"))
    assert "look at this first: zero.csv: tau.elbow: always 0 while the joint moves" in words
    assert "--unmeasured elbow --out " in command
    words, command = first("plan.csv", lambda line: line[: head.index("tau.yaw")])
    assert "it has no tau.yaw, tau.shoulder, tau.elbow and tau.wrist" in words
    assert command.startswith("ident excite ")


@pytest.mark.parametrize("name", ["arm", "five_bar", "four_bar", "pendulum", "slider_crank"])
def test_check_knows_every_robot(name, robots, done):
    outcome = done("check", robots / name)
    assert f"mechanism {name}" in outcome.out
    assert "degrees of freedom" in outcome.out
    assert "a motion can identify" in outcome.out
    assert "nan" not in outcome.out


def test_check_with_a_log_says_what_it_holds(robots, done):
    folder = robots / "slider_crank"
    outcome = done("check", folder, folder / "run.csv")
    for words in ("theta", "driven", "passive", "ball (point)", "2001 samples", "1000 Hz"):
        assert words in outcome.out
    assert "this motion identifies 3 base parameters of 3 unknowns" in outcome.out


def test_check_of_a_bare_urdf_and_of_effects(arm, done):
    outcome = done("check", arm, "--with", "viscous")
    assert "viscous:shoulder" in outcome.out
    assert "viscous:elbow" in outcome.out
    assert "20 of 20 dynamic parameters" in outcome.out


def test_a_mechanism_toml_beside_a_bare_urdf_is_named(robots, ident, refused, tmp_path):
    folder = robots / "arm"
    says = f"mechanism.toml is there, and is not used with arm.urdf: give the folder, {folder}"
    outcome = ident("check", folder / "arm.urdf", folder / "run.csv")
    assert says in outcome.out.replace("\n", " ").replace("  ", " ")
    assert "is not used" not in ident("check", folder, folder / "run.csv").out
    log = tmp_path / "log.csv"
    log.write_text((folder / "run.csv").read_text().replace("t,", "stamp,", 1))
    refused(("write in mechanism.toml", says), "check", folder / "arm.urdf", log)


def test_check_names_joints_beyond_their_limits(arm, done, tmp_path):
    """In one line, for a planned motion too."""
    t = np.linspace(0, 4, 401)
    q = np.array([2.2 * np.sin(3 * t), 0.1 * np.sin(t)])
    log = api.Log.from_arrays("plan", t, {"q.shoulder": q[0], "q.elbow": q[1]})
    log.write(tmp_path / "plan.csv")
    said = done("check", arm, tmp_path / "plan.csv").out
    (line,) = (each for each in said.splitlines() if "beyond the limits of the URDF" in each)
    assert "shoulder -2.2 to 2.2 rad (limits -2 to 2); shoulder 6.6 rad/s (limit 5)" in line
    assert "elbow" not in line
    assert "speed limit" in said
    (tmp_path / "plan.csv").unlink()
    smaller = api.Log.from_arrays("plan", t, {"q.shoulder": q[1], "q.elbow": q[1]})
    smaller.write(tmp_path / "small.csv")
    assert "beyond the limits" not in done("check", arm, tmp_path / "small.csv").out
    said = done("check", arm, "--lock", "shoulder=3", "--verbose").out
    assert "outside its limits -2 to 2" in said


def test_check_in_absolute_coordinates(robots, done):
    outcome = done("check", robots / "slider_crank", "--absolute")
    assert "24 coordinates" in outcome.out


# --- identify ----------------------------------------------------------------------------------


def test_identify_the_papers_second_example(robots, done):
    folder = robots / "slider_crank"
    outcome = done("identify", folder, folder / "run.csv")
    for name, truth in (("rod.Ixx", 4e-3), ("rod.Iyy", 4e-4), ("rod.Izz", 4e-3)):
        assert number(outcome.out, name) == pytest.approx(truth, rel=1e-9)
    assert "kg m²" in outcome.out
    assert "note:" not in outcome.out


@pytest.mark.parametrize(
    ("basis", "error"), [("linear", 2e-3), ("cubic", 1e-6), ("quintic", 1e-7), ("free", 1e-9)]
)
def test_identify_the_papers_first_example_in_every_basis(basis, error, robots, done):
    folder = robots / "pendulum"
    spacing = [] if basis == "free" else ["--spacing", "0.05"]
    outcome = done("identify", folder, folder / "run.csv", "--basis", basis, *spacing)
    assert number(outcome.out, "rod.Izz") == pytest.approx(0.2, rel=error)


def test_identify_in_absolute_coordinates(slider, done):
    outcome = done("identify", slider, slider / "run.csv", "--absolute")
    assert number(outcome.out, "rod.Iyy") == pytest.approx(4e-4, rel=1e-6)


def test_identify_validates_on_another_log(slider, done):
    other = slider / "other.csv"
    header, *lines = (slider / "run.csv").read_text().splitlines(keepends=True)
    other.write_text("".join([header, *lines[:200]]))
    outcome = done("identify", slider, slider / "run.csv", "--validate", other)
    assert "other.csv" in outcome.out
    fits = done("identify", slider, slider / "run.csv").out
    assert number(outcome.out, "rod.Ixx") == number(fits, "rod.Ixx")


def test_identify_with_an_effect(slider, done):
    outcome = done("identify", slider, slider / "run.csv", "--with", "viscous:theta")
    assert abs(number(outcome.out, "viscous.theta.Fv")) < 1e-9
    assert "N m s/rad" in outcome.out


def test_identify_several_logs(slider, done, tmp_path):
    (slider / "again.csv").write_text((slider / "run.csv").read_text())
    out = tmp_path / "out"
    done("identify", slider, slider / "run.csv", slider / "again.csv", "--out", out)
    assert json.loads((out / "fit.json").read_text())["logs"] == ["run.csv", "again.csv"]
    header, *lines = rows(out / "multipliers.csv")
    assert header == ["t", "ball.x", "ball.y", "ball.z", "log"]
    assert {line[-1] for line in lines} == {"run.csv", "again.csv"}


@pytest.fixture
def fitted(fitted_once, tmp_path):
    """The slider-crank's folder, and one with its fit, to work on."""
    shutil.copytree(fitted_once, tmp_path, dirs_exist_ok=True)
    return tmp_path / "slider_crank", tmp_path / "out"


VALUE = {"name": str, "value": float, "stderr": float, "unit": str}
CONTRACT = {
    "schema": str, "mechanism": str, "logs": list, "samples": int, "parameters": list,
    "base_parameters": list, "effects": list, "multipliers": dict, "error": dict,
    "condition_number": float, "rank": int, "warnings": list,
}  # fmt: skip


def has(entry: dict, keys: dict) -> bool:
    return all(isinstance(entry[key], kind) for key, kind in keys.items())


def test_fit_json_keeps_the_contract(fitted):
    _, out = fitted
    fit = json.loads((out / "fit.json").read_text(encoding="utf-8"))
    assert has(fit, CONTRACT)
    assert fit["schema"] == "ident.fit/1"
    assert (fit["mechanism"], fit["logs"], fit["samples"]) == ("slider_crank", ["run.csv"], 401)
    assert [entry["name"] for entry in fit["parameters"]] == ["rod.Ixx", "rod.Iyy", "rod.Izz"]
    more = {"identifiable": bool, "prior": float}
    assert all(has(entry, VALUE | more) for entry in fit["parameters"])
    assert all(has(entry, VALUE) for entry in fit["base_parameters"])
    assert {entry["unit"] for entry in fit["parameters"]} == {"kg m²"}
    (effect,) = fit["effects"]
    assert (effect["kind"], effect["joint"]) == ("viscous", "theta")
    (value,) = effect["parameters"]
    assert has(value, VALUE)
    assert (value["name"], value["unit"]) == ("viscous.theta.Fv", "N m s/rad")
    errors = {"stderr", "by_priors", "rest_on"}
    assert {key: x for key, x in fit["multipliers"].items() if key not in errors} == {
        "names": ["ball.x", "ball.y", "ball.z"],
        "unit": ["N", "N", "N"],
        "basis": "free",
        "spacing": 0.0,
        "file": "multipliers.csv",
    }
    error = fit["error"]["train"]["theta"]
    assert has(error, {"rms": float, "relative": float, "unit": str})
    assert error["unit"] == "N m"
    assert fit["error"]["validation"] == {}
    assert fit["rank"] == 4


def test_multipliers_csv(fitted, robots):
    _, out = fitted
    header, *lines = rows(out / "multipliers.csv")
    assert header == ["t", "ball.x", "ball.y", "ball.z"]
    truth = np.array(rows(robots / "slider_crank/reactions.csv")[1:][::5], dtype=float)
    found = np.array(lines, dtype=float)
    assert np.allclose(found, truth, atol=1e-9)


def test_the_report_needs_no_network(fitted):
    _, out = fitted
    page = read_page(out / "report.html")
    assert "rod.Ixx" in reading(page)


def test_the_identified_folder_is_a_mechanism(fitted, done):
    slider, out = fitted
    folder, log = out / "identified", slider / "run.csv"
    assert "nothing is unknown" in done("check", folder).out
    again = slider.parent / "again.csv"
    done("simulate", folder, log, "--out", again)
    measured, simulated = (np.array(rows(path)[1:], dtype=float) for path in (log, again))
    tau = rows(again)[0].index("tau.theta")
    assert np.allclose(simulated[:, tau], measured[:, 4], atol=1e-9)
    outcome = done("identify", folder, log, "--with", "coulomb:theta")
    assert abs(number(outcome.out, "coulomb.theta.Fc")) < 1e-9
    outcome = done("identify", folder, log, "--verbose")
    assert "nothing is unknown: these are the errors of the model as it is" in outcome.err
    assert "\nrank " not in outcome.out
    assert "Nothing is missing" in " ".join(done("diagnose", folder, log).out.split())
    urdf = api.load(out / "identified.urdf")
    # frames without mass have the least body that a simulator takes
    assert np.allclose(urdf.prior, api.load(folder).prior, atol=1e-3)


# --- compare -----------------------------------------------------------------------------------


def test_compare_one_fit(fitted, done):
    slider, out = fitted
    outcome = done("compare", slider, slider / "run.csv", "--fit", out / "fit.json")
    assert "error of the predicted torque" in outcome.out
    assert "theta" in outcome.out
    assert "falls" not in outcome.out


@pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
def test_compare_two_fits_and_draw_them(suffix, fitted, tmp_path, change, done):
    slider, out = fitted
    worse = tmp_path / "worse.json"
    fit = json.loads((out / "fit.json").read_text())
    fit["parameters"][0]["value"] *= 2
    worse.write_text(json.dumps(fit))
    plot = tmp_path / f"plot.{suffix}"
    both = ["--fit", worse, "--fit", out / "fit.json"]
    outcome = done("compare", slider, slider / "run.csv", *both, "--plot", plot)
    assert "worse.json" in outcome.out
    assert f"note: wrote {plot}" in outcome.err
    assert "theta" in outcome.out
    assert "100 %" in outcome.out
    marks = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}
    assert plot.read_bytes().startswith(marks[suffix])


def test_compare_takes_the_sum_apart_and_writes_a_report(fitted, tmp_path, done):
    slider, out = fitted
    report = tmp_path / "report"
    outcome = done(
        "compare", slider, slider / "run.csv", "--fit", out / "fit.json", "--out", report
    )
    for words in ("the sum taken apart", "where it fails"):
        assert words in outcome.out
    lines = [line for line in outcome.out.splitlines() if not line.startswith("  ident ")]
    assert max(len(line) for line in lines if str(out) not in line) <= 100
    assert sorted(file.name for file in report.iterdir()) == ["compare.json", "report.html"]
    assert "rigid bodies" in reading(read_page(report / "report.html"))
    told = json.loads((report / "compare.json").read_text())
    (model,) = told["models"].values()
    assert model["where"][0]["joint"] == "theta"
    for error in (model["fitted"]["train"]["theta"], model["error"]["theta"]):
        assert error["rms"] < 1e-12


# --- add, effects ------------------------------------------------------------------------------


def test_add_then_identify_sees_it(slider, done):
    outcome = done("add", slider, "viscous:theta")
    assert outcome.out == f"{slider / 'mechanism.toml'}: added viscous:theta\n"
    assert "viscous.theta.Fv" in done("identify", slider, slider / "run.csv").out


def test_effects_tell_of_every_kind(done):
    outcome = done("effects")
    for kind in api.effects:
        assert f"\n\n{kind}" in f"\n\n{outcome.out}"
    assert max(len(line) for line in outcome.out.splitlines()) <= 100
    for words in ("N m s/rad", "when missing", "confused with", "source"):
        assert words in outcome.out
    assert outcome.err == ""


def test_effects_tell_of_one_kind(done):
    outcome = done("effects", "stribeck")
    assert outcome.out.startswith("stribeck:joint\n")
    for words in ("Fs sign(v) exp(−(v/vs)²)", "vs [rad/s | m/s]", "searched:", "Automatica"):
        assert words in outcome.out
    assert "viscous:joint" not in outcome.out


# --- simulate ----------------------------------------------------------------------------------


def test_simulate_then_identify_recovers_what_was_planted(slider, tmp_path, done):
    log = tmp_path / "planted.csv"
    planted = {"rod.Ixx": 3e-3, "rod.Izz": 5e-3, "viscous.theta.Fv": 0.02, "coulomb.s.Fc": 0.7}
    sets = [word for name, value in planted.items() for word in ("--set", f"{name}={value}")]
    effects = ["--with", "viscous:theta", "--with", "coulomb:s"]
    done("simulate", slider, slider / "run.csv", *effects, *sets, "--out", log)
    outcome = done("identify", slider, log, *effects)
    for name, value in planted.items():
        assert number(outcome.out, name) == pytest.approx(value, rel=1e-6)


def test_simulate_by_a_fit(fitted, tmp_path, done):
    slider, out = fitted
    log = tmp_path / "again.csv"
    done("simulate", slider, slider / "run.csv", "--fit", out / "fit.json", "--out", log)
    outcome = done("compare", slider, log, "--fit", out / "fit.json")
    table = outcome.out.partition("error of the predicted torque")[2]
    line = next(line for line in table.splitlines() if "theta" in line)
    assert float(line.split()[1]) < 1e-9


def test_simulate_adds_effects_to_those_of_a_fit(fitted, tmp_path, done):
    slider, out = fitted
    log = tmp_path / "damped.csv"
    effect = ("--with", "viscous:theta", "--set", "viscous.theta.Fv=0.5")
    done("simulate", slider, slider / "run.csv", "--fit", out / "fit.json", *effect, "--out", log)
    outcome = done("identify", slider, log, "--with", "viscous:theta")
    assert number(outcome.out, "viscous.theta.Fv") == pytest.approx(0.5, rel=1e-6)


def test_simulate_prints_csv(slider, done):
    outcome = done("simulate", slider, slider / "run.csv", "--columns", "q,tau", "--joints", "beta")
    header, first, *_ = outcome.out.splitlines()
    assert header.split(",")[:2] == ["t", "q.beta"]
    assert set(header.split(",")[2:]) == {"tau.s", "tau.theta"}
    assert float(first.split(",")[0]) == 0.0


def test_noise_is_as_asked_and_repeats_with_its_seed(slider, tmp_path, done):
    def simulated(*options: str) -> dict[str, np.ndarray]:
        path = tmp_path / "noisy.csv"
        done("simulate", slider, slider / "run.csv", *options, "--out", path)
        log = api.read_log(path)
        return {name: np.array(x) for name, x in log.columns.items()}

    clean = simulated()
    noise = ("--noise", "q=1e-3", "--noise", "tau.theta=10%")
    one, same, other = simulated(*noise), simulated(*noise), simulated(*noise, "--seed", "1")
    for name in clean:
        assert np.array_equal(one[name], same[name])
    assert not np.array_equal(one["q.theta"], other["q.theta"])
    assert np.array_equal(one["v.theta"], clean["v.theta"])
    assert np.std(one["q.theta"] - clean["q.theta"]) == pytest.approx(1e-3, rel=0.15)
    share = np.std(one["tau.theta"] - clean["tau.theta"]) / np.std(clean["tau.theta"])
    assert share == pytest.approx(0.1, rel=0.15)


def test_simulate_writes_the_true_multipliers(slider, robots, tmp_path, done):
    path = tmp_path / "lambda.csv"
    sets = ["--set", "rod.Ixx=4e-3", "--set", "rod.Iyy=4e-4", "--set", "rod.Izz=4e-3"]
    log = slider / "run.csv"
    done("simulate", slider, log, *sets, "--multipliers", path, "--out", tmp_path / "new.npz")
    truth = np.array(rows(robots / "slider_crank/reactions.csv")[1:][::5], dtype=float)
    header, *lines = rows(path)
    assert header == ["t", "ball.x", "ball.y", "ball.z"]
    assert np.allclose(np.array(lines, dtype=float), truth, atol=1e-9)


# --- the program itself ------------------------------------------------------------------------

OPTIONS = {
    "check": "--with --cutoff --absolute --allow-code",
    "identify": "--with --validate --basis --spacing --cutoff --absolute --allow-code --out",
    "compare": "--fit --cutoff --absolute --allow-code --plot",
    "add": "--allow-code",
    "effects": "",
    "simulate": "--fit --with --set --noise --seed --columns --joints --multipliers --allow-code "
    "--out",
}


@pytest.mark.parametrize(("command", "options"), OPTIONS.items())
def test_help_shows_every_option(command, options, done):
    outcome = done(command, "--help")
    for option in options.split():
        assert f"\n  {option} " in outcome.out
    assert outcome.out == done(command, "-h").out


def test_help_shows_every_command(done):
    outcome = done("--help")
    for command in OPTIONS:
        assert f"\n  {command} " in outcome.out
    assert "..." not in outcome.out.split("Commands:")[1]


def test_version(done):
    assert done("--version").out == f"ident {api.__version__}\n"


def test_python_m_ident(robots):
    command = [sys.executable, "-m", "ident", "check", str(robots / "pendulum")]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert ran.returncode == 0
    assert ran.stdout.startswith("pendulum: a motion can identify 1 ")


def test_a_terminal_without_greek(robots):
    folder = robots / "pendulum"
    command = [sys.executable, "-m", "ident", "identify", str(folder), str(folder / "run.csv")]
    environment = {"PYTHONIOENCODING": "ascii", "PATH": ""}
    ran = subprocess.run(command, capture_output=True, env=environment, timeout=60, check=False)
    assert ran.returncode == 0
    assert b"rod.Izz" in ran.stdout


def test_a_reader_that_has_seen_enough():
    command = f"{sys.executable} -m ident effects | head -c 20"
    ran = subprocess.run(
        command, shell=True, capture_output=True, text=True, timeout=60, check=False
    )
    assert ran.stderr == ""


def test_a_fault_of_ident_is_one_line(slider, monkeypatch, ident):
    monkeypatch.setattr("ident.mechanism.load", lambda *a, **k: 1 / 0)
    outcome = ident("check", slider)
    assert outcome.status == 1
    assert outcome.err.count("\n") == 1
    assert "a fault of ident" in outcome.err
    assert "ZeroDivisionError" in outcome.err
    monkeypatch.setenv("IDENT_TRACEBACK", "1")
    with pytest.raises(ZeroDivisionError):
        ident("check", slider)


def test_check_judges_torques_beside_the_motion(robots, tmp_path, ident):
    """Before anything is identified: a sign, a unit, exchanged columns."""
    log = api.read_log(robots / "arm" / "run.csv")
    turned = {**log.columns, "tau.wrist": -log.columns["tau.wrist"]}
    api.Log.from_arrays("turned.csv", log.t, turned).write(tmp_path / "turned.csv")
    said = " ".join(ident("check", robots / "arm", tmp_path / "turned.csv").out.split())
    assert "look at this first: tau.wrist: the sign is against that of q.wrist" in said
    said = ident("check", robots / "arm", robots / "arm" / "run.csv").out
    assert "no channel looks wrong" in said


def test_check_proposes_all_entries_of_numbered_columns_at_once(robots, tmp_path, ident):
    """Copied into mechanism.toml, they are taken; positions have the factor of their unit."""
    log, joints = api.read_log(robots / "arm" / "run.csv"), api.load(robots / "arm").driven
    columns = {"time_ms": 1234500.0 + 1e3 * log.t}
    for i, joint in enumerate(joints, 1):
        columns[f"motor{i}_pos_deg"] = np.degrees(log.columns[f"q.{joint}"])
        columns[f"motor{i}_current_mA"] = 1e3 * log.columns[f"tau.{joint}"]
    names, values = [*columns], np.column_stack([*columns.values()])
    np.savetxt(tmp_path / "raw.csv", values, delimiter=",", header=",".join(names), comments="")
    urdf = next((robots / "arm").glob("*.urdf"))
    (tmp_path / urdf.name).write_bytes(urdf.read_bytes())
    refused = ident("check", tmp_path / urdf.name, tmp_path / "raw.csv")
    assert refused.status == 1
    lines = refused.out.partition("\n\n")[2]
    assert len(joints) == lines.count("degrees to rad") == lines.count("mA to A")
    (tmp_path / "mechanism.toml").write_text(lines)
    said = ident("check", tmp_path, tmp_path / "raw.csv")
    assert said.status == 0, said.err
    read = api.load(tmp_path).columns["q.elbow"]
    assert (read.column, read.scale) == (f"motor{joints.index('elbow') + 1}_pos_deg", np.pi / 180)


def test_a_joint_without_a_torque_sensor_is_in_no_table(robots, tmp_path, ident):
    head, *lines = rows(robots / "arm" / "run.csv")
    at = head.index("tau.wrist")
    with (tmp_path / "run.csv").open("w", newline="") as stream:
        csv.writer(stream).writerows([*line[:at], *line[at + 1 :]] for line in (head, *lines))
    given = robots / "arm", tmp_path / "run.csv"
    refused = ident("identify", *given)
    assert refused.status
    assert "--unmeasured wrist" in refused.err
    with_friction = "--with", "viscous", "--with", "coulomb", "--unmeasured", "wrist"
    said = ident("identify", *given, *with_friction, "--out", tmp_path / "fit").out
    table = said.partition("error of the predicted torque")[2].partition("Effects")[0]
    assert "elbow" in table
    assert "wrist" not in table
    assert "ident excite" in said
    assert "--unmeasured wrist" in said
    said = ident("check", *given, "--unmeasured", "wrist").out
    assert "can be used for identification of 22 of 22" in said
    for command in (
        ("diagnose", *given, *with_friction),
        ("diagnose", tmp_path / "fit" / "identified", given[1]),
    ):
        assert "Left: noise of the sensors" in " ".join(ident(*command).out.split())
