// The parts of the picture: the arm of cylinders, points, arrows, and the coloured workspace.
import {
  BufferGeometry, CanvasTexture, Color, CylinderGeometry, ConeGeometry, Float32BufferAttribute, Group, InstancedMesh, Matrix4, Mesh,
  LinearFilter, MeshLambertMaterial, Points, PointsMaterial, Quaternion, SphereGeometry, Vector3,
} from "three";

const UP = new Vector3(0, 1, 0); // axis of three's cylinders
export const STOPS = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];

/** Rows by what they were used for, and those that are chosen, in the picture and in the plot beside it. */
export const ROWS = { fitted: 0x808080, held: 0x009e73, aside: 0xe69f00, chosen: 0xcc79a7, error: 0xd55e00 };

export const css = (colour) => `#${colour.toString(16).padStart(6, "0")}`;

export function colourOf(share) {
  const place = Math.min(Math.max(share, 0), 1) * (STOPS.length - 1);
  const first = Math.min(Math.floor(place), STOPS.length - 2);
  return STOPS[first].map((value, k) => Math.round(value + (place - first) * (STOPS[first + 1][k] - value)));
}

export function rod(from, to, radius, material) {
  const length = from.distanceTo(to);
  const mesh = new Mesh(new CylinderGeometry(radius, radius, Math.max(length, 0.1), 20), material);
  mesh.position.copy(from).add(to).multiplyScalar(0.5);
  mesh.quaternion.setFromUnitVectors(UP, to.clone().sub(from).normalize());
  return mesh;
}

/** A mesh of nine numbers for each triangle, mm, flatly shaded. */
export function mesh(corners) {
  const made = new BufferGeometry();
  made.setAttribute("position", new Float32BufferAttribute(corners, 3));
  made.computeVertexNormals();
  return made;
}

export function arm(pose, size, meshes, ghost = false) {
  const group = new Group();
  const made = (color) => new MeshLambertMaterial(ghost ? { color: 0x8f9aa5, transparent: true, opacity: 0.28, depthWrite: false } : { color });
  const [link, joint, tool] = [0x8f9aa5, 0x0072b2, 0xe69f00].map(made);
  const thick = (ghost ? 0.018 : 0.022) * size;
  for (const [from, to, moved] of pose.segments) if (!meshes[moved]) group.add(rod(from, to, thick, link));
  for (const [name, shape] of Object.entries(meshes)) {
    const one = new Mesh(shape.clone(), link);
    one.applyMatrix4(pose.frames[name]);
    group.add(one);
  }
  for (const { at, axis } of pose.joints) {
    const half = axis.clone().multiplyScalar(1.7 * thick);
    group.add(rod(at.clone().sub(half), at.clone().add(half), 1.45 * thick, joint));
  }
  for (const [from, to] of pose.rods) for (const side of [-2.1, 2.1]) { // beside the links, seen from either side
    const aside = from.axis.clone().multiplyScalar(side * thick);
    group.add(rod(from.at.clone().add(aside), to.at.clone().add(aside), 0.45 * thick, tool));
  }
  if (pose.flange.distanceTo(pose.tool) > 0.5) group.add(rod(pose.flange, pose.tool, 0.5 * thick, tool));
  const tip = new Mesh(new SphereGeometry(0.8 * thick, 16, 12), tool);
  tip.position.copy(pose.tool);
  group.add(tip);
  if (!ghost) group.traverse((one) => (one.castShadow = true));
  return group;
}

export function release(object) {
  object?.traverse((one) => {
    one.geometry?.dispose();
    one.material?.dispose();
  });
  object?.removeFromParent();
}

function geometry(places, colours) {
  const made = new BufferGeometry();
  made.setAttribute("position", new Float32BufferAttribute(places, 3));
  if (colours) made.setAttribute("color", new Float32BufferAttribute(colours, 3));
  return made;
}

const round = document.createElement("canvas");
Object.assign(round, { width: 32, height: 32 });
Object.assign(round.getContext("2d"), { fillStyle: "#ffffff" });
round.getContext("2d").arc(16, 16, 15, 0, 7);
round.getContext("2d").fill();
const dot = { map: Object.assign(new CanvasTexture(round), { minFilter: LinearFilter }), alphaTest: 0.05, transparent: true, sizeAttenuation: false };

/** Points of one colour. */
export function points(places, chosen, colour, size) {
  const some = places.filter((_, k) => chosen[k]);
  return new Points(geometry(some.flat()), new PointsMaterial({ ...dot, color: colour, size }));
}

/** Colour of an error: a share of a large one. */
export const heat = (share) => {
  const [low, high, part] = share < 0.5 ? [HEAT[0], HEAT[1], 2 * share] : [HEAT[1], HEAT[2], 2 * Math.min(share, 1) - 1];
  return low.map((value, k) => Math.round(value + part * (high[k] - value)));
};
const HEAT = [[86, 180, 233], [230, 159, 0], [200, 60, 0]];

/** Arrows from where the tool was expected to `times` the error further, of one colour or of one each; of many no heads. */
export function arrows(at, errors, times, colour, size) {
  const group = new Group();
  const many = at.length > 2000;
  const white = new MeshLambertMaterial({ color: 0xffffff });
  const [shafts, heads] = [new CylinderGeometry(0.0035 * size, 0.0035 * size, 1, 6), new ConeGeometry(0.011 * size, 0.034 * size, 10)].map((shape) => new InstancedMesh(shape, white, at.length));
  const [turn, one, scale, shade] = [new Quaternion(), new Matrix4(), new Vector3(), new Color()];
  at.forEach((from, k) => {
    const start = new Vector3(...from);
    const along = new Vector3(...errors[k]).multiplyScalar(times);
    turn.setFromUnitVectors(UP, along.lengthSq() ? along.clone().normalize() : UP);
    shafts.setMatrixAt(k, one.compose(start.clone().addScaledVector(along, 0.5), turn, scale.set(1, Math.max(along.length(), 1e-6), 1)));
    heads.setMatrixAt(k, one.compose(start.add(along), turn, scale.set(1, 1, 1)));
    const [red, green, blue] = typeof colour === "number" ? [16, 8, 0].map((shift) => (colour >> shift) & 255) : colour(k);
    shade.setRGB(red / 255, green / 255, blue / 255, "srgb");
    [shafts, heads].forEach((part) => part.setColorAt(k, shade));
  });
  group.add(...(many ? [shafts] : [shafts, heads]));
  return group;
}

export function cloud(places, values, highest, size) {
  const shade = new Color();
  const colours = values.flatMap((value) => {
    const [red, green, blue] = colourOf(value / highest);
    shade.setRGB(red / 255, green / 255, blue / 255, "srgb");
    return [shade.r, shade.g, shade.b];
  });
  return new Points(geometry(places.flat(), colours), new PointsMaterial({ ...dot, vertexColors: true, size, transparent: true, opacity: 0.7 }));
}
