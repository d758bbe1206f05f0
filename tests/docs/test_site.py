"""The site builds without a warning, has all there is, and needs no network."""

from __future__ import annotations

import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest

import ident
from ident.cli.app import COMMANDS
from ident.effects.effect import NOWHERE

DOCS = Path(__file__).resolve().parents[2] / "docs"


class Page(HTMLParser):
    """Links, ids, what is loaded, and pictures without words."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path, self.links, self.ids, self.loaded, self.mute = path, set(), set(), set(), []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attributes):
        has = dict(attributes)
        self.ids |= {has[key] for key in ("id", "name") if has.get(key)}
        if tag == "a" and has.get("href"):
            self.links.add(has["href"])
        if tag in ("script", "img", "iframe", "source") and has.get("src"):
            self.loaded.add(has["src"])
        if tag == "link" and "stylesheet" in (has.get("rel") or ""):
            self.loaded.add(has["href"])
        if tag == "img" and not has.get("alt"):
            self.mute.append(has.get("src"))


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """Built as a person builds it."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, str(DOCS / "build.py"), str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.fixture(scope="module")
def pages(site) -> dict[Path, Page]:
    return {path: Page(path) for path in site.rglob("*.html")}


def test_links_lead_somewhere(pages):
    for path, page in pages.items():
        for link in page.links:
            if re.match(r"\w+:", link):
                continue
            name, _, anchor = link.partition("#")
            target = (path.parent / unquote(name)).resolve() if name else path
            assert target.exists(), (path.name, link)
            if anchor and target in pages:
                assert unquote(anchor) in pages[target].ids, (path.name, link)


def test_nothing_comes_from_a_network(pages, site):
    for path, page in pages.items():
        outside = [each for each in page.loaded if re.match(r"(https?:)?//", each)]
        assert not outside, (path.name, outside)
    for sheet in site.rglob("*.css"):
        assert not re.search(r"url\(['\"]?(https?:)?//", sheet.read_text(encoding="utf-8"))


def test_pictures_have_words(pages):
    assert not {path.name: page.mute for path, page in pages.items() if page.mute}


def test_every_effect_has_its_picture(pages, site):
    library = pages[site / "generated" / "library.html"]
    for kind in ident.effects:
        assert f"effect-{kind.replace('_', '-')}" in library.ids, kind
        effect = ident.effects[kind]  # a drive has no residual without it, a vehicle no arm's
        shown = effect.candidate_sites != NOWHERE and effect.sits != "frame"
        if shown and not effect.through_drives:
            assert any(Path(each).stem == kind for each in library.loaded), kind


def test_every_command_is_there(pages, site):
    commands = pages[site / "generated" / "commands.html"]
    for name in COMMANDS:
        assert f"command-{name}" in commands.ids, name


def test_every_public_name_is_there(pages, site):
    reference = pages[site / "generated" / "reference.html"]
    for name in ident.__all__:
        assert f"ident.{name}" in reference.ids, name
    for name in ("Fit.predict", "Diagnosis.write", "Mechanism.with_effect", "Log.from_arrays"):
        assert f"ident.{name}" in reference.ids, name


def test_search_finds_words_of_docstrings_and_pages(site):
    index = (site / "searchindex.js").read_text(encoding="utf-8")
    for word in ("stribeck", "multipli", "mechan"):
        assert word in index


def test_no_code_is_cut_on_a_screen_or_a_phone(browser, pages):
    page = browser.new_page(offline=True)
    for path in pages:
        page.goto(path.as_uri())
        for width in (1400, 400):
            page.set_viewport_size({"width": width, "height": 900})
            cut, wide = page.evaluate("""() => [[...document.querySelectorAll("article pre")]
                .filter((e) => e.scrollWidth > e.clientWidth + 1).map((e) => e.textContent),
                document.documentElement.scrollWidth]""")
            assert not cut, (path.name, width, cut)
            assert wide <= width, (path.name, width)
    page.close()
