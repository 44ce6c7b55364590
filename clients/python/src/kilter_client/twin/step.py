"""The step that an exported model of MuJoCo takes beside its elements: what no element of it is, from its own table.

``kilter version export VERSION --format mjcf`` writes the table into the file. Call :func:`apply` before every ``mj_step``, or
hand it to ``mujoco.set_mjcb_control``. SI throughout; loads are those of the weight of everything behind a joint.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from kilter_client.twin.motion_step import TABLE as MOTION
from kilter_client.twin.motion_step import apply_motion, model_text, parse_table
from kilter_files.ground.later import np

if TYPE_CHECKING:
    from kilter_files.ground import Floats

TABLE = "kilter"
NO_LOAD = 1e-9  # N m (N): below it a sign would be that of rounding noise
NEVER_MOVED = 1e-9  # rad (m) of a control


def apply(model: Any, data: Any) -> None:
    """Move what the tables move: offsets of the drives, the bodies behind the joints, friction and late torques.

    Args:
        model: an ``mjModel`` that holds an exported arm; one without a table needs nothing.
        data: its ``mjData``; controls are the readings of the controller.

    Raises:
        UsageError: the table is of a later release.

    """
    motion = model_text(model, MOTION)
    if motion is not None:
        apply_motion(model, data, motion)
    table = _read_embedded_table(model)
    if table is None:
        return
    controls = {name: _control(model, data, table, name) for name in table["order"]}
    sides = _sides(data, controls)
    loaded = {*table["joints"], *(row["joint"] for row in table["bending"])}
    wrenches = {name: _load(model, data, name, f"{name}_link") for name in loaded}
    shifts = dict.fromkeys(table["order"], 0.0)
    twists: dict[str, list[float]] = {}
    for name, own in table["joints"].items():
        shifts[name] += _shift(own, _axial(model, name, wrenches[name]), sides[name])
        if "tilt" in own or "radial_compliance" in own:
            twists.setdefault(name, [0.0] * 6)
            for k, tilt in enumerate(_tilts(own, *wrenches[name][3:5])):
                twists[name][3 + k] += tilt
    for curve in table["curves"]:
        amount = _curve(curve, controls[curve["driver"]], controls[curve["joint"]])
        if curve["twist"] is None:
            shifts[curve["joint"]] += amount
        else:
            twists.setdefault(curve["joint"], [0.0] * 6)[curve["twist"]] += amount
    for row in table["bending"]:
        bent = _bent(model, data, row, controls, wrenches[row["joint"]])
        twist = twists.setdefault(row["joint"], [0.0] * 6)
        twists[row["joint"]] = [a + b for a, b in zip(twist, bent, strict=True)]
    for name, shift in shifts.items():
        drive = model.actuator(table.get("drives", {}).get(name, name)).id
        model.actuator_biasprm[drive, 0] = model.actuator_gainprm[drive, 0] * shift
    for name, constant in table["twists"].items():
        moved = [a + b for a, b in zip(constant, twists.get(name, [0.0] * 6), strict=True)]
        _place(model, f"{name}_behind", moved)


def _read_embedded_table(model: Any) -> dict[str, Any] | None:
    text = model_text(model, TABLE)
    return None if text is None else parse_table(text)


def _sides(data: Any, controls: dict[str, float]) -> dict[str, float]:
    """Direction of the last motion of each control, kept in ``userdata``: sides, last controls, and whether it began."""
    n = len(controls)
    for k, now in enumerate(controls.values()):
        moved = now - data.userdata[n + k]
        if data.userdata[2 * n] != 0.0 and abs(moved) > NEVER_MOVED:
            data.userdata[k] = math.copysign(1.0, moved)
        if data.userdata[2 * n] == 0.0 or abs(moved) > NEVER_MOVED:
            data.userdata[n + k] = now
    data.userdata[2 * n] = 1.0
    return {name: float(data.userdata[k]) for k, name in enumerate(controls)}


def _control(model: Any, data: Any, table: dict[str, Any], name: str) -> float:
    return float(data.ctrl[model.actuator(table.get("drives", {}).get(name, name)).id])


def _load(model: Any, data: Any, joint: str, body: str) -> Floats:
    """Force and moment (6,) of the weight behind ``body``, about the origin and in the axes of the joint's own frame."""
    own, subtree = model.body(f"{joint}_link").id, model.body(body).id
    R, weight = data.xmat[own].reshape(3, 3), model.body_subtreemass[subtree] * model.opt.gravity
    moment = _cross((data.subtree_com[subtree] - data.xpos[own]).tolist(), weight.tolist())
    return np.concatenate([weight @ R, moment @ R])


def _cross(a: list[float], b: list[float]) -> Floats:
    """The vector product of two short lists, for which numpy's takes thirty times as long."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _axial(model: Any, name: str, wrench: Floats) -> float:
    slides = int(model.joint(name).type[0]) == 2  # mjJNT_SLIDE
    return float(wrench[2] if slides else wrench[5])


def _soft_sign(x: float, width: float) -> float:
    if width > 0.0:
        return math.tanh(x / width)
    return 0.0 if abs(x) <= NO_LOAD else math.copysign(1.0, x)


def _shift(own: dict[str, Any], load: float, side: float) -> float:
    """What the drive of a joint adds to its command."""
    shift: float = own.get("compliance", 0.0) * load - own.get("hardening", 0.0) * load * abs(load)
    shift += side * (0.5 * own.get("reversal", 0.0) + own.get("compliance_by_direction", 0.0) * load)
    shift += own.get("backlash", 0.0) * _soft_sign(load, own.get("backlash_softening_nm", 0.0))
    return shift


def _tilts(own: dict[str, Any], x: float, y: float) -> tuple[float, float]:
    """Tilt about x and y of the joint's frame: of fixed size in its clearance, and in proportion in its bearing."""
    c, t = own.get("radial_compliance", 0.0), own.get("tilt", 0.0)
    total = abs(x) + abs(y)
    if t == 0.0 or total <= NO_LOAD:
        return c * x, c * y
    by_vector = own["tilt_by_vector"]
    share = math.atan2(abs(x), abs(y)) if by_vector else abs(x) / total * 0.5 * math.pi
    width = own["tilt_softening_nm"]
    a = t * math.sin(share) * _soft_sign(x, width)
    b = t * math.cos(share) * _soft_sign(y, width)
    return c * x + a / math.hypot(1.0, a), c * y + b / math.hypot(1.0, b)


def _curve(curve: dict[str, Any], q: float, own: float) -> float:
    """What a curve says at the control ``q`` of its driver and the control ``own`` of its joint."""
    a, shape, constants = curve["a"], curve["shape"], curve["constants"]
    if shape == "wave":
        return float(a * math.sin(curve["factor"] * q) + curve["b"] * math.cos(curve["factor"] * q))
    if shape == "linear":
        return float(a * q)
    if shape == "sines":
        return float(a * math.sin(q) * math.sin(own))
    if shape == "polynomial":
        u = min(1.0, max(-1.0, (q - constants[0]) / constants[1]))
        return float(sum(power * u**k for k, power in enumerate(curve["powers"])))
    near, far, angle, free = constants
    length = math.sqrt(near**2 + far**2 - 2.0 * near * far * math.cos(q + angle))
    return float(-a * math.sin(q + angle) * (1.0 - free / length))


def _bent(model: Any, data: Any, row: dict[str, Any], controls: dict[str, float], of_joint: Floats) -> list[float]:
    """Twist of a link that bends: linear in the loads on its joint and on its end."""
    order = list(controls)
    place = order.index(row["joint"])
    after = f"{order[place + 1]}_link" if place + 1 < len(order) else "flange"
    of_end = _load(model, data, row["joint"], after)
    of_end[3:] -= _cross(row["link"], of_end[:3].tolist())
    power, root, way = row["reach"]
    reach = max(0.0, way * (controls[row["joint"]] - root)) ** power
    twist: list[float] = (reach * (np.array(row["of_joint"]) @ of_joint + np.array(row["of_end"]) @ of_end)).tolist()
    return twist


def _place(model: Any, body: str, twist: list[float]) -> None:
    """Put a body where a twist (v, w) leads from its parent: the exponential."""
    v, w = np.array(twist[:3]), np.array(twist[3:])
    angle = float(np.linalg.norm(w))
    half = 0.5 * angle
    scale = 0.5 if angle < 1e-9 else math.sin(half) / angle
    first = 0.5 if angle < 1e-6 else (1.0 - math.cos(angle)) / angle**2
    second = 1.0 / 6.0 if angle < 1e-4 else (angle - math.sin(angle)) / angle**3
    at = model.body(body).id
    across = _cross(twist[3:], twist[:3])
    model.body_pos[at] = v + first * across + second * _cross(twist[3:], across.tolist())
    model.body_quat[at] = [math.cos(half), *(scale * w)]
