// The list of effects: native buttons, all words as text, never as markup.
const make = (tag, kind, words) => {
  const found = document.createElement(tag);
  if (kind) found.className = kind;
  if (words) found.textContent = words;
  return found;
};

function item(model, row) {
  const line = make("li", row.present ? "present" : row.sure ? "sure" : "");
  const button = make("button", row.present ? "off" : "on", row.present ? "remove" : "add");
  button.type = "button";
  button.setAttribute("aria-label", `${row.present ? "remove" : "add"} ${row.label}`);
  button.dataset.key = row.key;
  button.addEventListener("click", () => {
    if (!model.locked) model.send_msg({ label: row.label, present: row.present });
  });
  const name = make("span", "name", row.label);
  if (row.mark) name.append(" ", make("em", "mark", row.mark));
  const fall = make("span", "fall", row.fall);
  const bar = make("span", "bar");
  bar.setAttribute("aria-hidden", "true");
  bar.style.setProperty("--share", `${100 * row.share}%`);
  line.append(button, name, fall, bar);
  for (const [kind, words] of [["what", row.words], ["rivals", row.rivals], ["why", row.why]])
    if (words) line.append(make("span", kind, words));
  return line;
}

export function render({ model }) {
  const root = make("section", "candidates");
  root.setAttribute("aria-label", "Effects");
  const filter = make("input", "filter");
  filter.type = "search";
  filter.placeholder = "Show only, as elbow or coulomb";
  filter.setAttribute("aria-label", "Show only effects with these words");
  const said = make("p", "said");
  const list = make("ul");
  root.append(filter, said, list);

  let shown = "";
  const fill = () => {
    const focused = root.getRootNode().activeElement?.dataset?.key;
    const wanted = filter.value.trim().toLowerCase();
    const rows = model.rows.filter((row) => row.find.toLowerCase().includes(wanted));
    const lines = [];
    let group = "";
    for (const row of rows) {
      if (row.group !== group) lines.push(make("li", "group", (group = row.group)));
      lines.push(item(model, row));
    }
    list.replaceChildren(...lines);
    const changed = rows.filter((row) => row.present).map((row) => row.key).join();
    if (changed !== shown) list.scrollTop = 0;  // what has just changed stands above
    shown = changed;
    list.classList.toggle("stale", model.stale);
    said.textContent = wanted ? `${rows.length} of ${model.rows.length} effects` : model.said;
    if (focused)
      for (const button of list.querySelectorAll("button"))
        if (button.dataset.key === focused) button.focus({ preventScroll: true });
  };
  const lock = () => {
    for (const button of list.querySelectorAll("button"))  // not `disabled`, which loses the focus
      button.setAttribute("aria-disabled", String(model.locked));
    list.classList.toggle("locked", model.locked);
  };
  filter.addEventListener("input", () => { fill(); lock(); });
  for (const name of ["rows", "stale", "said"]) model.on(name, () => { fill(); lock(); });
  model.on("locked", lock);
  fill();
  lock();
  return root;
}
