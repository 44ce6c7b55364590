// A server that does not answer says so on every view, until it answers again; and what could not be loaded is a sentence
// with a way out, never JSON.
import htmx from "htmx.org";

const LOOK_MS = 15_000; // while somebody looks
const AGAIN_MS = 3_000; // while it is lost
const root = document.documentElement.dataset.root || "";
const banner = document.getElementById("lost");
let lost = false;
let next = 0;

function look(after) {
  clearTimeout(next);
  next = setTimeout(ask, after);
}

async function ask() {
  if (document.visibilityState !== "visible" && !lost) return look(LOOK_MS);
  try {
    await fetch(`${root}/v1/health/live`, { cache: "no-store" });
    found();
  } catch {
    missed();
  }
}

/** Say that the server does not answer, and ask it again and again. */
export function missed() {
  if (!lost) {
    const at = new Date().toLocaleTimeString([], { hour: "2-digit", minute: "2-digit", hour12: false });
    banner.querySelector("[data-words]").textContent = `The server does not answer since ${at}. What you see is older. This page asks again by itself.`;
    banner.querySelector("button").hidden = true;
    banner.className = "note bad";
    banner.hidden = false;
    lost = true;
  }
  look(AGAIN_MS);
}

function found() {
  if (lost) {
    banner.querySelector("[data-words]").textContent = "The server answers again. What you see may be older:";
    banner.querySelector("button").hidden = false;
    banner.className = "note good";
    lost = false;
  }
  look(LOOK_MS);
}

/** In place of a part that did not come: why, and a button that asks for it as its element did, where that may help. */
function instead(detail, words) {
  const { target, requestConfig } = detail;
  const elt = requestConfig.elt; // that of the event may be the target
  const note = Object.assign(document.createElement("div"), { className: "note bad", textContent: `${words} ` });
  note.setAttribute("role", "alert");
  const passing = !detail.xhr.status || [408, 429].includes(detail.xhr.status) || detail.xhr.status >= 500;
  if (passing && requestConfig.verb === "get") {
    const again = Object.assign(document.createElement("button"), { type: "button", textContent: "Ask again" });
    const how = { source: elt, target, swap: elt.getAttribute("hx-swap") || "innerHTML", select: elt.getAttribute("hx-select") };
    again.addEventListener("click", () => htmx.ajax("GET", requestConfig.path, how));
    note.append(again);
  }
  target.replaceChildren(note);
}

/** What a refusal says: the page's own, a document of the HTTP interface, or that of a proxy between. */
function said(xhr) {
  const loose = `The server refused this (${xhr.status}). Load the page anew and try again.`;
  try {
    if (xhr.getResponseHeader("Content-Type")?.includes("json")) return JSON.parse(xhr.response).detail || loose;
  } catch {
    return loose;
  }
  return new DOMParser().parseFromString(xhr.response, "text/html").querySelector('[role="alert"][data-code]')?.textContent.trim() || loose;
}

const refreshed = (detail) => detail.requestConfig.elt.getAttribute("hx-trigger")?.startsWith("every"); // it keeps what it shows

banner.querySelector("button").addEventListener("click", () => window.location.reload());
document.addEventListener("htmx:sendError", (event) => {
  missed();
  const { target, requestConfig } = event.detail;
  if (target && requestConfig.verb === "get" && !refreshed(event.detail)) instead(event.detail, "This part could not be loaded, because the server does not answer.");
});
document.addEventListener("htmx:beforeSwap", (event) => {
  const { xhr, requestConfig } = event.detail;
  if (xhr.status < 400) return;
  // A refusal has nothing of what is selected, and would leave no trace; where it took the place of its target, nothing
  // could be asked there again. One with more than a sentence stays as it is: it has the way out.
  event.detail.selectOverride = "unset";
  event.detail.swapOverride = "innerHTML";
  if (requestConfig.verb !== "get" && xhr.response.includes("data-code") && !xhr.response.startsWith("{")) return;
  event.detail.shouldSwap = false;
  if (!refreshed(event.detail)) instead(event.detail, said(xhr));
});
window.addEventListener("offline", missed);
document.addEventListener("visibilitychange", () => document.visibilityState === "visible" && look(0));
look(LOOK_MS);
