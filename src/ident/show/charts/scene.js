// Draws a moving mechanism, given as the data of ident.show.view, into a canvas: faces from
// far to near, without a graphics card. `told(log, x)`: the user has chosen that moment.
let onPaper = false // which is white, whatever the page is
addEventListener("beforeprint", () => { onPaper = true })
addEventListener("afterprint", () => { onPaper = false })
function drawScene(scene, place, told) {
  const numbers = scene.arrays.map(unpacked)
  const make = (tag, attributes) => Object.assign(document.createElement(tag), attributes)
  const canvas = make("canvas"), art = canvas.getContext("2d")
  const films = scene.films.map((film) => ({...film, t: numbers[film.t], poses: numbers[film.poses]}))
  const beside = make("canvas"), shadow = beside.getContext("2d") // a ghost is drawn alone, then laid below the machine
  const bar = make("div", {className: "tools"})
  const play = make("button", {type: "button", textContent: "▶", title: "Play"})
  const time = make("input", {type: "range", step: "any", title: "Time [s]"})
  const choice = make("select", {title: "Which log"}), now = make("span")
  films.forEach((film, i) => choice.append(new Option(film.name, i)))
  bar.append(play, time, now, ...(films.length > 1 ? [choice] : []))
  const half = [0, 1].map((i) => Math.max(...scene.outline.map((p) => Math.abs(p[i])))) // of what is seen [m]
  canvas.style.aspectRatio = half[0] / half[1]
  place.append(canvas, ...(films.some((film) => film.t.length > 1) ? [bar] : []))

  // --- vectors and camera -------------------------------------------------------------------------
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
  const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
  const plus = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]]
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
  const unit = (a) => { const n = Math.sqrt(dot(a, a)) || 1; return [a[0] / n, a[1] / n, a[2] / n] }
  const turned = (a, axis, angle) => { // by Rodrigues' formula
    const c = Math.cos(angle), s = Math.sin(angle)
    return plus(plus([a[0] * c, a[1] * c, a[2] * c], cross(axis, a), s), axis, dot(axis, a) * (1 - c))
  }
  let away = scene.direction // its length: closer or farther than all of it needs
  let width = 1, height = 1, right, over, back, fit = 1 // the wider the window, the nearer [m]
  const eyed = (p) => { const d = minus(p, plus(scene.target, away, fit)); return [dot(d, right), dot(d, over), -dot(d, back)] }
  const seen = ([x, y, z]) => { // a pinhole camera, `fov` from top to bottom
    const scale = height / 2 / Math.tan(scene.fov / 2) / Math.max(z, 1e-6)
    return [width / 2 + scale * x, height / 2 - scale * y]
  }

  // --- one moment ---------------------------------------------------------------------------------
  let film = films[0], k = 0
  const places = new Map() // of words, around their joints
  const shapes = scene.shapes.map((each) => ({...each, corners: numbers[each.corners], faces: numbers[each.faces]}))
  for (const shape of shapes) { // of the corners
    const n = shape.corners.length / 3
    shape.middle = [0, 1, 2].map((i) => shape.corners.reduce((sum, x, j) => j % 3 === i ? sum + x / n : sum, 0))
  }
  const ORDER = {body: 0, closure: 1, joint: 2, effect: 3}
  const coloured = (pivot) => { // by the residual of the joint
    const share = pivot in film.misfit ? numbers[film.misfit[pivot]][k] / (scene.misfit || 1) : NaN
    return share >= 0 ? scene.ramp[Math.round(Math.min(share, 1) * (scene.ramp.length - 1))] : scene.unknown
  }
  const css = ([r, g, b], light, alpha = 1) => `rgb(${r * light} ${g * light} ${b * light} / ${alpha})`
  const three = (x, i) => [x[3 * i], x[3 * i + 1], x[3 * i + 2]]

  function line(a, b, colour, head) {
    const [p, q] = [seen(eyed(a)), seen(eyed(b))], dx = q[0] - p[0], dy = q[1] - p[1], n = Math.hypot(dx, dy)
    if (n < 1) return
    art.strokeStyle = art.fillStyle = colour
    art.lineWidth = head ? 4 : 2
    const [x, y] = [dx / n, dy / n], tip = head ? Math.min(14, n) : 0
    art.beginPath()
    art.moveTo(...p)
    art.lineTo(q[0] - tip * x, q[1] - tip * y)
    art.stroke()
    if (!head) return
    art.beginPath()
    art.moveTo(...q)
    art.lineTo(q[0] - tip * x - 0.5 * tip * y, q[1] - tip * y + 0.5 * tip * x)
    art.lineTo(q[0] - tip * x + 0.5 * tip * y, q[1] - tip * y - 0.5 * tip * x)
    art.fill()
  }

  function paint() {
    const ratio = devicePixelRatio || 1
    width = canvas.clientWidth || 600
    height = canvas.clientHeight || 350
    if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio)
    if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio)
    const tan = Math.tan(scene.fov / 2)
    fit = Math.max(...scene.outline.map(([x, y, z]) => z + Math.max(Math.abs(y), Math.abs(x) * height / width) / tan))
    art.setTransform(ratio, 0, 0, ratio, 0, 0)
    art.clearRect(0, 0, width, height)
    back = unit(away)
    right = unit(cross(scene.up, back))
    over = cross(back, right)
    const light = unit(plus(plus(back, right, 0.5), over, 0.8)), camera = plus(scene.target, away, fit)
    const joints = films[0].poses.length / films[0].t.length / 12
    const posed = (poses, moment, joint, p) => {
      const m = poses.subarray((moment * joints + joint) * 12, (moment * joints + joint) * 12 + 12)
      return [0, 1, 2].map((i) => m[3 * i] * p[0] + m[3 * i + 1] * p[1] + m[3 * i + 2] * p[2] + m[9 + i])
    }
    const named = []

    function visible(poses, moment, drawn, colourOf) { // faces that look to the camera, the farthest first
      const faces = []
      for (const shape of drawn) {
        const rgb = colourOf(shape), world = [], eye = []
        for (let i = 0; i < shape.corners.length / 3; i++) {
          world.push(posed(poses, moment, shape.joint, three(shape.corners, i)))
          eye.push(eyed(world[i]))
        }
        for (let i = 0; i < shape.faces.length / 3; i++) {
          const [a, b, c] = three(shape.faces, i), normal = cross(minus(world[b], world[a]), minus(world[c], world[a]))
          if (dot(normal, minus(camera, world[a])) <= 0) continue // its back
          const bright = 0.6 + 0.4 * Math.max(0, dot(unit(normal), light))
          faces.push({order: ORDER[shape.kind], depth: eye[a][2] + eye[b][2] + eye[c][2], points: [a, b, c].map((j) => seen(eye[j])),
                      colour: css(rgb, bright)})
        }
      }
      return faces.sort((a, b) => a.order - b.order || b.depth - a.depth)
    }
    function fill(context, faces) {
      for (const {points, colour} of faces) {
        context.fillStyle = context.strokeStyle = colour
        context.lineWidth = 0.8 // closes the seam to the next face
        context.beginPath()
        points.forEach((p, i) => i ? context.lineTo(...p) : context.moveTo(...p))
        context.closePath()
        context.fill()
        context.stroke()
      }
    }

    beside.width = canvas.width
    beside.height = canvas.height
    for (const [name, ghost] of Object.entries(film.ghosts)) { // what both models agree on is below the machine
      const moment = k - ghost.first, poses = numbers[ghost.poses]
      if (moment < 0 || moment >= poses.length / joints / 12) continue
      shadow.setTransform(ratio, 0, 0, ratio, 0, 0)
      shadow.clearRect(0, 0, width, height)
      fill(shadow, visible(poses, moment, shapes.filter((each) => each.kind === "body" && each.joint > 0), () => scene.ghosts[name]))
      art.globalAlpha = 0.6
      art.drawImage(beside, 0, 0, width, height)
      art.globalAlpha = 1
    }
    const faces = visible(film.poses, k, shapes, (shape) => shape.kind === "joint" ? coloured(shape.pivot) : shape.colour)
    fill(art, faces)
    for (const shape of shapes) {
      if (!scene.marks[shape.pivot]) continue
      const colour = css(shape.kind === "joint" ? coloured(shape.pivot) : shape.colour, 1)
      named.push([scene.marks[shape.pivot], seen(eyed(posed(film.poses, k, shape.joint, shape.middle))), colour])
    }
    for (const gap of film.gaps) line(three(numbers[gap], 2 * k), three(numbers[gap], 2 * k + 1), "#777")
    for (const {colour, ends} of film.arrows) {
      line(three(numbers[ends], 2 * k), three(numbers[ends], 2 * k + 1), css(colour, 1), true)
    }
    art.font = "600 13px system-ui, sans-serif"
    // near its joint, where least is behind it
    const triangles = faces.filter(({order}) => order < 3).map(({points}) => points), taken = [] // boxes of the words written already
    if (Object.keys(scene.ghosts).length) { // the words in the corner
      for (const i of [0, 1, 2]) taken.push([10, height - 10 - 18 * i, 70])
    }
    const inside = ([x, y]) => triangles.filter((t) => t.every(([x0, y0], i) => {
      const [x1, y1] = t[(i + 1) % 3] // seen from the front all turn alike
      return (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0) <= 0
    })).length
    for (const [text, [x, y], colour] of named.sort((a, b) => a[1][1] - b[1][1])) {
      const wide = art.measureText(text).width
      const cost = ([left, line], i) => {
        const grid = [0, 0.25, 0.5, 0.75, 1].flatMap((u) => [-13, -5, 3].map((v) => [left + u * wide, line + v]))
        const within = triangles.filter((t) => t.some(([u, v]) => u > left - 2 && u < left + wide + 2 && v > line - 15 && v < line + 5)).length
        const hidden = within + grid.filter((p) => inside(p)).length, far = Math.hypot(Math.max(left - x, 0, x - left - wide), line - 5 - y)
        const over = taken.some(([l, b, w]) => left < l + w + 8 && l < left + wide + 8 && Math.abs(b - line) < 18)
        return 40 * over + 4 * hidden + far / 20 - (places.get(text) === i ? 3 : 0) // it stays while that is about as good
      }
      const around = [18, 40, 80].flatMap((r) => [[r, 5], [r, -r], [-wide / 2, -r], [-r - wide, -r], [-r - wide, 5], [-r - wide, r + 9], [-wide / 2, r + 9], [r, r + 9]])
        .concat([[-x, -y], [width - x, -y], [-x, height - y], [width - x, height - y]]) // or in a corner
        .map(([dx, dy]) => [Math.max(4, Math.min(x + dx, width - wide - 6)), Math.max(15, Math.min(y + dy, height - 6))])
      const costs = around.map(cost), best = costs.indexOf(Math.min(...costs)), [left, line] = around[best]
      places.set(text, best)
      taken.push([left, line, wide])
      art.strokeStyle = onPaper ? "white" : getComputedStyle(document.body).backgroundColor // readable over the machine
      art.lineWidth = 4
      art.strokeText(text, left, line)
      art.strokeStyle = art.fillStyle = "#d1495b"
      art.lineWidth = 1.5
      art.fillText(text, left, line)
      art.beginPath()
      const start = [Math.max(left - 4, Math.min(x, left + wide + 4)), Math.max(line - 14, Math.min(y, line + 4))]
      const n = Math.hypot(start[0] - x, start[1] - y) || 1 // to the rim of its circle
      art.moveTo(...start)
      art.lineTo(x + 9 * (start[0] - x) / n, y + 9 * (start[1] - y) / n)
      art.stroke()
      art.beginPath()
      art.arc(x, y, 9, 0, 7)
      art.fillStyle = colour // the joint's own, large enough to be seen
      art.fill()
      art.stroke()
    }
    Object.entries(scene.ghosts).forEach(([name, rgb], i) => {
      art.fillStyle = css(rgb, 1)
      art.fillText(name, 10, height - 10 - 18 * (Object.keys(scene.ghosts).length - i))
    })
    if (Object.keys(scene.ghosts).length) {
      art.fillStyle = css([125, 132, 142], 1)
      art.fillText("measured", 10, height - 10)
    }
    now.textContent = `${film.t[k].toFixed(2)} s`
  }

  let waiting = false
  const repaint = () => {
    if (waiting) return
    waiting = true
    requestAnimationFrame(() => { waiting = false; paint() })
  }

  // --- moments ------------------------------------------------------------------------------------
  function at(x) {
    let i = 0, j = film.t.length - 1
    while (i < j) { const m = (i + j) >> 1; if (film.t[m] < x) i = m + 1; else j = m }
    k = i > 0 && x - film.t[i - 1] < film.t[i] - x ? i - 1 : i
    time.value = x
    repaint()
  }
  function load(other) {
    film = other
    time.min = film.t[0]
    time.max = film.t[film.t.length - 1]
    choice.value = films.indexOf(film)
    at(film.t[0])
  }
  let playing = 0
  const stop = () => { cancelAnimationFrame(playing); playing = 0; play.textContent = "▶"; play.title = "Play" }
  function start(until = +time.max, rest = until) {
    let before = performance.now(), x = +time.value >= until ? +time.min : +time.value
    const step = (clock) => {
      x += (clock - before) / 1000
      before = clock
      at(Math.min(x, until))
      told(film.name, +time.value)
      if (x < until) { playing = requestAnimationFrame(step); return }
      stop()
      at(rest)
      told(film.name, rest)
    }
    play.textContent = "❚❚"
    play.title = "Pause"
    playing = requestAnimationFrame(step)
  }
  play.addEventListener("click", () => playing ? stop() : start())
  time.addEventListener("input", () => { stop(); at(+time.value); told(film.name, +time.value) })
  choice.addEventListener("change", () => load(films[+choice.value]))
  const orbit = (dx, dy) => {
    away = turned(away, scene.up, -0.01 * dx)
    const tipped = turned(away, right, -0.01 * dy)
    if (Math.abs(dot(unit(tipped), scene.up)) < 0.98) away = tipped // not over the pole
    repaint()
  }
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId))
  canvas.addEventListener("pointermove", (event) => { if (event.buttons) orbit(event.movementX, event.movementY) })
  canvas.addEventListener("wheel", (event) => { // alone it scrolls the page
    if (!event.ctrlKey) return
    event.preventDefault()
    const factor = Math.exp(0.002 * event.deltaY)
    away = away.map((x) => factor * x)
    repaint()
  }, {passive: false})
  new ResizeObserver(repaint).observe(canvas)
  addEventListener("beforeprint", paint)
  addEventListener("afterprint", repaint)
  paint()
  load(film)
  if (scene.stretch) {
    const [number, first, last, farthest] = scene.stretch
    load(films[number])
    at(first)
    if (matchMedia("(prefers-reduced-motion: reduce)").matches) at(farthest)
    else start(last, farthest) // once, and stands where the ghosts are farthest from the machine
  }
  return (log, x) => {
    const other = films.find((each) => each.name === log)
    if (!other || playing) return
    if (other !== film) load(other)
    at(x)
  }
}
