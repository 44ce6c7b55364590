import { archived } from "./archive.js";

const LOOKS_MS = 1000; // between two looks at what was read until now

/** Send a file as it is, and go where the answer says, or look at this view anew; a refusal is shown. */
async function send(address, file, told, refused, verb) {
  refused.replaceChildren();
  told.textContent = `${verb} ${file.name} …`;
  try {
    const answer = await window.kilter.send(address, { method: "POST", body: file, headers: { "HX-Request": "true", "Content-Type": "application/octet-stream" } });
    const to = answer.headers.get("HX-Redirect") || (answer.status === 201 || answer.status === 200 ? (await answer.json()).address : "");
    if (to) window.location.assign(to);
    else if (answer.ok) window.location.reload();
    else refused.innerHTML = await answer.text();
  } catch {
    refused.textContent = "The file did not arrive: the connection broke off. Send it again.";
  }
  told.textContent = "";
}

// data-send-file="PATH"   sends the chosen or dropped file, and goes to where its reading is shown
function sendFile(form) {
  const input = form.querySelector('input[type="file"]');
  input.addEventListener("change", async () => {
    if (!input.files.length) return;
    const file = input.files.length > 1 ? await archived([...input.files]) : input.files[0];
    input.disabled = true;
    const arriving = form.parentElement.querySelector("[data-arriving]");
    const looks = arriving && setInterval(() => window.kilter.ajax(form.dataset.sendFile.replace(/file$/, "reading"), arriving), LOOKS_MS);
    const asked = new URLSearchParams({ name: file.name, job: form.dataset.job || "" });
    await send(`${form.dataset.sendFile}?${asked}`, file, form.querySelector("[data-sending]"), form.parentElement.querySelector("[data-refused]"), "Reading");
    clearInterval(looks);
    arriving?.replaceChildren();
    input.disabled = false;
    input.value = "";
  });
}

// data-send-shape="PATH"   sends the chosen file as the shape of the chosen link
function sendShape(form) {
  const refused = document.getElementById("shape-refused");
  const button = form.querySelector("button");
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    const { file: input, unit, link } = form.elements;
    const file = input.files[0];
    const most = Number(input.dataset.mostMb);
    refused.textContent = file.size > most * 2 ** 20 ? `${file.name} is larger than ${most} MB: simplify the mesh, it is only drawn.` : "";
    if (refused.textContent) return;
    button.disabled = true;
    const asked = new URLSearchParams({ unit: unit.value, name: file.name });
    await send(`${form.dataset.sendShape}/${encodeURIComponent(link.value)}?${asked}`, file, form.parentElement.querySelector("[data-sending]"), refused, "Sending");
    button.disabled = false;
  });
}

document.querySelectorAll("[data-send-file]").forEach(sendFile);
document.querySelectorAll("[data-send-shape]").forEach(sendShape);

// A form that was read anew is another one: who chose by keyboard goes on where they were.
let chosen = "";
document.addEventListener("change", (event) => {
  if (event.target.closest(".column-map")) chosen = event.target.id;
});
document.addEventListener("htmx:afterSettle", () => {
  if (chosen) document.getElementById(chosen)?.focus({ preventScroll: true });
  chosen = "";
});
