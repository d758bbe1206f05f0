// One line: what is being done, what has been done, or what went wrong. Screen readers hear it.
export function render({ model }) {
  const root = document.createElement("div");
  const title = document.createElement("h1");
  const line = document.createElement("p");
  line.setAttribute("role", "status");
  line.setAttribute("aria-live", "polite");
  root.append(title, line);
  const fill = () => {
    root.className = `status ${model.kind}`;
    root.style.setProperty("--share", `${100 * model.share}%`);
    title.textContent = model.title;
    if (line.textContent !== model.said) line.textContent = model.said;
    line.setAttribute("aria-busy", String(model.kind === "busy"));
  };
  for (const name of ["said", "kind", "share", "title"]) model.on(name, fill);
  fill();
  return root;
}
