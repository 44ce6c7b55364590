// What every view needs: htmx, which asks for parts of the page, and four behaviours that are named in the markup.
//   data-follow="JOB"       shows how far a job is (server-sent events) and loads the page anew when it is over
//   data-confirm="ID"       opens the <dialog> with that id before its form is sent
//   data-theme-switch       changes between light and dark
//   data-drop               a place where files can be dropped: hands them to the file input within
import htmx from "htmx.org";
import "./drop.js";
import "./jobs.js";
import "./correct.js";
import "./login.js";
import "./palette.js";
import { missed } from "./lost.js";
import { ended, offer } from "./ended.js";
import * as rows from "./rows.js";
import { savable } from "./saving.js";

htmx.config.allowEval = false;
htmx.config.includeIndicatorStyles = false;
htmx.config.historyCacheSize = 0; // measurements stay out of the browser's storage
htmx.config.responseHandling = [{ code: "204", swap: false }, { code: "...", swap: true }]; // refusals are shown where they arise

const root = document.documentElement.dataset.root || "";
const csrf = document.querySelector('meta[name="csrf"]')?.content || "";

document.addEventListener("htmx:configRequest", (event) => {
  event.detail.headers["X-CSRF-Token"] = csrf;
});

/** Fetch as the page does: the change is sent with the page's own token. */
export function send(address, options = {}) {
  return fetch(root + address, { ...options, headers: { "X-CSRF-Token": csrf, ...(options.headers || {}) } }).catch((error) => {
    missed();
    throw error;
  });
}
window.kilter = { send, root, rows: rows.rows, ajax: (address, target) => htmx.ajax("GET", address, { target, swap: "innerHTML" }) };

const LOST_MS = 4000; // without an answer

/** How long ago something was, as a clock shows it. */
function elapsed(since) {
  const seconds = Math.max(0, Math.round((Date.now() - since) / 1000));
  const two = (value) => String(value).padStart(2, "0");
  return `${Math.floor(seconds / 3600) ? `${Math.floor(seconds / 3600)}:${two(Math.floor(seconds / 60) % 60)}` : Math.floor(seconds / 60)}:${two(seconds % 60)}`;
}

/** Say since when a job computes, or waits, and when it may be over: at the pace it had until now. */
function clock(place) {
  const told = place.querySelector("[data-elapsed]");
  const since = Number(place.dataset.since) * 1000;
  const tick = () => {
    const done = place.querySelector("progress").value;
    const spent = Date.now() - since;
    const left = place.dataset.state === "running" && done > 0.05 && spent > 5000 ? `, about ${elapsed(Date.now() - (spent * (1 - done)) / done)} to go at this pace` : "";
    told.textContent = `${place.dataset.state === "running" ? "Computes" : "Waits"} since ${elapsed(since)}${left}.`;
  };
  tick();
  setInterval(tick, 1000);
}

function follow(place) {
  const title = document.title;
  if (place.dataset.since) clock(place);
  offer(place);
  const source = new EventSource(`${root}/v1/jobs/${encodeURIComponent(place.dataset.follow)}/events`);
  const bar = place.querySelector("progress");
  const stage = place.querySelector("[data-stage]");
  source.addEventListener("progress", (event) => {
    const { state, progress: told } = JSON.parse(event.data);
    bar.value = told.fraction;
    stage.textContent = `${Math.round(100 * told.fraction)} % ${told.stage}`;
    document.title = `${Math.round(100 * told.fraction)} % · ${title}`;
    if (state !== place.dataset.state) window.location.reload(); // a worker took it, or gave it back
  });
  let before = "";
  source.addEventListener("error", () => setTimeout(() => {
    if (source.readyState === EventSource.OPEN || before) return;
    before = stage.textContent;
    stage.textContent = "The server does not answer. This page asks again by itself.";
    missed();
  }, LOST_MS));
  source.addEventListener("open", () => {
    if (before) stage.textContent = before;
    before = "";
  });
  source.addEventListener("end", (event) => {
    source.close();
    ended(event.data);
    window.location.reload();
  });
}

function takeDrops(place) {
  const input = place.querySelector('input[type="file"]');
  place.addEventListener("dragover", (event) => {
    event.preventDefault();
    place.classList.add("over");
  });
  place.addEventListener("dragleave", () => place.classList.remove("over"));
  place.addEventListener("drop", (event) => {
    event.preventDefault();
    place.classList.remove("over");
    input.files = event.dataTransfer.files;
    input.dispatchEvent(new Event("change", { bubbles: true }));
  });
}

function switchTheme() {
  const dark = window.matchMedia("(prefers-color-scheme: dark)").matches;
  const now = document.documentElement.dataset.theme || (dark ? "dark" : "light");
  const next = now === "dark" ? "light" : "dark";
  document.documentElement.dataset.theme = next;
  localStorage.setItem("kilter-theme", next);
}

const BEHAVIOURS = {
  "[data-follow]": follow,
  "[data-drop]": takeDrops,
};
const started = new WeakSet(); // a part that is swapped in stands beside elements that have their behaviour already

function start(within) {
  for (const [named, give] of Object.entries(BEHAVIOURS)) {
    for (const element of within.querySelectorAll(named)) {
      if (!started.has(element)) {
        started.add(element);
        give(element);
      }
    }
  }
}

document.addEventListener("click", ({ target }) => {
  const point = target.closest("[data-goto]"); // of a figure, which has a table beside it
  if (point) window.location.href = point.dataset.goto;
  const asks = target.closest("[data-confirm]");
  if (asks) document.getElementById(asks.dataset.confirm).showModal();
  if (target.closest("[data-theme-switch]")) switchTheme();
  target.closest("dialog [data-close]")?.closest("dialog").close();
});

// data-opens="ID": the <dialog> with that id opens once htmx has filled it.
document.addEventListener("htmx:afterSwap", (event) => {
  const opens = event.detail.requestConfig?.elt?.dataset?.opens;
  const dialog = opens && document.getElementById(opens);
  if (dialog && !dialog.open) dialog.showModal();
});

// Figures are as wide as the window was at the view before: where it is much narrower now, nobody could read them.
const tight = [...document.querySelectorAll("figure > svg")].some((one) => one.clientWidth && one.viewBox.baseVal.width > 1.6 * one.clientWidth);
if (tight && performance.getEntriesByType("navigation")[0]?.type === "navigate") window.location.reload();
start(document);
rows.begin();
savable(document);
document.addEventListener("htmx:load", (event) => {
  if (event.detail.elt !== document.body) start(event.detail.elt.parentElement || event.detail.elt);
});
