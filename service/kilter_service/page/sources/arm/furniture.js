// What stands around the arm: light, a grid of round size, axes with their names, and a bar that says how long a cell is.
import {
  AmbientLight, CanvasTexture, DirectionalLight, Group, GridHelper, Mesh, MeshBasicMaterial, PlaneGeometry, ShadowMaterial, SRGBColorSpace, Sprite,
  SpriteMaterial, Vector3,
} from "three";
import { arrows, css, rod } from "./parts.js";

const AXES = [["x", [1, 0, 0], 0xd55e00], ["y", [0, 1, 0], 0x009e73], ["z", [0, 0, 1], 0x0072b2]];
const CELLS = 16;

function words(text, height, colour) {
  const canvas = Object.assign(document.createElement("canvas"), { width: 32 * text.length + 32, height: 64 });
  const pen = canvas.getContext("2d");
  Object.assign(pen, { font: "600 44px system-ui, sans-serif", fillStyle: css(colour), textAlign: "center", textBaseline: "middle" });
  pen.fillText(text, canvas.width / 2, 32);
  const map = Object.assign(new CanvasTexture(canvas), { colorSpace: SRGBColorSpace });
  const sprite = new Sprite(new SpriteMaterial({ map, depthTest: false }));
  sprite.scale.set((height * canvas.width) / 64, height, 1);
  return sprite;
}

/** A round length near this one: 1, 2 or 5 times a power of ten. */
export function round(length) {
  const power = 10 ** Math.floor(Math.log10(length));
  return [1, 2, 5, 10].map((part) => part * power).filter((one) => one <= length * 1.001).pop();
}

export function furniture(size) {
  const group = new Group();
  const light = new DirectionalLight(0xffffff, 2.2);
  light.position.set(0.5, -1, 3).multiplyScalar(size);
  light.castShadow = true;
  Object.assign(light.shadow.camera, { left: -2 * size, right: 2 * size, top: 2 * size, bottom: -2 * size, near: 0.1 * size, far: 8 * size });
  light.shadow.mapSize.set(1024, 1024);
  const ground = new Mesh(new PlaneGeometry(8 * size, 8 * size), new ShadowMaterial({ opacity: 0.22, depthWrite: false }));
  ground.receiveShadow = true;
  const cell = round(size / 4);
  const grid = new GridHelper(CELLS * cell, CELLS, 0x808080, 0x808080);
  grid.rotation.x = Math.PI / 2;
  Object.assign(grid.material, { transparent: true, opacity: 0.35 });
  group.add(new AmbientLight(0xffffff, 1.3), light, grid, ground);
  for (const [name, along, colour] of AXES) {
    const direction = new Vector3(...along);
    group.add(arrows([[0, 0, 0]], [along], 0.4 * size, colour, 2 * size));
    const label = words(name, 0.09 * size, colour);
    label.position.copy(direction).multiplyScalar(0.47 * size);
    group.add(label);
  }
  const bar = rod(new Vector3(cell, -2 * cell, 0), new Vector3(2 * cell, -2 * cell, 0), 0.006 * size, new MeshBasicMaterial({ color: 0x808080 }));
  const length = words(`${cell} mm`, 0.08 * size, 0x808080);
  length.position.set(1.5 * cell, -2.3 * cell, 0);
  group.add(bar, length);
  return { group, cell };
}
