// data-correct="PATH"   sends the chosen path as it is, shows what became of each row, and keeps the answer to be downloaded
// data-reads="ID"       puts the text of the chosen file into the text area with that id, beside the file's name
import { drawn } from "./arm/words.js";

const LISTED = 200;
const DIGITS = 4; // of a degree or mm in the list; the file has all
const BARS = 400;
const LOOKS = { OK: "good", UNSURE: "warn", DAMPED: "warn", LIMITED: "warn" }; // all others are refusals
const COLOURS = { good: "var(--corrected)", warn: "var(--set-aside)", bad: "var(--error)" };
const lookOf = (row) => LOOKS[row.status] || "bad";

function parsed(text) {
  const [head, ...lines] = text.trim().split("\n").map((line) => line.trim().split(",").map((cell) => cell.replaceAll('"', "")));
  return { head, rows: lines.map((cells, k) => ({ number: k + 1, cells, ...Object.fromEntries(head.map((name, c) => [name, cells[c]])) })) };
}

/** One bar for some rows: as high as the largest correction among them, coloured by the worst of them. */
function strip(rows) {
  const [width, height] = [800, 110];
  const svg = drawn("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", preserveAspectRatio: "none" }, drawn("title", {}, "Corrections of the path"));
  const moved = (row) => Math.hypot(...["dx_mm", "dy_mm", "dz_mm"].map((name) => Number(row[name]) || 0));
  const most = rows.reduce((found, row) => Math.max(found, moved(row)), 1e-9);
  const step = Math.ceil(rows.length / BARS);
  for (let first = 0; first < rows.length; first += step) {
    const some = rows.slice(first, first + step);
    const looks = some.map(lookOf);
    const look = ["bad", "warn", "good"].find((one) => looks.includes(one));
    const high = look === "bad" ? height : Math.max(2, (height * Math.max(...some.map(moved))) / most);
    const place = { x: (first / rows.length) * width, width: Math.max((some.length / rows.length) * width, 1), y: height - high, height: high };
    const bar = drawn("rect", Object.fromEntries(Object.entries(place).map(([name, value]) => [name, value.toFixed(1)])));
    bar.style.fill = COLOURS[look];
    svg.append(bar);
  }
  return { svg, most };
}

function tabled(table, head, rows) {
  const cell = (kind, text) => Object.assign(document.createElement(kind), { textContent: text });
  const line = document.createElement("tr");
  const others = head.map((_, c) => c).filter((c) => head[c] !== "status");
  line.append(...["row", "status", ...others.map((c) => head[c])].map((name, c) => Object.assign(cell("th", name), { className: c > 1 ? "number" : "" })));
  table.tHead.replaceChildren(line);
  const odd = rows.filter((row) => lookOf(row) !== "good");
  const shown = [...odd, ...rows.filter((row) => lookOf(row) === "good")].slice(0, LISTED);
  table.tBodies[0].replaceChildren(...shown.map((row) => {
    const made = Object.assign(document.createElement("tr"), { className: `path-${lookOf(row)}` });
    const short = (text, name) => (text === "" || !Number.isFinite(Number(text)) ? text : /_(deg|mm)$/.test(name) ? Number(text).toFixed(DIGITS).replace(/^-(0\.0+)$/, "$1") : Number(Number(text).toPrecision(7)));
    const number = (c) => Object.assign(cell("td", short(row.cells[c], head[c])), { className: "number" });
    made.append(cell("th", row.number), cell("td", row.status), ...others.map(number));
    return made;
  }));
  return { listed: shown.length, odd: odd.length };
}

function show(text, name, notes) {
  const place = document.querySelector("[data-corrected]");
  const find = (what) => place.querySelector(`[data-${what}]`);
  const { head, rows } = parsed(text);
  const counts = new Map();
  rows.forEach((row) => counts.set(row.status, (counts.get(row.status) || 0) + 1));
  find("counts").replaceChildren(...[...counts].map(([status, count]) => Object.assign(document.createElement("span"), { className: `badge ${LOOKS[status] || "bad"}`, textContent: `${count} ${status.toLowerCase().replaceAll("_", " ")}` })));
  find("notes").replaceChildren(...notes.map((one) => Object.assign(document.createElement("div"), { className: "note warn", textContent: one.replaceAll("`", "") })));
  const { svg, most } = strip(rows);
  find("strip").querySelector("svg")?.remove();
  find("strip").prepend(svg);
  const { listed, odd } = tabled(find("rows"), head, rows);
  find("said").textContent = `${rows.length} rows, at most ${most.toPrecision(3)} mm moved; ${odd ? `the ${odd} that are not as asked are listed first` : "all as asked"}${listed < rows.length ? `, ${listed} listed` : ""}.`;
  const link = find("download");
  URL.revokeObjectURL(link.href);
  link.href = URL.createObjectURL(new Blob([text], { type: "text/csv" }));
  link.download = name.replace(/(\.csv)?$/i, "-corrected.csv");
  place.hidden = false;
}

function correct(form) {
  const told = form.querySelector("[data-sending]");
  const refused = document.querySelector("[data-refused]");
  const say = (text) => refused.replaceChildren(Object.assign(document.createElement("div"), { className: "note bad", textContent: text }));
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    const file = form.elements.file.files[0];
    refused.replaceChildren();
    document.querySelector("[data-corrected]").hidden = true;
    if (!file) return say("Choose a path first: a CSV file with a row for each setpoint.");
    told.textContent = `Correcting ${file.name} …`;
    let answer = null;
    try {
      const asked = new URLSearchParams([...new FormData(form)].filter(([name, value]) => name !== "file" && value));
      answer = await window.kilter.send(`${form.dataset.correct}?${asked}`, { method: "POST", body: file, headers: { "Content-Type": "text/csv" } });
    } catch {
      say("The server does not answer. The path was not corrected; try again when it is back.");
    }
    told.textContent = "";
    if (answer?.ok) show(await answer.text(), file.name, (answer.headers.get("Kilter-Notes") || "").split(" | ").filter(Boolean));
    else if (answer) say(await answer.json().then(({ detail }) => detail, () => `The server refused the path (${answer.status}).`));
  });
}

function reads(place) {
  const input = place.querySelector('input[type="file"]');
  input.addEventListener("change", async () => {
    const file = input.files[0];
    if (!file) return;
    const form = input.form;
    document.getElementById(place.dataset.reads).value = await file.text();
    form.elements.file.value = file.name;
    form.elements.preset.value = "";
    place.querySelector("[data-sending]").textContent = `${file.name}: check it, and see what it comes to.`;
    if (/\.(urdf|xml|csv|tsv|txt)$/i.test(file.name)) form.querySelector("details").open = true;
  });
}

document.querySelectorAll("[data-correct]").forEach(correct);
document.querySelectorAll("[data-reads]").forEach(reads);
