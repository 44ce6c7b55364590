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
    const at = new Date().toLocaleTimeString([], { hour: "2-digit", minute: "2-digit" });
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

/** In place of a part that did not come: why, and a button that asks for it again. */
function instead(target, path) {
  const note = Object.assign(document.createElement("div"), { className: "note bad", textContent: "This part could not be loaded, because the server does not answer. " });
  const again = Object.assign(document.createElement("button"), { type: "button", textContent: "Ask again" });
  again.addEventListener("click", () => htmx.ajax("GET", path, { target, swap: "innerHTML" }));
  note.append(again);
  note.setAttribute("role", "alert");
  target.replaceChildren(note);
}

banner.querySelector("button").addEventListener("click", () => window.location.reload());
document.addEventListener("htmx:sendError", (event) => {
  missed();
  const { target, requestConfig } = event.detail;
  const refreshed = event.detail.elt.getAttribute("hx-trigger")?.startsWith("every"); // it keeps what it shows
  if (target && requestConfig.verb === "get" && !refreshed) instead(target, requestConfig.path);
});
document.addEventListener("htmx:beforeSwap", (event) => {
  if (!event.detail.xhr.getResponseHeader("Content-Type")?.includes("json")) return;
  const note = Object.assign(document.createElement("div"), { className: "note bad" });
  note.setAttribute("role", "alert");
  try {
    note.textContent = JSON.parse(event.detail.serverResponse).detail;
  } catch {
    note.textContent = `The server refused this (${event.detail.xhr.status}). Load the page anew and try again.`;
  }
  event.detail.serverResponse = note.outerHTML;
});
window.addEventListener("offline", missed);
document.addEventListener("visibilitychange", () => document.visibilityState === "visible" && look(0));
look(LOOK_MS);
