"""Reports opened in a real browser: drawn, zoomed, clicked, in both colours, without a network."""

from __future__ import annotations

import io
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import ident
from helpers import ROBOTS
from ident.cli.app import main
from ident.show.card import Card
from ident.show.charts import MEASURED, Chart, Level, Line, Panel
from ident.show.html import Section, code, report_page
from identification import motion_log, plant, robot
from pages import DRAWN, PAINTED, WRITTEN, assert_legible, overlapping, titles

N = 100_000
REPORTS = (
    "diagnosed", "fitted", "compared", "grew", "monitored", "studied", "viewed", "charted",
)  # fmt: skip


@pytest.fixture
def opened(browser):
    """`opened(path, scheme, width, unfold)`: the page, with all its charts drawn or, not unfolded,
    the first ones, and what its console complained of or fetched.
    """
    contexts = []

    def open_(path, scheme="light", width=1280, unfold=True):
        context = browser.new_context(
            viewport={"width": width, "height": 900}, color_scheme=scheme, offline=True
        )
        contexts.append(context)
        page, wrong = context.new_page(), []
        page.add_init_script(WRITTEN)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("console", lambda m: wrong.append(m.text) if m.type in ("error", "warning") else 0)
        page.on("request", lambda r: None if r.url.startswith(("file:", "data:", "blob:"))
                else wrong.append(r.url))  # fmt: skip
        page.goto(path.as_uri())
        for button in page.get_by_role("button", name="Unfold all").all() if unfold else ():
            button.click()
        page.wait_for_function(DRAWN)
        return page, wrong

    yield open_
    for context in contexts:
        context.close()


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory):
    mechanism = robot("four_bar")
    case = plant(mechanism.with_effect("viscous:crank"), motion_log("four_bar", 100.0), seed=1)
    motion = ident.complete(mechanism, case.log)
    fit = ident.identify(mechanism, motion, estimator="least-squares")
    folder = tmp_path_factory.mktemp("diagnosed")
    found = ident.diagnose(fit)
    found.write(folder)
    return found, folder / "report.html"


@pytest.fixture(scope="module")
def fitted(diagnosed, tmp_path_factory):
    folder = tmp_path_factory.mktemp("fitted")
    diagnosed[0].fit.write(folder)
    return folder / "report.html"


@pytest.fixture(scope="module")
def compared(diagnosed, tmp_path_factory):
    found = diagnosed[0]
    folder = tmp_path_factory.mktemp("compared")
    ident.compare(found.fit, found.candidates[0].fit).write(folder)
    return folder / "report.html"


@pytest.fixture(scope="module")
def grew(tmp_path_factory):
    folder = tmp_path_factory.mktemp("grew")
    case = plant(robot("arm").with_effect("viscous"), motion_log("arm", 100.0, 8.0), seed=2)
    ident.grow(robot("arm"), ident.complete(robot("arm"), case.log)).write(folder)
    return folder / "report.html"


@pytest.fixture(scope="module")
def monitored(tmp_path_factory):
    folder = tmp_path_factory.mktemp("monitored")
    with pytest.MonkeyPatch.context() as words:
        command = "ident", "monitor", ROBOTS / "arm", ROBOTS / "arm" / "run.csv", "--out", folder
        words.setattr(sys, "argv", [*map(str, command), "--with", "viscous"])
        with pytest.raises(SystemExit):
            main()
    return folder / "report.html"


@pytest.fixture(scope="module")
def studied(tmp_path_factory):
    pendulum = ident.load(ROBOTS / "pendulum")
    folder = tmp_path_factory.mktemp("studied")
    log = ident.read_log(ROBOTS / "pendulum" / "run.csv")
    ident.monte_carlo(pendulum, log, snr=(60.0, 40.0), runs=2, jobs=1).write(folder)
    return folder / "report.html"


@pytest.fixture(scope="module")
def viewed(diagnosed, tmp_path_factory):
    model = diagnosed[0].fit
    return model.motion.view().write(tmp_path_factory.mktemp("viewed") / "v.html")


@pytest.fixture(scope="module")
def charted(tmp_path_factory):
    """A chart alone, in the layout of a planned motion."""
    t, titles = np.linspace(0, 10, 200), ("position", "speed", "acceleration", "torque")
    rows = [
        tuple(Panel((Line(t, k * np.sin(t)),), "t [s]", f"elbow_{k} [rad/s²]", name)
              for name in (titles if k == 1 else ("",) * 4))
        for k in (1, 20, 300)
    ]  # fmt: skip
    path = tmp_path_factory.mktemp("charted") / "chart.html"
    Chart("a planned motion", tuple(rows), shared_x=True).save(path)
    return path


def drawn(figure):
    """Whether marks are in a figure's picture: axes and words are grey, series have a colour."""
    figure.scroll_into_view_if_needed()
    canvas = figure.locator("canvas").first
    canvas.wait_for()
    png = io.BytesIO(canvas.screenshot())
    rgb = np.asarray(Image.open(png).convert("RGB")).astype(int)
    return int((np.ptp(rgb, axis=-1) > 40).sum()) > 20


def test_the_pictures_are_there_nothing_complains_and_a_screen_reader_finds_all(opened, diagnosed):
    page, wrong = opened(diagnosed[1])
    figures = page.locator("figure.chart:visible")
    assert figures.count() >= 5
    for i in range(figures.count()):
        assert drawn(figures.nth(i))
    assert not wrong
    assert page.get_by_role("main").count() == 1
    assert page.get_by_role("heading", level=2).count() == page.locator("main > details").count()
    labels = "[...document.querySelectorAll('figure.chart')].map((e) => e.ariaLabel ?? '')"
    for label in page.evaluate(labels):
        assert re.search(r"\w+ \w+", label)
    tables = """[...document.querySelectorAll("table")].map((e) =>
        [e.querySelectorAll("caption").length, e.querySelectorAll("th[scope=col]").length])"""
    for captions, heads in page.evaluate(tables):
        assert captions == 1
        assert heads > 0
    assert page.evaluate("document.documentElement.lang") == "en"
    unnamed = "() => [...document.querySelectorAll('button')].filter(b => !b.textContent.trim())"
    assert page.evaluate(f"({unnamed})().filter(b => !b.closest('.canvas')).length") == 0


@pytest.mark.parametrize("width", [1400, 400])
@pytest.mark.parametrize("report", REPORTS)
def test_no_label_overlaps_or_is_cut(opened, report, width, request):
    path = request.getfixturevalue(report)
    path = path if isinstance(path, Path) else path[1]
    page, wrong = opened(path, "light" if width > 400 else "dark", width)
    assert assert_legible(page, width) > 20 or report == "viewed"
    assert not wrong


def test_a_click_on_a_candidate_shows_its_residual(opened, diagnosed):
    found, path = diagnosed
    page, wrong = opened(path)
    group = page.get_by_role("group", name="Which candidate")
    buttons = group.get_by_role("button")
    refitted = [each for each in found.candidates if each.fit is not None]
    assert buttons.count() == min(len(refitted), 8) > 1
    second = refitted[1].effect.label
    heading = page.get_by_role("heading", name=f"With {second}", exact=True)
    assert not heading.is_visible()
    buttons.nth(1).focus()
    page.keyboard.press("Enter")  # as with the mouse
    heading.wait_for()
    assert buttons.nth(1).get_attribute("aria-pressed") == "true"
    assert buttons.nth(0).get_attribute("aria-pressed") == "false"
    shown = page.locator(".option:visible").filter(has=heading).locator("figure.chart")
    assert "as it is and with" in (shown.first.locator("figcaption").text_content() or "")
    assert drawn(shown.first)
    assert not wrong


def start(page, number):
    """Where the x axis of a chart begins, as its script knows it."""
    return page.evaluate(
        "n => { const f = document.querySelector(`figure[data-chart='${n}']`);"
        " const r = ranges.get(f).range; return [r.start, r.end] }", number
    )  # fmt: skip


def test_keys_and_buttons_zoom_all_charts_of_time(opened, diagnosed):
    page, wrong = opened(diagnosed[1])
    timed = page.locator("figure.chart[data-clock]:visible")
    first = timed.first
    first.scroll_into_view_if_needed()
    number = first.get_attribute("data-chart")
    page.wait_for_function("n => ranges.has(document.querySelector(`figure[data-chart='${n}']`))",
                           arg=number)  # fmt: skip
    whole = start(page, number)
    first.focus()
    page.keyboard.press("+")
    nearer = start(page, number)
    assert nearer[1] - nearer[0] == pytest.approx((whole[1] - whole[0]) / 2)
    first.get_by_role("button", name="To the right").click()
    assert start(page, number)[0] > nearer[0]
    moved = start(page, number)
    last = timed.last  # out of view: it follows when it comes into it
    last.scroll_into_view_if_needed()
    other = last.get_attribute("data-chart")
    assert other != number
    page.wait_for_function(
        "([n, x]) => { const known = ranges.get(document.querySelector("
        "`figure[data-chart='${n}']`)); return known && known.range.start === x }",
        arg=[other, moved[0]],
    )
    first.scroll_into_view_if_needed()
    page.keyboard.press("Tab")
    first.focus()
    page.keyboard.press("0")
    assert start(page, number) == whole
    assert not wrong


def test_commands_are_broken_between_words(opened, tmp_path):
    words = "ident identify robots/four_bar robots/four_bar/run.csv --with viscous --with coulomb "
    words += (
        "--with torque_offset:a_joint --separate coulomb:a_joint viscous:a_joint --out next.csv"
    )
    path = tmp_path / "report.html"
    top = Card("x", f"Beside it: `{words}`.", command=words)
    path.write_bytes(report_page("x", top, (Section("y", (code(words),)),)))
    page, _ = opened(path, width=320)
    lines = """(e) => [...e.querySelectorAll("span")].map((x) => x.getClientRects().length &&
        x.getBoundingClientRect().height < 1.9 * parseFloat(getComputedStyle(x).fontSize))"""
    for place in page.locator("pre, p code").all():
        whole = place.evaluate(lines)
        assert len(whole) > 10
        assert all(whole)
        assert (
            place.evaluate(
                "(e) => { getSelection().selectAllChildren(e); return getSelection().toString() }"
            ).strip()
            == words
        )  # what is copied


def test_light_and_dark_and_print(opened, diagnosed):
    papers = []
    for scheme in ("light", "dark"):
        page, _ = opened(diagnosed[1], scheme, unfold=False)
        papers.append(page.evaluate("getComputedStyle(document.body).backgroundColor"))
    assert papers[0] == "rgb(255, 255, 255)"
    assert papers[1] != papers[0]
    page.emulate_media(media="print")
    assert not page.get_by_role("button", name="Unfold all").is_visible()
    assert page.locator("h1").is_visible()
    heads = (
        "[...document.querySelectorAll('summary, h3')].map((e) => getComputedStyle(e).breakAfter)"
    )
    assert {*page.evaluate(heads)} == {"avoid"}  # none is the last line of a page


def test_a_folded_report_prints_all_charts_as_wide_as_paper(browser, diagnosed):
    page = browser.new_page(viewport={"width": 1400, "height": 900}, color_scheme="dark")
    page.goto(diagnosed[1].as_uri())
    page.evaluate("""() => addEventListener("beforeprint", () => { // after the page's own
      const scene = document.querySelector(".scene canvas")
      const {data} = scene.getContext("2d").getImageData(0, 0, scene.width, scene.height)
      const dark = [20, 23, 28, 255]
      const is = (_, i) => i % 4 === 0 && dark.every((x, j) => data[i + j] === x)
      window.halo = data.filter(is).length
      window.paper = figures.filter(visible).map((f) => {
        const part = f.querySelector(f.matches(".scene") ? "canvas" : "svg.picture")
        const marks = part instanceof SVGElement ? part.querySelectorAll("path").length
          : new Set(part.getContext("2d").getImageData(0, 0, part.width, part.height).data).size
        return [part.getBoundingClientRect().width, marks]
      })})""")
    page.pdf(print_background=True)
    printed = page.evaluate("paper")
    assert len(printed) > 5
    assert page.evaluate("halo") < 10  # pixels of the dark page, #14171c
    assert all(600 < width < 700 and marks > 10 for width, marks in printed), printed
    assert not page.locator("svg.picture").count()
    assert page.locator("main figure.chart:visible").first.bounding_box()["width"] > 1200
    page.close()


@pytest.mark.parametrize("width", [1400, 400])
def test_the_rest_of_a_report_is_folded(browser, diagnosed, width):
    page = browser.new_page(viewport={"width": width, "height": 900}, offline=True)
    page.goto(diagnosed[1].as_uri())
    folded = page.locator("main > details")
    assert folded.count() > 8
    unfold = page.get_by_role("button", name="Unfold all").bounding_box()
    assert unfold["y"] < folded.first.bounding_box()["y"]
    assert not page.locator("main figure:visible, main p:visible:not(.tools)").count()
    front = page.locator(".front figure:visible")
    assert front.count() == 2
    if width > 1000:  # all of it is on the first screen, beside the first lines
        assert all(front.nth(i).bounding_box()["y"] < 600 for i in range(2))
    assert page.evaluate("document.body.scrollHeight") < 3 * 900
    page.get_by_text("What is missing", exact=True).click()
    page.locator("figure.chart:visible").first.scroll_into_view_if_needed()
    page.locator("figure.chart[data-drawn] canvas").first.wait_for()
    page.close()


def test_a_hundred_thousand_samples_keep_every_peak(opened, tmp_path):
    """One sample sticks out: it is seen from afar, and alone when one comes close."""
    t = np.linspace(0, 100, N)
    rng = np.random.default_rng(0)
    rows = []
    for joint in range(7):
        y = np.sin((joint + 1) * t) + 0.1 * rng.normal(size=N)
        y[61_803] = 9.0
        lines = (Line(t, y, "measured", MEASURED), Line(t, np.sin((joint + 1) * t), "predicted"))
        rows.append((Panel(lines, "t [s]", f"joint {joint} [N m]"),))
    chart = Chart("Seven joints", tuple(rows), shared_x=True, clock="long")
    path = tmp_path / "long.html"
    path.write_bytes(report_page("Long", "100,000 samples", (Section("Time", (chart,)),)))
    page, wrong = opened(path)
    page.wait_for_function("() => ranges.size === 1")
    seen = """() => { const d = documents[0]; return [...d._all_models.values()]
        .filter(m => m.type === 'ColumnDataSource' && m.data.y?.length > 1)
        .map(m => [m.data.y.length, Math.max(...m.data.y)]) }"""
    lengths, tops = zip(*page.evaluate(seen), strict=True)
    assert max(lengths) <= 4100
    assert max(tops) == 9.0
    page.evaluate("""async () => {
        const frame = () => new Promise(done => requestAnimationFrame(done))
        ranges.get(figures[0]).range.setv({start: 60, end: 64})
        await frame(); await frame()
    }""")
    lengths, tops = zip(*page.evaluate(seen), strict=True)
    assert max(lengths) <= 4100
    assert tops.count(9.0) == 7
    assert not wrong


def test_words_beside_a_mark_at_the_edge_are_whole(opened, tmp_path):
    x = np.arange(9.0)
    marks = (Line(x, x, "formulas", 0), Level(8.0, upright=True, label="chosen"))
    path = tmp_path / "report.html"
    path.write_bytes(
        report_page("front", "", (Section("x", (Chart("a front", ((Panel(marks),),)),)),))
    )
    page, _ = opened(path, width=400)
    page.wait_for_function(DRAWN)
    found = [(text, wide) for wide, _, texts in page.evaluate(PAINTED) for text in texts]
    (text, wide), *_ = ((text, wide) for text, wide in found if text[0] == "chosen")
    assert text[3] <= wide


def test_long_names_leave_room_for_a_chart(opened, tmp_path):
    names = tuple(f"coulomb:shoulder_lift_joint_of_the_second_robot_{i}" for i in range(5))
    x = np.arange(5.0)
    panel = Panel((Line(x, x, "error", 0),), "held-out error [%]", y_names=names)
    path = tmp_path / "report.html"
    path.write_bytes(report_page("names", "", (Section("x", (Chart("bars", ((panel,),)),)),)))
    page, _ = opened(path, width=400)
    page.wait_for_function(DRAWN)
    for wide, _, texts in page.evaluate(PAINTED):
        assert not overlapping(texts)
        assert all(text[1] > -1 and text[3] < wide + 1 for text in texts), texts
    painted = [text[0] for _, _, texts in page.evaluate(PAINTED) for text in texts]
    assert any(text.endswith("robot_0") for text in painted)


def test_titles_are_in_the_order_of_reading(diagnosed):
    from pages import read_page

    found = titles(read_page(diagnosed[1]))
    assert found[0] == "Where it fails"
    assert found[-1] == "How to reproduce"


PROBE = """async () => {
  const refused = [];
  document.addEventListener("securitypolicyviolation", e => refused.push(e.effectiveDirective));
  for (const address of ["http://127.0.0.1:9/", "data:,x"]) {
    try { await fetch(address); refused.push("answered"); } catch (error) { }
  }
  for (const kind of [WebSocket, EventSource]) {
    try { new kind("http://127.0.0.1:9/"); } catch (error) { }
  }
  navigator.sendBeacon("http://127.0.0.1:9/", "x");
  for (const tag of ["img", "script", "iframe", "link"]) {
    const element = document.createElement(tag);
    element.rel = "stylesheet";
    element[tag == "link" ? "href" : "src"] = "http://127.0.0.1:9/";
    document.body.append(element);
  }
  await new Promise(resolve => setTimeout(resolve, 500));
  return refused;
}"""


def test_a_report_connects_to_nothing_whatever_runs_in_it(diagnosed, opened):
    page, wrong = opened(diagnosed[1], unfold=False)
    assert not wrong
    refused = page.evaluate(PROBE)
    assert "answered" not in refused
    assert {"connect-src", "img-src", "script-src-elem", "frame-src", "style-src-elem"} <= set(
        refused
    )
    assert refused.count("connect-src") >= 5
