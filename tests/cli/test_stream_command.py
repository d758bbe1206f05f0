"""`ident identify --stream`, and when it streams by itself."""

from __future__ import annotations

import json

import pytest

import ident
from helpers import ROBOTS
from ident.cli import logs as identifying

ARM, RUN = ROBOTS / "arm", ROBOTS / "arm" / "run.csv"


def test_a_streamed_fit_is_written_as_any_other(spoken, tmp_path):
    said = spoken("identify", ARM, RUN, "--with", "viscous", "--stream", "--out", tmp_path / "out")
    assert said[0] == 0
    plain = spoken("identify", ARM, RUN, "--with", "viscous", "--out", tmp_path / "plain")
    names = [
        sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))
        for folder in (tmp_path / "out", tmp_path / "plain")
    ]
    assert names[0] == names[1]
    assert said[1].splitlines()[0] == plain[1].splitlines()[0]
    one, other = (json.loads((tmp_path / n / "fit.json").read_text()) for n in ("out", "plain"))
    assert one.keys() == other.keys()
    assert one["samples"] == other["samples"]


def test_a_long_log_streams_by_itself_and_says_so(spoken, monkeypatch):
    monkeypatch.setattr(identifying, "MOST_IN_MEMORY", 1000)
    status, _, notes = spoken("identify", ARM, RUN)
    assert status == 0
    assert "more than 1000 samples: read in portions" in notes


@pytest.mark.parametrize("option", ["--stream", "--jobs=2"])
def test_a_refined_fit_needs_all_samples(spoken, option):
    status, _, error = spoken("identify", ARM, RUN, "--refine", option)
    assert status == 1
    assert "--refine" in error


def test_progress_reaches_its_end_in_every_step():
    told: dict[str, list[float]] = {}
    ident.gather(
        ident.load(ARM), RUN, samples=1024,
        progress=lambda what, share: told.setdefault(what, []).append(share),
    )  # fmt: skip
    shares = [*told["looking at the logs"], *told["equations"]]
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(0.9)
    assert len(told["equations"]) > 1
