
// a button beside a command: into the clipboard, or, where a browser refuses that, marked as text
document.addEventListener("click", async ({target}) => {
  const button = target.closest?.("button[data-copy]")
  if (!button) return
  try {
    await navigator.clipboard.writeText(button.dataset.copy)
    button.textContent = "Copied"
  } catch {
    getSelection().selectAllChildren(button.previousElementSibling)
    button.textContent = document.execCommand("copy") ? "Copied" : "Marked"
  }
  setTimeout(() => { button.textContent = "Copy" }, 2000)
})
