import { archived } from "./archive.js";

// data-send-file="PATH"   sends the chosen or dropped file as it is, and goes to where its reading is shown
function sendFile(form) {
  const input = form.querySelector('input[type="file"]');
  const told = form.querySelector("[data-sending]");
  const refused = form.parentElement.querySelector("[data-refused]");
  input.addEventListener("change", async () => {
    if (!input.files.length) return;
    const file = input.files.length > 1 ? await archived([...input.files]) : input.files[0];
    refused.replaceChildren();
    told.textContent = `Reading ${file.name} …`;
    input.disabled = true;
    try {
      const asked = new URLSearchParams({ name: file.name, job: form.dataset.job || "" });
      const address = `${form.dataset.sendFile}?${asked}`;
      const answer = await window.kilter.send(address, { method: "POST", body: file, headers: { "HX-Request": "true", "Content-Type": "application/octet-stream" } });
      const to = answer.headers.get("HX-Redirect");
      if (to) window.location.assign(to);
      else if (answer.ok) window.location.assign((await answer.json()).address);
      else refused.innerHTML = await answer.text();
    } catch {
      refused.textContent = "The file did not arrive: the connection broke off. Drop it again.";
    }
    told.textContent = "";
    input.disabled = false;
    input.value = "";
  });
}

document.querySelectorAll("[data-send-file]").forEach(sendFile);

// A form that was read anew is another one: who chose by keyboard goes on where they were.
let chosen = "";
document.addEventListener("change", (event) => {
  if (event.target.closest(".column-map")) chosen = event.target.id;
});
document.addEventListener("htmx:afterSettle", () => {
  if (chosen) document.getElementById(chosen)?.focus({ preventScroll: true });
  chosen = "";
});
