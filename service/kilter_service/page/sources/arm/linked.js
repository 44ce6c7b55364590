// The rows of the picture: coloured by any column, drawn over any other, pointed at, and chosen together with all other views.
import { Vector3 } from "three";
import { key } from "./key.js";
import { pickable } from "./picking.js";
import { cloud, colourOf, css, points, ROWS } from "./parts.js";
import { ends, Scatter } from "./scatter.js";
import { length } from "./words.js";

const OWN = { use: "use: fitted, held out, set aside", row: "row", error: "error, µm", residual_sigma: "standard deviations" };

export class Linked {
  constructor(picture, campaign, version) {
    Object.assign(this, { picture, campaign, version, columns: {} });
    this.scatter = new Scatter(picture.find("scatter"));
    this.selects = Object.fromEntries(["colour", "across", "up"].map((name) => [name, picture.find(name)]));
    this.boxing = picture.find("boxing");
    this.offer(picture.data.places.columns, picture.chain.joints);
    this.listen();
  }

  /** What rows may be coloured by and drawn over: their use, their error in three ways, and every column measured. */
  offer(columns, joints) {
    const motions = joints.map(({ name, unit }) => [`joint:${name}`, `error as motion of ${name}, ${unit}`]);
    const errors = [["error", OWN.error], ["residual_sigma", OWN.residual_sigma], ...motions];
    const give = (select, list) => select.replaceChildren(...list.map(([value, text]) => new Option(text, value)));
    give(this.selects.up, errors);
    give(this.selects.across, [["row", OWN.row], ...columns]);
    give(this.selects.colour, [["use", OWN.use], ["row", OWN.row], ...errors, ...columns]);
  }

  listen() {
    const { places } = this.picture.data;
    for (const [name, select] of Object.entries(this.selects)) {
      const told = this.picture.address.get(name);
      if ([...select.options].some(({ value }) => value === told)) select.value = told;
      select.addEventListener("change", () => {
        this.picture.address.set({ [name]: select.selectedIndex ? select.value : null });
        this.redraw();
      });
    }
    this.boxing.addEventListener("click", () => this.boxing.setAttribute("aria-pressed", String(!this.boxed())));
    const shared = {
      hover: (k, event) => (k < 0 ? window.kilter.rows.leave() : window.kilter.rows.point(this.campaign, places.row[k], event.clientX, event.clientY)),
      box: (found) => found.length && window.kilter.rows.toggle(this.campaign, found.map((k) => places.row[k]), true),
      click: (k) => {
        window.kilter.rows.toggle(this.campaign, [places.row[k]]);
        this.picture.toRow(places.row[k]);
      },
    };
    pickable(this.picture.canvas, { ...shared, places: () => this.projected(), boxing: (event) => event.shiftKey || this.boxed(), hold: (on) => this.picture.looking.hold(on) });
    pickable(this.scatter.canvas, { ...shared, places: () => this.scatter.places, boxing: () => true });
    window.kilter.rows.watch(() => this.redraw());
    const redraw = () => requestAnimationFrame(() => this.plot());
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
    document.querySelector("[data-theme-switch]")?.addEventListener("click", redraw);
    new ResizeObserver(redraw).observe(this.scatter.canvas.parentElement);
  }

  boxed() {
    return this.boxing.getAttribute("aria-pressed") === "true";
  }

  /** Where the points are on the canvas, x and y after one another. */
  projected() {
    const { canvas, camera, data } = this.picture;
    const out = new Float32Array(2 * data.places.at.length);
    const at = new Vector3();
    data.places.at.forEach((place, k) => {
      at.set(...place).project(camera);
      const seen = Math.abs(at.z) <= 1;
      out[2 * k] = seen ? (0.5 + at.x / 2) * canvas.clientWidth : NaN;
      out[2 * k + 1] = (0.5 - at.y / 2) * canvas.clientHeight;
    });
    return out;
  }

  async values(name) {
    const { places } = this.picture.data;
    if (name === "row") return places.row;
    if (name === "error") return this.picture.left().map((one) => 1e3 * length(one));
    this.columns[name] ??= fetch(`${window.kilter.root}/campaigns/${this.campaign}/values.json?${new URLSearchParams({ version: this.version, column: name })}`)
      .then((answer) => (answer.ok ? answer.json() : { values: [] }))
      .then((found) => places.row.map((_, k) => found.values[k] ?? NaN));
    return this.columns[name];
  }

  async redraw() {
    const { picture } = this;
    const [x, y, z] = await Promise.all([this.selects.across, this.selects.up, this.selects.colour].map((select) => (select.value === "use" ? null : this.values(select.value))));
    Object.assign(this, { x, y });
    this.colours = this.coloured(z);
    const { at, row } = picture.data.places;
    const mine = row.map((one) => window.kilter.rows.has(this.campaign, one));
    this.chosen = row.map((_, k) => k).filter((k) => mine[k]);
    picture.show("chosen", this.chosen.length ? points(at, mine, ROWS.chosen, 15, true) : null);
    picture.draw();
    this.plot();
    picture.place.dataset.chosen = this.chosen.length;
  }

  /** Give each row its colour, in the picture and in the plot. */
  coloured(values) {
    const { picture } = this;
    const { at, held_out: held, set_aside: aside } = picture.data.places;
    const words = picture.find("row-colours");
    for (const name of ["fitted", "held", "aside"]) if (picture.parts[name]) picture.parts[name].visible = !values;
    if (!values) {
      picture.show("coloured", null);
      words.replaceChildren();
      return held.map((one, k) => css(aside[k] ? ROWS.aside : one ? ROWS.held : ROWS.fitted));
    }
    const [low, high] = ends(values);
    const shares = values.map((value) => (Number.isFinite(value) ? (value - low) / (high - low || 1) : 0));
    picture.show("coloured", cloud(at, shares, 1, 8));
    key(words, low.toPrecision(4), high.toPrecision(4));
    return shares.map((share) => `rgb(${colourOf(share).join(",")})`);
  }

  plot() {
    if (!this.x) return;
    const label = (select) => select.selectedOptions[0].textContent;
    const { across, up } = this.selects;
    this.scatter.draw({ values: this.x, label: label(across) }, { values: this.y, label: label(up), zero: !up.value.startsWith("joint:") }, this.colours, this.chosen);
    this.scatter.canvas.dataset.drawn = `${up.value} ${across.value}`;
  }
}
