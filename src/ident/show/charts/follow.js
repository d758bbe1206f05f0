// Of every bucket of the samples in view the smallest and the largest value: no peak is lost.
if (!range.waiting) {
  range.waiting = true
  requestAnimationFrame(() => {
    range.waiting = false
    const low = Math.min(range.start, range.end), high = Math.max(range.start, range.end)
    const first = (x, value) => {
      let i = 0, j = x.length
      while (i < j) { const k = (i + j) >> 1; if (x[k] < value) i = k + 1; else j = k }
      return i
    }
    shown.forEach((source, k) => {
      const x = sources[k].data.x, y = sources[k].data[columns[k]]
      const i = Math.max(0, first(x, low) - 1), j = Math.min(x.length, first(x, high) + 1)
      const n = j - i, step = Math.max(1, Math.floor(n / points)), xs = [], ys = []
      for (let a = i; a < j; a += step) {
        if (step === 1) { xs.push(x[a]); ys.push(y[a]); continue }
        const end = Math.min(a + step, j)
        let least = Infinity, most = -Infinity
        for (let b = a; b < end; b++) { // a gap compares as false
          if (y[b] < least) least = y[b]
          if (y[b] > most) most = y[b]
        }
        xs.push(x[a], x[end - 1])
        if (most >= least) ys.push(least, most); else ys.push(NaN, NaN)
      }
      source.data = {x: xs, y: ys}
    })
  })
}
