// Runs before the page is drawn, so that a dark page does not flash white.
const kept = localStorage.getItem("kilter-theme");
if (kept) document.documentElement.dataset.theme = kept;
// The server draws figures as wide as there is room for them: from the next view, or the next part of this one, on.
const tell = () => (document.cookie = `kilter-width=${window.innerWidth}; path=${document.documentElement.dataset.root || ""}/; SameSite=Strict`);
tell();
window.addEventListener("resize", tell);
