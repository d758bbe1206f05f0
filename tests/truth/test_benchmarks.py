"""The benchmarks of speed run, on a thousand samples; their tables are what scale.py writes."""

import importlib
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def benchmarks(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module


def test_the_whole_way_from_a_file_to_a_fit(benchmarks, monkeypatch):
    module, scale = benchmarks("whole_way"), benchmarks("scale")
    monkeypatch.setattr(module, "REPEAT", 1)
    rows = module.table((1000,), crank=False)
    assert [row["step"] for row in rows] == list(module.STEPS)
    assert all(row["us"] > 0 and row["kernels"] >= 0 for row in rows)
    assert "identify" in scale.markdown(rows)


def test_cores_agree_with_the_lines_that_a_user_would_write(tmp_path):
    def run(*arguments: str) -> dict:
        command = [sys.executable, str(BENCHMARKS / "figaroh_core.py"), *arguments]
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300)
        return json.loads(done.stdout.splitlines()[-1]) if done.stdout else {}

    run("--make", "1000", str(tmp_path))
    for kind in ("core", "plain"):
        assert run(f"--{kind}", str(tmp_path))["us"] > 0
    core, plain = (np.load(tmp_path / f"{kind}.npy") for kind in ("core", "plain"))
    # normal equations square the condition, 2,400 in a second of this motion: they count 58
    # independent columns where there are 57, and fit some of the noise with the other
    assert np.abs(core - plain).max() < 1e-4 * np.abs(core).max()


def test_elimination_agrees_with_banded_normal_equations(benchmarks, monkeypatch):
    module = benchmarks("banded")
    monkeypatch.setattr(module, "REPEAT", 1)
    assert max(module.table()[1]["p, λ apart"]) < 1e-10


def test_growth_with_joints_closures_and_candidates(benchmarks):
    module = benchmarks("growth")
    rows = [*module.joints(400, (2,)), *module.closures(400, (1, 2))]
    assert [row["count"] for row in rows] == [2, 1, 2]
    assert all(row["identify"] > 0 and row["rank"] > 0 for row in rows)
    (row,) = module.candidates(500, (10,))
    assert row["ranking"] > 0


def test_samples_one_by_one(benchmarks, monkeypatch):
    module = benchmarks("online")
    monkeypatch.setattr(module, "MACHINES", {"arm of 7 joints": module.arm})
    rows = module.table(400)
    assert [row["rows made"] for row in rows][-1] == "at once"
    assert all(row["mean"] > 0 for row in rows)


def test_two_versions_are_compared_row_by_row(benchmarks):
    module = benchmarks("inside")
    assert module.figure("modules", module.SOURCE) == module.count()
    before, now = (
        "4.0 s (missing: coupling); nothing hidden 3.0 s",
        "2 s (missing); nothing hidden 6 s",
    )
    assert module.ratio_of(before, now) == "0.50, 2.00"
