// The arm in 3-D (page/robot): fetches the chain, the measured places and the workspace, and draws what is asked for.
import { Address } from "./arm/address.js";
import { Asked } from "./arm/asked.js";
import { key } from "./arm/key.js";
import { Linked } from "./arm/linked.js";
import { arrows, cloud, heat, points, ROWS } from "./arm/parts.js";
import { Live } from "./arm/live.js";
import { Poses } from "./arm/poses.js";
import { rounded, Stage } from "./arm/stage.js";
import { fill, length, mm, quantile } from "./arm/words.js";

const STAGES = { identified: "this version", registration_only: "registration only", nominal: "the nominal robot" };
const SHARE = 0.12; // of the workspace that a large error is drawn as
const MOST_LISTED = 200;
const MANY = 2000; // points

class Picture extends Stage {
  constructor(place) {
    super(place);
    this.data = { places: null, reach: null };
    this.row = 0; // the measured one whose load and directions hold
    this.address = new Address();
  }

  async start() {
    await this.open(this.address.get("camera"));
    this.find("grid").textContent = `A cell of the grid is ${this.cell} mm. Axes of the robot's base: x orange, y green, z blue.${this.parts.ghost ? ` Pale: the nominal arm, its difference ${this.ghosted} times.` : ""}`;
    this.asked = new Asked(this);
    this.sliders();
    this.listen();
    const { version, campaign } = this.place.dataset;
    if (version && campaign) await this.loadPlaces(version, campaign);
    else this.say("There are no measured errors to show yet: a version and a campaign are needed.");
    this.begin();
    this.frame(this.data.places?.at);
    if (["q", "row", "cloud", "stage", "scale", "camera"].some((name) => this.address.get(name))) this.find("controls").open = true;
    this.place.dataset.ready = "yes";
  }

  looked() {
    this.draw();
    if (this.looking && !this.framing) this.address.set({ camera: this.looking.told() });
  }

  /** Show what the address says: a pose by its joints, or a measured row; else the worst row. */
  begin() {
    const joints = (this.address.get("q") || "").split(",").map(Number);
    const sizes = this.data.places ? this.left().map(length) : [];
    const held = this.data.places?.held_out.some(Boolean) ? this.data.places.held_out : sizes.map(() => true);
    const worst = sizes.reduce((found, size, k) => (held[k] && (found < 0 || size > sizes[found]) ? k : found), -1);
    if (this.data.places) this.toRow(Number(this.address.get("row")) || this.data.places.row[worst], false);
    if (joints.length === this.readings.length && joints.every(Number.isFinite)) this.pose(joints);
    else if (!this.data.places) this.asked.pose(this.readings, 0);
    const cloud = this.find("cloud");
    if (this.address.get("cloud")) {
      cloud.value = this.address.get("cloud");
      this.workspace();
    }
  }

  draw() {
    super.draw();
    this.linked?.mark();
  }

  sliders() {
    const made = this.chain.joints.map(({ name, unit, low, high }, k) => {
      const label = document.createElement("label");
      const told = document.createElement("span"); // an output would take the label from the slider
      const slider = Object.assign(document.createElement("input"), { type: "range", min: low, max: high, step: (high - low) / 1000 });
      slider.value = this.readings[k];
      slider.addEventListener("input", () => {
        const readings = this.readings.map((value, j) => (j === k ? Number(slider.value) : value));
        this.pose(readings);
        this.address.set({ q: readings.map((value) => value.toFixed(3)) });
      });
      label.append(`${name} `, told, slider);
      return { label, slider, told, unit };
    });
    this.joints = made;
    this.find("joints").replaceChildren(...made.map(({ label }) => label));
    this.tell();
  }

  tell() {
    this.joints.forEach(({ slider, told, unit }, k) => {
      slider.value = this.readings[k];
      told.textContent = `${this.readings[k].toFixed(1)}${unit === "deg" ? "°" : " mm"}`;
    });
  }

  pose(readings) {
    this.readings = readings;
    this.tell();
    this.drawArm();
    this.draw();
    this.asked.pose(readings, this.row);
  }

  listen() {
    this.find("stage").addEventListener("change", () => this.measured(true));
    this.find("scale").addEventListener("input", () => {
      this.errors();
      this.address.set({ scale: this.find("scale").value });
    });
    this.find("cloud").addEventListener("change", () => {
      this.workspace();
      this.address.set({ cloud: this.find("cloud").value });
    });
    this.find("to-row").addEventListener("change", (event) => this.toRow(Number(event.target.value)));
    this.place.querySelectorAll("[data-view]").forEach((button) => button.addEventListener("click", () => this.looking.go(button.dataset.view)));
  }

  async loadPlaces(version, campaign) {
    this.data.places = await this.get("places.json", { version, campaign });
    this.linked = this.place.linked = new Linked(this, campaign, version);
    this.find("stage").value = this.address.get("stage") || "identified";
    this.measured();
  }

  toRow(row, noted = true) {
    const k = this.data.places?.row.indexOf(row) ?? -1;
    if (k < 0) return this.say(`Row ${row} is not among those shown.`);
    this.row = row;
    this.find("to-row").value = row;
    if (noted) this.address.set({ row, q: null });
    this.pose(this.data.places.q[k]);
    return this.say(`The arm is drawn at row ${row}, where ${STAGES[this.find("stage").value]} is wrong by ${mm(length(this.left()[k]))}.`);
  }

  left() {
    return this.data.places.left[this.find("stage").value];
  }

  measured(chosen = false) {
    if (!this.data.places) return;
    const { at, held_out: held, set_aside: aside, row, total } = this.data.places;
    const left = this.left();
    const normal = held.map((one, k) => !one && !aside[k]);
    const less = at.length > MANY ? 0.4 : 1; // of very many the arm is still seen
    this.show("fitted", points(at, normal, ROWS.fitted, 5 * less));
    this.show("held", points(at, held.map((one, k) => one && !aside[k]), ROWS.held, 5 * less));
    this.show("aside", points(at, aside, ROWS.aside, 10));
    this.linked?.redraw();
    const sizes = left.map(length);
    const wanted = (SHARE * 2 * this.size) / (quantile(sizes, 0.95) || 1);
    const times = rounded(wanted);
    if (chosen) this.address.set({ stage: this.find("stage").value, scale: null });
    this.find("scale").value = this.address.get("scale") ?? Math.log10(times);
    this.errors();
    const some = row.length < total ? `${row.length} of ${total} rows are shown, the worst and the outermost among them` : `${total} rows`;
    const mean = sizes.reduce((sum, size) => sum + size, 0) / sizes.length;
    this.find("legend").textContent = `Grey points: rows that were fitted (${normal.filter(Boolean).length}). Green: held out (${held.filter(Boolean).length}). Large yellow: set aside (${aside.filter(Boolean).length}). Arrows: measured minus predicted, coloured by size.`;
    this.say(`${some}: ${STAGES[this.find("stage").value]} leaves ${mm(mean)} on average, at most ${mm(Math.max(...sizes))}.`);
    const order = sizes.map((_, k) => k).sort((a, b) => sizes[b] - sizes[a]).slice(0, MOST_LISTED);
    fill(this.place.querySelector('[data-table="places"]'), ["row", "x", "y", "z", "error x", "error y", "error z", "error", "use"],
      order.map((k) => [row[k], ...at[k].map((v) => v.toFixed(1)), ...left[k].map((v) => v.toFixed(4)), sizes[k].toFixed(4), aside[k] ? "set aside" : held[k] ? "held out" : "fitted"]),
      order.map((k) => `${this.linked.campaign}/${row[k]}`));
  }

  errors() {
    if (!this.data.places) return;
    const times = Number((10 ** Number(this.find("scale").value)).toPrecision(2));
    this.find("times").textContent = times;
    const sizes = this.left().map(length);
    const highest = quantile(sizes, 0.98) || 1;
    this.show("arrows", arrows(this.data.places.at, this.left(), times, (k) => heat(sizes[k] / highest), this.size));
    key(this.find("arrow-key"), `0, drawn ${times} times`, mm(highest), heat);
    this.draw();
  }

  async workspace() {
    const kind = this.find("cloud").value;
    const words = this.find("scale-words");
    this.show("cloud", null);
    words.textContent = "";
    this.find("colours").replaceChildren();
    if (kind && !this.place.dataset.version) words.textContent = "There is no version yet.";
    else if (kind) await this.coloured(kind, words);
    this.draw();
  }

  async coloured(kind, words) {
    words.textContent = "Computing …";
    this.data.reach ??= await this.get("reach.json", { version: this.place.dataset.version });
    const { at, before, after } = this.data.reach;
    const values = this.data.reach[kind];
    if (!values) {
      words.textContent = "This version does not know how certain it is: it was made without a covariance.";
      return;
    }
    const highest = quantile(values, 0.99) || 1;
    this.show("cloud", cloud(at, values, highest, 4));
    words.textContent = kind === "before"
      ? `Each point is a pose within the joint limits. Yellow: the tool is ${mm(highest)} or more from where the nominal robot expects it; dark: where it expects it.`
      : `Each point is a pose within the joint limits. Yellow: after the correction the tool is known to ${mm(highest)} (one standard deviation in the worst direction) or worse; dark: better. Errors that no effect describes are counted by what the fit left.`;
    key(this.find("colours"), "0", mm(highest));
    const line = (name, list) => [name, ...(list ? [quantile(list, 0.5), quantile(list, 0.95), Math.max(...list)].map(mm) : ["–", "–", "–"])];
    fill(this.place.querySelector('[data-table="reach"]'), ["", "median", "95 %", "largest"].map((text) => text || "of the poses"),
      [line("error before: movement by the correction", before), line("after: standard deviation", after)]);
  }
}

const KINDS = { poses: Poses, live: Live };
document.querySelectorAll("[data-arm]").forEach((place) => {
  const picture = new (KINDS[place.dataset.as] ?? Picture)(place);
  picture.start().catch((error) => {
    picture.say(error.message);
    place.dataset.ready = "refused";
  });
});
