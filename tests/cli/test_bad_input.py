"""Broken logs, fits and options: refused in one line, with status 1; wrong usage has status 2."""

from __future__ import annotations

import json
import pickle
import re
import subprocess
import sys

import numpy as np
import pytest

from helpers import ROBOTS

PNG = b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR\x00\x00\x00\x01"
HEADER = "t,q.theta,v.theta,a.theta,tau.theta,tau.s"


def column(index: int, change):
    """A change of one column of the slider-crank's log."""

    def edit(text: str) -> str:
        header, *rows = text.splitlines()
        cells = [row.split(",") for row in rows]
        for row in cells:
            row[index] = repr(float(change(float(row[index]))))
        return "\n".join([header, *(",".join(row) for row in cells)]) + "\n"

    return edit


def without(name: str):
    def edit(text: str) -> str:
        rows = [row.split(",") for row in text.splitlines()]
        at = rows[0].index(name)
        return "\n".join(",".join(row[:at] + row[at + 1 :]) for row in rows) + "\n"

    return edit


def cell(line: int, index: int, content: str):
    def edit(text: str) -> str:
        rows = text.splitlines()
        cells = rows[line - 1].split(",")
        cells[index] = content
        rows[line - 1] = ",".join(cells)
        return "\n".join(rows) + "\n"

    return edit


def lines(change):
    return lambda text: "".join(change(text.splitlines(keepends=True)))


# what becomes of the log's text, and words of the message
LOGS = {
    "empty": (lambda text: "", ("run.csv", "empty", "header")),
    "header only": (lambda text: HEADER + "\n", ("run.csv", "line 1", "no rows")),
    "no header": (lines(lambda rows: rows[1:]), ("run.csv", "line 1", "header", "t, q.<joint>")),
    "no t": (without("t"), ("run.csv", "'t'", "[s]")),
    "t under another name": (lambda s: s.replace("t,", "stamp,", 1), ("'t'", "'stamp'", "[log]")),
    "text in a cell": (cell(30, 1, "fast"), ("run.csv", "'q.theta'", "line 30", "'fast'", "empty")),
    "decimal comma": (cell(30, 1, '"0,5"'), ("'q.theta'", "line 30", "decimal point")),
    "ragged": (cell(30, 1, "0.1,0.2"), ("run.csv", "line 30", "7 cells", "6")),
    "cut off": (lambda text: text.rstrip()[:-30], ("run.csv", "line 402", "cut off", "delete")),
    "two columns of one name": (lambda s: s.replace("v.theta", "q.theta"), ("two columns",)),
    "t backward": (cell(30, 0, "0.01"), ("run.csv", "backward", "line 30", "split")),
    "t empty": (cell(30, 0, ""), ("run.csv", "t is empty", "line 30")),
    "t in milliseconds": (column(0, lambda t: 1e3 * t), ("run.csv", "not in seconds", "0.001")),
    "t in thousands of seconds": (column(0, lambda t: 1e-3 * t), ("not in seconds", "1000 makes")),
    "inf": (cell(30, 1, "inf"), ("run.csv", "'q.theta'", "line 30", "inf", "empty")),
    "nine rows": (lines(lambda rows: rows[:10]), ("run.csv", "9 samples", "10")),
    "no q": (without("q.theta"), ("run.csv", "degrees of freedom", "q.theta")),
    "no tau of a driven joint": (without("tau.theta"), ("run.csv", "tau.theta", "passive")),
    "q in degrees": (column(1, np.degrees), ("run.csv", "q.theta", "degrees", "[log]")),
    "v of the wrong sign": (column(2, lambda v: -v), ("v.theta", "sign", "scale = -1")),
    "a in degrees": (column(3, np.degrees), ("a.theta", "factor", "degrees")),
    "encoder counts": (column(1, lambda q: 4096.0 * q), ("q.theta", "factor", "[log]")),
    "unreachable": (
        lambda s: without("v.theta")(without("a.theta")(s)).replace("q.theta", "q.s"),
        ("cannot follow", "s = ", "unit, sign and zero"),
    ),
    "unknown wrench": (lambda s: s.replace("v.theta", "wrench.rd.fx"), ("rd.fx", "mean 'rod'")),
    "wrench without part": (lambda s: s.replace("v.theta", "wrench.rod"), ("wrench.<link>",)),
}  # fmt: skip


@pytest.mark.parametrize(("edit", "words"), LOGS.values(), ids=LOGS)
def test_logs_with_one_fault(edit, words, slider, refused):
    log = slider / "run.csv"
    log.write_text(edit(log.read_text()))
    refused(words, "identify", slider, log)


@pytest.mark.parametrize(("index", "name", "content"), [(3, "a", "1.797e+308"), (1, "q", "1e+06")])
def test_an_absurd_sample_is_named_and_left_out(index, name, content, slider, done):
    log = slider / "run.csv"
    whole = done("identify", slider, log).out
    log.write_text(cell(30, index, content)(log.read_text()))
    outcome = done("identify", slider, log)
    where = f"{name}.theta = {content} in row 29 (t = 0.14 s) is no measurement"
    assert sum(where in line and "left out" in line for line in outcome.err.splitlines()) == 1
    for parameter in ("rod.Ixx", "rod.Iyy", "rod.Izz"):
        before, after = (
            float(next(line.split()[1] for line in out.splitlines() if parameter in line))
            for out in (whole, outcome.out)
        )
        assert after == pytest.approx(before, rel=1e-6)


FILES = {
    "missing": ("rum.csv", None, ("rum.csv", "no such file", "did you mean 'run.csv'?")),
    "no folder": ("there/run.csv", None, ("run.csv", "no folder")),
    "wrong suffix": ("run.xlsx", b"", ("run.xlsx", ".csv", ".parquet", ".npz")),
    "no suffix": ("log", b"", ("log", ".csv")),
    "PNG named csv": ("run.csv", PNG, ("run.csv", "line 1", "UTF-8")),
    "UTF-16": ("run.csv", HEADER.encode("utf-16"), ("run.csv", "UTF-8")),
    "CSV named parquet": ("run.parquet", HEADER.encode(), ("run.parquet", "not a Parquet file")),
    "CSV named npz": ("run.npz", HEADER.encode(), ("run.npz", "NumPy", "np.savez")),
    "a bare pickle": ("run.npz", pickle.dumps({"t": [1]}), ("run.npz", "NumPy")),
}


@pytest.mark.parametrize(("name", "content", "words"), FILES.values(), ids=FILES)
def test_files_that_are_no_log(name, content, words, slider, refused):
    if content is not None:
        (slider / name).write_bytes(content)
    refused(words, "identify", slider, slider / name)


def test_a_folder_without_logs_is_no_log(slider, refused, tmp_path):
    empty = tmp_path / "empty"
    empty.mkdir()
    refused(("empty", "holds no log", ".csv"), "identify", slider, empty)


def test_pickles_in_an_archive_are_not_run(slider, refused):
    class Evil:
        def __reduce__(self):
            return print, ("I ran",)

    t = np.arange(20.0)
    np.savez(slider / "run.npz", t=t, q=np.array([Evil()] * 20, dtype=object))
    refused(("run.npz", "'q'", "pickles"), "identify", slider, slider / "run.npz")


def test_too_short_for_the_filter(slider, refused):
    log = slider / "run.csv"
    log.write_text("".join(log.read_text().splitlines(keepends=True)[:40]))
    words = ("run.csv", "filter", "longer log", "--cutoff")
    refused(words, "identify", slider, log, "--cutoff", "6")


def fit_of(mechanism, folder, done):
    done("identify", mechanism, mechanism / "run.csv", "--out", folder)
    return folder / "fit.json"


def edited(key, value):
    def edit(text: str) -> str:
        return json.dumps({**json.loads(text), key: value})

    return edit


STRANGE = [{"name": "leg.Ixx", "value": 1.0}]
EFFECT = {"kind": "viscos", "joint": "theta", "parameters": []}
FITS = {
    "no JSON": (lambda text: "fit", ("no JSON", "ident identify")),
    "cut off": (lambda text: text[:200], ("no JSON",)),
    "empty": (lambda text: "", ("no JSON",)),
    "a list": (lambda text: "[]", ("schema", "ident.fit/1")),
    "other schema": (edited("schema", "ident.fit/9"), ("'ident.fit/9'", "'ident.fit/1'")),
    "incomplete": (lambda text: '{"schema": "ident.fit/1"}', ("no complete fit.json",)),
    "values in words": (edited("parameters", [{"name": "rod.Lxx", "value": "x"}]), ("'x'",)),
    "NaN": (edited("rank", float("nan")), ("NaN",)),
    "of other links": (edited("parameters", STRANGE), ("'leg.Ixx'", "slider_crank", "rod")),
    "unknown effect": (edited("effects", [EFFECT]), ("did you mean 'viscous'?",)),
    "effect on a joint": (
        edited("effects", [EFFECT | {"kind": "viscous", "joint": "hip"}]),
        ("'hip'", "theta"),
    ),
}  # fmt: skip


@pytest.mark.parametrize(("edit", "words"), FITS.values(), ids=FITS)
def test_fits_with_one_fault(edit, words, slider, tmp_path, done, refused):
    fit = fit_of(slider, tmp_path / "out", done)
    fit.write_text(edit(fit.read_text()))
    refused(("fit.json", *words), "compare", slider, slider / "run.csv", "--fit", fit)


def test_the_fit_of_another_mechanism(slider, pendulum, tmp_path, done, refused):
    fit = fit_of(pendulum, tmp_path / "out", done)
    words = ("fit.json", "another mechanism", "pendulum", "ball.x")
    refused(words, "compare", slider, slider / "run.csv", "--fit", fit)


def test_a_fit_that_is_not_there(slider, refused):
    words = ("none.json", "no such file")
    refused(words, "compare", slider, slider / "run.csv", "--fit", "none.json")


IDENTIFY = {
    "cut-off in words": ("--cutoff fast", ("--cutoff fast", "Hz", "auto", "none")),
    "cut-off negative": ("--cutoff -5", ("-5", "above 0", "Hz")),
    "cut-off zero": ("--cutoff 0", ("0 Hz", "above 0")),
    "cut-off below the log": ("--cutoff 1e-9", ("1e-09 Hz", "long enough", "above 0.5 Hz")),
    "cut-off NaN": ("--cutoff nan", ("nan", "Hz")),
    "cut-off above Nyquist": ("--cutoff 5000", ("5000", "below 100 Hz")),
    "spacing without basis": ("--spacing 0.01", ("--spacing 0.01", "free", "--basis linear")),
    "spacing of free": ("--basis free --spacing 0.01", ("--spacing", "--basis linear")),
    "basis without spacing": ("--basis linear", ("--spacing", "'linear'", "above 0 s")),
    "basis unknown": ("--basis qubic --spacing 0.01", ("'qubic'", "did you mean 'cubic'?")),
    "spacing negative": ("--basis cubic --spacing -1", ("above 0 s", "-1")),
    "spacing far below the step": ("--basis cubic --spacing 1e-9", ("1e-09 s", "0.005 s", "free")),
    "spacing infinite": ("--basis cubic --spacing inf", ("above 0 s", "inf")),
    "effect unknown": ("--with viscos:theta", ("'viscos'", "did you mean 'viscous'?")),
    "effect alone unknown": ("--with frictoin", ("'frictoin'", "valid:")),
    "effect on no joint": ("--with viscous:tetha", ("'tetha'", "theta")),
    "effect without joint": ("--with viscous:", ("viscous:", "joint")),
    "effect on two joints": ("--with viscous:s,theta", ("1 joint", "viscous:joint")),
    "effect twice": ("--with viscous:s --with viscous:s", ("viscous:s", "already")),
    "effects everywhere twice": ("--with viscous --with viscous", ("'viscous'", "already")),
    "validated on nothing": ("--validate none.csv", ("none.csv", "no such file")),
    "out onto a file": ("--out {folder}/run.csv", ("run.csv", "is a file")),
    "out below a file": ("--out {folder}/run.csv/deep/er", ("run.csv", "cannot be written")),
    "out where nobody may write": ("--out /proc/ident", ("/proc", "cannot be written")),
}
SIMULATE = {
    "set malformed": ("--set rod.Ixx", ("--set rod.Ixx", "NAME=NUMBER")),
    "set in words": ("--set rod.Ixx=big", ("--set rod.Ixx=big", "NAME=NUMBER")),
    "set without parameter": ("--set rod.=1", ("rod.", "no parameter", "valid:")),
    "set NaN": ("--set rod.Ixx=nan", ("--set", "NAME=NUMBER")),
    "set unknown": ("--set rood.Ixx=1", ("rood.Ixx", "did you mean 'rod.")),
    "set without effect": ("--set viscous.s.Fv=1", ("viscous.s.Fv", "no parameter")),
    "effect without value": ("--with viscous:s", ("viscous.s.Fv", "value")),
    "noise malformed": ("--noise tau", ("--noise tau", "CHANNEL=LEVEL")),
    "noise in words": ("--noise tau=loud", ("--noise tau=loud", "CHANNEL=LEVEL")),
    "noise negative": ("--noise tau=-1", ("--noise tau=-1", "CHANNEL=LEVEL")),
    "noise infinite": ("--noise tau=inf%", ("--noise", "CHANNEL=LEVEL")),
    "noise on nothing": ("--noise w=1", ("noise", "'w'", "valid:")),
    "columns unknown": ("--columns q,w", ("'w'", "valid: a, q, tau, v")),
    "joints unknown": ("--joints elbow", ("'elbow'", "theta")),
    "out of no suffix": ("--out {folder}/new", ("new", ".csv, .parquet, .npz")),
    "out of other suffix": ("--out {folder}/new.txt", ("new.txt", "'.txt'", ".parquet")),
    "out onto a folder": ("--out {folder}", ("slider_crank", ".csv")),
    "out into no folder": ("--out {folder}/no/new.csv", ("new.csv", "no folder")),
    "multipliers of other suffix": ("--multipliers {folder}/m.mat", ("m.mat", ".npz")),
}


def arguments(text: str, folder) -> list[str]:
    return [word.replace("{folder}", str(folder)) for word in text.split()]


@pytest.mark.parametrize(("text", "words"), IDENTIFY.values(), ids=IDENTIFY)
def test_options_of_identify(text, words, slider, refused):
    refused(words, "identify", slider, slider / "run.csv", *arguments(text, slider))


@pytest.mark.parametrize(("text", "words"), SIMULATE.values(), ids=SIMULATE)
def test_options_of_simulate(text, words, slider, refused):
    before = sorted(slider.iterdir())
    refused(words, "simulate", slider, slider / "run.csv", *arguments(text, slider))
    assert sorted(slider.iterdir()) == before


@pytest.mark.parametrize("name", ["plot.bmp", "plot", "no/plot.png"])
def test_plots_that_cannot_be_drawn(name, slider, tmp_path, done, refused):
    fit = fit_of(slider, tmp_path / "out", done)
    words = (name, "no folder") if "/" in name else (name, ".png, .svg, .pdf")
    log, plot = slider / "run.csv", tmp_path / name
    refused(words, "compare", slider, log, "--fit", fit, "--plot", plot)


def test_a_system_error_is_one_line(tmp_path, refused):
    refused(("name too long",), "check", tmp_path / ("x" * 300))


USAGE = {
    "unknown command": ("identfy", "identfy"),
    "unknown option": ("identify --fast a b", "--fast"),
    "no mechanism": ("identify", "MECHANISM"),
    "no log": ("identify robot", "LOG"),
    "no fit": ("compare robot run.csv", "--fit"),
    "no effect": ("add robot", "EFFECT"),
    "no motion": ("simulate robot", "MOTION"),
    "spacing in words": ("identify a b --basis linear --spacing wide", "--spacing"),
    "seed negative": ("simulate a b --seed -1", "--seed"),
    "no verdict": ("diagnose a b --fail-on mising", "'missing'"),
    "option without value": ("identify a b --out", "--out"),
}


@pytest.mark.parametrize(("text", "word"), USAGE.values(), ids=USAGE)
def test_wrong_usage(text, word, ident):
    outcome = ident(*text.split())
    assert outcome.status == 2
    assert outcome.out == ""
    assert word in outcome.err
    assert "Traceback" not in outcome.err


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("check {folder}/none", ("no such file",)),
        ("identify {folder} {folder}/rum.csv", ("rum.csv", "'run.csv'")),
        ("identify {folder} {folder}/run.csv --with viscos", ("'viscous'",)),
        ("add {folder} coulomb:tetha", ("'tetha'", "theta")),
    ],
)
def test_in_a_process_of_its_own(text, words, slider, checked):
    command = [sys.executable, "-m", "ident", *arguments(text, slider)]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    checked(ran.returncode, ran.stdout, ran.stderr, words)
    assert not re.search(r"\x1b", ran.stderr)


def test_explore_reads_its_logs_before_it_gives_an_address(tmp_path, spoken):
    log = tmp_path / "bad.csv"
    log.write_text("a,b\n1,x\n")
    for path in (log, tmp_path / "none.csv"):
        status, text, said = spoken("explore", ROBOTS / "arm", path, "--no-browser")
        assert (status, text) == (1, "")
        assert path.name in said
