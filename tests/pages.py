"""Reports read as a person's browser reads them."""

import json
import re

from lxml import html

LOADING = ("src", "href", "data", "action", "poster", "srcset", "formaction", "background")


def read_page(path):
    """A report's tree, of which nothing is loaded from elsewhere, nor run but its own script."""
    text = path.read_text(encoding="utf-8")
    page = html.document_fromstring(text)
    loads = [
        value
        for element in page.iter()
        if isinstance(element.tag, str)
        for key, value in element.attrib.items()
        if key.rsplit("}")[-1] in LOADING
    ]
    assert not [value for value in loads if not value.startswith("#")], loads
    for style in page.iter("style"):
        assert "@import" not in style.text
        assert not re.search(r"url\(", style.text)
    for element in page.iter():
        handlers = [key for key in element.attrib if key.lower().startswith("on")]
        assert not handlers, handlers
    scripts = [each for each in page.iter("script") if not each.get("type")]
    # the page's own, and those that draw charts and scenes
    assert len(scripts) in (1, 3, 4, 5)
    for each in page.iter("script"):
        if each.get("type") == "application/json":
            json.loads(each.text)
    return page


def reading(page):
    """What a person reads, one space between words."""
    body = page.find("body")
    shown = [text for text in body.itertext(with_tail=True)]
    for script in body.iter("script"):
        shown = [text for text in shown if text != script.text]
    return re.sub(r"\s+", " ", " ".join(shown).replace("\u00a0", " "))


def titles(page):
    """Of the sections."""
    return [each.text for each in page.iter("h2")]


def charts(page):
    """What the charts show, in words, in the page's order."""
    return [figure.find("figcaption").text for figure in page.iter("figure")]
