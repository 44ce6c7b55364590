// Dialogs that are filled when their button is pressed: data-opens="ID" opens the <dialog> with that id once htmx has
// filled it; a button with data-close within it closes it.
document.addEventListener("htmx:afterSwap", (event) => {
  const opens = event.detail.requestConfig?.elt?.dataset?.opens;
  const dialog = opens && document.getElementById(opens);
  if (dialog && !dialog.open) dialog.showModal();
});
document.addEventListener("click", (event) => {
  const button = event.target.closest?.("dialog [data-close]");
  if (button) button.closest("dialog").close();
});
