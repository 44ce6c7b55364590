// Forward kinematics of a chain of elementary transforms, mm and degrees, in the frame of the robot's base.
import { Matrix4, Vector3 } from "three";

const RADIAN = Math.PI / 180;
const AXES = { X: new Vector3(1, 0, 0), Y: new Vector3(0, 1, 0), Z: new Vector3(0, 0, 1) };

function motion(axis, amount) {
  const along = AXES[axis[1]];
  if (axis[0] === "R") return new Matrix4().makeRotationAxis(along, amount * RADIAN);
  const shift = along.clone().multiplyScalar(amount);
  return new Matrix4().makeTranslation(shift.x, shift.y, shift.z);
}

/** What to draw at joint readings: segments [from, to], joints {at, axis, index}, and the tool's pose. */
export function posed(arm, readings) {
  const T = new Matrix4();
  const at = () => new Vector3().setFromMatrixPosition(T);
  const segments = [];
  const joints = [];
  const frames = { base: new Matrix4() }; // of what each joint moves
  const axles = {};
  let link = "base";
  arm.elements.forEach(([axis, value, joint, ratio], place) => {
    const before = at();
    if (joint !== null) {
      const direction = AXES[axis[1]].clone().transformDirection(T);
      joints.push({ at: before, axis: direction, index: joint, slides: axis[0] === "T" });
      axles[place] = { at: before, axis: direction };
    }
    T.multiply(motion(axis, joint === null ? value : ratio * readings[joint] + value));
    const after = at();
    if (before.distanceTo(after) > 0.5) segments.push([before, after, link]);
    if (joint !== null && arm.primary[joint] === place) {
      link = arm.joints[joint].name;
      frames[link] = T.clone();
    }
  });
  const flange = at();
  T.multiply(new Matrix4().set(...arm.tool.flat()));
  const rods = arm.linkages.map(([from, to]) => [axles[from], axles[to]]);
  return { segments, joints, frames, rods, flange, tool: at() };
}

/** A pose beyond another one: `times` as far from `here` as `there` is. Null where the two have not the same parts. */
export function blended(here, there, times) {
  if (here.segments.length !== there.segments.length) return null;
  const beyond = (from, to) => to.clone().sub(from).multiplyScalar(times).add(from);
  const joints = here.joints.map((one, k) => ({ ...one, at: beyond(one.at, there.joints[k].at) }));
  const segments = here.segments.map(([from, to, link], k) => [beyond(from, there.segments[k][0]), beyond(to, there.segments[k][1]), link]);
  return { segments, joints, frames: {}, rods: [], flange: beyond(here.flange, there.flange), tool: beyond(here.tool, there.tool) };
}
