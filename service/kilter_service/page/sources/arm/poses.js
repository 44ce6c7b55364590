// Poses to measure, stepped through: the arm at the current one, a dot for the tool of each, in the colour of what became of it.
import { posed } from "./chain.js";
import { points, ROWS } from "./parts.js";
import { Stage } from "./stage.js";

const STATES = { open: 0x808080, good: ROWS.held, bad: 0xd55e00 };
const WORDS = { open: "not measured yet", good: "measured", bad: "measured, but wrong" };

export class Poses extends Stage {
  async start() {
    await this.open();
    this.poses = JSON.parse(this.place.dataset.poses);
    this.at = this.poses.map((one) => posed(this.chain, one).tool.toArray());
    this.place.querySelectorAll("[data-step]").forEach((button) => button.addEventListener("click", () => this.go(this.current + Number(button.dataset.step))));
    this.rows().forEach((row, k) => row.addEventListener("click", () => this.go(k)));
    document.addEventListener("htmx:afterSettle", () => this.news());
    this.go(Math.max(0, this.states().indexOf("open")));
    this.frame(this.at);
    this.place.dataset.ready = "yes";
  }

  rows() {
    return [...this.place.querySelectorAll("tr[data-pose]")];
  }

  states() {
    return this.rows().map((row) => row.dataset.pose);
  }

  /** Rows arrived: colour their poses, and go on from one that was waited for. */
  news() {
    this.rows().forEach((row, k) => row.addEventListener("click", () => this.go(k)));
    const states = this.states();
    const next = states.indexOf("open");
    this.go(this.waited && states[this.current] !== "open" && next >= 0 ? next : this.current);
  }

  go(place) {
    this.current = Math.min(Math.max(place, 0), this.poses.length - 1);
    const states = this.states();
    this.waited = states[this.current] === "open";
    this.readings = this.poses[this.current];
    this.drawArm();
    for (const [state, colour] of Object.entries(STATES)) this.show(state, points(this.at, states.map((one, k) => one === state && k !== this.current), colour, 8));
    this.show("current", points([this.at[this.current]], [true], STATES[states[this.current]], 18));
    this.rows().forEach((row, k) => row.toggleAttribute("data-current", k === this.current));
    const joints = this.chain.joints.map(({ name, unit }, k) => `${name} ${this.readings[k].toFixed(2)}${unit === "deg" ? "°" : " mm"}`).join(", ");
    this.say(`Pose ${this.current + 1} of ${this.poses.length}, ${WORDS[states[this.current]]}: ${joints}.`);
    this.draw();
  }
}
