// A job that ends while nobody looks: its tab says so by title and icon, and, where people asked for it, a notification.
const KEPT = "kilter-notify";
const LOOKS = { succeeded: ["✓", "#00664a"], failed: ["✗", "#b3261e"], cancelled: ["–", "#8a5300"] };

/** Offer to tell when the job is over; the browser asks once whether this page may. */
export function offer(place) {
  if (!("Notification" in window) || Notification.permission === "denied") return;
  const label = document.createElement("label");
  const box = Object.assign(document.createElement("input"), { type: "checkbox", checked: sessionStorage.getItem(KEPT) === place.dataset.follow && Notification.permission === "granted" });
  label.append(box, " Notify me when it is over");
  box.addEventListener("change", async () => {
    if (box.checked && (await Notification.requestPermission()) !== "granted") box.checked = false;
    if (box.checked) sessionStorage.setItem(KEPT, place.dataset.follow);
    else sessionStorage.removeItem(KEPT);
  });
  place.append(label);
}

/** Notify whoever asked for it; `data` is what the stream of events says at its end. */
export function ended(data) {
  const job = document.querySelector("[data-follow]");
  const wanted = job && sessionStorage.getItem(KEPT) === job.dataset.follow;
  if (!wanted || Notification.permission !== "granted") return;
  sessionStorage.removeItem(KEPT);
  const state = JSON.parse(data || "{}").state || "over";
  new Notification(`${document.querySelector("h1").firstChild.textContent.trim()}: ${state}`, { body: document.title.replace(/^\d+ % · /, ""), tag: job.dataset.follow });
}

// The tab of a job that is over has its mark before the title and in the icon.
const over = LOOKS[document.querySelector("[data-job-state]")?.dataset.jobState];
if (over) {
  const [mark, colour] = over;
  document.title = `${mark} ${document.title}`;
  const drawn = `<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32"><circle cx="16" cy="16" r="15" fill="${colour}"/><text x="16" y="23" font-size="20" text-anchor="middle" fill="#fff" font-family="sans-serif">${mark}</text></svg>`;
  document.querySelector('link[rel="icon"]').href = `data:image/svg+xml,${encodeURIComponent(drawn)}`;
}
