// Looking at the arm: by mouse and touch (OrbitControls), by keyboard, and by buttons, which do the same.
import { Spherical, Vector3 } from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

const SEEN = 0.9; // of the picture, what is looked at fills at most
const STEP = Math.PI / 18;
const KEYS = { ArrowLeft: "left", ArrowRight: "right", ArrowUp: "up", ArrowDown: "down", "+": "nearer", "-": "farther" };
const SIDES = { front: [1, 0, 0.05], side: [0, -1, 0.05], top: [0.001, 0, 1], start: [1, -1.1, 0.6] };

export class Looking {
  constructor(camera, canvas, centre, distance, changed, told = null) {
    this.camera = camera;
    this.distance = distance;
    this.controls = new OrbitControls(camera, canvas);
    this.given = (told || "").split(",").map(Number);
    this.controls.addEventListener("change", changed);
    canvas.addEventListener("keydown", (event) => {
      if (!(event.key in KEYS)) return;
      event.preventDefault();
      this.go(KEYS[event.key]);
    });
    this.begin(centre);
  }

  /** Look as the address says: from where, mm from what is in the middle, and what that is; else from the start at `centre`. */
  begin(centre) {
    const known = [3, 6].includes(this.given.length) && this.given.every(Number.isFinite);
    this.controls.target.copy(known && this.given.length === 6 ? new Vector3(...this.given.slice(3)) : centre);
    if (!known) return this.go("start");
    this.camera.position.copy(this.controls.target).add(new Vector3(...this.given.slice(0, 3)));
    this.controls.update();
  }

  /** Look from the start at all these points, as near as they are still seen; where the address says from where, from there. */
  frame(points, centre) {
    const toward = new Vector3(...SIDES.start).normalize();
    const right = new Vector3(0, 0, 1).cross(toward).normalize();
    const up = toward.clone().cross(right);
    const high = SEEN * Math.tan((this.camera.fov * Math.PI) / 360);
    const away = points.map((one) => {
      const from = one.clone().sub(centre);
      return from.dot(toward) + Math.max(Math.abs(from.dot(right)) / (high * this.camera.aspect), Math.abs(from.dot(up)) / high);
    });
    this.distance = away.reduce((most, one) => Math.max(most, one), this.distance / 3);
    this.begin(centre);
  }

  /** From where the arm is looked at, mm from what is in the middle, and where that is: what is measured or posed moves it. */
  told() {
    const { position } = this.camera, { target } = this.controls;
    return [...position.clone().sub(target).toArray(), ...target.toArray()].map(Math.round);
  }

  /** Whether dragging is for something else now. */
  hold(on) {
    this.controls.enabled = !on;
  }

  go(where) {
    const from = this.camera.position.clone().sub(this.controls.target);
    if (where in SIDES) from.copy(new Vector3(...SIDES[where]).normalize().multiplyScalar(this.distance));
    else if (where === "nearer" || where === "farther") from.multiplyScalar(where === "nearer" ? 0.85 : 1 / 0.85);
    else this.turn(from, where);
    this.camera.position.copy(this.controls.target).add(from);
    this.controls.update();
  }

  turn(from, where) {
    const flat = new Spherical().setFromVector3(new Vector3(from.x, from.z, -from.y)); // three's poles are along y
    flat.theta += where === "left" ? -STEP : where === "right" ? STEP : 0;
    flat.phi += where === "up" ? -STEP : where === "down" ? STEP : 0;
    flat.makeSafe();
    const to = new Vector3().setFromSpherical(flat);
    from.set(to.x, -to.z, to.y);
  }
}
