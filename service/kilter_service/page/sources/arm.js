// The arm in 3-D (page/robot): fetches the chain, the measured places and the workspace, and draws what is asked for.
import { Box3, PerspectiveCamera, Scene, Sphere, Vector3, WebGLRenderer } from "three";
import { Address } from "./arm/address.js";
import { Asked } from "./arm/asked.js";
import { posed } from "./arm/chain.js";
import { Looking } from "./arm/camera.js";
import { furniture } from "./arm/furniture.js";
import { key } from "./arm/key.js";
import { Linked } from "./arm/linked.js";
import { arm, arrows, cloud, mesh, points, release, ROWS } from "./arm/parts.js";
import { fill, length, mm, quantile } from "./arm/words.js";

const STAGES = { identified: "this version", registration_only: "registration only", nominal: "the nominal robot" };
const SHARE = 0.12; // of the workspace that a large error is drawn as
const MOST_LISTED = 200;
const MANY = 2000; // points

class Picture {
  constructor(place) {
    this.place = place;
    this.canvas = place.querySelector("canvas");
    this.scene = new Scene();
    this.parts = {};
    this.data = { places: null, reach: null };
    this.row = 0; // the measured one whose load and directions hold
    this.address = new Address();
  }

  find(name) {
    return this.place.querySelector(`[data-${name}]`);
  }

  say(text) {
    this.find("said").textContent = this.renderer === null ? `This browser has no WebGL, so the arm is not drawn: plot and tables have its numbers. ${text}` : text;
  }

  async start() {
    this.chain = await this.get("arm.json");
    this.meshes = await this.loadMeshes();
    this.readings = this.chain.joints.map(({ low, high }) => Math.min(Math.max(0, low), high));
    this.size = this.reachOf();
    this.renderer = this.drawing();
    this.camera = new PerspectiveCamera(40, 1, this.size / 100, this.size * 30);
    this.camera.up.set(0, 0, 1);
    const { group, cell } = furniture(this.size);
    this.scene.add(group);
    this.find("grid").textContent = `A cell of the grid is ${cell} mm. Axes of the robot's base: x orange, y green, z blue.`;
    this.sliders();
    this.drawArm();
    new ResizeObserver(() => this.fit()).observe(this.canvas.parentElement);
    this.asked = new Asked(this);
    const { center, radius } = this.around();
    this.looking = new Looking(this.camera, this.canvas, center, 1.2 * radius / Math.sin((20 * Math.PI) / 180), () => this.looked(), this.address.get("camera"));
    this.listen();
    this.fit();
    const { version, campaign } = this.place.dataset;
    if (version && campaign) await this.loadPlaces(version, campaign);
    else this.say("There are no measured errors to show yet: a version and a campaign are needed.");
    this.begin();
    this.frame();
    if (["q", "row", "cloud", "stage", "scale", "camera"].some((name) => this.address.get(name))) this.find("controls").open = true;
    this.place.dataset.ready = "yes";
  }

  /** What draws; null without WebGL: all but the picture goes on. */
  drawing() {
    try {
      const renderer = new WebGLRenderer({ canvas: this.canvas, antialias: true, alpha: true });
      renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
      return renderer;
    } catch {
      this.canvas.hidden = true;
      return null;
    }
  }

  async get(name, asked = {}) {
    const answer = await fetch(`${this.place.dataset.arm}/${name}?${new URLSearchParams(asked)}`, { headers: { "HX-Request": "true" } });
    if (answer.ok) return answer.json();
    const refused = new DOMParser().parseFromString(await answer.text(), "text/html");
    throw new Error(refused.body.textContent.trim());
  }

  reachOf() {
    const { segments, flange, tool } = posed(this.chain, this.readings);
    return segments.reduce((sum, [from, to]) => sum + from.distanceTo(to), flange.distanceTo(tool)) * 0.6 || 500;
  }

  /** The ball that holds the arm as it is drawn and its base. */
  around() {
    const { segments, tool } = posed(this.chain, this.readings);
    const box = new Box3().setFromPoints([new Vector3(), tool, ...segments.flatMap(([from, to]) => [from, to])]);
    const ball = box.getBoundingSphere(new Sphere());
    return { center: ball.center, radius: Math.max(ball.radius, 0.7 * this.size) };
  }

  /** Look at the arm as it is drawn, and at all that was measured. */
  frame() {
    const { segments, tool } = posed(this.chain, this.readings);
    const measured = (this.data.places?.at ?? []).map((one) => new Vector3(...one));
    const points = [new Vector3(), tool, ...segments.flatMap(([from, to]) => [from, to]), ...measured];
    this.framing = true; // which is nothing that the address keeps
    this.looking.frame(points, new Box3().setFromPoints(points).getCenter(new Vector3()));
    this.framing = false;
    this.draw();
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

  show(name, object) {
    release(this.parts[name]);
    this.parts[name] = object;
    if (object) this.scene.add(object);
  }

  fit() {
    if (!this.renderer) return;
    const width = this.canvas.parentElement.clientWidth;
    const height = Math.round(Math.min(0.85 * width, Math.max(0.3 * window.innerHeight, 270)));
    this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.draw();
  }

  draw() {
    this.renderer?.render(this.scene, this.camera);
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

  drawArm() {
    const pose = posed(this.chain, this.readings);
    this.show("arm", arm(pose, this.size, this.meshes));
    this.place.dataset.tool = pose.tool.toArray().map((value) => value.toFixed(2)).join(" ");
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

  async loadMeshes() {
    const loaded = await Promise.all(this.chain.meshes.map(async (link) => {
      const answer = await fetch(`${this.place.dataset.arm}/meshes/${encodeURIComponent(link)}`);
      return answer.ok ? [[link, mesh(new Float32Array(await answer.arrayBuffer()))]] : []; // else it stays a cylinder
    }));
    return Object.fromEntries(loaded.flat());
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
    this.show("fitted", points(at, normal, ROWS.fitted, 6 * less));
    this.show("held", points(at, held.map((one, k) => one && !aside[k]), ROWS.held, 8 * less));
    this.show("aside", points(at, aside, ROWS.aside, 12));
    this.linked?.redraw();
    const sizes = left.map(length);
    const wanted = (SHARE * 2 * this.size) / (quantile(sizes, 0.95) || 1);
    const times = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000].filter((one) => one <= wanted).pop() ?? 1;
    if (chosen) this.address.set({ stage: this.find("stage").value, scale: null });
    this.find("scale").value = this.address.get("scale") ?? Math.log10(times);
    this.errors();
    const some = row.length < total ? `${row.length} of ${total} rows are shown, the worst and the outermost among them` : `${total} rows`;
    const mean = sizes.reduce((sum, size) => sum + size, 0) / sizes.length;
    this.find("legend").textContent = `Grey points: rows that were fitted (${normal.filter(Boolean).length}). Green: held out (${held.filter(Boolean).length}). Large yellow: set aside (${aside.filter(Boolean).length}). Red arrows: measured minus predicted.`;
    this.say(`${some}: ${STAGES[this.find("stage").value]} leaves ${mm(mean)} on average, at most ${mm(Math.max(...sizes))}.`);
    const order = sizes.map((_, k) => k).sort((a, b) => sizes[b] - sizes[a]).slice(0, MOST_LISTED);
    fill(this.place.querySelector('[data-table="places"]'), ["row", "x", "y", "z", "error x", "error y", "error z", "error", "use"],
      order.map((k) => [row[k], ...at[k].map((v) => v.toFixed(1)), ...left[k].map((v) => v.toFixed(4)), sizes[k].toFixed(4), aside[k] ? "set aside" : held[k] ? "held out" : "fitted"]),
      order.map((k) => `${this.linked.campaign}/${row[k]}`));
  }

  errors() {
    if (!this.data.places) return;
    const times = Math.round(10 ** Number(this.find("scale").value));
    this.find("times").textContent = times;
    this.show("arrows", arrows(this.data.places.at, this.left(), times, ROWS.error, this.size));
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

document.querySelectorAll("[data-arm]").forEach((place) => {
  const picture = new Picture(place);
  picture.start().catch((error) => {
    picture.say(error.message);
    place.dataset.ready = "refused";
  });
});
