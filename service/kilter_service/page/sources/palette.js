// The palette: k (or Ctrl+K) opens it, the arrows walk over what is found, Enter goes there.
const palette = document.getElementById("palette");
const field = palette?.querySelector("input");
const links = () => [...palette.querySelectorAll("a")];

function walk(step) {
  const all = links();
  const at = all.indexOf(document.activeElement) + step;
  (at < 0 ? field : all[Math.min(at, all.length - 1)])?.focus();
}

document.addEventListener("keydown", (event) => {
  const typing = event.target.closest("input, textarea, select, [contenteditable]");
  if (event.key === "k" && palette && !palette.open && (event.ctrlKey || event.metaKey || (!typing && !event.altKey))) {
    event.preventDefault();
    palette.showModal();
    field.select();
    field.dispatchEvent(new Event("input", { bubbles: true }));
  } else if (palette?.open && (event.key === "ArrowDown" || event.key === "ArrowUp")) {
    event.preventDefault();
    walk(event.key === "ArrowDown" ? 1 : -1);
  } else if (palette?.open && event.key === "Enter" && event.target === field) {
    event.preventDefault();
    links()[0]?.click();
  }
});
