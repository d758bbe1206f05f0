// Draws charts, given as the data of ident.show.charts.live, by BokehJS's API.
function unpacked(text) { // an array of ident.show.charts.Arrays
  const bytes = Uint8Array.from(atob(text.slice(3)), (c) => c.charCodeAt(0))
  const kind = {"<f4": Float32Array, "<f8": Float64Array, "<i4": Int32Array}[text.slice(0, 3)]
  return new kind(bytes.buffer)
}

function drawChart(chart, place, pointed = null) { // pointed(x): the pointer is over that x
  const {Plotting, Range1d, DataRange1d, PlainText, ColumnDataSource} = Bokeh, GREY = "#767c86"
  Bokeh.logger.set_level("warn") // the console stays empty
  const POINTS = 1000 // buckets of a line in view
  const longest = Math.max(0, ...chart.rows.flat().map((panel) => panel?.title?.length ?? 0))
  const NARROW = Math.max(165, 75 + 7 * longest) // pixels, below which no panel gets: its title is whole
  const numbers = chart.arrays.map(unpacked), cursors = [] // one a panel: a line at a moment
  const columns = (data) => ({ // a source, and each property of a glyph from the column of its name
    source: new ColumnDataSource({data}),
    ...Object.fromEntries(Object.keys(data).map((name) => [name, {field: name}]))})
  const plain = (text) => new PlainText({text: text ?? ""}) // never read as mathematics
  const width = place.clientWidth || 1000, most = Math.max(1, Math.floor(width / NARROW))
  const pieces = (row) => row.length > most ? [row.slice(0, most), ...pieces(row.slice(most))] : [row]
  const rows = chart.rows.flatMap(pieces) // on a narrow page panels stand below each other
  const labelled = new Map() // a mark and all renderers by their label in the legend
  const long = [] // lines that are drawn by the extremes of the samples in view

  // smallest and largest value of each bucket of the samples between two places: no peak is lost
  function extremes(x, y, low, high) {
    const first = (value) => {
      let i = 0, j = x.length
      while (i < j) { const k = (i + j) >> 1; if (x[k] < value) i = k + 1; else j = k }
      return i
    }
    const i = Math.max(0, first(low) - 1), j = Math.min(x.length, first(high) + 1)
    const step = Math.max(1, Math.ceil((j - i) / POINTS)), xs = [], ys = []
    for (let a = i; a < j; a += step) {
      const end = Math.min(a + step, j)
      if (step === 1) { xs.push(x[a]); ys.push(y[a]); continue }
      let least = Infinity, most = -Infinity
      for (let b = a; b < end; b++) { // a gap compares as false
        if (y[b] < least) least = y[b]
        if (y[b] > most) most = y[b]
      }
      xs.push(x[a], x[end - 1])
      if (most >= least) ys.push(least, most); else ys.push(NaN, NaN)
    }
    return {x: xs, y: ys}
  }

  const ends = () => {
    let low = Infinity, high = -Infinity
    for (const panel of chart.rows.flat()) for (const {x} of panel.marks) {
      for (const value of x === undefined ? [] : numbers[x]) {
        if (value < low) low = value
        if (value > high) high = value
      }
    }
    if (!(high >= low)) return {start: 0, end: 1}
    return {start: low, end: high > low ? high : low + 1}
  }
  const shared = chart.shared_x ? new Range1d(ends()) : null

  const glyphs = { // each draws a mark into a figure and returns the renderers it consists of
    Line(fig, m, {x, y}) {
      const data = columns({x, y})
      const line = fig.line({...data, line_color: m.colour, line_width: m.width})
      return m.dotted ? [line, dots(fig, data, m, 6)] : [line]
    },
    Points: (fig, m, {x, y}) => [dots(fig, columns({x, y}), m, 3, 0.45)],
    Dots: (fig, m, {at, values, errors}) => [
      m.upright ? fig.scatter({...columns({x: values, y: at}), marker: "dash", angle: Math.PI / 2, size: 14, line_color: m.colour, line_width: 2.5})
        : dots(fig, columns({x: values, y: at}), m, 7), whiskers(fig, at, values, errors, m.colour)],
  }
  const dots = (fig, data, m, size, fill_alpha = 1) => fig.scatter(
    {...data, size, line_color: null, fill_color: m.colour, fill_alpha})
  const whiskers = (fig, at, values, errors, line_color) => fig.segment({
    ...columns({x0: values.map((v, i) => v - errors[i]), x1: values.map((v, i) => v + errors[i]),
                y0: at, y1: at}), line_color, line_width: 1.5})

  const inView = (m) => m.kind === "Level" && m.dashed && !m.upright && m.value !== null

  function level(fig, m) {
    if (m.value === null) return
    if (inView(m)) fig.scatter({x: [ends().start], y: [m.value], size: 0}).visible = false
    const style = {line_color: m.colour, line_dash: m.dashed ? "dashed" : "solid"}
    fig.add_layout(new Bokeh.Span({location: m.value, dimension: m.upright ? "height" : "width", ...style}))
    const {start, end} = ends(), late = 2 * m.value > start + end // then it has room on the left
    if (m.upright && m.label) fig.add_layout(new Bokeh.Label({
      x: m.value, y: 3, y_units: "screen", x_offset: late ? -4 : 4, text_align: late ? "right" : "left", text: plain(m.label), text_color: m.colour, text_font_size: "11px"}))
  }

  function add(fig, m) {
    if (m.kind === "Level") return level(fig, m)
    let data = {}
    for (const name of ["x", "y", "at", "values", "errors"]) {
      if (name in m) data[name] = numbers[m[name]]
    }
    const {x, y} = data, many = m.kind === "Line" && y.length > 2 * POINTS
    if (many) data = extremes(x, y, -Infinity, Infinity)
    const drawn = glyphs[m.kind](fig, m, data)
    for (const each of drawn) each.name = m.label
    if (many) long.push({x, y, source: drawn[0].data_source})
    if (!m.label) return
    if (!labelled.has(m.label)) labelled.set(m.label, {mark: m, renderers: []})
    labelled.get(m.label).renderers.push(...drawn)
  }

  function fitting(name, pixels) { // a name that is longer than so many in several lines
    const most = Math.max(16, Math.floor(pixels / 7.5)), lines = []
    for (const part of name.split("\n")) {
      lines.push("")
      const words = part.match(/\[[^\]]*\]\s*|[^\s:,[]+[\s:,]*|[\s:,[]+/g) ?? [] // a unit is one word, and so is a name that fits
      for (const word of words.flatMap((each) => each.trim().length > most ? each.split(/(?<=[._ ])/) : [each])) {
        if (lines.at(-1) && lines.at(-1).length + word.trim().length > most) lines.push("")
        lines[lines.length - 1] += word
      }
    }
    return lines.map((each) => each.trim()).filter((each) => each) // names of joints differ at their end
      .map((each) => each.length <= most ? each : `…${each.slice(1 - most)}`).join("\n")
  }

  function named(axis, names, text, looks) {
    axis.setv({
      axis_label: plain(text), axis_label_text_font_style: "normal", axis_label_text_color: GREY,
      major_label_text_color: GREY, major_label_text_font_size: "11px", axis_line_color: GREY,
      major_tick_line_color: GREY, minor_tick_line_color: GREY, ...looks})
    if (!names.length) return
    const overrides = new Map(names.map((name, i) => [i, plain(name)]))
    const ticks = names.map((_, i) => i)
    axis.setv({major_label_overrides: overrides, ticker: new Bokeh.FixedTicker({ticks})})
  }

  function figureOf(panel, row, left) {
    const last = row === rows.length - 1, along = chart.shared_x ? "width" : "both"
    const across = width / rows[0].length
    const inner = left !== null && chart.shared_y // its y axis stands at the left of the row
    const places = (names) => ({start: -0.5, end: names.length - 0.5})
    const between = ([start, end]) => new Range1d({start, end})
    const downwards = () => ({start: panel.y_names.length - 0.5, end: -0.5}) // run downwards
    const names = panel.y_names.map((name) => fitting(name, across / 2))
    const lines = Math.max(0, ...names.map((name) => name.split("\n").length)) * names.length
    const fig = new Plotting.Figure({
      height: Math.max(panel.height, lines * 14 + 70), // title and axis below beside the names
      sizing_mode: "stretch_width", toolbar_location: null,
      x_range: shared ?? (panel.x_range ? between(panel.x_range) : panel.x_names.length ? new Range1d(places(panel.x_names)) : new DataRange1d()),
      y_range: chart.shared_y && scale ? scale : panel.y_range ? between(panel.y_range)
        : panel.y_names.length ? new Range1d(downwards()) : new DataRange1d(),
      x_axis_type: panel.logarithmic_x ? "log" : "linear",
      y_axis_type: panel.logarithmic ? "log" : "linear",
      tools: chart.fixed ? [new Bokeh.HoverTool({tooltips: [["", "$name"], ["x", "@x{0.0000}"], ["y", "@y{0.00000}"]]})] : [
        new Bokeh.BoxZoomTool({dimensions: along}), new Bokeh.PanTool({dimensions: along}),
        // the wheel alone scrolls the page
        new Bokeh.WheelZoomTool({dimensions: along, modifiers: {ctrl: true}}),
        new Bokeh.ResetTool(),
        new Bokeh.HoverTool({tooltips: [["", "$name"], ["x", "@x{0.0000}"], ["y", "@y{0.00000}"]]}),
      ],
      background_fill_color: null, border_fill_color: null, min_border_left: inner ? 16 : 70, min_border_right: 12, // half a number
      // BokehJS paints once before it has a layout, and never clears the left half of the first pixels
      styles: {clip_path: "inset(0 0 0 2px)"},
      outline_line_color: panel.marked ? "#d1495b" : null, outline_line_width: panel.marked ? 3 : 1,
    })
    fig.title = new Bokeh.Title({text: plain(panel.title), text_color: panel.marked ? "#d1495b" : GREY})
    const bare = chart.shared_x && !last // numbers stand below the last row
    const tilted = Math.max(0, ...panel.x_names.map((name) => name.length)) > 6
    const far = panel.marks.some((m) => "x" in m && Math.abs(numbers[m.x].at(-1)) > 1e6) // as times from 1970
    for (const axis of fig.xaxes) {
      if (!panel.x_names.length) axis.ticker.setv({desired_num_ticks: across < 450 ? (far ? 1 : 3) : 6})
      named(axis, panel.x_names, bare ? "" : fitting(panel.x, across), {
        major_label_text_font_size: bare ? "0px" : "11px",
        major_label_orientation: tilted ? 0.45 : "horizontal"})
    }
    for (const axis of fig.yaxes) {
      if (!panel.y_names.length && panel.height < 200) axis.ticker.setv({desired_num_ticks: 4})
    }
    for (const axis of fig.yaxes) {
      named(axis, names, fitting(panel.y, panel.height - 30), {visible: !inner})
    }
    if (panel.logarithmic_x) {
      const [low, high] = (panel.x_range ?? [1e-18, 1e6]).map(Math.log10), step = Math.ceil((high - low) / (across < 450 ? 4 : 8))
      const ticks = Array.from({length: 24}, (_, i) => Number(`1e${Math.floor(high) - i * step}`))
      fig.xaxes[0].setv({ticker: new Bokeh.FixedTicker({ticks}), major_label_overrides: new Map(ticks.map((x) => [x, plain(String(x))]))})
    }
    if (panel.logarithmic) { // numbers below 1 too, as few as there is room for
      const sizes = panel.marks.flatMap((m) => "y" in m ? [...numbers[m.y]] : inView(m) ? [m.value] : []).filter((y) => y > 0)
      const [low, high] = panel.y_range ?? [Math.min(...sizes), Math.max(...sizes)]
      const steps = [[1, 2, 5], [1, 2, 3, 4, 5, 6, 7, 8, 9], Array.from({length: 90}, (_, i) => (10 + i) / 10)]
      if (high >= 1000 * low) steps.unshift([1])
      const choices = steps.map((own) => Array.from({length: 24}, (_, i) => i - 12).flatMap((i) => own.map((x) => Number(`${x}e${i}`))))
      const ticks = choices.find((own) => own.filter((x) => low <= x && x <= high).length > 1) ?? choices[0]
      fig.yaxes[0].setv({ticker: new Bokeh.FixedTicker({ticks}), major_label_overrides: new Map(ticks.map((x) => [x, plain(String(x))]))})
    }
    for (const axis of [...fig.xaxes, ...fig.yaxes]) {
      const format = axis.formatter
      if (!("power_limit_high" in format)) continue
      format.setv({power_limit_high: far && fig.xaxes.includes(axis) ? 12 : 6, power_limit_low: -6})
      const written = format.doFormat.bind(format) // 3.000e−7 is 3e−7
      format.doFormat = (...given) => written(...given).map((text) => text.replace(/\.?0+e/, "e").replace(/^0e.*/, "0"))
    }
    for (const grid of fig.center) if (grid instanceof Bokeh.Grid) grid.setv({grid_line_color: GREY, grid_line_alpha: 0.25})
    for (const mark of panel.marks) add(fig, mark)
    if (shared && pointed) {
      const cursor = new Bokeh.Span({location: 0, dimension: "height", line_color: "#d1495b", visible: false})
      fig.add_layout(cursor)
      cursors.push(cursor)
      fig.on_event("mousemove", ({x}) => pointed(x))
    }
    return fig
  }

  let scale = null // of y, where all panels have the same
  const figures = rows.map((row, number) => {
    let left = null
    return row.map((panel) => {
      const fig = figureOf(panel, number, left)
      left ??= fig
      scale ??= fig.y_range
      return fig
    })
  })
  place.append(legend())

  // above all panels, in as many lines as it takes; a click on a name hides it everywhere
  function legend() {
    const names = document.createElement("div")
    names.style = "display: flex; flex-wrap: wrap; gap: 0 14px; padding: 2px 0"
    for (const [label, {mark, renderers}] of labelled) {
      const sign = document.createElement("span"), button = document.createElement("button")
      const line = mark.kind === "Line"
      sign.style = `display: inline-block; width: 16px; height: ${line ? 3 : 10}px; margin-right: 5px;
        vertical-align: middle; background: ${mark.colour}; border-radius: ${mark.kind === "Points" || mark.kind === "Dots" ? 5 : 0}px`
      if (!line) sign.style.width = mark.upright ? "3px" : "10px"
      button.type = "button"
      button.style = `all: unset; cursor: pointer; font: 12px/1.6 system-ui, sans-serif; color: ${GREY}`
      button.setAttribute("aria-pressed", "true")
      button.append(sign, label)
      button.addEventListener("click", () => {
        const shown = button.getAttribute("aria-pressed") === "false"
        button.setAttribute("aria-pressed", String(shown))
        button.style.opacity = shown ? 1 : 0.45
        for (const each of renderers) each.visible = shown
      })
      names.append(button)
    }
    return names
  }

  if (shared && long.length) {
    let waiting = false
    const resample = () => {
      if (waiting) return
      waiting = true
      requestAnimationFrame(() => {
        waiting = false
        const low = Math.min(shared.start, shared.end), high = Math.max(shared.start, shared.end)
        for (const {x, y, source} of long) source.data = extremes(x, y, low, high)
      })
    }
    shared.properties.start.change.connect(resample)
    shared.properties.end.change.connect(resample)
  }
  const across = Math.max(...figures.map((row) => row.length))
  const filled = figures.map((row) => [...row, ...Array(across - row.length).fill(null)])
  const grid = Plotting.gridplot(filled, {merge_tools: true, sizing_mode: "stretch_width", toolbar_location: chart.fixed ? null : "above"})
  grid.toolbar.logo = null
  const tool = (kind) => grid.toolbar.tools.find((each) => (each.tools?.[0] ?? each) instanceof kind)
  if (!chart.fixed) {
    grid.toolbar.active_drag = tool(Bokeh.BoxZoomTool)
    grid.toolbar.active_scroll = tool(Bokeh.WheelZoomTool)
  }
  const shown = Plotting.show(grid, place)
  return Promise.resolve(shown).then(() => {
    const cursor = (x) => cursors.forEach((each) => each.setv({location: x, visible: true}))
    return {document: grid.document, range: shared, cursor}
  })
}

// Draws pieces of a page that a server sends: HTML, which it has escaped, and charts.
const pieces = new Map() // documents of those drawn, by their place
function drawPieces(all, place) {
  pieces.get(place)?.forEach((each) => each.clear())
  const own = []
  pieces.set(place, own)
  place.replaceChildren()
  for (const {html, chart, words, height} of all) {
    const part = document.createElement("div")
    place.append(part)
    if (html !== undefined) { part.innerHTML = html; continue }
    part.className = "chart"
    part.setAttribute("role", "img")
    part.setAttribute("aria-label", words)
    part.style.minHeight = `${height}px`
    drawChart(JSON.parse(chart), part).then((drawn) => own.push(drawn.document))
  }
}
