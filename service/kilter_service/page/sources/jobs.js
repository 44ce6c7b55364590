// The form of a new job: Run is possible only while a passed check of exactly these inputs is shown.
function watch(form) {
  const run = form.querySelector("[data-run]");
  const shown = form.querySelector("#check");
  const forget = () => {
    run.disabled = true;
    form.querySelector("#refusal").replaceChildren();
    if (shown.childElementCount === 0) return;
    shown.replaceChildren();
    const note = document.createElement("div");
    note.className = "note warn";
    note.textContent = "The inputs have changed since the check: check them again.";
    shown.append(note);
  };
  let edits = 0;
  let asked = 0;
  for (const kind of ["input", "change"]) {
    form.addEventListener(kind, () => {
      edits += 1;
      forget();
    });
  }
  form.addEventListener("htmx:beforeRequest", (event) => {
    if (event.target === form) asked = edits;
  });
  shown.addEventListener("htmx:afterSwap", () => {
    if (asked !== edits) forget(); // an answer to inputs that are no longer there
    else run.disabled = shown.querySelector("[data-passed]") === null;
  });
}

document.querySelectorAll("form[data-checked]").forEach(watch);

// A campaign that was found by a search and given a use joins the table of the form: the next search keeps it.
const there = (select) => select.form.querySelector(`[data-uses] select[name="${CSS.escape(select.name)}"]`);
document.addEventListener("change", (event) => {
  const select = event.target.closest?.("[data-sought] select");
  if (select?.value) select.form.querySelector("[data-uses]").append(select.closest("tr"));
});
document.addEventListener("htmx:afterSwap", (event) => {
  if (!event.detail.target.matches("[data-sought]")) return;
  for (const select of event.detail.target.querySelectorAll("select")) if (there(select)) select.replaceWith("in the table above");
});
