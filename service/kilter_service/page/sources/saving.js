// Figures and tables as files: each figure as SVG, as PNG (twice its size, on white) and, of its numbers, as CSV; each table as CSV.
const PAPER = { color: "#1a1f24", ground: "#ffffff" };
const SCALE = 2;
const FEWEST = 2; // lines of a table that is worth a file

function save(blob, name) {
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

function named(text, ending) {
  const plain = text.trim().toLowerCase().replaceAll(/[^\p{L}\p{N}]+/gu, "-").replaceAll(/^-|-$/g, "").slice(0, 80);
  return `${plain || "kilter"}.${ending}`;
}

/** A figure that stands alone: with its namespace, dark on white whatever the page looks like. */
function standing(svg) {
  const copy = svg.cloneNode(true);
  const { x, y, width, height } = svg.viewBox.baseVal;
  copy.setAttribute("color", PAPER.color);
  copy.querySelectorAll("[data-chosen]").forEach((one) => one.removeAttribute("data-chosen"));
  const ground = document.createElementNS("http://www.w3.org/2000/svg", "rect");
  Object.entries({ x, y, width, height, fill: PAPER.ground }).forEach(([name, value]) => ground.setAttribute(name, value));
  copy.querySelector("desc, title")?.parentNode === copy ? copy.querySelector("desc, title").after(ground) : copy.prepend(ground);
  return new Blob([new XMLSerializer().serializeToString(copy)], { type: "image/svg+xml" });
}

async function raster(svg) {
  const { width, height } = svg.viewBox.baseVal;
  const image = Object.assign(new Image(), { src: URL.createObjectURL(standing(svg)) });
  await image.decode();
  const canvas = Object.assign(document.createElement("canvas"), { width: SCALE * width, height: SCALE * height });
  canvas.getContext("2d").drawImage(image, 0, 0, canvas.width, canvas.height);
  URL.revokeObjectURL(image.src);
  return new Promise((done) => canvas.toBlob(done, "image/png"));
}

function csv(table) {
  const cell = (one) => {
    const text = one.textContent.trim().replaceAll(/\s+/g, " ").replaceAll(/(?<=\d) (?=\d{3}(?!\d))/g, "");
    return /[",]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
  };
  const lines = [...table.rows].map((row) => [...row.cells].map(cell).join(","));
  return new Blob([`${lines.join("\n")}\n`], { type: "text/csv" });
}

function buttons(give) {
  const place = Object.assign(document.createElement("p"), { className: "saving" });
  for (const [text, label, act] of give) {
    const button = Object.assign(document.createElement("button"), { type: "button", className: "plain", textContent: text });
    button.setAttribute("aria-label", label);
    button.addEventListener("click", act);
    place.append(button, " ");
  }
  return place;
}

function ofFigure(figure) {
  const svg = figure.querySelector("svg");
  const title = svg?.querySelector("title")?.textContent;
  if (!title) return;
  const table = figure.querySelector("table");
  const give = [
    ["SVG", `Save ${title} as SVG`, () => save(standing(svg), named(title, "svg"))],
    ["PNG", `Save ${title} as PNG`, async () => save(await raster(svg), named(title, "png"))],
  ];
  if (table) give.push(["CSV", `Save the numbers of ${title} as CSV`, () => save(csv(table), named(title, "csv"))]);
  figure.append(buttons(give));
}

function ofTable(region) {
  const table = region.querySelector(":scope > table");
  const label = region.getAttribute("aria-label") || "table";
  if (!table || table.querySelector("input, select") || table.tBodies[0]?.rows.length < FEWEST) return;
  region.after(buttons([["CSV", `Save ${label} as CSV`, () => save(csv(table), named(label, "csv"))]]));
}

const started = new WeakSet();

export function savable(within) {
  const once = (element, give) => {
    if (started.has(element)) return;
    started.add(element);
    give(element);
  };
  within.querySelectorAll("figure").forEach((figure) => once(figure, ofFigure));
  within.querySelectorAll(".scroll[role=region]").forEach((region) => region.closest("figure, dialog") || once(region, ofTable));
}

document.addEventListener("htmx:load", (event) => savable(event.detail.elt.parentElement || event.detail.elt));
