// Rows of campaigns, chosen in any view and lit in all of them. A row is told by data-row="CAMPAIGN/ROW" wherever it stands:
// a line of a table, a point of a figure; what draws on a canvas asks window.kilter.rows. Pointing at a row says what is known
// of it, a click chooses it. Ids and numbers of chosen rows are kept until the browser is closed; measurements are not.
import { mm } from "./arm/words.js";
import { Chosen } from "./chosen.js";

const KEPT = "kilter-rows";
const MOST_KEPT = 20_000; // characters of the browser's storage
const MOST_ASKED = 6000; // characters that the server takes
const WAIT_MS = 80; // pointing at one row after the other asks for none of them
const chosen = new Map(); // campaign: Chosen
const watching = new Set();
const known = new Map();
const NONE = new Chosen();
let tip = null;
let asked = 0;
let tray = null;

const named = (element) => [element.dataset.row.slice(0, element.dataset.row.lastIndexOf("/")), Number(element.dataset.row.split("/").pop())];
const judge = () => document.querySelector("[data-judge]")?.dataset.judge || "";

export const rows = {
  has: (campaign, row) => chosen.get(campaign)?.has(row) ?? false,
  of: (campaign) => chosen.get(campaign) ?? NONE,
  /** Choose rows, or no longer: all of them as the first is not. */
  toggle(campaign, some, on = !rows.has(campaign, some[0])) {
    const mine = chosen.get(campaign) ?? new Chosen();
    for (const row of some) mine.put(row, on);
    mine.size ? chosen.set(campaign, mine) : chosen.delete(campaign);
    changed();
  },
  clear() {
    chosen.clear();
    changed();
  },
  equip,
  watch(told) {
    watching.add(told);
    told();
  },
  point,
  leave,
};

function changed() {
  const text = JSON.stringify([...chosen].map(([campaign, some]) => [campaign, some.written()]));
  sessionStorage.setItem(KEPT, text.length > MOST_KEPT ? "[]" : text);
  light();
  show();
  watching.forEach((told) => told());
}

function light(within = document) {
  for (const element of within.querySelectorAll("[data-row]")) {
    const on = rows.has(...named(element));
    if (element.hasAttribute("data-chosen") !== on) element.toggleAttribute("data-chosen", on);
    if (element.tagName !== "TR") continue;
    element.querySelector(".pick")?.setAttribute("aria-pressed", String(on));
  }
}

/** The number of a row in a table becomes a button: it is chosen by keyboard too. */
function equip(within) {
  for (const line of within.querySelectorAll("tr[data-row]")) {
    const head = line.querySelector("th");
    if (head.querySelector(".pick")) continue;
    const button = Object.assign(document.createElement("button"), { type: "button", className: "pick", textContent: head.firstChild.textContent.trim() });
    button.setAttribute("aria-label", `Choose row ${button.textContent}`);
    head.firstChild.replaceWith(button);
  }
  light(within);
}

async function told(campaign, row) {
  const key = `${campaign}/${row} ${judge()}`;
  if (!known.has(key)) {
    const answer = await fetch(`${window.kilter.root}/campaigns/${campaign}/rows.json?${new URLSearchParams({ rows: row, version: judge() })}`);
    if (!answer.ok) return "";
    const { campaign: name, joints, units, rows: [found] } = await answer.json();
    const left = found.error_mm === null ? "error not known" : `${mm(found.error_mm)}${found.sigma === null ? "" : `, ${found.sigma.toPrecision(2)} σ`}`;
    const file = found.file > 1 || found.file_row !== found.row ? ` (row ${found.file_row} of file ${found.file})` : "";
    known.set(key, `${name}, row ${row}${file}: ${left}\n${joints.map((joint, k) => `${joint} ${found.joints[k]} ${units[k]}`).join(", ")}`);
  }
  return known.get(key);
}

/** Say what is known of a row, beside where the pointer is. */
function point(campaign, row, x, y) {
  const mine = ++asked;
  setTimeout(async () => {
    if (mine !== asked) return;
    const text = await told(campaign, row);
    if (mine !== asked || !text) return;
    tip ??= document.body.appendChild(Object.assign(document.createElement("div"), { className: "row-tip" }));
    tip.setAttribute("role", "status");
    tip.textContent = text;
    tip.hidden = false;
    tip.style.left = `${Math.max(4, Math.min(x + 14, window.innerWidth - tip.offsetWidth - 8))}px`;
    tip.style.top = `${y + 18 + tip.offsetHeight > window.innerHeight ? y - tip.offsetHeight - 10 : y + 18}px`;
  }, WAIT_MS);
}

function leave() {
  asked += 1;
  if (tip) tip.hidden = true;
}

function show() {
  const count = [...chosen.values()].reduce((sum, some) => sum + some.size, 0);
  tray ??= made();
  tray.hidden = count === 0;
  tray.querySelector("[data-count]").textContent = `${count} row${count === 1 ? "" : "s"} chosen`;
}

function made() {
  const place = document.getElementById("row-tray").content.firstElementChild.cloneNode(true);
  document.body.append(place);
  const dialog = place.querySelector("dialog");
  place.querySelector("[data-list]").addEventListener("click", () => list(dialog));
  place.querySelector("[data-clear]").addEventListener("click", rows.clear);
  return place;
}

async function list(dialog) {
  const place = dialog.querySelector("[data-lists]");
  place.replaceChildren();
  dialog.showModal();
  for (const [campaign, some] of chosen) {
    const part = place.appendChild(document.createElement("div"));
    const text = some.written();
    if (text.length > MOST_ASKED) part.textContent = `${some.size} scattered rows are more than a list takes: choose fewer, or take the file of all residuals.`;
    else await window.kilter.ajax(`${window.kilter.root}/campaigns/${campaign}/rows?${new URLSearchParams({ rows: text, version: judge() })}`, part);
  }
}

document.addEventListener("click", (event) => {
  const element = event.target.closest?.("[data-row]");
  if (!element || event.target.closest("a, input, select, summary, button:not(.pick)")) return;
  const [campaign, row] = named(element);
  rows.toggle(campaign, [row]);
});
document.addEventListener("pointerover", (event) => {
  const element = event.target.closest?.("[data-row]");
  if (element) point(...named(element), event.clientX, event.clientY);
});
document.addEventListener("pointerout", (event) => {
  if (event.target.closest?.("[data-row]")) leave();
});
document.addEventListener("focusin", (event) => {
  const pick = event.target.closest?.(".pick");
  if (!pick?.closest("[data-row]") || !pick.matches(":focus-visible")) return;
  const { left, bottom } = pick.getBoundingClientRect();
  point(...named(pick.closest("[data-row]")), left, bottom);
});
document.addEventListener("focusout", leave);
document.addEventListener("keydown", (event) => {
  if (event.key === "Escape") leave();
});
document.addEventListener("htmx:load", (event) => equip(event.detail.elt.parentElement || event.detail.elt));

/** Begin with what was chosen in another view. */
export function begin() {
  for (const [campaign, text] of JSON.parse(sessionStorage.getItem(KEPT) || "[]")) chosen.set(campaign, Chosen.read(text));
  equip(document);
  if (chosen.size) show();
}
