"""Comparisons: tables that fit a terminal, pictures, report.html and compare.json."""

import json

import numpy as np
import polars as pl
import pytest
from matplotlib.figure import Figure

import ident
from helpers import ROBOTS
from ident import FitError, Noise
from ident.assess.comparison import assess_comparison
from ident.fit.residual import _exceeds
from ident.show.charts import Line
from ident.show.comparison import rounded_name
from ident.text import WIDTH, rounded, shortened
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
    for words in ("falls in", "rigid bodies", "coulomb", "depends on", "noise of the sensors"):
        assert words in text
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
    assert len(charts(page)) >= 2 + len(comparison.units)
    assert "Residual maps" in titles(page)
    told = json.loads((tmp_path / "compare.json").read_text())
    assert list(told["models"]) == ["fit 1", "fit 2"]
    entry = told["models"]["fit 1"]["where"][0]
    needed = {"joint", "rms", "relative", "share", "depends_on", "worst", "white"}
    assert needed <= set(entry)


def test_the_report_has_what_the_models_say(compared, tmp_path):
    fits, comparison = compared
    comparison.write(tmp_path)
    page = read_page(tmp_path / "report.html")
    assert {"Parameters", "What was understood", "How to reproduce"} <= set(titles(page))
    assert ("Multipliers" in titles(page)) == bool(fits[0].mechanism.closures)
    captions = "Effects;", "Base parameters of the bodies;"
    tables = [t for t in page.iter("table") if t.findtext("caption").startswith(captions)]
    assert len(tables) == 2
    rows = [
        [row.findtext("th"), *("".join(cell.itertext()) for cell in row.iter("td"))]
        for t in tables
        for row in t.find("tbody")
    ]
    found = {row[0].replace("\u00a0", " "): [x.replace("\u00a0", " ") for x in row] for row in rows}
    assert len(found) == len(rows) >= len(fits[1].base_parameters)
    for each in fits[1].base_parameters:
        *_, value, unit = found[shortened(each.name, WIDTH)]
        assert (value, unit) == (rounded(each.value, each.stderr), each.unit)
    assert found[next(name for name in found if name.startswith("coulomb"))][1] == "–"


def test_seconds_since_1970_are_counted_from_the_start_of_the_log():
    """float32 has steps of 128 s there, and two logs of different clocks share no axis."""
    mechanism = robot("arm")
    case = plant(mechanism, motion_log("arm", 100.0, 6.0), seed=1)
    late = ident.Log.from_arrays("late.csv", case.log.t + 1.7e9, dict(case.log.columns))
    motion = ident.complete(mechanism, [case.log, late])
    fit = ident.identify(mechanism, motion)
    for chart in (fit.plot(1), fit.plot_parts(1), fit.plot_maps("yaw")):
        for panel in chart.panels:
            for mark in panel.marks:
                if panel.x.startswith("t") and hasattr(mark, "x"):
                    assert np.abs(mark.x).max() < 10.0
    assert "1700000000" in fit.plot(1).panels[0].x


def test_a_machine_that_stands_still_has_a_report(tmp_path):
    """Nothing can be held out, and no signal explains what does not change."""
    mechanism = robot("arm")
    log = motion_log("arm", 100.0, 6.0)
    case = plant(mechanism, log, seed=1)
    still = {name: np.full_like(x, x[0]) for name, x in case.log.columns.items()}
    motion = ident.complete(mechanism, ident.Log.from_arrays("still.csv", case.log.t, still))
    ident.identify(mechanism, motion).write(tmp_path)
    assert "Residual maps" in titles(read_page(tmp_path / "report.html"))


def test_combinations_that_differ_by_rounding_have_one_row():
    names = ("a.m + 0.0364793 b.m", "a.m + 0.0364792 b.m", "a.m - 1e-07 wrist_2_link.mx")
    one, two, small = map(rounded_name, names)
    assert one == two == "a.m + 0.0365 b.m"
    assert small == "a.m - 1e-07 wrist_2_link.mx"


def test_a_log_too_short_for_the_filter_has_no_residual_of_another_one():
    mechanism, table = ident.load(ROBOTS / "arm"), pl.read_csv(ROBOTS / "arm" / "run.csv")
    logs = [ident.Log.from_frame(table.head(n), name=f"{n}.csv") for n in (60, 2500)]
    fit = ident.identify(mechanism, ident.complete(mechanism, logs))
    assert [trace.name for trace in fit.residual.traces] == ["2500.csv"]
    for number, lines in ((0, 1), (1, 2)):  # the unfiltered difference, and the filtered one
        below = fit.plot(number).rows[1][0].marks
        assert sum(isinstance(mark, Line) for mark in below) == lines


def test_an_error_that_is_noise_is_no_larger_one_beside_no_change():
    """The second log's noise is larger, and so is its error."""
    mechanism = robot("arm").with_effect("viscous")
    quiet, loud = (
        plant(
            mechanism, motion_log("arm", 100.0, 8.0),
            noise=[Noise("tau", size, relative=True)], seed=seed, spread=0.0, offset=0.0,
        )
        for seed, size in ((1, 0.01), (1, 0.02))
    )  # fmt: skip
    fit = quiet.fit(cutoff="auto")
    c = ident.compare(fit, motion=ident.complete(mechanism, loud.log))
    a = assess_comparison(c, names={name: name for name in c.residuals})
    assert a.verdict == "unchanged"
    assert any(bar.now.rms > 1.5 * bar.before.rms for bar in a.errors)
    assert a.increased == ()
    assert "noise of the sensors" in str(c)
    assert "has structure" not in str(c)


def test_what_changes_from_some_time_on_is_a_change():
    """Friction that doubles halfway: over all blocks that is less than their scatter."""
    scatter = np.random.default_rng(3).uniform(0.5, 1.5, 14)
    before, after = 1e-4 * scatter, np.where(np.arange(14) < 7, 1e-4, 5.0) * scatter
    assert not _exceeds(before, 0.1, 6)
    assert _exceeds(after, 0.1, 6)
    assert not _exceeds(after[::-1], 0.1, 6)  # what has gone by the end is none
