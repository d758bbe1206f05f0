"""The report of a long log: what it costs to write and to open.

python benchmarks/report.py [SAMPLES]      default: 100000 of a seven-joint arm with friction

Opens it in Chromium, if playwright and /usr/bin/chromium are there, and zooms as a person would.
"""

import sys
import tempfile
import time
from pathlib import Path

import arm7

import ident
from ident.show.fit import report_html

ZOOM = """async () => {
    const range = ranges.get(figures.find(f => ranges.has(f))).range
    const frame = () => new Promise(done => requestAnimationFrame(done))
    const whole = [range.start, range.end], times = []
    for (let i = 1; i <= 40; i++) {
        const before = performance.now()
        range.setv({start: whole[0] + i * (whole[1] - whole[0]) / 90, end: whole[1] - i})
        await frame(); await frame()
        times.push(performance.now() - before)
    }
    times.sort((a, b) => a - b)
    return [times[20], times[38]]
}"""


def main() -> None:
    samples = int(sys.argv[1]) if len(sys.argv) > 1 else 100_000
    mechanism = arm7.mechanism()
    log = arm7.log(mechanism, samples, 0.02)
    start = time.process_time()
    fit = ident.identify(mechanism, ident.complete(mechanism, log))
    fitted = time.process_time() - start
    with tempfile.TemporaryDirectory() as folder:
        start = time.process_time()
        path = Path(folder) / "report.html"
        path.write_bytes(report_html(fit))
        written = time.process_time() - start
        print(f"{samples} samples, 7 joints: log to fit {fitted:.1f} s, report {written:.1f} s")
        print(f"report.html: {path.stat().st_size / 1e6:.1f} MB")
        opened(path)


def opened(path: Path) -> None:
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        sys.exit("playwright is not installed: not opened")
    with sync_playwright() as started:
        browser = started.chromium.launch(
            executable_path="/usr/bin/chromium", args=["--no-sandbox", "--disable-gpu"]
        )
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        start = time.perf_counter()
        page.goto(path.as_uri())
        page.wait_for_function("() => typeof ranges !== 'undefined' && ranges.size > 0")
        print(f"opened, first chart drawn: {time.perf_counter() - start:.1f} s")
        half, worst = page.evaluate(ZOOM)
        print(f"zoomed 40 times: {half:.0f} ms a step, 95 % within {worst:.0f} ms")
        browser.close()


if __name__ == "__main__":
    main()
