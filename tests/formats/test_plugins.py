"""Formats that other packages bring, installed as pip installs them: a module and its metadata."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import ident
from helpers import ROBOTS

CONTRIBUTING = Path(__file__).parents[2] / "CONTRIBUTING.md"


def blocks(language: str) -> list[str]:
    """Return the code blocks of CONTRIBUTING.md in a language."""
    return re.findall(rf"```{language}\n(.*?)```", CONTRIBUTING.read_text("utf-8"), re.DOTALL)


def test_the_example_of_contributing(install, tmp_path, spoken):
    (code,) = (block for block in blocks("python") if "read_dat" in block)
    (toml,) = (tomllib.loads(block) for block in blocks("toml") if "ident.formats" in block)
    install("dat_logs", code, toml["project"]["entry-points"]["ident.formats"])
    t = np.arange(0, 1, 0.01)
    np.savetxt(tmp_path / "run.dat", np.column_stack([t, np.sin(t), np.cos(t)]))
    log = ident.read_log(tmp_path / "run.dat")
    np.testing.assert_allclose(log.t, t, atol=1e-15)
    np.testing.assert_allclose(log.columns["tau.theta"], np.cos(t), atol=1e-15)
    assert log.name == "run.dat"
    assert len(log.sha256) == 64
    status, out, err = spoken("check", ROBOTS / "slider_crank", tmp_path / "run.dat")
    assert status == 0, err
    assert "run.dat" in out


def test_what_another_packages_log_may_be(install, tmp_path):
    text = """
import polars as pl
def frame(path): return pl.DataFrame({"t": [0.01 * k for k in range(20)], "q.a": range(20)})
def backward(path): return {"t": [1.0, 0.0] * 6}
def uneven(path): return {"t": range(12), "q.a": [1.0]}
def broken(path): raise ValueError("no\\nmagic")
"""
    kinds = ("frame", "backward", "uneven", "broken", "missing")
    install("made_logs", text, {f"log.{kind}": f"made_logs:{kind}" for kind in kinds})
    for kind in kinds:
        (tmp_path / f"run.{kind}").touch()
    np.testing.assert_array_equal(ident.read_log(tmp_path / "run.frame").columns["q.a"], range(20))
    for kind, says in (
        ("backward", "goes backward"),
        ("uneven", "different lengths: 't' has 12, 'q.a' has 1"),
        ("broken", r"made_logs:broken \(ValueError: no magic\)"),
        ("missing", "made_logs:missing"),
        ("other", r"unknown suffix '\.other'; valid: \.csv, .*\.frame"),
    ):
        (tmp_path / f"run.{kind}").touch()
        with pytest.raises(ident.LogError, match=says) as caught:
            ident.read_log(tmp_path / f"run.{kind}")
        assert str(caught.value).startswith(str(tmp_path / f"run.{kind}"))
        assert "\n" not in str(caught.value)


MECHANISMS = """
import tomllib
from pathlib import Path
from ident.mechanism.description import Description
FOUR_BAR = Path({folder!r})
def bare(path): return (FOUR_BAR / "four_bar.urdf").read_bytes()
def closed(path):
    toml = tomllib.loads((FOUR_BAR / "mechanism.toml").read_text())
    return Description(bare(path), "closed", closures=tuple(toml["closure"]),
                       passive=tuple(toml["joints"]["passive"]), start=toml["joints"]["start"])
def broken(path): return "<robot><link/></robot>"
"""


def test_a_mechanism_of_another_package(install, tmp_path):
    text = MECHANISMS.format(folder=str(ROBOTS / "four_bar"))
    kinds = ("bare", "closed", "broken")
    install("made_mechanisms", text, {f"mechanism.{k}": f"made_mechanisms:{k}" for k in kinds})
    for kind in kinds:
        (tmp_path / f"machine.{kind}").write_text("of its own kind")
    known = ident.load(ROBOTS / "four_bar")
    bare, closed = (ident.load(tmp_path / f"machine.{kind}") for kind in ("bare", "closed"))
    assert bare.closures == ()
    np.testing.assert_array_equal(bare.prior, known.prior)
    assert closed.degrees_of_freedom == known.degrees_of_freedom == 1
    assert closed.driven == ("crank",)
    log = ident.read_log(ROBOTS / "four_bar" / "run.csv")
    fits = [ident.identify(m, ident.complete(m, log)) for m in (closed, known)]
    assert fits[0].train["crank"].rms == pytest.approx(fits[1].train["crank"].rms, rel=1e-9)
    fits[0].write(tmp_path / "out")
    again = ident.load(tmp_path / "out" / "identified")
    assert [each.name for each in again.closures] == ["pin"]
    with pytest.raises(ident.MechanismError, match=r"machine\.broken:1: a <link> has no name"):
        ident.load(tmp_path / "machine.broken")
