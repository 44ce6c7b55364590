// The arm in 3-D on a canvas: its chain, light, ground, shadow and camera. What is shown beside it is of who derives from this.
import { Box3, PerspectiveCamera, Scene, Sphere, Vector3, WebGLRenderer } from "three";
import { blended, posed } from "./chain.js";
import { Looking } from "./camera.js";
import { furniture } from "./furniture.js";
import { arm, mesh, release } from "./parts.js";

const ROUND = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000];
const OFF = 0.25; // of the size of the arm that the ghost stands away at most

/** The largest round number that is not above this one. */
export const rounded = (wanted) => ROUND.filter((one) => one <= wanted).pop() ?? 1;

export class Stage {
  shadows = true;

  constructor(place) {
    this.place = place;
    this.canvas = place.querySelector("canvas");
    this.scene = new Scene();
    this.parts = {};
  }

  find(name) {
    return this.place.querySelector(`[data-${name}]`);
  }

  say(text) {
    this.find("said").textContent = this.renderer === null ? `This browser has no WebGL, so the arm is not drawn: the tables have its numbers. ${text}` : text;
  }

  async open(told = null) {
    const { version } = this.place.dataset;
    this.chain = await this.get("arm.json", version ? { version } : {});
    this.meshes = await this.loadMeshes();
    this.readings = this.chain.joints.map(({ low, high }) => Math.min(Math.max(0, low), high));
    this.size = this.reachOf();
    this.renderer = this.drawing();
    this.camera = new PerspectiveCamera(40, 1, this.size / 100, this.size * 30);
    this.camera.up.set(0, 0, 1);
    const { group, cell } = furniture(this.size);
    this.cell = cell;
    this.scene.add(group);
    this.drawArm();
    new ResizeObserver(() => this.fit()).observe(this.canvas.parentElement);
    const { center, radius } = this.around();
    this.looking = new Looking(this.camera, this.canvas, center, 1.2 * radius / Math.sin((20 * Math.PI) / 180), () => this.looked(), told);
    this.fit();
  }

  /** What draws; null without WebGL: all but the picture goes on. */
  drawing() {
    try {
      const renderer = new WebGLRenderer({ canvas: this.canvas, antialias: true, alpha: true });
      renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
      renderer.shadowMap.enabled = this.shadows;
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

  async loadMeshes() {
    const loaded = await Promise.all(this.chain.meshes.map(async (link) => {
      const answer = await fetch(`${this.place.dataset.arm}/meshes/${encodeURIComponent(link)}`);
      return answer.ok ? [[link, mesh(new Float32Array(await answer.arrayBuffer()))]] : []; // else it stays a cylinder
    }));
    return Object.fromEntries(loaded.flat());
  }

  reachOf() {
    const { segments, flange, tool } = posed(this.chain, this.readings);
    return segments.reduce((sum, [from, to]) => sum + from.distanceTo(to), flange.distanceTo(tool)) * 0.6 || 500;
  }

  /** The ball that holds the arm as it is drawn and its base. */
  around() {
    const ball = new Box3().setFromPoints(this.drawn()).getBoundingSphere(new Sphere());
    return { center: ball.center, radius: Math.max(ball.radius, 0.7 * this.size) };
  }

  drawn() {
    const { segments, tool } = posed(this.chain, this.readings);
    return [new Vector3(), tool, ...segments.flatMap(([from, to]) => [from, to])];
  }

  /** Look at the arm as it is drawn, and at these points, from near enough to fill the picture. */
  frame(more = []) {
    const points = [...this.drawn(), ...more.map((one) => new Vector3(...one))];
    this.framing = true; // which is nothing that the address keeps
    this.looking.frame(points, new Box3().setFromPoints(points).getCenter(new Vector3()));
    this.framing = false;
    this.draw();
  }

  looked() {
    this.draw();
  }

  show(name, object) {
    release(this.parts[name]);
    this.parts[name] = object;
    if (object) this.scene.add(object);
  }

  fit() {
    if (!this.renderer) return;
    const width = this.canvas.parentElement.clientWidth;
    const height = Math.round(Math.min(0.85 * width, Math.max((this.place.dataset.as === "poses" ? 0.5 : 0.28) * window.innerHeight, 250)));
    this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.draw();
  }

  draw() {
    this.renderer?.render(this.scene, this.camera);
  }

  /** Draw the arm, and the ghost of the nominal one where a version has another geometry: their difference many times. */
  drawArm() {
    const pose = posed(this.chain, this.readings);
    this.show("arm", arm(pose, this.size, this.meshes));
    this.place.dataset.tool = pose.tool.toArray().map((value) => value.toFixed(2)).join(" ");
    if (!this.chain.identified) return;
    const had = posed({ ...this.chain, elements: this.chain.identified }, this.readings);
    const off = Math.max(...pose.joints.map(({ at }, k) => at.distanceTo(had.joints[k].at)), pose.tool.distanceTo(had.tool), 1e-6);
    this.ghosted = rounded((OFF * this.size) / off);
    const nominal = blended(had, pose, this.ghosted);
    this.show("ghost", nominal && arm(nominal, this.size, {}, true));
  }
}
