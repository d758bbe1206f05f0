"""Builds the site: python docs/build.py [FOLDER]. Warnings are errors; no network is needed."""

import sys
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.util.console import nocolor

from ident.show.progress import terminal_bar

HERE = Path(__file__).resolve().parent


def main(site: Path) -> int:
    """Build the site into a folder; a bar in a terminal names each page. Return the exit status."""
    nocolor()
    with terminal_bar() as (_, progress):
        progress("making reference pages", 0.0)
        app = Sphinx(HERE, HERE, site, site / ".doctrees", "html", status=None,
                     warningiserror=True)  # fmt: skip
        done = {"reading": 0, "writing": 0}

        def report(what: str, page: str, start: float) -> None:
            done[what] += 1
            pages = max(len(app.env.found_docs), 1)
            progress(f"{what} {page}", start + 0.45 * min(done[what] / pages, 1.0))

        app.connect("source-read", lambda _, page, __: report("reading", page, 0.1))
        app.connect("html-page-context", lambda _, page, *__: report("writing", page, 0.55))
        app.build()
    if app.statuscode == 0:
        print(f"the site begins at {site / 'index.html'}")
    return app.statuscode


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE.parent / "site"))
