// The rows of the picture: coloured by any column, drawn over any other, pointed at, and chosen together with all other views.
import { Matrix4 } from "three";
import { key } from "./key.js";
import { Marks } from "./marks.js";
import { pickable } from "./picking.js";
import { cloud, colourOf, css, ROWS } from "./parts.js";
import { ends, Scatter } from "./scatter.js";
import { length, unitOf } from "./words.js";

const OWN = { use: "use in the fit", row: "row", error: "error", residual_sigma: "standard deviations" };

export class Linked {
  constructor(picture, campaign, version) {
    Object.assign(this, { picture, campaign, version, columns: {}, chosen: [] });
    this.at = Float32Array.from(picture.data.places.at.flat());
    this.marks = new Marks(picture.canvas);
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
    window.kilter.rows.watch(() => this.choose());
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
    const { canvas: { clientWidth: width, clientHeight: height }, camera } = this.picture;
    camera.updateMatrixWorld();
    const m = new Matrix4().multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse).elements;
    const out = new Float32Array((2 * this.at.length) / 3);
    for (let k = 0; k < out.length / 2; k += 1) {
      const [x, y, z] = [this.at[3 * k], this.at[3 * k + 1], this.at[3 * k + 2]];
      const [far, deep] = [m[3] * x + m[7] * y + m[11] * z + m[15], m[2] * x + m[6] * y + m[10] * z + m[14]];
      out[2 * k] = Math.abs(deep) <= far ? (0.5 + (m[0] * x + m[4] * y + m[8] * z + m[12]) / far / 2) * width : NaN;
      out[2 * k + 1] = (0.5 - (m[1] * x + m[5] * y + m[9] * z + m[13]) / far / 2) * height;
    }
    return out;
  }

  async values(name) {
    const { places } = this.picture.data;
    if (name === "row") return places.row;
    if (name === "error") return this.errors();
    this.columns[name] ??= fetch(`${window.kilter.root}/campaigns/${this.campaign}/values.json?${new URLSearchParams({ version: this.version, column: name })}`)
      .then((answer) => (answer.ok ? answer.json() : { values: [] }))
      .then((found) => places.row.map((_, k) => found.values[k] ?? NaN));
    return this.columns[name];
  }

  /** Their sizes, in the unit of the largest, which all lists then name. */
  errors() {
    const sizes = this.picture.left().map(length);
    const [unit, times] = unitOf(ends(sizes)[1]);
    for (const option of this.picture.place.querySelectorAll('option[value="error"]')) option.textContent = `error, ${unit}`;
    return sizes.map((size) => times * size);
  }

  async redraw() {
    this.errors();
    const { picture } = this;
    const [x, y, z] = await Promise.all([this.selects.across, this.selects.up, this.selects.colour].map((select) => (select.value === "use" ? null : this.values(select.value))));
    Object.assign(this, { x, y });
    this.colours = this.coloured(z);
    picture.draw();
    this.plot();
  }

  /** Ring the rows that are chosen, and draw nothing else. */
  choose() {
    const { row } = this.picture.data.places;
    const mine = window.kilter.rows.of(this.campaign);
    this.chosen = [];
    for (let k = 0; k < row.length; k += 1) if (mine.has(row[k])) this.chosen.push(k);
    this.mark();
    this.scatter.mark(this.chosen);
    this.picture.place.dataset.chosen = this.chosen.length;
  }

  /** Ring them in the picture as it is looked at. */
  mark() {
    this.marks.draw(this.chosen.length ? this.projected() : [], this.chosen);
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
    picture.show("coloured", cloud(at, shares, 1, at.length > 2000 ? 3 : 8));
    key(words, low.toPrecision(4), high.toPrecision(4));
    return shares.map((share) => `rgb(${colourOf(share).join(",")})`);
  }

  plot() {
    if (!this.x) return;
    const label = (select) => select.selectedOptions[0].textContent;
    const { across, up } = this.selects;
    this.scatter.draw({ values: this.x, label: label(across) }, { values: this.y, label: label(up), zero: !up.value.startsWith("joint:") }, this.colours);
    this.scatter.mark(this.chosen);
    this.scatter.canvas.dataset.drawn = `${up.value} ${across.value}`;
  }
}
