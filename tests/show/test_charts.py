"""Charts: thinned without losing a peak, drawn still and live, saved whole or not at all."""

import json
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from ident.errors import IdentError
from ident.show.charts import RESIDUAL, ROLES, SERIES, Chart, Dots, Level, Line, Panel, Points

T = np.linspace(0.0, 10.0, 50_001)
AT = np.arange(3.0)
EVERY = Panel(
    (
        Line(T, np.sin(T), "line"),
        Points(T, np.cos(T), "points", 1),
        Dots(AT, AT, 0.1 * AT, "dots", 3),
        Level(0.5),
        Level(0.5, upright=True, dashed=True, colour=RESIDUAL),
    ),
    "x [m]",
    "y <b>[N]</b>",
    title="</script><script>alert(1)</script>",
    marked=True,
)
CHART = Chart("Every mark, </script> too", ((EVERY, EVERY), (EVERY,)))


def test_extremes_keep_every_peak():
    y = np.sin(T)
    y[[7, 40_000]] = 5.0, -7.0
    thin = Line(T, y).thinned(100)
    assert len(thin.y) == len(thin.x) == 200
    assert (thin.y.max(), thin.y.min()) == (5.0, -7.0)
    assert (np.diff(thin.x) >= 0).all()


def test_a_gap_stays_a_gap():
    y = np.ones_like(T)
    y[20_000:30_000] = np.nan
    thin = Line(T, y).thinned(100)
    assert np.isnan(thin.y[(thin.x > 4.2) & (thin.x < 5.8)]).all()
    assert (thin.y[thin.x < 3.8] == 1).all()


def test_short_lines_stay_as_they_are():
    line = Line(T[:150], T[:150])
    assert line.thinned(100) is line


def test_every_mark_is_drawn_still_and_live():
    assert isinstance(CHART.figure, Figure)
    assert len(CHART.axes) == 4  # the last of them empty
    assert CHART._repr_png_().startswith(b"\x89PNG")
    rows = json.loads(CHART.data())["rows"]
    assert [len(row) for row in rows] == [2, 1]


def test_words_cannot_leave_their_place():
    page = CHART.html()
    assert "</script><script>alert" not in page
    assert CHART.words in page.replace("&lt;", "<").replace("&gt;", ">")


@pytest.mark.parametrize("kind", ["png", "svg", "pdf", "html"])
def test_saving(kind, tmp_path):
    CHART.save(tmp_path / f"x.{kind}")
    assert (tmp_path / f"x.{kind}").stat().st_size > 1000
    assert len(list(tmp_path.iterdir())) == 1


def test_another_suffix_is_refused(tmp_path):
    with pytest.raises(IdentError, match=r"\.png, \.svg, \.pdf or \.html"):
        CHART.save(tmp_path / "x.bmp")
    assert not list(tmp_path.iterdir())


def test_names_of_rows_run_downwards():
    names = ("first", "second", "third")
    panel = replace(EVERY, marks=(Dots(AT, AT, 0 * AT),), y_names=names)
    (axis,) = Chart("rows", ((panel,),)).axes
    assert [label.get_text() for label in axis.get_yticklabels()] == list(names)
    low, high = axis.get_ylim()
    assert low > high


def luminance(c):
    x = np.array([int(c[i : i + 2], 16) / 255 for i in (1, 3, 5)])
    x = np.where(x <= 0.03928, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)
    return float(x @ [0.2126, 0.7152, 0.0722])


@pytest.mark.parametrize("colour", [*SERIES, ROLES["residual"], ROLES["measured"]])
@pytest.mark.parametrize("paper", ["#ffffff", "#14171c"])
def test_colours_are_legible_on_both_papers(colour, paper):
    """WCAG 2.1, 1.4.11: 3 to 1 for what is not text."""
    light, dark = sorted((luminance(colour), luminance(paper)), reverse=True)
    assert (light + 0.05) / (dark + 0.05) >= 3.0


def test_an_array_goes_into_the_page_once():
    panel = Panel((Line(T, np.sin(T)), Line(T.copy(), np.cos(T))))
    arrays = json.loads(Chart("", ((panel,), (panel,))).data())["arrays"]
    assert len(arrays) == 3


def test_frequent_gaps_leave_the_line_and_its_peaks():
    y = np.sin(T)
    y[::90] = np.nan
    y[12_345] = 7.0
    thin = Line(T, y).thinned(100)
    assert np.isfinite(thin.y).all()
    assert thin.y.max() == 7.0
    assert (thin.x[0], thin.x[-1]) == (T[0], T[-1])


def opened(browser, chart, tmp_path):
    """The page of a chart, drawn, and what its console complained of."""
    chart.save(tmp_path / "x.html")
    page, wrong = browser.new_page(), []
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("console", lambda m: wrong.append(m.text) if m.type in ("error", "warning") else 0)
    page.goto((tmp_path / "x.html").as_uri())
    page.wait_for_function("() => Bokeh.documents.length && Bokeh.documents[0].is_idle")
    return page, wrong


MODELS = "(kind) => [...Bokeh.documents[0]._all_models.values()].filter(m => m.type === kind)"


def test_bokeh_draws_every_mark_and_complains_of_nothing(browser, tmp_path):
    nan = Panel((Level(float("nan")), Line(T[:9], T[:9])), logarithmic=True)
    for chart in (CHART, replace(CHART, shared_x=True, shared_y=True), Chart("nan", ((nan,),))):
        page, wrong = opened(browser, chart, tmp_path)
        assert page.evaluate(f"({MODELS})('Figure').length") == len(chart.panels)
        assert not wrong
        page.close()


def test_names_of_a_later_panel_are_in_the_legend(browser, tmp_path):
    first = Panel((Line(T[:9], T[:9], "measured"),))
    second = Panel((Line(T[:9], T[:9], "measured"), Line(T[:9], T[:9], "coulomb", 3)))
    page, wrong = opened(browser, Chart("", ((first,), (second,)), shared_x=True), tmp_path)
    names = page.get_by_role("button", pressed=True)
    assert names.all_text_contents() == ["measured", "coulomb"]
    names.nth(1).click()
    assert page.get_by_role("button", pressed=False).all_text_contents() == ["coulomb"]
    lines = f"({MODELS})('GlyphRenderer').filter(r => r.name === 'coulomb')"
    assert page.evaluate(f"{lines}.map(r => r.visible)") == [False]
    assert not wrong
    page.close()


def test_signs_of_mathematics_are_signs(browser, tmp_path):
    name = r"$$\foo$$ and $x_1$"
    panel = Panel((Line(T[:9], T[:9], name),), name, name, name, (name,), (name,))
    chart = Chart(name, ((panel,),))
    assert chart._repr_png_().startswith(b"\x89PNG")
    page, wrong = opened(browser, chart, tmp_path)
    texts = f"({MODELS})('PlainText').map(m => m.text)"
    assert page.evaluate(texts).count(name) >= 3
    assert not wrong
    page.close()


def test_the_end_of_a_long_name_is_shown(browser, tmp_path):
    """Joints of one robot differ in it."""
    names = [f"j2s6s200_joint_{i}" for i in (1, 2)] + ["averyverylongnameofajoint7"]
    rows = tuple((Panel((Line(T[:9], T[:9]),), "t [s]", f"{name} [N m]"),) for name in names)
    page, wrong = opened(browser, Chart("", rows, shared_x=True), tmp_path)
    axes = page.evaluate(f"({MODELS})('LinearAxis').map(axis => axis.axis_label?.text ?? '')")
    shown = [each for each in axes if "[N m]" in each]
    assert [each.split("\n")[-2][-2:] for each in shown] == ["_1", "_2", "t7"]
    assert not wrong
    page.close()


@pytest.mark.parametrize(
    ("low", "high"), [(0.1, 1000.0), (21.0, 48.0), (0.0206, 0.0288), (3.0, 3.0)]
)
def test_a_logarithmic_axis_has_two_numbers(browser, tmp_path, low, high):
    line = Line(np.arange(3.0), np.array([low, high, low]), dotted=True)
    chart = Chart("", ((Panel((line,), logarithmic=True),),))
    page, wrong = opened(browser, chart, tmp_path)
    ticks = page.evaluate(f"({MODELS})('FixedTicker')[0].ticks")
    start, end = page.evaluate(
        f"({MODELS})('Figure').map(f => [f.y_range.start, f.y_range.end])[0]"
    )
    assert 1 < sum(start <= x <= end for x in ticks) < 14
    assert not wrong
    page.close()


def test_dashed_levels_are_in_view(browser, tmp_path):
    line = Line(np.arange(3.0), np.array([30.0, 20.0, 10.0]), dotted=True)
    panel = Panel((line, Level(0.2, dashed=True)), logarithmic=True, x_names=("a", "b", "c"))
    page, wrong = opened(browser, Chart("", ((panel,),)), tmp_path)
    ends = page.evaluate(f"({MODELS})('Figure').map(f => [f.y_range.start, f.y_range.end])[0]")
    assert 0.1 < ends[0] < 0.2
    assert ends[1] > 30
    assert not wrong
    page.close()
