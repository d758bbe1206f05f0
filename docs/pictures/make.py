"""Makes pictures anew: the report of a diagnosis and the page of `ident monitor` as a browser shows
them, and charts.

    python docs/pictures/make.py [moving]

The machine is the one of `ident demo --seed 1`; charts are of the robots that are shipped. Needs
playwright and chromium.
"""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

import ident
from ident.cli.demo import make_puzzle
from ident.show.charts import Chart
from ident.show.laws import plot_curve
from ident.simulate.replay import replay

PICTURE = Path(__file__).resolve().with_name("diagnosis.png")
ROBOTS = PICTURE.parents[2] / "robots"
SEED = 1
WIDTH = 1280  # px
COLOURS = 256
CHROMIUM = os.environ.get("CHROMIUM", "/usr/bin/chromium")
OFFLINE = (
    "--no-sandbox", "--disable-gpu", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--no-first-run",
)  # fmt: skip
PERIODS, REPEATED = 10.0, 5  # s of whole periods of the shipped log, and how often it is repeated
FRICTION, CHANGED, NOISE = 0.3, 20.0, 0.015  # N m in the elbow, s from which on; of the torques
FRAMES = 15  # pictures a second of the moving one
LESS = "#where-it-fails, .scene, .tools { display: none !important }"


def main() -> None:
    """Diagnose, show, photograph; with the word `moving` only the moving picture."""
    if sys.argv[1:] == ["moving"]:
        with tempfile.TemporaryDirectory() as folder, sync_playwright() as p:
            moving(p.chromium.launch(executable_path=CHROMIUM, args=list(OFFLINE)), Path(folder))
        return
    with tempfile.TemporaryDirectory() as folder:
        report = diagnosed(Path(folder))
        with sync_playwright() as p:
            browser = p.chromium.launch(executable_path=CHROMIUM, args=list(OFFLINE))
            page = browser.new_page(viewport={"width": WIDTH, "height": 3000}, color_scheme="light")
            page.goto(report.as_uri())
            png = shot(page)
            moving(browser, Path(folder))
            watched = monitored(browser, Path(folder))
            browser.close()
    picture = Image.open(io.BytesIO(png)).convert("RGB")
    save(picture, PICTURE)
    save(Image.open(io.BytesIO(watched)).convert("RGB"), PICTURE.with_name("monitor.png"))
    for name, chart in {"law": law(), "motion": motion()}.items():
        still = Image.open(io.BytesIO(chart.image("png"))).convert("RGB")
        save(still, PICTURE.with_name(f"{name}.png"))


def save(picture: Image.Image, path: Path) -> None:
    """Write a picture of few colours."""
    few = picture.quantize(COLOURS, dither=Image.Dither.NONE)
    few.save(path, optimize=True)
    print(f"{path.name}: {picture.width} × {picture.height}, {path.stat().st_size} bytes")


def moving(browser: Browser, folder: Path) -> None:
    """The first screen of a grown model of the arm, whose machine moves with the model's ghosts."""
    mechanism = ident.load(ROBOTS / "arm")
    with contextlib.chdir(folder):
        ident.grow(mechanism, ident.complete(mechanism, ROBOTS / "arm" / "run.csv")).write("grown")
    page = browser.new_page(
        viewport={"width": 1400, "height": 900}, color_scheme="light", reduced_motion="reduce"
    )
    page.goto((folder / "grown" / "report.html").as_uri())
    page.wait_for_timeout(3000)  # charts are drawn
    slider = page.locator("figure.scene input")
    first, last = page.evaluate(
        "[...document.querySelectorAll('script[id^=data-]')]"
        ".map(e => JSON.parse(e.textContent).stretch).find(Array.isArray).slice(1, 3)"
    )
    annotated(page)
    pictures = []
    for moment in np.arange(first, last, 1 / FRAMES):
        slider.fill(str(moment))
        slider.dispatch_event("input")
        slider.evaluate("e => e.blur()")  # no frame around it
        page.wait_for_timeout(60)
        picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
        pictures.append(picture.resize((1050, 675), Image.Resampling.LANCZOS))
    path, between = PICTURE.with_name("moving.webp"), round(1000 / FRAMES)
    pictures[0].save(
        path, save_all=True, append_images=pictures[1:], duration=between, loop=0, quality=60,
        method=4,
    )  # fmt: skip
    print(f"{path.name}: {len(pictures)} pictures, {path.stat().st_size} bytes")
    page.close()


PARTS = {  # of a report's first screen, in the order of docs/report.md; not all have all of them
    "header .line": 1, "table.errors": 2, ".next": 3, ".front figure.chart >> nth=0": 4,
    ".front figure.chart >> nth=1": 5, "figure.scene": 6,
}  # fmt: skip
NUMBER = (
    "position:absolute;width:30px;height:30px;border-radius:15px;background:#d63384;color:white;"
    "font:600 17px/30px sans-serif;text-align:center;z-index:9"
)


def annotated(page: Page) -> None:
    """The first screen with a number at each of its parts."""
    for place, number in PARTS.items():
        part = page.locator(place)
        if not part.count() or not (box := part.first.bounding_box()):
            continue
        left, top = max(box["x"] - 34, 2), box["y"]
        page.evaluate(
            "([style, text]) => { const e = document.createElement('div'); e.className = 'number';"
            " e.style = style; e.textContent = text; document.body.append(e) }",
            [f"{NUMBER};left:{left}px;top:{top}px", str(number)],
        )
    save(Image.open(io.BytesIO(page.screenshot())).convert("RGB"), PICTURE.with_name("report.png"))
    page.evaluate("document.querySelectorAll('.number').forEach((e) => e.remove())")


def law() -> Chart:
    """The curve of a magnet at the elbow of the arm, and its formula."""
    mechanism = ident.load(ROBOTS / "arm").with_effect("viscous").with_effect("coulomb")
    log = ident.read_log(ROBOTS / "arm" / "run.csv")
    magnet = 0.86 / (1 + ((log.columns["q.elbow"] - 0.9) / 0.39) ** 2)
    columns = log.columns | {"tau.elbow": log.columns["tau.elbow"] + magnet}
    odd = ident.Log.from_arrays("odd.csv", log.t, columns)
    d = ident.diagnose(ident.identify(mechanism, ident.complete(mechanism, odd)))
    return plot_curve(d.curves[0], d.laws[0])


def motion() -> Chart:
    """The simulated motion of the four-bar against the measured one."""
    mechanism = ident.load(ROBOTS / "four_bar").with_effect("viscous").with_effect("coulomb")
    measured = ident.complete(mechanism, ROBOTS / "four_bar" / "run.csv")
    return replay(ident.identify(mechanism, measured), motion=measured).plot()


def diagnosed(folder: Path) -> Path:
    """The report of a diagnosis of a machine that hides something."""
    with contextlib.chdir(folder):  # the command in it names no folder of this machine
        puzzle = make_puzzle(Path("picker"), seed=SEED)
        mechanism = puzzle.mechanism
        fit = ident.identify(mechanism, ident.complete(mechanism, puzzle.log))
        ident.diagnose(fit).write("diagnosis")
    return folder / "diagnosis" / "report.html"


def monitored(browser: Browser, folder: Path) -> bytes:
    """The page of a monitor of the arm, whose elbow has more dry friction from 20 s on."""
    log, random = ident.read_log(ROBOTS / "arm" / "run.csv"), np.random.default_rng(SEED)
    t = np.concatenate([log.t + i * PERIODS for i in range(REPEATED)])
    for name, more in {"normal.csv": 0.0, "today.csv": FRICTION}.items():
        columns = {x: np.tile(values, REPEATED) for x, values in log.columns.items()}
        speed = np.gradient(columns["q.elbow"], t)
        columns["tau.elbow"] = columns["tau.elbow"] + more * np.sign(speed) * (t > CHANGED)
        for x in filter(lambda x: x.startswith("tau."), columns):
            columns[x] = columns[x] + NOISE * np.std(columns[x]) * random.standard_normal(len(t))
        ident.Log.from_arrays(name, t, columns).write(folder / name)
    shutil.copytree(ROBOTS / "arm", folder / "arm")  # the page names it as the command does
    friction = ("--with", "viscous", "--with", "coulomb", "--like", "normal.csv")
    command = ("monitor", "arm", "today.csv", *friction, "--page")
    running = subprocess.Popen(
        (sys.executable, "-u", "-m", "ident", *command), cwd=folder, stdout=subprocess.PIPE,
        text=True,
    )  # fmt: skip
    assert running.stdout is not None
    address = next(x for x in running.stdout if "http://" in x).split()[-1]
    page = browser.new_page(viewport={"width": WIDTH, "height": 1000}, color_scheme="light")
    page.goto(address)
    page.get_by_text("1 alarm").first.wait_for()
    page.wait_for_timeout(5000)  # charts are drawn
    png = page.screenshot()
    running.send_signal(signal.SIGINT)
    running.wait()
    return png


def shot(page: Page) -> bytes:
    """From the title to the residual's maps before and after."""
    page.add_style_tag(content=LESS)
    page.locator("#what-is-missing > summary").click()
    page.wait_for_timeout(3000)  # charts are drawn
    bottom = page.evaluate(
        "[...document.querySelectorAll('#what-is-missing figcaption')]"
        ".find(e => e.textContent.includes('against time')).getBoundingClientRect().bottom"
        " + window.scrollY"
    )
    clip = {"x": 0, "y": 0, "width": WIDTH, "height": round(bottom) + 24}
    return page.screenshot(full_page=True, clip=clip)


if __name__ == "__main__":
    main()
