"""The page in a real browser, drawn in software; the server, its port, and its end."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from moving import view_of

import ident
from ident.show.bodies import BODIES, ENDS
from ident.show.view import LONGEST, MAP, SHADES, _ramp, distance_of

STRICT = 6.0  # [deg] of hue, within which an arrow is blue and a blue body is not


@pytest.fixture(scope="module")
def five_bar(robots):
    mechanism = ident.load(robots / "five_bar")
    log = ident.read_log(robots / "five_bar" / "run.csv")
    first = {name: x[:501] for name, x in log.columns.items()}
    return mechanism, ident.complete(
        mechanism, ident.Log.from_arrays("two seconds", log.t[:501], first)
    )


def test_a_page_shows_the_moment_that_is_asked_for_without_a_network(five_bar, look, tmp_path):
    mechanism, motion = five_bar
    e = motion.experiments[0]
    forces = np.tile([8.0, 0.0, 0.0], (len(e.t), 1))
    view = view_of(mechanism, e.t, e.q, forces)
    path = view.write(tmp_path / "five_bar.html")
    k = int(np.argmin(np.abs(e.t - 1.0)))
    tip = tip_of(mechanism, e.q[k])
    length = LONGEST * view.size

    def there(seen) -> bool:
        """Both arrows point from the tip, where a pinhole camera sees it."""
        return all(
            len(seen.like(colour, STRICT)) > 50
            and np.linalg.norm(
                np.median(seen.like(colour, STRICT), axis=0)
                - pixel(view.camera, seen.drawing, tip + length * np.array([0.6 * sign, 0, 0]))
            )
            < 25
            for colour, sign in zip(ENDS, (1, -1), strict=True)
        )

    def seek(page) -> None:
        page.get_by_text("What colours and lengths mean").click()
        page.locator("input").first.fill("1.0")
        page.evaluate("scrollTo({top: 0, behavior: 'instant'})")

    seen = look(path.as_uri(), there, seek)
    assert seen.faults == []
    assert seen.fetched <= {"file", "data", "blob"}
    assert there(seen)
    for colour in BODIES[:4]:
        assert seen.near(colour) > 150, colour
    assert "reaction forces λ, up to 8 N" in seen.words


def tip_of(mechanism: ident.Mechanism, q: np.ndarray) -> np.ndarray:
    """Where Pinocchio has the tip of the left arm (3,) [m]."""
    model = pin.buildModelFromUrdf(str(mechanism.urdf))
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return data.oMf[model.getFrameId("left_distal")].act(np.array([0.28, 0.0, 0.006]))


def pixel(camera, drawing, point) -> np.ndarray:
    """Where a pinhole camera with 35° from top to bottom sees a point, x and y."""
    x0, y0, width, height = drawing
    away, target, _, outline = camera
    distance = distance_of(outline, width / height)
    position = target + distance * away
    right = np.cross([0.0, 0.0, 1.0], away)
    right /= np.linalg.norm(right)
    from_camera = point - position
    scale = height / 2 / np.tan(np.radians(35.0 / 2)) / -(from_camera @ away)
    across, upward = from_camera @ right, from_camera @ np.cross(away, right)
    return np.array([x0 + width / 2 + scale * across, y0 + height / 2 - scale * upward])


def test_a_mechanism_alone_stands_still(robots, look, tmp_path):
    path = ident.load(robots / "arm").view().write(tmp_path / "arm.html")
    seen = look(path.as_uri(), lambda seen: seen.near(BODIES[1]) > 150)
    assert seen.faults == []
    assert seen.near(BODIES[1]) > 150


def test_a_cursor_over_a_chart_moves_the_machine_and_the_other_charts(five_bar, browser, tmp_path):
    mechanism, motion = five_bar
    path = tmp_path / "view.html"
    ident.identify(mechanism, motion, estimator="least-squares").view().write(path)
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.goto(path.as_uri())
    chart = page.locator("figure.chart").first
    page.wait_for_function("() => ranges.size > 0 && documents.every((each) => each.is_idle)")
    cursor = """() => [...documents[0]._all_models.values()]
        .filter((m) => m.type === 'Span' && m.dimension === 'height').map((m) => m.location)"""
    page.locator("figure.scene input").fill("0.5")
    assert set(page.evaluate(cursor)) == {0.5}
    box = chart.bounding_box()
    for x in (0.7, 0.71):
        page.mouse.move(box["x"] + x * box["width"], box["y"] + 150)
    page.wait_for_function("() => document.querySelector('figure.scene input').value > 1")
    at = float(page.locator("figure.scene input").input_value())
    assert page.evaluate(cursor) == [pytest.approx(at)] * 4
    page.wait_for_function(
        "x => Math.abs(parseFloat(document.querySelector('figure.scene span').textContent) - x)"
        " < 0.01", arg=at,
    )  # fmt: skip
    page.close()


def test_the_mark_of_the_guilty_joint_has_the_colour_of_its_residual(five_bar, browser, tmp_path):
    mechanism, motion = five_bar
    path = tmp_path / "view.html"
    view = ident.identify(mechanism, motion, estimator="least-squares").view()
    view.write(path)
    (joint,) = view.marks
    page = browser.new_page(viewport={"width": 900, "height": 900})
    page.add_init_script("""window.marks = []
        const {arc} = CanvasRenderingContext2D.prototype
        CanvasRenderingContext2D.prototype.arc = function (...all) {
          arc.apply(this, all)
          this.round = true
        }
        const {fill} = CanvasRenderingContext2D.prototype
        CanvasRenderingContext2D.prototype.fill = function () {
          fill.apply(this)
          if (this.round) marks.push(this.fillStyle)
          this.round = false
        }""")
    page.goto(path.as_uri())
    share = view.films[0].misfit[joint]
    for k in (int(np.nanargmin(share)), int(np.nanargmax(share))):
        page.locator("figure.scene input").fill(str(view.films[0].t[k]))
        level = round(min(share[k] / view.largest_misfit, 1.0) * (SHADES - 1))
        colour = "#" + "".join(f"{x:02x}" for x in _ramp(SHADES)[level])
        page.wait_for_function("colour => marks.at(-1) === colour", arg=colour)
    page.close()


@pytest.mark.parametrize("width", [400, 1400])
def test_a_label_lies_on_no_body_and_the_machine_fills_its_frame(robots, browser, tmp_path, width):
    mechanism = ident.load(robots / "arm")
    path = tmp_path / "view.html"
    replace(mechanism.view(), marks={"elbow": "load_friction:elbow or hysteresis"}).write(path)
    page = browser.new_page(viewport={"width": width, "height": 900})
    page.add_init_script("""window.points = [], window.words = []
        const art = CanvasRenderingContext2D.prototype, {lineTo, fillText} = art
        art.lineTo = function (x, y) { points.push([x, y]); return lineTo.call(this, x, y) }
        art.fillText = function (text, x, y, ...more) {
          words.push([x, y - 12, x + this.measureText(text).width, y + 3])
          return fillText.call(this, text, x, y, ...more)
        }""")
    page.goto(path.as_uri())
    page.wait_for_function("() => words.length > 0")
    x, y = np.array(page.evaluate("points.slice(0, -1)")).T  # the last is the label's own line
    left, top, right, bottom = page.evaluate("words.at(-1)")
    assert not ((x > left) & (x < right) & (y > top) & (y < bottom)).any()
    box = page.locator("figure.scene canvas").bounding_box()
    assert max(np.ptp(x) / box["width"], np.ptp(y) / box["height"]) > 0.7
    assert 0 <= x.min() < x.max() <= box["width"]
    page.close()


def test_the_page_is_served(five_bar, look):
    with five_bar[1].view().serve() as page:
        seen = look(page.address, lambda seen: seen.near(BODIES[2]) > 150)
    assert seen.faults == []
    assert seen.fetched <= {"http", "data", "blob"}
    assert seen.near(BODIES[2]) > 150


def test_it_is_served_on_this_machine_alone(five_bar):
    with five_bar[1].view().serve() as page:
        assert urllib.request.urlopen(page.address, timeout=10).status == 200
        table = Path("/proc/net/tcp")
        if not table.exists():
            pytest.skip("only Linux tells which addresses are listened on")
        rows = [line.split() for line in table.read_text().splitlines()[1:]]
        listening = [row[1] for row in rows if row[3] == "0A"]
        ours = [each for each in listening if each.endswith(f":{page.port:04X}")]
        assert ours == [f"0100007F:{page.port:04X}"]
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", page.port)) != 0
    assert "ended" in repr(page)


def test_a_notebook_gets_a_frame_with_the_page(five_bar):
    shown = five_bar[0].view()._repr_html_()
    assert shown.startswith("<iframe srcdoc=")
    assert shown.count('"') == shown.split("srcdoc=")[0].count('"') + 6  # nothing leaks out
    assert "five_bar in 3-D" in shown


def test_written_whole_or_not_at_all(five_bar, tmp_path, monkeypatch):
    view = five_bar[0].view()
    with pytest.raises(ident.IdentError, match=r"valid: .html"):
        view.write(tmp_path / "view.png")
    (tmp_path / "file").touch()
    with pytest.raises(ident.IdentError, match="name a folder"):
        view.write(tmp_path / "file" / "view.html")
    assert [each.name for each in tmp_path.iterdir()] == ["file"]


def test_the_command_writes_a_page(spoken, robots, tmp_path):
    out = tmp_path / "view.html"
    status, said, err = spoken("view", robots / "four_bar", "--out", out)
    assert (status, err) == (0, "")
    assert f"{out}: 1 moment;" in said
    log = robots / "five_bar" / "run.csv"  # of all logs together
    _, said, _ = spoken("view", robots / "five_bar", log, log, "--out", out)
    assert 150 < int(said.removeprefix(f"{out}: ").split()[0]) <= 1000


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--out", "view.png"), "valid: .html, .htm"),
        (("--fit", "fit.json"), "give a LOG too"),
        (("--port", "70000"), "valid: 1 to 65535"),
    ],
)
def test_the_command_refuses(spoken, robots, words, expected):
    status, said, err = spoken("view", robots / "four_bar", *words)
    assert status == 1
    assert said == ""
    assert err.startswith("error: ")
    assert expected in err
    assert len(err.splitlines()) == 1


def test_the_command_serves_until_it_is_interrupted(root, robots):
    command = [sys.executable, "-m", "ident", "view", str(robots / "four_bar")]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=root,
        env={**os.environ, "PYTHONPATH": str(root / "src")},
        # a runner in the background ignores the signal, and its children with it
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as run:  # fmt: skip
        address = run.stdout.readline().split()[0]
        assert urllib.request.urlopen(address, timeout=10).status == 200
        time.sleep(0.2)
        run.send_signal(signal.SIGINT)
        rest, err = run.communicate(timeout=120)
    assert run.returncode == 0
    assert rest == ""
    assert err == ""


def test_the_colours_are_those_of_matplotlib():
    colormaps = pytest.importorskip("matplotlib").colormaps
    for shades in (9, SHADES):
        expected = 255 * colormaps["plasma"](np.linspace(0.0, 1.0, shades))[:, :3]
        assert np.array(_ramp(shades)) == pytest.approx(expected, abs=0.51)
    assert len(set(MAP)) == SHADES
