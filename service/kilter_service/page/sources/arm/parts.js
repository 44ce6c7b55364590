// The parts of the picture: the arm of cylinders, points, arrows, and the coloured workspace.
import {
  BufferGeometry, Color, CylinderGeometry, ConeGeometry, Float32BufferAttribute, Group, InstancedMesh, LineBasicMaterial,
  LineSegments, Matrix4, Mesh, MeshLambertMaterial, Points, PointsMaterial, Quaternion, SphereGeometry, Vector3,
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

export function arm(pose, size, meshes) {
  const group = new Group();
  const link = new MeshLambertMaterial({ color: 0x8f9aa5 });
  const joint = new MeshLambertMaterial({ color: 0x0072b2 });
  const tool = new MeshLambertMaterial({ color: 0xe69f00 });
  const thick = 0.022 * size;
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

/** Points of one colour. */
export function points(places, chosen, colour, size) {
  const some = places.filter((_, k) => chosen[k]);
  return new Points(geometry(some.flat()), new PointsMaterial({ color: colour, size, sizeAttenuation: false }));
}

/** Arrows from where the tool was expected to `times` the error further; heads only where they are few. */
export function arrows(at, errors, times, colour, size) {
  const group = new Group();
  const ends = at.map((from, k) => from.map((value, j) => value + times * errors[k][j]));
  group.add(new LineSegments(geometry(at.flatMap((from, k) => [...from, ...ends[k]])), new LineBasicMaterial({ color: colour })));
  if (at.length <= 2000) {
    const heads = new InstancedMesh(new ConeGeometry(0.006 * size, 0.02 * size, 8), new MeshLambertMaterial({ color: colour }), at.length);
    const [turn, one, unit] = [new Quaternion(), new Matrix4(), new Vector3(1, 1, 1)];
    at.forEach((from, k) => {
      const along = new Vector3(...errors[k]);
      turn.setFromUnitVectors(UP, along.lengthSq() ? along.normalize() : UP);
      heads.setMatrixAt(k, one.compose(new Vector3(...ends[k]), turn, unit));
    });
    group.add(heads);
  }
  return group;
}

export function cloud(places, values, highest, size) {
  const shade = new Color();
  const colours = values.flatMap((value) => {
    const [red, green, blue] = colourOf(value / highest);
    shade.setRGB(red / 255, green / 255, blue / 255, "srgb");
    return [shade.r, shade.g, shade.b];
  });
  return new Points(geometry(places.flat(), colours), new PointsMaterial({ vertexColors: true, size, sizeAttenuation: false, transparent: true, opacity: 0.7 }));
}
