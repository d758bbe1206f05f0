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


# every text that is painted into a canvas since it was cleared, with its box in the canvas
WRITTEN = """
window.written = new Map()
const art = CanvasRenderingContext2D.prototype
const {fillText, clearRect} = art
art.clearRect = function (...area) {
  if (area[2] > 2) written.set(this.canvas, [])
  return clearRect.apply(this, area)
}
art.fillText = function (text, x, y, ...more) {
  const size = this.measureText(text), to = this.getTransform()
  const corners = [-size.actualBoundingBoxLeft, size.actualBoundingBoxRight].flatMap((dx) =>
    [-size.actualBoundingBoxAscent, size.actualBoundingBoxDescent].map((dy) =>
      to.transformPoint(new DOMPoint(x + dx, y + dy))))
  const xs = corners.map((p) => p.x), ys = corners.map((p) => p.y)
  if (!written.has(this.canvas)) written.set(this.canvas, [])
  const drawn = text.trim() && size.width > 0, tilted = to.a * to.b !== 0
  if (drawn) written.get(this.canvas).push(
    [text, Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys), tilted])
  return fillText.call(this, text, x, y, ...more)
}
"""
PAINTED = """() => [...written].filter(([canvas]) => canvas.isConnected && canvas.width > 40)
  .map(([canvas, texts]) => [canvas.width, canvas.height, texts])"""
# words of the page that are cut, or leave it: [what, right edge]; tables scroll in their own boxes
CUT = """() => [...document.querySelectorAll(
    "h1, h2, h3, p, li, dt, dd, caption, figcaption, button, pre, a, summary")]
  .filter((e) => e.offsetParent && !e.closest(".skip") && e.textContent.trim())
  .filter((e) => e.getBoundingClientRect().right > innerWidth + 1 && !e.closest(".wide")
                 || e.scrollWidth > e.clientWidth + 1 && getComputedStyle(e).overflowX === "hidden")
  .map((e) => [e.textContent.slice(0, 40), Math.round(e.getBoundingClientRect().right)])"""


def overlapping(texts):
    """Pairs of texts whose boxes overlap by more than a pixel."""
    return [
        (a[0], b[0])
        for i, a in enumerate(texts)
        for b in texts[:i]
        if not a[5]
        and not b[5]  # tilted names run beside each other, their boxes do not
        and min(a[3], b[3]) - max(a[1], b[1]) > 1
        and min(a[4], b[4]) - max(a[2], b[2]) > 1
    ]


# words of the page that lie on others: [one, the other]; those of a canvas are in WRITTEN
LYING = """() => {
  scrollTo({top: 0, behavior: "instant"}) // where what stays in view covers nothing
  const boxes = [], walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT)
  while (walk.nextNode()) {
    const node = walk.currentNode, range = document.createRange(), on = node.parentElement
    const shown = on.checkVisibility() && !on.closest(".skip, select, #effects")
    if (!node.data.trim() || !shown) continue
    range.selectNodeContents(node)
    for (const {left, top, right, bottom} of range.getClientRects())
      boxes.push([node.data.trim().slice(0, 40), left, top + 3, right, bottom - 3]) // letters alone
  }
  boxes.sort((a, b) => a[2] - b[2])
  return boxes.flatMap((a, i) => {
    const found = []
    for (let j = i + 1; j < boxes.length && boxes[j][2] < a[4] - 1; j++) {
      const b = boxes[j]
      if (Math.min(a[3], b[3]) - Math.max(a[1], b[1]) > 1) found.push([a[0], b[0]])
    }
    return found
  })
}"""
DRAWN = "() => !window.Bokeh || Bokeh.documents.length && Bokeh.documents.every((x) => x.is_idle)"


def assert_legible(page, width):
    """Number of words in a page's charts, none of which lies on others, is cut or leaves it.

    The page had `WRITTEN` from its start.
    """
    for figure in page.locator("figure:visible").all():
        figure.scroll_into_view_if_needed()
    page.wait_for_function(DRAWN)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    for wrong in (CUT, LYING):
        assert not (found := page.evaluate(wrong)), found
    painted = page.evaluate(PAINTED)
    for wide, high, texts in painted:
        assert not (found := overlapping(texts)), found
        outside = [each for each in texts if each[1] < -1 or each[2] < -1
                   or each[3] > wide + 1 or each[4] > high + 1]  # fmt: skip
        assert not outside, (wide, high, outside)
    return sum(len(texts) for *_, texts in painted)
