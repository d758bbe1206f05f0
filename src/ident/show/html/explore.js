"use strict"
// Draws the state that the server sends, whole and then by changes; names are text, never markup.
const state = {}
const $ = (id) => document.getElementById(id)
const make = (tag, attributes = {}, ...children) => {
  const made = document.createElement(tag)
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value)
  made.append(...children)
  return made
}
const button = (label, act, attributes = {}) => {
  const made = make("button", {type: "button", ...attributes}, label)
  made.addEventListener("click", act)
  return made
}
const socket = new WebSocket(location.href.replace(/^http/, "ws"))
const send = (message) => { if (socket.readyState === 1) socket.send(JSON.stringify(message)) }
const change = (message) => { if (!state.busy) { unfloat(); over = ""; send(message); effects() } }
let over = "", drawn = null // the effect that is previewed, and what is drawn of it
let floats = false // whether it is that under the pointer or with the focus, beside the list
const place = make("div", {class: "place", "aria-live": "polite"}) // below its line
function preview(label) { // a second click ends it
  if (state.busy || state.stale) return // candidates of another model
  const pinned = floats && over === label
  if (pinned) { floats = false; place.remove() } else unfloat()
  over = !pinned && label === over ? "" : label
  send({do: "preview", label: over})
  effects()
  previewed()
}
function float(label) { // nothing on the page moves
  if (state.busy || state.stale || (over && !floats)) return
  floats = true
  over = label
  send({do: "preview", label})
  document.body.append(place)
  previewed()
}
function unfloat() {
  if (!floats) return
  floats = false
  over = ""
  place.remove()
  send({do: "preview", label: ""})
}
const previewed = () => {
  const wanted = over && state.preview?.label === over ? state.preview.shown : null
  if (wanted && wanted !== drawn) drawPieces(wanted, place)
  if (!wanted) place.textContent = "computing …"
  drawn = wanted
}
const look = (what) => send({do: "look", view: state.view, joint: state.joint, ...what})
const busy = () => ({"aria-disabled": String(state.busy)}) // not `disabled`, which loses the focus
let listed = ""
const MOST = 4 // places of a kind whose falls are written on its line

const previewer = (label, title) => {
  const made = button("preview", () => preview(label), {"aria-label": `preview ${title}`,
    "aria-pressed": String(label === over && !floats), "data-key": `preview ${label}`, ...busy()})
  made.addEventListener("pointerenter", (event) => { if (event.pointerType === "mouse") float(label) })
  made.addEventListener("focus", () => { if (made.matches(":focus-visible")) float(label) })
  for (const end of ["pointerleave", "blur"]) made.addEventListener(end, unfloat)
  return made
}

function effects() {
  const focus = document.activeElement?.dataset.key, focused = focus?.replace(/^(preview|refuse) /, ""), list = $("effects")
  const wanted = $("filter").value.trim().toLowerCase()
  const rows = state.effects.filter((x) => `${x.label} ${x.about}`.toLowerCase().includes(wanted))
  const groups = []
  let lines, together // of a group, and of several of one kind: one line, with its parts on unfolding
  for (const x of rows) {
    if (x.group !== groups.at(-1)?.dataset.name) {
      const own = rows.filter((y) => y.group === x.group), held = own.some((y) => y.label === focused)
      lines = make("ul", {})
      groups.push(make("li", {class: "group", "data-name": x.group}, folding(x.group, `${x.group} (${own.length})`,
        wanted || held || state.open.includes(x.group) !== toggled.has(x.group), lines)))
    }
    const alike = rows.filter((y) => y.group === x.group && y.set === x.set && !y.present && !y.offered && y.sure)
    const several = alike.length > 1 && alike.includes(x)
    if (several && alike[0] !== x) continue
    if (several) {
      const labels = alike.map((y) => y.label).join("\n"), key = `all ${x.set}`
      const judged = x.set === x.mark // what a diagnosis names together, of one kind or of several
      const apart = judged || new Set(alike.map((y) => y.joint)).size === alike.length // else one would do for another
      const title = judged ? `${x.mark}: ${alike.length} effects` : `${x.plain} in ${apart ? "" : "one of "}${alike.length} places`
      together = make("ul", {})
      const first = x === rows.find((y) => !y.present && !y.offered) // unfolded: one effect is added before all
      const parts = folding(key, title,
        first !== toggled.has(key) || alike.some((y) => y.label === focused), together)
      const all = !apart ? [] : [button(`add all ${alike.length}`, () => change({do: "add", label: labels}),
        {"aria-label": `add ${title}`, "data-key": key, ...busy()}), " ", previewer(labels, title)]
      const best = alike.slice(0, MOST).map((y) => `${judged ? y.label : y.label.split(":").slice(1).join(":")}: ${y.fall}`)
      const where = [...best, ...(alike.length > MOST ? [`${alike.length - MOST} more`] : [])]
      lines.append(make("li", {class: "sure several"}, parts, make("div", {class: "about"}, ...where.map((each) => make("div", {}, each))), ...all))
      if (labels === over && !floats) lines.lastChild.append(place)
    }
    for (const y of several ? alike : [x]) (several ? together : lines).append(row(y, several && y.set !== y.mark && y !== alike[0]))
  }
  list.replaceChildren(...groups)
  finish(list, rows, wanted, focus)
}

const toggled = new Set() // keys of what is not as it is at first
function folding(key, title, open, ...inside) {
  const head = make("summary", {}, title)
  head.addEventListener("click", () => toggled.has(key) ? toggled.delete(key) : toggled.add(key))
  return make("details", open ? {open: ""} : {}, head, ...inside)
}
function row(x, likewise = false) { // likewise: the row above, of the same kind, says what it is
  const verb = x.present ? "remove" : "add", kind = x.present ? "present" : x.sure ? "sure" : ""
  const name = make("span", {class: "name"}, x.label)
  if (x.mark) name.append(" ", make("em", {}, x.mark))
  const act = (word, does) => button(word, () => change({do: does, label: x.label}),
    {"aria-label": `${word} ${x.label}`, "data-key": (does === "refuse" ? "refuse " : "") + x.label, ...busy()})
  const buttons = x.offered ? [act("accept", "add"), act("refuse", "refuse")] : [act(verb, verb)]
  if (!x.present) buttons.push(previewer(x.label, x.label))
  const line = make("li", {class: kind}, make("span", {class: "do"}, ...buttons),
    name, make("span", {class: "fall"}, x.fall),
    make("span", {class: "bar", style: `--share: ${100 * x.share}%`, "aria-hidden": "true"}))
  for (const part of likewise ? ["why"] : ["about", "why"]) if (x[part]) line.append(make("span", {class: part}, x[part]))
  if (x.label === over && !floats) line.append(place)
  return line
}

function finish(list, rows, wanted, focused) { // what stays as it was when the list is drawn again
  list.classList.toggle("stale", state.stale)
  const present = rows.filter((x) => x.present).map((x) => x.label).join()
  if (present !== listed) list.scrollTop = 0 // what has just changed is at the top
  listed = present
  $("note").textContent = wanted ? `${rows.length} of ${state.effects.length} effects` : state.note
  const again = [...list.querySelectorAll("button")].find((each) => each.dataset.key === focused)
  if (focused) again?.focus({preventScroll: true})
}

function ladder() {
  const [head, ...rungs] = state.ladder
  if (!head) return
  const lines = rungs.map(([name, ...cells], i) => {
    const now = i === rungs.length - 1, label = `back to rung ${i}: ${name}`
    const first = now ? name : button(name, () => change({do: "back", rung: i}), {"aria-label": label, ...busy()})
    return make("tr", now ? {"aria-current": "true"} : {}, make("th", {scope: "row"}, first),
                ...cells.map((cell, j) => make("td", {"data-head": head[j + 1]}, cell)))
  })
  const top = make("tr", {}, ...head.map((cell) => make("th", {scope: "col"}, cell.replaceAll("_", "_\u200b"))))
  $("ladder").replaceChildren(make("table", {}, make("thead", {}, top), make("tbody", {}, ...lines)))
  $("ladder").scrollTop = $("ladder").scrollHeight
}

const draw = { // by key of the state
  title() { $("status").querySelector("h1").textContent = document.title = state.title },
  status() {
    const {kind, text, share} = state.status, line = $("status").querySelector("p")
    $("status").className = `status ${kind}`
    $("status").style.setProperty("--share", `${100 * share}%`)
    line.setAttribute("aria-busy", String(kind === "busy"))
    if (line.textContent !== text) line.textContent = text
  },
  card() { $("card").innerHTML = state.card }, // escaped by the server
  folder() { $("folder").textContent = state.folder.split(/[\\/]/).pop(); $("folder").title = state.folder },
  views() { views() }, view() { views() }, open: effects, effects, stale: effects, note: effects, ladder, preview: previewed,
  shown() { drawPieces(state.shown, $("shown")) },
  joints() { $("joint").replaceChildren(...state.joints.map((name) => make("option", {}, name))) },
  joint() { $("joint").value = state.joint },
  undo() { $("undo").disabled = state.busy || !state.undo },
  busy() {
    $("judge").disabled = $("save").disabled = state.busy
    draw.undo()
    for (const each of document.querySelectorAll("#effects button, #ladder button")) {
      each.setAttribute("aria-disabled", String(state.busy))
    }
  },
}
function views() {
  $("views").replaceChildren(...state.views.map((view) => button(
    view, () => look({view}), {"aria-pressed": String(view === state.view)})))
}

socket.addEventListener("message", (event) => {
  const changes = JSON.parse(event.data)
  Object.assign(state, changes)
  for (const each of new Set(Object.keys(changes).map((key) => draw[key]))) each()
})
socket.addEventListener("close", () => {
  Object.assign(state, {busy: true, status: {kind: "bad", share: 0, text: "The command has ended; start it again."}})
  draw.busy()
  draw.status()
})
$("filter").addEventListener("input", effects)
$("joint").addEventListener("change", () => look({joint: $("joint").value}))
$("undo").addEventListener("click", () => change({do: "undo"}))
$("judge").addEventListener("click", () => change({do: "judge"}))
$("save").addEventListener("click", () => change({do: "save", name: $("name").value}))
