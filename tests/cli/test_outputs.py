"""What the commands write: whole or not at all, and nothing anywhere else."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import ident as api
from ident.errors import IdentError
from ident.files import check_writable, write_all
from ident.mechanism.write import folder_files

COMMENTED = """# a robot with a story
urdf = "slider_crank.urdf"   # beside this file

[[effect]]   # measured by Ann
kind = "viscous"
joint = "s"
Fv = 0.5     # N s/m
"""


def snapshot(folder: Path) -> dict[str, bytes | None]:
    """Every path below a folder, hidden ones too, with its content."""
    return {
        str(path.relative_to(folder)): None if path.is_dir() else path.read_bytes()
        for path in sorted(folder.rglob("*"))
    }


def test_identify_writes_into_out_only(slider, tmp_path, monkeypatch, done):
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    before = snapshot(tmp_path)
    done("identify", slider, slider / "run.csv", "--out", "the results/of today")
    after = snapshot(tmp_path)
    new = set(after) - set(before)
    assert all(name.startswith("here/the results") for name in new)
    assert {name: after[name] for name in before} == before
    files = {path.name for path in (here / "the results/of today").rglob("*") if path.is_file()}
    assert files == {
        "fit.json", "multipliers.csv", "identified.urdf", "report.html", "slider_crank.urdf",
        "mechanism.toml", "covariance.csv",
    }  # fmt: skip


def test_without_out_nothing_is_written(slider, tmp_path, monkeypatch, done):
    monkeypatch.chdir(tmp_path)
    before = snapshot(tmp_path)
    done("check", slider, slider / "run.csv")
    done("identify", slider, slider / "run.csv")
    done("simulate", slider, slider / "run.csv")
    assert snapshot(tmp_path) == before


def test_a_mechanism_folder_that_is_read_only(slider, tmp_path, done):
    for path in (*slider.iterdir(), slider):
        path.chmod(0o555 if path.is_dir() else 0o444)
    try:
        done("identify", slider, slider / "run.csv", "--out", tmp_path / "out")
    finally:
        slider.chmod(0o755)
    assert os.access(tmp_path / "out/identified/mechanism.toml", os.W_OK)


def failing(monkeypatch, name: str, target: str, error: type[BaseException]) -> None:
    """Make `os.replace` or `Path.open` of a new file fail at files whose name holds `target`."""
    owner = os if name == "replace" else Path
    real = getattr(owner, name)

    def fail(path, *rest, **options):
        about = str(rest[0]) if name == "replace" else str(path)
        if target in Path(about).name and (name == "replace" or "xb" in rest):
            raise error(28, "No space left on device", about)
        return real(path, *rest, **options)

    monkeypatch.setattr(owner, name, fail)


@pytest.mark.parametrize("error", [OSError, KeyboardInterrupt])
@pytest.mark.parametrize("step", ["replace", "open"])
@pytest.mark.parametrize("older", [False, True])
def test_all_files_or_none(step, error, older, tmp_path, monkeypatch):
    out = tmp_path / "out"
    contents = {name: b"new" for name in ("a", "b", "deep/c")}
    if older:
        write_all(out, {"a": b"old", "b": b"old"})
    before = snapshot(tmp_path)
    failing(monkeypatch, step, "b", error)
    with pytest.raises(IdentError if error is OSError else error):
        write_all(out, contents)
    assert snapshot(tmp_path) == before
    monkeypatch.undo()
    write_all(out, contents)
    assert {name: x for name, x in snapshot(out).items() if x} == contents


def test_identify_onto_a_full_disk(slider, tmp_path, monkeypatch, ident, done):
    out = tmp_path / "out"
    done("identify", slider, slider / "run.csv", "--out", out)
    before = snapshot(tmp_path)
    failing(monkeypatch, "replace", "identified.urdf", OSError)
    log = slider / "run.csv"
    outcome = ident("identify", slider, log, "--with", "coulomb:s", "--out", out)
    assert outcome.status == 1
    assert "No space left on device" in outcome.err.splitlines()[-1]
    assert snapshot(tmp_path) == before


def test_a_folder_is_tried_without_a_trace(tmp_path):
    check_writable(tmp_path / "a/b/c")
    assert snapshot(tmp_path) == {}
    (tmp_path / "file").touch()
    with pytest.raises(IdentError, match=r"file.*cannot be written"):
        check_writable(tmp_path / "file" / "below")


def test_a_file_may_not_take_a_folders_name(tmp_path):
    (tmp_path / "fit.json").mkdir()
    with pytest.raises(IdentError, match=r"fit\.json.*is a folder"):
        write_all(tmp_path, {"report.html": b"", "fit.json": b"{}"})
    assert list(snapshot(tmp_path)) == ["fit.json"]


def test_add_keeps_what_the_user_wrote(slider, done):
    toml = slider / "mechanism.toml"
    before = toml.read_text()
    done("add", slider, "viscous:theta")
    done("add", toml, "coulomb")
    after = toml.read_text()
    assert after.startswith(before.rstrip())
    labels = [effect.label for effect in api.load(slider).effects]
    assert labels == ["viscous:theta", "coulomb:s", "coulomb:theta"]


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
def test_add_keeps_comments_and_ends_of_lines(newline, mark, slider, done):
    toml = slider / "mechanism.toml"
    closure = toml.read_text().partition("[joints]")[2]
    text = COMMENTED.replace("[[effect]]", f"[joints]{closure}\n[[effect]]", 1)
    toml.write_bytes(mark + text.replace("\n", newline).encode())
    done("add", slider, "viscous:theta")
    raw = toml.read_bytes().decode()
    for comment in ("# a robot with a story", "# measured by Ann", "# N s/m"):
        assert comment in raw
    assert raw.startswith(text.rstrip().replace("\n", newline))
    effects = tomllib.loads(raw)["effect"]
    assert effects[0] == {"kind": "viscous", "joint": "s", "Fv": 0.5}
    assert effects[1] == {"kind": "viscous", "joint": "theta"}


def test_add_to_effects_written_in_line(slider, change, done):
    toml = slider / "mechanism.toml"
    change(toml, "[joints]", 'effect = [{ kind = "viscous", joint = "s" }]\n\n[joints]')
    done("add", slider, "viscous:theta")
    assert [effect.label for effect in api.load(slider).effects] == ["viscous:s", "viscous:theta"]


def test_add_is_whole_or_not_at_all(slider, monkeypatch, refused):
    before = snapshot(slider)
    failing(monkeypatch, "replace", "mechanism.toml", OSError)
    refused(("mechanism.toml", "No space left"), "add", slider, "viscous:theta")
    assert snapshot(slider) == before


def test_add_refuses_what_is_there(slider, refused, done):
    done("add", slider, "viscous:theta")
    before = snapshot(slider)
    refused(("viscous:theta", "already"), "add", slider, "viscous:theta")
    assert snapshot(slider) == before


def test_add_frees_what_is_known(slider, done, change):
    toml = slider / "mechanism.toml"
    tables = '[[effect]]\nkind = "viscous"\njoint = "{}"\nFv = 0.8\n\n'
    change(toml, "[joints]", f"{tables.format('theta')}{tables.format('s')}[joints]")
    assert "unknown again: viscous:theta" in done("add", slider, "viscous:theta").out
    effects = {effect.label: effect.values for effect in api.load(slider).effects}
    assert effects == {"viscous:s": {"Fv": 0.8}, "viscous:theta": {}}


def test_add_to_a_bare_urdf_makes_a_mechanism(arm, done, refused):
    outcome = done("add", arm, "coulomb:elbow")
    assert "mechanism.toml: added coulomb:elbow" in outcome.out
    assert f"{arm} by itself stays as it is" in outcome.err
    assert f"ident diagnose {arm.parent / 'mechanism.toml'} LOG" in outcome.err
    assert [effect.label for effect in api.load(arm.parent).effects] == ["coulomb:elbow"]
    refused(("mechanism.toml", "is there already"), "add", arm, "viscous:elbow")


@pytest.mark.parametrize("name", ["two words", "größe_π", "it's", "[brackets]", "100%", "a.b"])
def test_paths_of_every_kind(name, slider, tmp_path, monkeypatch, done):
    place = tmp_path / name
    shutil.copytree(slider, place / "the robot")
    shutil.copy(slider / "run.csv", place / f"{name}.csv")
    monkeypatch.chdir(place)
    done("identify", "the robot", f"{name}.csv", "--out", "out")
    outcome = done("compare", "the robot", f"{name}.csv", "--fit", "out/fit.json")
    assert "theta" in outcome.out
    done("check", "out/identified", f"{name}.csv", "--with", "viscous")


@pytest.mark.parametrize("where", ["", "elsewhere/"])
def test_closure_functions_come_along(where, slider):
    toml, file = slider / "mechanism.toml", slider / where / "phi.py"
    file.parent.mkdir(exist_ok=True)
    file.write_text("def phi(q):\n    return q['s'] - 0.05 * q['theta'] - 0.2\n")
    head, _, rest = toml.read_text().partition('kind = "point"')
    rest = rest.partition('axes = "xyz"')[2]
    name = f"../slider_crank/{where}phi.py" if where else "phi.py"
    toml.write_text(f'{head}kind = "function"\nfile = "{name}"\nfunction = "phi"{rest}')
    model = api.load(slider, allow_code=True)
    files = folder_files(model, b"<robot/>", [], [], {})
    assert set(files) == {"slider_crank.urdf", "mechanism.toml", "phi.py"}
    assert tomllib.loads(files["mechanism.toml"].decode())["closure"][0]["file"] == "phi.py"


INPUTS = {
    "the log": ("simulate {folder} {folder}/run.csv --out {folder}/run.csv", "run.csv"),
    "multipliers": ("identify {folder} {out}/multipliers.csv --out {out}", "multipliers.csv"),
    "its folder of logs": ("identify {folder} {out} --out {out}", "multipliers.csv"),
    "the mechanism": ("identify {out}/identified {folder}/run.csv --out {out}", "identified"),
}


@pytest.mark.parametrize(("text", "name"), INPUTS.values(), ids=INPUTS)
def test_an_output_that_is_an_input(text, name, slider, tmp_path, refused):
    out = tmp_path / "out"
    (out / "identified").mkdir(parents=True)
    for file in ("slider_crank.urdf", "mechanism.toml"):
        shutil.copy(slider / file, out / "identified")
    shutil.copy(slider / "run.csv", out / "multipliers.csv")
    before = snapshot(tmp_path)
    refused((name, "input", "another name"), *text.format(folder=slider, out=out).split())
    assert snapshot(tmp_path) == before


def test_files_are_complete_where_nobody_reads(slider, tmp_path):
    out = tmp_path / "out"
    words = ["identify", slider, slider / "run.csv", "--out", out]
    run = subprocess.Popen(
        [sys.executable, "-m", "ident", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    run.stdout.close()  # before anything is printed
    errors = run.stderr.read().decode()
    run.stderr.close()
    assert run.wait() in (0, 141)
    assert all(line.startswith("note: ") for line in errors.splitlines())
    assert (out / "report.html").read_text().rstrip().endswith("</html>")
    assert (out / "fit.json").exists()


def test_ctrl_c_is_one_line(slider, tmp_path, monkeypatch, ident):
    def interrupted(*args, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr("ident.motion.complete", interrupted)
    outcome = ident("identify", slider, slider / "run.csv", "--out", tmp_path / "out")
    assert outcome.status == 130
    assert outcome.out == ""
    (line,) = outcome.err.splitlines()
    assert line.startswith("interrupted")
    again = f"ident identify {slider} {slider / 'run.csv'} --out {tmp_path / 'out'}"
    assert line.endswith(f"no file was written; begin again with: {again}")
    assert not (tmp_path / "out").exists()


def test_ctrl_c_among_many_logs_loses_no_verdict(slider, tmp_path, monkeypatch, ident):
    from ident.streams.many_logs import Verdict

    def verdict(common, task):
        if task[0].startswith("b"):
            raise KeyboardInterrupt
        return Verdict(task[0], 10, "nothing")

    monkeypatch.setattr("ident.streams.many_logs._verdict", verdict)
    (tmp_path / "logs").mkdir()
    for name in ("a", "b"):
        shutil.copy(slider / "run.csv", tmp_path / "logs" / f"{name}.csv")
    words = ("diagnose", slider, tmp_path / "logs", "--jobs", 1, "--out", tmp_path / "out")
    outcome = ident(*words)
    assert outcome.status == 130
    assert "logs.csv" in outcome.err.splitlines()[-1]
    (row,) = (tmp_path / "out" / "logs.csv").read_text().splitlines()[1:]
    assert row.startswith("a.csv,10,nothing")


@pytest.mark.parametrize(
    "verb", [("identify",), ("diagnose",), ("grow",), ("compare", "--fit", "fit.json"), ("view",)]
)
def test_folders_of_packages_are_checked_by_every_command(verb, slider, refused):
    words = ("--mesh-path nowhere", "contains packages")
    refused(words, verb[0], slider, slider / "run.csv", *verb[1:], "--mesh-path", "nowhere")
