"""Makes pictures anew: the README's, the report of a diagnosis as a browser shows it, and charts.

    python docs/pictures/make.py

The machine is the one of `ident demo --seed 1`; charts are of the robots that are shipped. Needs
playwright and chromium.
"""

from __future__ import annotations

import io
import os
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

import ident
from ident.cli.demo import make_puzzle
from ident.show.charts import Chart
from ident.show.laws import plot_curve
from ident.simulate.replay import replay

PICTURE = Path(__file__).resolve().with_name("diagnosis.png")
ROBOTS = PICTURE.parents[2] / "robots"
SEED = 1
WIDTH = 1280  # px
COLOURS = 96
CHROMIUM = os.environ.get("CHROMIUM", "/usr/bin/chromium")
OFFLINE = (
    "--no-sandbox", "--disable-gpu", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--no-first-run",
)  # fmt: skip
LESS = "#where-it-fails, nav { display: none } body { grid-template-columns: 1fr }"


def main() -> None:
    """Diagnose, show, photograph."""
    with tempfile.TemporaryDirectory() as folder:
        report = diagnosed(Path(folder))
        with sync_playwright() as p:
            browser = p.chromium.launch(executable_path=CHROMIUM, args=list(OFFLINE))
            page = browser.new_page(viewport={"width": WIDTH, "height": 900}, color_scheme="light")
            page.goto(report.as_uri())
            png = shot(page)
            browser.close()
    picture = Image.open(io.BytesIO(png)).convert("RGB")
    save(picture, PICTURE)
    for name, chart in {"law": law(), "motion": motion()}.items():
        still = Image.open(io.BytesIO(chart.image("png"))).convert("RGB")
        save(still, PICTURE.with_name(f"{name}.png"))


def save(picture: Image.Image, path: Path) -> None:
    """Write a picture of few colours."""
    few = picture.quantize(COLOURS, dither=Image.Dither.NONE)
    few.save(path, optimize=True)
    print(f"{path.name}: {picture.width} × {picture.height}, {path.stat().st_size} bytes")


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
    puzzle = make_puzzle(folder / "picker", seed=SEED)
    mechanism = puzzle.mechanism
    fit = ident.identify(mechanism, ident.complete(mechanism, puzzle.log))
    ident.diagnose(fit).write(folder / "diagnosis")
    return folder / "diagnosis" / "report.html"


def shot(page: Page) -> bytes:
    """From the title to the residual's maps before and after."""
    page.add_style_tag(content=LESS)
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
