"""A run that is killed goes on where it was, and gives what it would have given."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from importlib import import_module

import numpy as np
import pytest
from test_portions import log_of

import ident
from helpers import ROBOTS

checkpoint = import_module("ident.streams.portions")
ROWS, SAMPLES = 6144, 1024
RUN = """
import sys
from importlib import import_module

import ident

checkpoint = import_module("ident.streams.portions")
checkpoint.PORTIONS, checkpoint.SECONDS = 2, 0.0
mechanism = ident.load(sys.argv[1]).with_effect("viscous").with_effect("coulomb")
ident.gather(
    mechanism, sys.argv[2], cutoff=None, samples=1024, checkpoint=sys.argv[3],
    progress=lambda what, share: print(what, share, flush=True),
)
"""


@pytest.fixture(scope="module")
def arm():
    return ident.load(ROBOTS / "arm").with_effect("viscous").with_effect("coulomb")


@pytest.fixture(scope="module")
def killed(arm, tmp_path_factory):
    """A folder with a log and what a killed process has left of it in `out`."""
    folder = tmp_path_factory.mktemp("killed")
    log_of(arm, {}, rows=ROWS).write(folder / "run.parquet")
    killed_at(folder / "run.parquet", folder / "out")
    return folder


@pytest.fixture
def run(killed):
    return killed / "run.parquet"


@pytest.fixture
def out(killed, tmp_path):
    """A copy of what the killed process has left, but for a file in the middle of its writing."""
    half = shutil.ignore_patterns("*.part")
    return shutil.copytree(killed / "out", tmp_path / "out", ignore=half)


@pytest.fixture(autouse=True)
def often(monkeypatch):
    """Checkpoints after every other portion."""
    monkeypatch.setattr(checkpoint, "PORTIONS", 2)
    monkeypatch.setattr(checkpoint, "SECONDS", 0.0)


def gathered(mechanism, run, folder=None, **options):
    options = {"cutoff": None, "samples": SAMPLES, **options}
    return ident.gather(mechanism, run, checkpoint=folder, **options)


def killed_at(run, folder, share=0.65):
    """A process of its own, killed when it has done a share of all work: half of the portions."""
    words = [sys.executable, "-c", RUN, str(ROBOTS / "arm"), str(run), str(folder)]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=environment) as process:
        assert process.stdout is not None
        for line in process.stdout:
            what, _, done = line.rpartition(" ")
            if what == "equations" and float(done) > share:
                process.send_signal(signal.SIGKILL)
                break
    assert process.returncode == -signal.SIGKILL


def test_a_killed_run_goes_on_and_gives_what_it_would_have_given(arm, run, out):
    assert [path.name for path in out.iterdir()] == [checkpoint.NAME]
    whole, again = gathered(arm, run), gathered(arm, run, out)
    portions = len(whole.plan.parts[0].borders) - 1
    assert whole.worked == portions
    assert again.worked + again.resumed == portions
    assert again.resumed > 0.3 * portions
    assert any(f"{again.resumed} portions were done" in note for note in again.notes)
    x = whole.fit.estimate.solution.x
    np.testing.assert_allclose(
        again.fit.estimate.solution.x, x, rtol=0, atol=1e-12 * np.abs(x).max()
    )
    C = whole.fit.covariance
    np.testing.assert_allclose(again.fit.covariance, C, rtol=1e-9, atol=1e-12 * np.abs(C).max())
    again.write(out)
    assert (out / "fit.json").is_file()
    assert not any(path.name.startswith(".") for path in out.iterdir())


@pytest.mark.parametrize("change", ["cutoff", "effect", "log", "version", "cut off"])
def test_a_checkpoint_of_another_run_is_not_used_and_that_is_said(
    arm, run, out, change, monkeypatch
):
    options, mechanism = {}, arm
    if change == "cutoff":
        options = {"cutoff": 20.0}
    elif change == "effect":
        mechanism = arm.without("viscous:elbow")
    elif change == "log":
        run = out.parent / "run.parquet"
        log_of(arm, {}, rows=ROWS, seed=3).write(run)
    elif change == "version":
        monkeypatch.setattr(checkpoint, "version", lambda: "0.0.0")
    else:
        file = out / checkpoint.NAME
        file.write_bytes(file.read_bytes()[:-2000])
    found = gathered(mechanism, run, out, **options)
    assert found.resumed == 0
    assert found.worked == len(found.plan.parts[0].borders) - 1
    assert any("not used" in note for note in found.notes)


def test_nothing_is_said_and_nothing_kept_where_no_checkpoint_is_asked_for(arm, run, tmp_path):
    before = {path.name for path in tmp_path.iterdir()}
    found = gathered(arm, run)
    assert not any("checkpoint" in note or "went on" in note for note in found.notes)
    assert {path.name for path in tmp_path.iterdir()} == before
