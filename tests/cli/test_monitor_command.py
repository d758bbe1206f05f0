"""`ident monitor`: a file, a file that grows, standard input, and every way to end it."""

import csv
import os
import re
import signal
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import ident
from helpers import ROBOTS
from ident import Log, Noise, load
from ident.show.streams import MonitorHistory, ThinnedSeries
from identification import motion_log, plant, robot
from pages import WRITTEN, assert_legible, read_page

CRANK = ROBOTS / "slider_crank"
COMMAND = [sys.executable, "-m", "ident", "monitor"]
PATIENCE = 60.0  # [s]


def started(*words, **options):
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True} | options
    return subprocess.Popen([*COMMAND, *map(str, words)], **pipes)


def table(path):
    with path.open() as stream:
        return list(csv.DictReader(stream))


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """The slider-crank's log with torques that are noisy."""
    case = plant(robot("slider_crank"), motion_log("slider_crank", 200.0, 4.0),
                 noise=[Noise("tau", 0.01, relative=True)], spread=0.2)  # fmt: skip
    path = tmp_path_factory.mktemp("log") / "run.csv"
    case.log.write(path)
    return path


def test_a_file_to_its_end(spoken, log, tmp_path):
    out = tmp_path / "out"
    words = ["monitor", CRANK, log, "--like", log, "--every", 1, "--out", out]
    status, said, _ = spoken(*words)
    assert status == 0
    lines = said.splitlines()
    assert sum(line.startswith("t = ") for line in lines) >= 3
    assert any(line.startswith("at t = 3.") and "800 samples" in line for line in lines)
    mechanism = ident.load(CRANK)
    motion = ident.complete(mechanism, log)
    fit = ident.identify(mechanism, motion, estimator="least-squares")
    rows = table(out / "parameters.csv")
    last = {row["quantity"]: row for row in rows if row["t"] == rows[-1]["t"]}
    for value in fit.parameters:
        off = float(last[value.name]["value"]) - value.value
        assert abs(off) < 3 * value.stderr + 1e-3 * abs(value.value)
        assert last[value.name]["unit"] == value.unit
        assert float(last[value.name]["stderr"]) > 0
    assert "error.theta" in last
    reactions = table(out / "multipliers.csv")
    t, known = fit.multipliers[0]
    assert len(reactions) > 400
    times = np.array([float(row["t"]) for row in reactions])
    assert (np.diff(times) > 0).all()
    found = np.array([float(row["ball.y"]) for row in reactions])[-150:]
    expected = np.interp(times[-150:], t, known[:, 1])
    assert np.abs(found - expected).max() < 0.05 * np.abs(known[:, 1]).max()
    assert table(out / "alarms.csv") == []
    assert spoken(*words)[0] == 0  # the files grow on
    assert len(table(out / "parameters.csv")) == 2 * len(rows)


def test_bad_lines_are_said_and_the_rest_goes_on(spoken, log, tmp_path):
    lines = log.read_text().splitlines()
    bad = tmp_path / "bad.csv"
    cells = lines[10].split(",")
    text = [
        *lines[:10],
        lines[10][:12],
        ",".join(["nan", *cells[1:]]),
        *lines[11:20],
        lines[5],
        *lines[20:],
    ]
    bad.write_text("\n".join(text) + "\n")
    status, said, noted = spoken("monitor", CRANK, bad, "--like", log)
    assert status == 0
    assert f"{len(lines) - 2} samples" in said
    assert re.search(r"note: line 11 is left out: \d cells, the header has", noted)
    assert "note: line 12 is left out: slider_crank: t = nan" in noted
    assert "note: line 22 is left out: slider_crank: a sample at t = " in noted


@pytest.fixture(scope="module")
def long(tmp_path_factory):
    """The arm's log with noisy torques, and friction."""
    mechanism = robot("arm").with_effect("viscous").with_effect("coulomb")
    case = plant(mechanism, motion_log("arm", 200.0, 30.0),
                 noise=[Noise("tau", 0.01, relative=True)], spread=0.2)  # fmt: skip
    return case.log


def watched(spoken, log, path, *words):
    log.write(path)
    arm = [ROBOTS / "arm", path, "--with", "viscous", "--with", "coulomb", "--every", 10]
    status, out, noted = spoken("monitor", *arm, *words)
    assert status == 0, noted
    return out, noted


def test_what_the_samples_show_of_their_channels_is_a_note(spoken, long, tmp_path):
    """A torque that is held from the middle on, and one in thousandths from the beginning."""
    late = dict(long.columns)
    late["tau.elbow"] = np.where(long.t < 12.0, late["tau.elbow"], 1.25)
    _, noted = watched(spoken, Log.from_arrays("late", long.t, late), tmp_path / "late.csv")
    assert re.search(r"tau\.elbow: 40 % of the samples stay at an extreme \(1\.25\)", noted)
    assert re.search(r"since t = [12]\d(\.\d+)? s or later: .*tau\.elbow: always 1\.25", noted)
    unit = long.columns | {"tau.yaw": 1000 * long.columns["tau.yaw"]}
    _, noted = watched(spoken, Log.from_arrays("unit", long.t, unit), tmp_path / "unit.csv")
    assert re.search(r"tau\.yaw: reads (9\d\d|1e\+03|10\d\d) times", noted)
    dead = long.columns | {"tau.yaw": 0 * long.t}
    _, noted = watched(spoken, Log.from_arrays("dead", long.t, dead), tmp_path / "dead.csv")
    assert "tau.yaw: always 0 while the joint moves" in noted


def test_garbage_changes_no_parameter_and_raises_no_alarm(spoken, long, tmp_path):
    """100 rad in a sample, 1e20 N m in a cell, a time of 1e9 s, binary rubbish: named by line."""
    path, like = tmp_path / "bad.csv", tmp_path / "like.csv"
    reference, _ = watched(spoken, long, like, "--like", like)
    lines = like.read_text().splitlines()
    names = lines[0].split(",")

    def put(number, name, text):
        cells = lines[number - 1].split(",")
        cells[names.index(name)] = text
        lines[number - 1] = ",".join(cells)

    put(2002, "q.elbow", "100")
    put(3003, "tau.yaw", "1e20")
    put(4004, "t", "1e9")
    lines.insert(5004, "\x07\x01garbage")
    path.write_text("\n".join(lines) + "\n")
    words = [ROBOTS / "arm", path, "--like", like, "--every", 10]
    words += ["--with", "viscous", "--with", "coulomb"]
    status, said, noted = spoken("monitor", *words)
    assert status == 0
    for number, what in (
        (2002, "q.elbow = 100"), (3003, "tau.yaw = 1e+20"), (4004, "t = 1e+09 s"), (5005, "cells"),
    ):  # fmt: skip
        assert re.search(rf"line {number} is left out: .*{re.escape(what)}", noted), noted
    assert "alarm" not in said

    def values(text):
        found = re.findall(r"^  (\S+\.F[vc]) +(\S+) ± (\S+)", text, re.M)
        return {name: (float(x), float(s)) for name, x, s in found}

    before, after = values(reference), values(said)
    assert len(before) == 8
    for name, (x, stderr) in before.items():
        assert abs(after[name][0] - x) < stderr


@pytest.mark.parametrize("change", ["tau.theta", "t"])
def test_a_column_that_is_missing_is_an_error(spoken, log, tmp_path, change):
    text = log.read_text()
    other = tmp_path / "other.csv"
    other.write_text(text.replace(change, "x" + change, 1) if change != "t" else "x" + text)
    status, _, said = spoken("monitor", CRANK, other, "--like", log)
    assert status == 1
    assert f"error: slider_crank: a sample has no column '{change}'" in said


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["rum.csv"], "no such file"),
        (["run.csv", "--forget", "0"], "forget 0; valid"),
        (["run.csv", "--with", "hysteresis:theta"], "hysteresis:theta"),
    ],
)
def test_bad_input_is_one_line(spoken, log, words, said):
    status, out, errors = spoken("monitor", CRANK, log.parent / words[0], *words[1:])
    assert (status, out) == (1, "")
    assert errors.startswith("error: ")
    assert errors.count("\n") == 1
    assert said in errors


def test_normal_running_that_is_too_short_is_stated_on_the_page(spoken, log, tmp_path):
    like = tmp_path / "like.csv"
    like.write_bytes(log.read_bytes())
    spoken("monitor", CRANK, log, "--like", like, "--every", 100, "--out", tmp_path)
    page = read_page(tmp_path / "report.html")
    went_in = {each.text_content() for each in page.iterfind(".//th[@scope='row']")}
    assert {"mechanism.toml", log.name, "like.csv"} <= went_in
    header = " ".join(page.find(".//header").text_content().split())
    assert "alarms are not possible: normal running has only " in header
    assert "give longer logs" in header
    assert not re.search("ident monitor (?!--like compares)", header)  # it would raise none either


def test_files_of_other_columns_are_left_alone(spoken, log, tmp_path):
    (tmp_path / "parameters.csv").write_text("t,mine\n0,1\n")
    status, _, said = spoken("monitor", CRANK, log, "--like", log, "--out", tmp_path)
    assert status == 1
    assert "parameters.csv: has other columns" in said
    assert (tmp_path / "parameters.csv").read_text() == "t,mine\n0,1\n"
    (tmp_path / "parameters.csv").unlink()
    (tmp_path / "parameters.csv").mkdir()
    status, _, said = spoken("monitor", CRANK, log, "--like", log, "--out", tmp_path)
    assert status == 1
    assert (
        "parameters.csv: cannot be written (Is a directory); name a folder that you may write"
        in said
    )


def test_standard_input_as_it_comes(log):
    """A line is said while the input is still open."""
    lines = log.read_text().splitlines(keepends=True)
    process = started(CRANK, "-", "--like", log, "--every", 0.5, stdin=subprocess.PIPE)
    try:
        process.stdin.writelines(lines[:400])
        process.stdin.flush()
        assert process.stdout.readline().startswith("t = ")
        process.stdin.writelines(lines[400:])
        said, errors = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
    assert process.returncode == 0, errors
    assert f"{len(lines) - 1} samples" in said


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM], ids=["Ctrl-C", "SIGTERM"])
def test_asked_to_end_it_says_what_it_knows(log, tmp_path, how):
    lines = log.read_text().splitlines(keepends=True)
    growing = tmp_path / "growing.csv"
    growing.write_text("".join(lines[:300]))
    words = ["--like", log, "--cutoff", "none", "--every", 0.2, "--out", tmp_path]
    process = started(CRANK, growing, "--follow", *words)
    try:
        process.stdout.readline()
        with growing.open("a") as stream:
            stream.writelines(lines[300:600])
        while float(process.stdout.readline().split()[2]) < 2.5:  # t = 2.6 s: …
            pass
        os.kill(process.pid, how)
        said, errors = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
    assert process.returncode == 0, errors
    assert "599 samples" in said
    assert "rod.Ixx" in said
    for name in ("parameters", "multipliers", "alarms"):
        assert (tmp_path / f"{name}.csv").read_text().endswith("\n")


def test_a_reader_that_leaves_is_no_fault(log):
    process = started(CRANK, log, "--like", log, "--every", 0)
    process.stdout.readline()
    process.stdout.close()
    errors = process.stderr.read()
    process.wait(timeout=PATIENCE)
    process.stderr.close()
    assert "Traceback" not in errors
    assert "error" not in errors


def test_the_page_shows_what_comes_and_the_report_stays(log, tmp_path, browser):
    """While the log grows: its state is drawn, with reaction forces; Ctrl-C ends both."""
    lines = log.read_text().splitlines(keepends=True)
    growing = tmp_path / "growing.csv"
    growing.write_text("".join(lines[:500]))
    words = [CRANK, growing, "--like", log, "--follow", "--every", 0.5, "--page"]
    page, faults = browser.new_page(viewport={"width": 400, "height": 800}), []
    page.add_init_script(WRITTEN)
    page.on("console", lambda m: faults.append(m.text))
    page.on("pageerror", lambda error: faults.append(str(error)))
    with started(*words, "--out", tmp_path / "out") as run:
        try:
            page.goto(run.stdout.readline().strip())
            page.get_by_role("heading", name="Reaction forces").wait_for()
            before = page.inner_text("header")
            with growing.open("a") as stream:
                stream.writelines(lines[500:])
            page.wait_for_function(
                "x => document.querySelector('header').innerText !== x", arg=before
            )
            assert page.locator("#shown canvas").count() > 0
            assert assert_legible(page, 400) > 20
        finally:
            run.send_signal(signal.SIGINT)
        run.communicate(timeout=PATIENCE)
        page.get_by_text("The command has ended").wait_for()
        page.close()
    assert (run.returncode, faults) == (0, [])
    assert "alarms are not possible: normal running has only 8 intervals of 0.4 s" in before
    report = (tmp_path / "out" / "report.html").read_text()
    for title in ("Parameters over time", "Reaction forces", "Error of the predicted torque"):
        assert f"{title}</h2>" in report


def test_curves_of_hours_are_thinned_evenly():
    curve = ThinnedSeries()
    for k in range(50_000):
        curve.add(float(k), np.array([k]))
    t, values = curve.series
    assert 400 <= len(t) <= 1000
    assert len(set(np.diff(t))) <= 2
    assert np.array_equal(t, values[:, 0])


def test_charts_begin_where_a_value_is_known_and_mark_alarms():
    history, curve = MonitorHistory(load(ROBOTS / "arm"), ""), ThinnedSeries()
    history.alarms.append(SimpleNamespace(onset=6.0, suspects=("coulomb:elbow",)))
    for t in range(10):
        value, stderr = (0.0, np.nan) if t == 0 else (90.0, 40.0) if t < 3 else (1.0, 0.01)
        curve.add(float(t), np.array([[value, stderr]]))
    (chart,) = history._charts("Parameters", curve, {"coulomb.elbow.Fc": (0, "N m")}, 8)
    (panel,) = chart.panels
    *band, value, alarm = panel.marks
    for line in (*band, value):
        assert np.flatnonzero(np.isfinite(line.y)).tolist() == [*range(3, 10)]
    assert alarm.label == "alarm: coulomb:elbow"
    assert (alarm.value, alarm.upright) == (6.0, True)


def test_what_was_never_determined_has_no_chart():
    history, curve = MonitorHistory(load(ROBOTS / "arm"), ""), ThinnedSeries()
    for t in range(5):
        curve.add(float(t), np.array([[np.nan, np.nan], [1.0, 0.01], [2.0, 0.01]]))
    names = {name: (i, "N m") for i, name in enumerate(("unknown", "first", "second"))}
    (chart,) = history._charts("Parameters", curve, names, 2)
    assert [panel.y for panel in chart.panels] == ["first\n[N m]", "second\n[N m]"]
    assert history._charts("Parameters", curve, {"unknown": (0, "N m")}, 2) == ()


@pytest.mark.slow
def test_a_change_raises_an_alarm(spoken, tmp_path):
    """Viscous friction of one joint doubles halfway."""
    mechanism = robot("arm").with_effect("viscous").with_effect("coulomb")
    motion = motion_log("arm", 100.0, 40.0, 7.0)
    noise = [Noise("tau", 0.01, relative=True)]
    before = plant(mechanism, motion, noise=noise, spread=0.0, seed=1)
    viscous = {k: x for k, x in before.values.items() if k.startswith(("viscous", "coulomb"))}
    other = viscous | {"viscous.elbow.Fv": 4 * viscous["viscous.elbow.Fv"]}
    after = plant(mechanism, motion, other, noise=noise, spread=0.0, seed=1)
    half = motion.t < 20.0
    columns = {k: np.where(half, x, after.log.columns[k]) for k, x in before.log.columns.items()}
    clean, changed = tmp_path / "clean.csv", tmp_path / "changed.csv"
    before.log.write(clean)
    Log.from_arrays("changed", motion.t, columns).write(changed)
    words = ["--with", "viscous", "--with", "coulomb", "--like", clean, "--out", tmp_path]
    status, said, noted = spoken("monitor", ROBOTS / "arm", changed, *words)
    assert status == 0
    alarms = table(tmp_path / "alarms.csv")
    assert alarms, said
    assert 19.0 < float(alarms[0]["onset"]) < 21.0
    assert float(alarms[0]["detected"]) < 25.0
    assert "viscous:elbow" in alarms[0]["suspects"].split()
    assert "alarm: " in said
    assert "1 alarm, changed since" in " ".join(noted.split())
    assert "viscous:elbow" in (tmp_path / "report.html").read_text()
