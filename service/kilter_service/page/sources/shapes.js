// data-send-shape="PATH"   sends the chosen file as the shape of the chosen link, and shows the robot anew
function sendShape(form) {
  const told = form.parentElement.querySelector("[data-sending]");
  const refused = document.getElementById("shape-refused");
  const button = form.querySelector("button");
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    const input = form.elements.file;
    const file = input.files[0];
    const most = Number(input.dataset.mostMb);
    refused.replaceChildren();
    if (file.size > most * 2 ** 20) {
      refused.textContent = `${file.name} is larger than ${most} MB: simplify the mesh, it is only drawn.`;
      return;
    }
    told.textContent = `Sending ${file.name} …`;
    button.disabled = true;
    try {
      const asked = new URLSearchParams({ unit: form.elements.unit.value, name: file.name });
      const address = `${form.dataset.sendShape}/${encodeURIComponent(form.elements.link.value)}?${asked}`;
      const answer = await window.kilter.send(address, { method: "POST", body: file, headers: { "HX-Request": "true", "Content-Type": "application/octet-stream" } });
      const to = answer.headers.get("HX-Redirect");
      if (to) window.location.assign(to);
      else if (answer.ok) window.location.reload();
      else refused.innerHTML = await answer.text();
    } catch {
      refused.textContent = "The file did not arrive: the connection broke off. Send it again.";
    }
    told.textContent = "";
    button.disabled = false;
  });
}

document.querySelectorAll("[data-send-shape]").forEach(sendShape);
