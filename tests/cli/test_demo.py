"""The story of `ident demo`: it finds what was planted, and keeps what it says it keeps."""

import json

import numpy as np
import pytest

import ident as api
from helpers import ROBOTS
from ident.cli.demo import make_puzzle, make_servo_puzzle
from ident.cli.puzzles import SECRETS, SERVO_SECRETS


def test_the_story_comes_out_right_and_keeps_its_files(done, tmp_path):
    folder = tmp_path / "kept"
    said = done("demo", "--seed", 11, "--out", folder).out
    assert "coulomb:right_elbow" in said
    answer = (folder / "answer.txt").read_text()
    assert "coulomb:right_elbow" in answer
    assert "Nothing is missing that this data could show" in " ".join(said.split())
    assert "wrong" not in said.partition("The answer")[2]
    for name in ("before", "diagnosis", "after"):
        assert (folder / name / "report.html").stat().st_size > 1000
    found = json.loads((folder / "diagnosis" / "diagnosis.json").read_text())
    assert found["best"] == {"effect": "coulomb", "joints": ["right_elbow"]}
    assert "right_elbow" in (folder / "mechanism.toml").read_text().rpartition("[[effect]]")[2]
    fit = json.loads((folder / "after" / "fit.json").read_text())
    (added,) = [e for e in fit["effects"] if e["joint"] == "right_elbow"]
    planted = float(answer.split(" = ")[1].split()[0])
    assert added["parameters"][0]["value"] == pytest.approx(planted, rel=0.02)
    # what it shows can be typed as it stands
    commands = [line.strip()[2:].split() for line in said.splitlines() if "   $ ident" in line]
    assert [words[1] for words in commands] == [
        "check", "identify", "compare", "diagnose", "add", "identify", "diagnose",
    ]  # fmt: skip
    done(*commands[0][1:])
    done(*commands[2][1:])


def test_a_puzzle_does_not_tell(done, refused, tmp_path):
    folder = tmp_path / "puzzle"
    outcome = done("demo", "--puzzle", "--seed", 3, "--out", folder)
    answer = (folder / "answer.txt").read_text().split()[0]
    assert answer not in outcome.out
    assert answer.partition(":")[0] not in (folder / "mechanism.toml").read_text()
    assert sorted(path.name for path in folder.iterdir()) == [
        "answer.txt", "mechanism.toml", "picker.urdf", "run.csv",
    ]  # fmt: skip
    refused(("has a picker.urdf", "new folder"), "demo", "--puzzle", "--out", folder)
    refused(("--puzzle", "--out DIR"), "demo", "--puzzle")


def test_a_seed_is_one_machine(tmp_path):
    one, again, other = (
        make_puzzle(tmp_path / name, seed=seed) for name, seed in (("a", 5), ("b", 5), ("c", 6))
    )
    assert one.log.read_bytes() == again.log.read_bytes() != other.log.read_bytes()
    assert one.truth == again.truth


def test_servos_are_found_from_commands_and_positions(done, tmp_path):
    folder = tmp_path / "servos"
    said = done("demo", "--servo", "--seed", 4, "--out", folder).out
    commands = [line.strip()[2:].split() for line in said.splitlines() if "   $ ident" in line]
    assert [words[1] for words in commands] == [
        "check", "identify", "compare", "diagnose", "grow", "compare", "compare",
    ]  # fmt: skip
    assert (folder / "run.csv").read_text().startswith("t,ref.yaw,q.yaw,ref.shoulder")
    assert "ripple:elbow" in (folder / "answer.txt").read_text()
    assert "The diagnosis named ripple:elbow." in " ".join(said.split())
    fit = json.loads((folder / "grown" / "fit.json").read_text())
    values = {p["name"]: p for effect in fit["effects"] for p in effect["parameters"]}
    table = [line.split() for line in said.partition("planted")[2].splitlines() if "±" in line]
    planted = {words[0]: float(words[1]) for words in table}
    assert len(planted) == 16  # of the drives and the ripple
    for name, value in planted.items():
        assert abs(values[name]["value"] - value) < 3 * values[name]["stderr"]
        if ".kp" in name:
            assert values[name]["value"] == pytest.approx(value, rel=0.01)
    before, after = (part.splitlines() for part in said.split("error by joint")[1:])
    rms = [float(line.split()[1]) for part in (before, after) for line in part if "rad" in line][:6]
    assert rms[5] < 2e-4 < 1e-3 < rms[2]  # [rad], of the elbow


def test_a_puzzle_of_servos_begins_with_commands_that_run(done, tmp_path):
    folder = tmp_path / "servos"
    said = done("demo", "--servo", "--puzzle", "--seed", 1, "--out", folder).out
    assert sorted(path.name for path in folder.iterdir()) == [
        "answer.txt", "mechanism.toml", "other.csv", "run.csv", "servo_arm.urdf",
    ]  # fmt: skip
    check = next(line.split()[2:] for line in said.splitlines() if "$ ident check" in line)
    assert "by known bodies: forearm" in done(*check).out
    for name in ("servo_arm.urdf", "mechanism.toml"):
        assert (folder / name).read_bytes() == (ROBOTS / "servo_arm" / name).read_bytes()


def test_secrets_are_effects_that_the_machine_can_have(tmp_path):
    machines = make_puzzle(tmp_path / "picker", seed=0).mechanism, api.load(ROBOTS / "servo_arm")
    kinds = zip(machines, (SECRETS, SERVO_SECRETS), strict=True)
    for mechanism, (label, sizes) in ((m, secret) for m, all_of in kinds for secret in all_of):
        effect = mechanism.with_effect(label).effects[-1]
        assert [each.name for each in effect.parameters] == list(sizes)


SEEDS = [*range(24), 38, 105]  # 38: a cable, of which the spring is a special case; 105: rivals


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_the_right_name_or_honest_rivals(seed, tmp_path):
    """Or one that contains it. And with it in the model, the error falls to that of noise."""
    puzzle = make_puzzle(tmp_path / "machine", seed=seed)
    motion = api.complete(puzzle.mechanism, api.read_log(puzzle.log))
    before = api.identify(puzzle.mechanism, motion, estimator="least-squares")
    found = api.diagnose(before)
    assert found.best is not None
    named = [found.best.label, *(each.label for each in found.rivals)]
    contains = found.best.kind in puzzle.answer.nested_in
    assert contains or puzzle.answer.label in named
    assert found.best.joints == puzzle.answer.joints
    after = api.identify(puzzle.mechanism + puzzle.answer.freed, motion, estimator="least-squares")
    assert max(error.relative for error in after.held_out.values()) < 0.002
    for name, value in puzzle.truth.items():
        if after[name].stderr:
            assert np.isclose(after[name].value, value, rtol=0.05, atol=5 * after[name].stderr)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_what_is_hidden_in_servos_is_named(seed, tmp_path):
    puzzle = make_servo_puzzle(tmp_path / "machine", seed=seed)
    motion = api.complete(puzzle.mechanism, api.read_log(puzzle.log))
    diagnosis = api.diagnose(api.identify(puzzle.mechanism, motion))
    assert diagnosis.best is not None
    assert diagnosis.best.label == puzzle.answer.label
