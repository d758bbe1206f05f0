"""The commands that results print run as they are printed, one after the other."""

from __future__ import annotations

import re
import shlex
import shutil

import pytest

from helpers import ROBOTS

COMMAND = re.compile(r"^  (ident \w.*)$", re.MULTILINE)
ONCE = {"excite": ["--tries", "1", "--duration", "6"]}  # so that a plan takes seconds


def printed(text):
    """The commands of a result."""
    return COMMAND.findall(text)


def follow(words, steps, spoken):
    """Run a command, then what it prints, and so on; return the verbs that ran."""
    verbs = []
    for _ in range(steps + 1):
        more = ONCE.get(words[0], [])
        status, out, err = spoken(*words, *more)
        assert status == 0, (words, err)
        verbs.append(words[0])
        following = printed(out)
        if not following:
            return verbs
        _, *words = shlex.split(following[0])
    return verbs


def test_from_a_first_identification_to_another_log(tmp_path, monkeypatch, spoken):
    monkeypatch.chdir(tmp_path)
    arm, log = ROBOTS / "arm", ROBOTS / "arm" / "run.csv"
    # friction is offered where the residual rubs, then a motion to test the model on
    assert follow(["identify", arm, log, "--out", "out"], 2, spoken) == [
        "identify", "identify", "excite",
    ]  # fmt: skip
    assert {path.name for path in tmp_path.iterdir()} == {"out", "out_2", "next.csv"}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["arm", "five_bar", "slider_crank", "four_bar"])
@pytest.mark.parametrize("verb", ["check", "diagnose", "grow"])
def test_what_other_results_print(name, verb, tmp_path, monkeypatch, spoken):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROBOTS / name, tmp_path / name)  # `add` writes into it
    log = tmp_path / name / "run.csv"
    out = ["--out", "grown"] if verb == "grow" else []
    assert len(follow([verb, name, log, *out], 1, spoken)) == 2


@pytest.mark.slow
def test_a_planned_motion_of_a_diagnosis_is_one_file(tmp_path, monkeypatch, spoken):
    """Whatever the next experiment of a robot is, its command writes one file."""
    monkeypatch.chdir(tmp_path)
    for name in ("arm", "five_bar"):
        log = ROBOTS / name / "run.csv"
        friction = ("--with", "viscous", "--with", "coulomb")
        _, out, _ = spoken("diagnose", ROBOTS / name, log, *friction)
        for line in (x for x in printed(out) if " excite " in x):
            words = shlex.split(line)[1:]
            assert spoken(*words, *ONCE["excite"])[0] == 0, line
            assert (tmp_path / words[words.index("--out") + 1]).is_file()


def test_a_diagnosis_with_more_missing_than_it_names_goes_on_with_grow(
    tmp_path, monkeypatch, spoken
):
    """One next command: not `add` beside a sentence on `grow`, and none after "no motion can"."""
    monkeypatch.chdir(tmp_path)
    log = ROBOTS / "arm" / "run.csv"
    _, out, _ = spoken("diagnose", ROBOTS / "arm", log)
    (line,) = printed(out)
    assert line == shlex.join(["ident", "grow", str(ROBOTS / "arm"), str(log), "--out", "grown"])
    assert out.count("Next: ") == 1
    assert "That is not all" in out
