// The arm as a stream moves it, drawn as often as the browser has time for.
import { Stage } from "./stage.js";

const [SOONEST_MS, REST] = [100, 4]; // between pictures, and how many times as long as one took the browser has for the rest

export class Live extends Stage {
  shadows = false;

  async start() {
    this.place.hidden = true;
    document.addEventListener("kilter:setpoint", ({ detail }) => this.take(detail));
    await this.open();
    this.place.dataset.ready = "yes";
    if (this.latest) this.take(this.latest);
  }

  /** Step back where the arm leaves the picture. */
  follow() {
    const leaves = this.drawn().some((one) => [one.project(this.camera)].some(({ x, y }) => Math.max(Math.abs(x), Math.abs(y)) > 0.98));
    if (leaves) this.frame((this.outer = [...(this.outer ?? []).slice(-8), ...this.drawn().map((one) => one.toArray())]));
  }

  take(readings) {
    this.latest = readings;
    if (!this.looking || this.busy || document.hidden) return;
    const [began, seen] = [performance.now(), !this.place.hidden];
    this.busy = true;
    this.place.hidden = false;
    this.readings = readings;
    this.drawArm();
    if (!seen) {
      this.fit(); // hidden, it had no size
      this.frame();
    }
    this.follow();
    if (this.parts.ghost) this.say(`Pale: the nominal arm, its difference ${this.ghosted} times.`);
    this.draw();
    requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(() => (this.busy = false), Math.max(SOONEST_MS, REST * (performance.now() - began)))));
  }
}
