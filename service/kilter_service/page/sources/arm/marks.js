// Rings around points that are chosen, on a sheet of their own above a canvas: choosing draws neither the picture nor the plot anew.
import { ROWS } from "./parts.js";

const RADIUS = 7;
const LINE = 2.5;

/** The pixels of a ring around 0, 0: x, y and how much of each it covers, 0 to 255. */
function ring(ratio) {
  const found = [];
  const reach = Math.ceil((RADIUS + LINE) * ratio);
  for (let y = -reach; y <= reach; y += 1) {
    for (let x = -reach; x <= reach; x += 1) {
      const covered = (LINE / 2) * ratio + 0.5 - Math.abs(Math.hypot(x, y) - RADIUS * ratio);
      if (covered > 0) found.push(x, y, Math.round(255 * Math.min(covered, 1)));
    }
  }
  return Int16Array.from(found);
}

export class Marks {
  constructor(canvas) {
    this.below = canvas;
    this.canvas = Object.assign(document.createElement("canvas"), { className: "marks", hidden: true });
    this.canvas.setAttribute("aria-hidden", "true");
    canvas.after(this.canvas);
  }

  /** `places` are x and y of all points after one another, `chosen` the numbers of those that are ringed. */
  draw(places, chosen) {
    this.canvas.hidden = !chosen.length || this.below.hidden;
    if (this.canvas.hidden) return;
    const { clientWidth, clientHeight, offsetLeft, offsetTop, clientLeft, clientTop } = this.below;
    const ratio = Math.min(window.devicePixelRatio, 2);
    const [width, height] = [Math.max(1, Math.round(clientWidth * ratio)), Math.max(1, Math.round(clientHeight * ratio))];
    Object.assign(this.canvas, { width, height });
    Object.assign(this.canvas.style, { left: `${offsetLeft + clientLeft}px`, top: `${offsetTop + clientTop}px`, width: `${clientWidth}px`, height: `${clientHeight}px` });
    const pen = this.canvas.getContext("2d");
    const image = pen.createImageData(width, height);
    const pixels = image.data;
    const stencil = ring(ratio);
    const [red, green, blue] = [16, 8, 0].map((shift) => (ROWS.chosen >> shift) & 255);
    for (const k of chosen) {
      const [x, y] = [Math.round(places[2 * k] * ratio), Math.round(places[2 * k + 1] * ratio)]; // NaN is within no bounds
      for (let j = 0; j < stencil.length; j += 3) {
        const [px, py] = [x + stencil[j], y + stencil[j + 1]];
        if (!(px >= 0 && px < width && py >= 0 && py < height)) continue;
        const at = 4 * (py * width + px);
        if (pixels[at + 3] >= stencil[j + 2]) continue;
        pixels[at] = red;
        pixels[at + 1] = green;
        pixels[at + 2] = blue;
        pixels[at + 3] = stencil[j + 2];
      }
    }
    pen.putImageData(image, 0, 0);
  }
}
