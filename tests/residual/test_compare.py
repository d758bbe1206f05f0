"""Comparisons: tables that fit a terminal, pictures, report.html and compare.json."""

import json

import pytest
from matplotlib.figure import Figure

import ident
from ident import FitError, Noise
from identification import motion_log, plant, robot
from pages import charts, read_page, titles

NOISE = [Noise("tau", 0.02, relative=True)]


@pytest.fixture(scope="module", params=["arm", "five_bar"])
def compared(request):
    rigid = robot(request.param)
    full = rigid.with_effect("viscous").with_effect("coulomb")
    log = motion_log(request.param, 100.0, 8.0)
    case = plant(full, log, noise=NOISE, seed=1)
    fits = case.fit(mechanism=rigid, cutoff="auto"), case.fit(cutoff="auto")
    return fits, ident.compare(*fits)


def test_the_tables(compared):
    fits, comparison = compared
    text = str(comparison)
    assert max(map(len, text.splitlines())) <= 100
    for words in ("error falls", "held out", "rigid bodies", "coulomb", "depends on", "noise"):
        assert words in text
    assert ("closure forces" in text) == bool(fits[0].mechanism.closures)
    for (name, errors), fit in zip(comparison.fitted.items(), fits, strict=True):
        assert errors["train"] == fit.train
        assert errors["held out"] == fit.held_out
        assert {f.joint for f in comparison.where[name]} == set(fit.train)


def test_the_pictures(compared):
    fits, comparison = compared
    d = len(fits[0].motion.independent)
    assert len(comparison.plot().axes) == 2 * d
    assert len(comparison.plot_parts().axes) == 2 * d
    figure = comparison.plot_maps()
    assert isinstance(figure.figure, Figure)
    labels = [panel.x.split()[0] for panel in figure.panels]
    assert labels[:5] == ["t", "q", "v", "a", "load"]
    assert len(labels) in (2 * 5, 2 * 6)
    with pytest.raises(FitError, match="no residual of joint 'x'; valid"):
        comparison.plot_maps("x")


def test_the_files(compared, tmp_path):
    _, comparison = compared
    assert [path.name for path in comparison.write(tmp_path)] == ["report.html", "compare.json"]
    page = read_page(tmp_path / "report.html")
    assert len(charts(page)) == 2 + len(comparison.units)
    assert "Residual maps" in titles(page)
    told = json.loads((tmp_path / "compare.json").read_text())
    assert list(told["models"]) == ["fit 1", "fit 2"]
    entry = told["models"]["fit 1"]["where"][0]
    needed = {"joint", "rms", "relative", "share", "depends_on", "worst", "white"}
    assert needed <= set(entry)
