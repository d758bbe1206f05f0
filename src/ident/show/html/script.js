"use strict"
// Charts are drawn when they come into view, move together along time, and listen to keys.
const figures = [...document.querySelectorAll("figure.chart, figure.scene")]
const ranges = new Map() // of figures whose panels share one x axis
const documents = []
const seen = new Set() // figures in view or nearly so
let moving = false
const spans = new Map() // of time, by clock, that all charts of it show

const shade = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim()

function paint(drawn, ink = shade("--soft")) {
  for (const model of drawn._all_models.values()) {
    if ("major_label_text_color" in model) {
      model.setv({major_label_text_color: ink, axis_label_text_color: ink, axis_line_color: ink,
                  major_tick_line_color: ink, minor_tick_line_color: ink})
    } else if ("label_text_color" in model) model.setv({label_text_color: ink})
  }
}

const clock = (figure) => figure.dataset.clock, logOf = (figure) => figure.dataset.log

function follow(figure) { // those out of view follow when they come into it
  const known = ranges.get(figure), span = spans.get(clock(figure))
  if (!known || !span || !clock(figure)) return
  moving = true
  known.range.setv(span)
  moving = false
}

function together(figure, range) {
  ranges.set(figure, {range, whole: [range.start, range.end]})
  if (!clock(figure)) return
  follow(figure)
  const tell = () => {
    if (moving) return
    spans.set(clock(figure), {start: range.start, end: range.end})
    for (const other of seen) if (other !== figure && clock(other) === clock(figure)) follow(other)
  }
  range.properties.start.change.connect(tell)
  range.properties.end.change.connect(tell)
}

const cursors = new Map() // of charts and scenes of a log: what shows a moment of it
function point(log, x, from) { // the same moment in all charts and scenes of a log
  for (const [figure, show] of cursors) if (figure !== from && figure.offsetParent !== null) show(log, x)
}

async function draw(figure) {
  if (figure.dataset.drawn) return
  figure.dataset.drawn = "yes"
  const number = figure.dataset.chart, place = document.getElementById(`chart-${number}`)
  const content = JSON.parse(document.getElementById(`data-${number}`).textContent)
  if (figure.classList.contains("scene")) {
    cursors.set(figure, drawScene(content, place, (log, x) => point(log, x, figure)))
    return
  }
  const log = logOf(figure)
  const {document: drawn, range, cursor} = await drawChart(content, place, log ? (x) => point(log, x) : null)
  documents.push(drawn)
  paint(drawn)
  if (range) together(figure, range)
  if (log) cursors.set(figure, (of, x) => { if (of === log) cursor(x) })
}

function move(figure, how) {
  const known = ranges.get(figure)
  if (!known) return
  const {range, whole} = known
  const middle = (range.start + range.end) / 2, half = (range.end - range.start) / 2
  const at = {
    nearer: [middle - half / 2, middle + half / 2], farther: [middle - 2 * half, middle + 2 * half],
    earlier: [range.start - half / 2, range.end - half / 2],
    later: [range.start + half / 2, range.end + half / 2], all: whole,
  }[how]
  range.setv({start: at[0], end: at[1]})
}

const KEYS = {"+": "nearer", "=": "nearer", "-": "farther", ArrowLeft: "earlier",
              ArrowRight: "later", "0": "all"}
for (const figure of figures) {
  for (const button of figure.querySelectorAll("button[data-do]")) {
    button.addEventListener("click", () => move(figure, button.dataset.do))
  }
  figure.addEventListener("keydown", (event) => {
    if (event.target !== figure || !(event.key in KEYS) || event.ctrlKey || event.metaKey || event.altKey) return
    event.preventDefault()
    move(figure, KEYS[event.key])
  })
}

const visible = (figure) => figure.offsetParent !== null
for (const choice of document.querySelectorAll(".choice")) {
  const buttons = [...choice.querySelectorAll(":scope > .buttons > button")]
  for (const button of buttons) {
    button.addEventListener("click", () => {
      for (const other of buttons) {
        other.setAttribute("aria-pressed", String(other === button))
        document.getElementById(other.getAttribute("aria-controls")).hidden = other !== button
      }
      const shown = document.getElementById(button.getAttribute("aria-controls"))
      shown.querySelectorAll("figure").forEach((figure) => { if (visible(figure)) draw(figure) })
    })
  }
}

const near = new IntersectionObserver((entries) => {
  for (const {isIntersecting, target} of entries) {
    if (!isIntersecting) { seen.delete(target); continue }
    seen.add(target)
    if (visible(target)) draw(target)
    follow(target)
  }
}, {rootMargin: "400px"})
figures.forEach((figure) => near.observe(figure))
const unfold = (which) => {
  document.querySelectorAll(which).forEach((each) => { each.open = true })
  figures.filter(visible).forEach(draw)
}
const places = [...document.querySelectorAll(".canvas")]
addEventListener("beforeprint", () => {
  places.forEach((place) => { place.style.width = "680px" }) // what paper has
  unfold("details")
})
addEventListener("beforeprint", () => { // when the promises of the first are kept; no frame comes, so pictures stand in
  documents.forEach((drawn) => paint(drawn, "#404040"))
  for (const view of window.Bokeh?.index.roots ?? []) {
    if (!view.compute_layout || !view.el.offsetParent) continue
    view.after_resize()
    view.compute_layout()
    const picture = view.export("svg").canvas
    picture.classList.add("picture")
    view.el.after(picture)
    view.el.style.display = "none"
  }
})
addEventListener("afterprint", () => {
  document.querySelectorAll(".picture").forEach((each) => each.remove())
  places.forEach((place) => { place.style.width = "" })
  for (const view of window.Bokeh?.index.roots ?? []) view.el.style.display = ""
  documents.forEach((drawn) => paint(drawn))
})
document.getElementById("unfold")?.addEventListener("click", () => unfold("main > details"))
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => documents.forEach((drawn) => paint(drawn)))
