"""Makes the README's picture anew: the report of a diagnosis, as a browser shows it.

    python docs/pictures/make.py

The machine is the one of `ident demo --seed 1`. Needs playwright and chromium.
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

PICTURE = Path(__file__).resolve().with_name("diagnosis.png")
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
    few = picture.quantize(COLOURS, dither=Image.Dither.NONE)
    few.save(PICTURE, optimize=True)
    print(f"{PICTURE.name}: {picture.width} × {picture.height}, {PICTURE.stat().st_size} bytes")


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
