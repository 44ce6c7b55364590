// A plot of rows on a canvas: one column over another, each point in a colour of its own, chosen ones ringed.
import { Marks } from "./marks.js";

const [LEFT, RIGHT, TOP, BOTTOM] = [64, 14, 10, 44];
const MANY = 2000; // points, of which each is smaller
const STEPS = [1, 2, 2.5, 5, 10];

function ticks(low, high, most) {
  const raw = (high - low) / most || 1;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = power * STEPS.find((part) => power * part >= raw * 0.999);
  const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9) + (step / power === 2.5 ? 1 : 0));
  const found = [];
  for (let value = Math.ceil(low / step - 1e-9) * step; value <= high + 1e-9 * step; value += step) found.push([value, (Math.abs(value) < step / 2 ? 0 : value).toFixed(decimals)]);
  return found;
}

export function ends(values) {
  const there = values.filter(Number.isFinite);
  const [low, high] = there.reduce(([a, b], value) => [Math.min(a, value), Math.max(b, value)], [Infinity, -Infinity]);
  return low <= high ? [low, high] : [0, 1];
}

export class Scatter {
  constructor(canvas) {
    this.canvas = canvas;
    this.places = new Float32Array(0);
    this.marks = new Marks(canvas);
  }

  /** `x` and `y` are {values, label}; `colours` a colour of each point. */
  draw(x, y, colours) {
    const width = this.canvas.parentElement.clientWidth;
    const height = Math.round(Math.min(Math.max(0.29 * window.innerHeight, 240), 0.75 * width));
    const ratio = Math.min(window.devicePixelRatio, 2);
    Object.assign(this.canvas, { width: width * ratio, height: height * ratio });
    this.canvas.style.width = `${width}px`;
    this.canvas.style.height = `${height}px`;
    this.pen = this.canvas.getContext("2d");
    this.pen.scale(ratio, ratio);
    this.ink = getComputedStyle(document.body).color;
    const [across, up] = [this.axis(x, LEFT, width - RIGHT, width / 90), this.axis(y, height - BOTTOM, TOP, 5)];
    this.frame(across, up, x.label, y.label, width, height);
    this.points(x.values.map(across.at), y.values.map(up.at), colours);
  }

  /** Ring the points with these numbers. */
  mark(chosen) {
    this.marks.draw(this.places, chosen);
  }

  axis({ values, zero }, from, to, most) {
    let [low, high] = ends(values);
    if (zero) low = Math.min(0, low);
    const room = 0.04 * (high - low) || 0.5 * Math.abs(high) || 1;
    [low, high] = [zero && low === 0 ? 0 : low - room, high + room];
    return { at: (value) => (Number.isFinite(value) ? from + ((value - low) / (high - low)) * (to - from) : NaN), ticks: ticks(low, high, most) };
  }

  frame(across, up, xLabel, yLabel, width, height) {
    const pen = this.pen;
    pen.fillStyle = pen.strokeStyle = this.ink;
    pen.font = "12px system-ui, sans-serif";
    const line = (ax, ay, bx, by, alpha) => {
      pen.globalAlpha = alpha;
      pen.beginPath();
      pen.moveTo(ax, ay);
      pen.lineTo(bx, by);
      pen.stroke();
      pen.globalAlpha = 1;
    };
    pen.textAlign = "center";
    for (const [value, text] of across.ticks) {
      line(across.at(value), height - BOTTOM, across.at(value), height - BOTTOM + 4, 1);
      pen.fillText(text, across.at(value), height - BOTTOM + 17);
    }
    pen.fillText(xLabel, (LEFT + width - RIGHT) / 2, height - 8);
    pen.textAlign = "right";
    for (const [value, text] of up.ticks) {
      line(LEFT, up.at(value), width - RIGHT, up.at(value), 0.15);
      pen.fillText(text, LEFT - 6, up.at(value) + 4);
    }
    line(LEFT, TOP, LEFT, height - BOTTOM, 1);
    line(LEFT, height - BOTTOM, width - RIGHT, height - BOTTOM, 1);
    pen.save();
    pen.translate(13, (TOP + height - BOTTOM) / 2);
    pen.rotate(-Math.PI / 2);
    pen.textAlign = "center";
    pen.fillText(yLabel, 0, 0);
    pen.restore();
  }

  points(xs, ys, colours) {
    this.places = new Float32Array(2 * xs.length);
    const pen = this.pen;
    const side = xs.length > MANY ? 2 : 5;
    xs.forEach((x, k) => {
      this.places[2 * k] = Number.isFinite(ys[k]) ? x : NaN;
      this.places[2 * k + 1] = ys[k];
      pen.fillStyle = colours[k];
      pen.fillRect(x - side / 2, ys[k] - side / 2, side, side);
    });
  }
}
