// One chart of ident.show.charts; Panel's pages lack only the part of BokehJS for scripts.
export async function render({ model }) {
  if (!Bokeh.Plotting) {
    const script = document.createElement("script");
    script.textContent = api;
    document.head.append(script);
  }
  const place = document.createElement("div");
  place.setAttribute("role", "img");
  place.setAttribute("aria-label", model.words);
  model.on("after_render", () => drawChart(JSON.parse(model.data), place));
  return place;
}
