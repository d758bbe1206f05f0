// The ladder: a table in which every earlier rung is a way back.
const cell = (tag, words) => {
  const found = document.createElement(tag);
  found.textContent = words;
  return found;
};

export function render({ model }) {
  const root = document.createElement("div");
  root.className = "ladder";
  root.tabIndex = 0;
  root.setAttribute("role", "region");
  root.setAttribute("aria-label", "Ladder of models tried, with held-out errors joint by joint");
  const fill = () => {
    const table = document.createElement("table");
    const [head, ...rows] = model.rows;
    if (!head) return;
    const top = table.createTHead().insertRow();
    for (const words of head) top.append(Object.assign(cell("th", words), { scope: "col" }));
    const body = table.createTBody();
    rows.forEach((words, i) => {
      const line = body.insertRow();
      const first = Object.assign(cell("th", ""), { scope: "row" });
      if (i < rows.length - 1) {
        const back = cell("button", words[0]);
        back.type = "button";
        back.title = "Back to this model";
        back.setAttribute("aria-label", `back to rung ${i}: ${words[0]}`);
        back.addEventListener("click", () => { if (!model.locked) model.send_msg({ rung: i }); });
        first.append(back);
      } else {
        first.textContent = words[0];
        line.className = "now";
        line.setAttribute("aria-current", "true");
      }
      line.append(first, ...words.slice(1).map((each) => cell("td", each)));
    });
    root.replaceChildren(table);
    root.scrollTop = root.scrollHeight;
  };
  model.on("rows", fill);
  fill();
  return root;
}
