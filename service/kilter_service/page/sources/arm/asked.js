// What versions say of the pose that is drawn: a line of numbers below the sliders, and an arrow for each version.
import { arrows } from "./parts.js";

const WAIT_MS = 150; // while a slider moves nothing is asked
const COLOURS = [0x0072b2, 0xe69f00]; // of the version looked at, and of the other one
const SHARE = 0.25; // of the arm that the larger arrow is drawn as

export class Asked {
  constructor(picture) {
    this.picture = picture;
    this.place = picture.find("asked");
    this.latest = 0;
  }

  /** Ask for joints as they are drawn; `row` is the measured one whose load and directions hold. */
  pose(readings, row) {
    const mine = ++this.latest;
    const { version, other, campaign } = this.picture.place.dataset;
    if (!version || !this.place) return;
    setTimeout(async () => {
      if (mine !== this.latest) return;
      const asked = { version, other: other || "", campaign: row ? campaign : "", row: row || 0, q: readings.map((value) => value.toFixed(4)) };
      const answer = await fetch(`${this.picture.place.dataset.arm}/pose?${new URLSearchParams(asked)}`, { headers: { "HX-Request": "true" } });
      const text = await answer.text();
      if (mine !== this.latest) return;
      this.place.innerHTML = text;
      this.draw();
    }, WAIT_MS);
  }

  draw() {
    const { picture } = this;
    const vectors = (this.place.firstElementChild?.dataset.vectors || "").split(";").filter(Boolean).map((one) => one.split(" ").map(Number));
    const longest = Math.max(...vectors.map((one) => Math.hypot(...one)), 1e-9);
    const times = 10 ** Math.floor(Math.log10((SHARE * picture.size) / longest));
    const tool = picture.place.dataset.tool.split(" ").map(Number);
    [0, 1].forEach((k) => picture.show(`moved-${k}`, vectors[k] ? arrows([tool], [vectors[k]], times, COLOURS[k], 3 * picture.size) : null));
    this.place.dataset.drawn = vectors.length;
    picture.find("moved-words").textContent = vectors.length
      ? `From the tool: ${vectors.length > 1 ? "blue, what the version moves it by, and orange, the other one" : "what the version moves it by"}, ${times} times as long.`
      : "";
    picture.draw();
  }
}
