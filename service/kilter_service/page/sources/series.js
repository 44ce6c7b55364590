// data-series="PATH"   a column of a campaign, row by row: the server sends the least and the greatest value of each pixel
import { row } from "./arm/words.js";

const TABLE_ROWS = 20;
const MOST_MARKED = 500; // as many as the server takes

function start(form) {
  const card = form.parentElement;
  const place = card.querySelector("[data-series-plot]");
  const told = form.querySelector("[data-series-told]");
  const body = card.querySelector("[data-series-table]");
  const select = form.querySelector("select");
  const marked = { doubtful: numbers(form.dataset.doubtful), aside: numbers(form.dataset.aside) };
  const all = [1, Number(form.dataset.rows)];
  let plot = null;
  let shown = all;
  let asked = 0;
  let shifted = false; // dragging with Shift chooses rows, else it looks closer
  let drawn = null;
  const campaign = form.dataset.series.split("/")[2];
  const picked = window.kilter.rows;

  async function load(first, last) {
    const mine = ++asked;
    const began = performance.now();
    const others = [...marked.aside, ...marked.doubtful].filter((row) => row >= first && row <= last);
    const keep = [...picked.of(campaign).within(first, last, MOST_MARKED), ...others].slice(0, MOST_MARKED);
    const query = new URLSearchParams({ column: select.value, first, last, width: Math.max(200, Math.round(place.clientWidth)), keep });
    const answer = await window.kilter.send(`${form.dataset.series}?${query}`);
    if (mine !== asked) return;
    if (!answer.ok) {
      told.textContent = `This cannot be shown (${answer.status}).`;
      return;
    }
    const found = await answer.json();
    shown = [first, last];
    drawn = found;
    draw(found);
    table(found);
    told.textContent = `Rows ${first} to ${last} of ${found.rows}`;
    form.dataset.took = String(Math.round(performance.now() - began));
    form.dataset.drawn = `${select.value} ${first} ${last}`;
  }

  function draw(found) {
    const ink = () => getComputedStyle(document.body).color; // asked at each drawing: light and dark change meanwhile
    const axis = { stroke: ink, grid: { stroke: "#80808040" }, ticks: { stroke: "#80808080" } };
    const label = select.selectedOptions[0].dataset.label;
    const options = {
      width: Math.max(280, place.clientWidth), height: 320, scales: { x: { time: false } }, cursor: { drag: { x: true, y: false } },
      axes: [{ ...axis, label: "Row" }, { ...axis, label, size: 70 }],
      series: [
        { label: "Row" }, { label, stroke: "#0072b2", width: 1.2, points: { show: found.x.length < 400, size: 4 } },
        { label: "Looks wrong", stroke: "#d55e00", paths: () => null, points: { show: true, size: 9, fill: "#d55e00" } },
        { label: "Set aside", stroke: "#e69f00", paths: () => null, points: { show: true, size: 11, fill: "#e69f0000", width: 2 } },
        { label: "Chosen", stroke: "#cc79a7", paths: () => null, points: { show: true, size: 14, fill: "#cc79a700", width: 3 } },
      ],
      hooks: { setSelect: [(u) => zoom(u)], setCursor: [(u) => point(u, found)], ready: [(u) => pick(u, found)] },
    };
    plot?.destroy();
    place.replaceChildren();
    plot = new window.kilter.uPlot(options, lines(found), place);
  }

  function lines(found) {
    const marks = (rows) => found.x.map((row, k) => (rows.has(row) ? found.y[k] : null));
    return [found.x, found.y, marks(marked.doubtful), marks(marked.aside), marks(picked.of(campaign))];
  }

  const redraw = () => requestAnimationFrame(() => plot?.redraw());
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  document.querySelector("[data-theme-switch]")?.addEventListener("click", redraw);

  function zoom(u) {
    if (u.select.width < 4) return;
    const first = Math.max(all[0], Math.floor(u.posToVal(u.select.left, "x")));
    const last = Math.min(all[1], Math.ceil(u.posToVal(u.select.left + u.select.width, "x")));
    if (shifted) picked.toggle(campaign, Array.from({ length: last - first + 1 }, (_, k) => first + k), true);
    else if (last > first) load(first, last);
    if (shifted) u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
  }

  function point(u, found) {
    const { idx, event } = u.cursor;
    if (idx == null || !event || event.buttons || u.cursor.left < 0) picked.leave();
    else picked.point(campaign, found.x[idx], event.clientX, event.clientY);
  }

  function pick(u, found) {
    u.over.addEventListener("mousedown", (event) => (shifted = event.shiftKey), { capture: true });
    u.over.addEventListener("click", () => {
      if (u.select.width < 4 && u.cursor.idx != null) picked.toggle(campaign, [found.x[u.cursor.idx]]);
    });
  }

  function table(found) {
    const step = Math.max(1, Math.ceil(found.x.length / TABLE_ROWS));
    const rows = [];
    for (let k = 0; k < found.x.length; k += step) {
      const part = found.y.slice(k, k + step).filter((value) => value !== null);
      const ends = part.length ? [Math.min(...part), Math.max(...part)].map((value) => value.toPrecision(6)) : ["–", "–"];
      rows.push(row([`${found.x[k]} to ${found.x[Math.min(k + step, found.x.length) - 1]}`, ...ends]));
    }
    body.replaceChildren(...rows);
  }

  select.addEventListener("change", () => load(...shown));
  form.addEventListener("submit", (event) => event.preventDefault());
  form.querySelector("[data-series-all]").addEventListener("click", () => load(...all));
  window.addEventListener("resize", () => plot?.setSize({ width: Math.max(280, place.clientWidth), height: 320 }));
  load(...all);
  picked.watch(() => {
    if (!drawn) return;
    plot.setData(lines(drawn), false);
    plot.redraw();
    const some = picked.of(campaign).within(...shown, MOST_MARKED + 1);
    const there = new Set(drawn.x);
    if (some.length <= MOST_MARKED && some.some((row) => !there.has(row))) load(...shown); // one that is chosen was not among those drawn
  });
}

function numbers(text) {
  return new Set(text ? text.split(",").map(Number) : []);
}

document.querySelectorAll("[data-series]").forEach(start);
