// The live view of a stream: server-sent events into numbers, two plots and three tables.
// Numbers and plots follow every event; tables change once a second, so that they can be read.
import { drawn } from "./arm/words.js";

const SECONDS = 60;
const STALE_MS = 6000;
const CONDITIONS = { corrected: ["good", "corrected"], partly: ["warn", "partly refused"], bypass: ["bad", "bypass"], silent: ["faint", "no setpoints"] };
const COLOURS = 6; // --line-0 to --line-5 in the style sheet
const DASHES = [[], [6, 3], [2, 3], [8, 3, 2, 3], [1, 4], [12, 4]];

const place = document.querySelector("[data-stream]");
const robot = place.dataset.stream;
const names = JSON.parse(place.dataset.names); // of versions, by id
const root = document.documentElement.dataset.root || "";
const part = (name) => place.querySelector(`[data-live="${name}"]`);
const sections = new Map();
let heardAt = performance.now();
let updates = 0;

function number(value, digits = 3) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const decimals = digits - 1 - Math.floor(Math.log10(Math.abs(value)));
  return decimals > 0 ? value.toFixed(Math.min(decimals, 9)) : (Math.round(value * 10 ** decimals) / 10 ** decimals).toFixed(0);
}
const fixed = (value, unit) => `${value.toFixed(unit === "deg" ? 4 : 3)} ${unit === "deg" ? "°" : unit}`;
const count = (value) => value.toString().replace(/\B(?=(\d{3})+(?!\d))/g, "\u202f");
const length = (mm) => (mm === null ? "–" : mm < 0.0995 ? `${(mm * 1000).toFixed(0)} µm` : `${mm.toFixed(3)} mm`);
const age = (seconds) => (seconds < 2 ? "now" : seconds < 120 ? `${seconds.toFixed(0)} s ago` : `${(seconds / 60).toFixed(0)} minutes ago`);

/** Write a text only where it changed: whoever listens is not told the same again. */
function write(element, text) {
  if (element && element.textContent !== text) element.textContent = text;
}

function link(element, version, after) {
  const text = version ? (names[version] ?? version) + after : after;
  if (element.textContent.replace(/\s+/g, " ").trim() === text) return;
  element.textContent = "";
  if (version) {
    const anchor = document.createElement("a");
    anchor.href = `${root}/versions/${version}`;
    anchor.textContent = names[version] ?? version;
    element.append(anchor);
  }
  element.append(after);
}

function rows(table, cells) {
  const body = table.tBodies[0];
  body.textContent = "";
  for (const row of cells) {
    const line = body.insertRow();
    row.forEach((cell, k) => {
      const box = document.createElement(k ? "td" : "th");
      if (k) box.className = cell instanceof Node ? "barbox" : /^[-\d–]/.test(cell) ? "number" : "";
      else box.scope = "row";
      box.append(cell);
      line.append(box);
    });
  }
}

function bar(share) {
  const box = document.createElement("span");
  box.className = "bar";
  box.style.width = `${(100 * share).toFixed(1)}%`;
  return box;
}

/** A stream's section: its elements, and the last minute of its numbers. */
class Section {
  constructor(name, minute = []) {
    this.minute = minute; // what the server knew when the view was opened
    this.element = document.getElementById("stream-section").content.firstElementChild.cloneNode(true);
    this.element.dataset.name = name;
    this.times = [];
    this.joints = [];
    this.tool = [];
    this.tablesAt = 0;
    this.named = "";
  }

  field(name) {
    return this.element.querySelector(`[data-field="${name}"]`);
  }

  show(stream, active) {
    const [look, words] = CONDITIONS[stream.condition];
    write(this.field("name"), stream.name);
    write(this.field("condition"), words);
    this.field("condition").className = `badge ${look}`;
    write(this.field("words"), stream.words);
    write(this.field("rate"), stream.rate_hz === null ? "–" : `${number(stream.rate_hz)} /s`);
    write(this.field("seen"), age(stream.seen_s));
    write(this.field("counts"), `${count(stream.received)} setpoints, ${count(stream.corrected)} corrected`);
    write(this.field("made"), stream.made.join(", ") || "complete");
    write(this.field("signed"), stream.signed ? "signed" : "not signed");
    write(this.field("time"), stream.times && stream.times.p99_us ? `${number(stream.times.p99_us)} µs` : "–");
    link(this.field("version"), stream.version_id, !stream.version_id ? "none" : stream.version_id === active ? ", the active one" : ", not the active one");
    const moves = stream.condition !== "silent" && stream.condition !== "bypass";
    write(this.field("tool"), moves ? length(stream.tool_mm) : "–");
    write(this.field("left"), moves ? length(stream.left_mm) : "–");
    const held = Object.entries(stream.held_back).map(([name, n]) => `${count(n)} ${name}`).join(", ");
    write(this.field("held"), (held || "none") + (stream.most_left_mm === null ? "" : `; at most ${length(stream.most_left_mm)} left`));
    write(this.field("joint"), moves && stream.joints.length ? this.largest(stream.joints) : "–");
    if (stream.joints.length) this.plot(stream, moves);
    this.element.querySelector("[data-plots]").hidden = !this.joints.some((line) => line.some((value) => value !== null));
    if (performance.now() - this.tablesAt > 1000) this.tables(stream);
  }

  largest(joints) {
    const deg = joints.filter((joint) => joint.unit === "deg");
    const of = deg.length ? deg : joints;
    const most = of.reduce((a, b) => (Math.abs(b.correction) > Math.abs(a.correction) ? b : a));
    return fixed(Math.abs(most.correction), most.unit);
  }

  tables(stream) {
    this.tablesAt = performance.now();
    const table = (name) => this.element.querySelector(`[data-table="${name}"]`);
    rows(table("joints"), stream.joints.map((joint) => [joint.name, ...[joint.wanted, joint.correction].map((value) => fixed(value, joint.unit).split(" ")[0]), joint.unit]));
    const refused = Object.entries(stream.refusals);
    rows(table("refusals"), refused.length ? refused.map(([name, n]) => [name, count(n)]) : [["none", "0"]]);
    const times = stream.times;
    if (!times) return;
    const shown = times.counts.map((n, k) => [n, k]).filter(([n]) => n);
    const most = Math.log1p(Math.max(...shown.map(([n]) => n)));
    const to = (k) => (k + 1 < times.from_us.length ? ` – ${number(times.from_us[k + 1], 2)}` : " and more");
    rows(table("times"), shown.map(([n, k]) => [`${number(times.from_us[k], 2)}${to(k)}`, count(n), bar(Math.log1p(n) / most)]));
  }

  plot(stream, moves) {
    const names = stream.joints.map((joint) => joint.name + joint.unit).join();
    if (names !== this.named) this.begin(stream.joints, names);
    const now = Date.now() / 1000;
    this.times.push(now);
    this.joints.forEach((line, k) => line.push(moves ? stream.joints[k].correction : null));
    this.tool.push(moves ? stream.tool_mm : null);
    while (this.times[0] < now - SECONDS) [this.times, this.tool, ...this.joints].forEach((line) => line.shift());
    if (document.hidden || !moves && !this.joints[0].some((value) => value !== null)) return;
    this.jointPlot.setData([this.times, ...this.joints]);
    this.toolPlot.setData([this.times, this.tool]);
  }

  begin(joints, names) {
    const known = this.named ? [] : this.minute.filter((one) => one.joints.length === joints.length);
    this.named = names;
    this.times = known.map((one) => one.at_s);
    this.tool = known.map((one) => one.tool_mm);
    this.joints = joints.map((_, k) => known.map((one) => one.joints[k]));
    const lines = joints.map((joint, k) => ({
      label: joint.name, scale: joint.unit, stroke: () => colour(k), dash: DASHES[k % DASHES.length], width: 2, points: { show: false },
    }));
    const units = [...new Set(joints.map((joint) => joint.unit))];
    this.jointPlot?.destroy();
    this.toolPlot?.destroy();
    this.jointPlot = draw(this.element.querySelector('[data-plot="joints"]'), lines, units);
    this.toolPlot = draw(this.element.querySelector('[data-plot="tool"]'), [{ label: "tool", scale: "mm", stroke: () => colour(0), width: 2, points: { show: false } }], ["mm"]);
    this.element.querySelector("[data-keys]").replaceChildren(...joints.map((joint, k) => key(joint.name, k)));
  }
}

const colour = (k) => getComputedStyle(document.documentElement).getPropertyValue(`--line-${k % COLOURS}`);

/** An entry of the legend: the line as it is drawn, and its name. */
function key(name, k) {
  const of = { x1: 0, x2: 28, y1: 6, y2: 6, "stroke-width": 2, class: `line-${k % COLOURS}`, "stroke-dasharray": DASHES[k % DASHES.length].join(" ") };
  const entry = document.createElement("span");
  entry.append(drawn("svg", { width: 28, height: 12, "aria-hidden": "true" }, drawn("line", of)), ` ${name}`);
  return entry;
}

const ink = () => getComputedStyle(document.body).color;

const CALM = { deg: 0.005, mm: 0.05 }; // a correction that is smaller is drawn small: noise does not look like an event

/** An axis that holds zero and the largest so far: it grows, and never shrinks. */
function steady(unit, both) {
  let most = CALM[unit];
  return (_, low, high) => {
    most = Math.max(most, Math.abs(low ?? 0), Math.abs(high ?? 0));
    return [both ? -1.15 * most : 0, 1.15 * most];
  };
}

function draw(element, lines, units) {
  const faint = { stroke: "rgba(128, 128, 128, 0.25)", width: 1 };
  const names = { deg: "degrees", mm: "mm" };
  const upright = (unit, k) => ({ scale: unit, label: names[unit], side: k ? 1 : 3, stroke: ink, grid: k ? { show: false } : faint, size: 62, labelSize: 22 });
  const made = new window.kilter.uPlot({
    width: element.clientWidth || 480,
    height: 220,
    legend: { show: false },
    cursor: { show: false },
    scales: { ...Object.fromEntries(units.map((unit) => [unit, { range: steady(unit, lines.length > 1) }])), x: { time: true, range: () => [Date.now() / 1000 - SECONDS, Date.now() / 1000] } },
    series: [{}, ...lines],
    axes: [{ stroke: ink, grid: faint, space: 90, values: (_, ticks) => ticks.map((tick) => new Date(1000 * tick).toLocaleTimeString([], { hour12: false })) }, ...units.map(upright)],
  }, [[], ...lines.map(() => [])], element);
  new ResizeObserver(() => element.clientWidth && made.setSize({ width: element.clientWidth, height: 220 })).observe(element);
  return made;
}

function show(told) {
  heardAt = performance.now();
  updates += 1;
  place.dataset.updates = updates;
  part("stale").hidden = true;
  write(part("why"), told.bypass.replaceAll("`", ""));
  part("bypass").hidden = !told.bypass;
  place.classList.toggle("bypassed", Boolean(told.bypass));
  const at = told.since ? told.since.replace("T", " ").replace("+00:00", " UTC") : "";
  const reach = { connected: `answers; it started ${at}`, connecting: "is being asked", elsewhere: "runs on another machine; its numbers come every two seconds", away: "does not answer" };
  write(part("corrector"), reach[told.reach]);
  link(part("active"), told.active_version, told.active_version ? "" : "none: every setpoint is refused");
  const activation = part("activation");
  if (activation) activation.hidden = activation.dataset.version !== told.active_version;
  part("none").hidden = told.streams.length > 0;
  write(part("since"), at ? `since the corrector started, ${at}` : "that this server knows of");
  const opening = document.querySelector("[data-opening]"); // what the server said when the view was opened
  if (opening) opening.hidden = Boolean(told.bypass) || told.reach === "away" || told.streams.length !== Number(opening.dataset.opening);
  const moving = told.streams.find((stream) => stream.joints.length);
  if (moving) document.dispatchEvent(new CustomEvent("kilter:setpoint", { detail: moving.joints.map((joint) => joint.wanted) }));
  for (const stream of told.streams) {
    if (!sections.has(stream.name)) add(stream.name);
    sections.get(stream.name).show(stream, told.active_version);
  }
  const order = told.streams.map((stream) => sections.get(stream.name).element);
  if (order.some((element, k) => part("streams").children[k] !== element)) part("streams").replaceChildren(...order);
  for (const [name, section] of sections) if (!told.streams.some((stream) => stream.name === name)) remove(name, section);
  const running = told.streams.filter((stream) => stream.condition !== "silent");
  write(part("summary"), told.bypass ? "Bypass." : running.length ? `Running: ${running.map((stream) => `${stream.name}, ${CONDITIONS[stream.condition][1]}`).join("; ")}.` : "No stream is running.");
}

function add(name) {
  const there = [...part("streams").children].find((one) => one.dataset.name === name);
  const section = new Section(name, JSON.parse(there?.dataset.minute || "[]"));
  if (there) there.replaceWith(section.element);
  else part("streams").append(section.element);
  sections.set(name, section);
}

function remove(name, section) {
  section.element.remove();
  sections.delete(name);
}

// EventSource comes again by itself after a break; only a refusal ends it, such as that of a login which has ended.
const source = new EventSource(`${root}/robots/${encodeURIComponent(robot)}/stream/events`);
source.addEventListener("live", (event) => show(JSON.parse(event.data)));
source.addEventListener("error", () => {
  if (source.readyState === EventSource.CLOSED) setTimeout(() => window.location.reload(), 5000);
});
setInterval(() => {
  const stale = performance.now() - heardAt >= STALE_MS;
  part("stale").hidden = !stale;
  if (stale) part("bypass").hidden = true; // one bar at a time: what is old says nothing of now
}, 500);
