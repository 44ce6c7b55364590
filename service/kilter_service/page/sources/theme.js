// Runs before the page is drawn, so that a dark page does not flash white.
const kept = localStorage.getItem("kilter-theme");
if (kept) document.documentElement.dataset.theme = kept;
