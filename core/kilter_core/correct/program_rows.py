"""Rows of the correction's program: the chain with all constants multiplied out, and what the effects do at run time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kilter_core.arm.chain import Element
from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import BendingRow, Curve, RunTimeForm, Shape
from kilter_core.correct.kernels import layout
from kilter_core.model import Calibration, RobotModel
from kilter_core.model.calibration import Doubt
from kilter_core.transforms import pose_from_twist
from kilter_core.types import Floats


@dataclass(frozen=True)
class CollapsedChain:
    """Chain as constants between moves; ``moves`` are (element, joint, ratio, prismatic, primary)."""

    constants: list[Floats]
    moves: list[tuple[int, int, float, bool, bool]]
    since_move: list[Floats]  # per element: the constant transform since the last move
    move_of: list[int]  # per element: the last move, -1 before the first


def _rotation_to_z(element: Element, frame: Floats | None) -> Floats:
    """Rotation (4, 4) that brings z onto the element's axis: the joint frame when there is one."""
    T = np.eye(4)
    if frame is not None:
        T[:3, :3] = frame
        return T
    z = element.axis % 3
    T[:3, :3] = np.eye(3)[:, [(z + 1) % 3, (z + 2) % 3, z]]
    return T


def collapse_constants(robot: Robot, values: list[float], T_base: Floats, T_tool: Floats) -> CollapsedChain:
    """Multiply everything that does not move into constants; every move becomes one about or along z."""
    primary = {k: j for j, k in enumerate(robot.chain.primary)}
    frames = robot.chain.program.joint_frame
    out = CollapsedChain([], [], [], [])
    since = T_base
    for k, (element, value) in enumerate(zip(robot.chain.elements, values, strict=True)):
        since = since @ element.axis.motion(value)
        if element.joint is not None:
            rotation = _rotation_to_z(element, frames[primary[k]] if k in primary else None)
            out.constants.append(since @ rotation)
            sign = rotation[element.axis % 3, 2]
            out.moves.append((k, element.joint, float(sign * element.ratio), not element.axis.rotates, k in primary))
            since = rotation.T
        out.since_move.append(since)
        out.move_of.append(len(out.moves) - 1)
    out.constants.append(since @ T_tool)
    return out


def write_moves(P: Floats, nominal: CollapsedChain, actual: CollapsedChain) -> None:
    """Write the constants of both chains and what moves between them."""
    _write_constants(P, layout.NOMINAL, nominal)
    _write_constants(P, layout.IDENTIFIED, actual)
    for row, (_, joint, ratio, prismatic, primary) in enumerate(nominal.moves):
        P[row, layout.KIND] = float(prismatic)
        P[row, layout.JOINT] = joint
        P[row, layout.RATIO] = ratio
        P[row, layout.PRIMARY] = 0.0 if primary else -1.0


def load_rows(loads: CollapsedChain) -> Floats:
    """Rows with the constants of the chain that loads are taken on, for where it is not the nominal one."""
    rows = np.zeros((len(loads.constants), layout.COLUMNS))
    _write_constants(rows, layout.NOMINAL, loads)
    return rows


def _write_constants(P: Floats, column: int, chain: CollapsedChain) -> None:
    for row, T in enumerate(chain.constants):
        P[row, column : column + 9] = T[:3, :3].ravel()
        P[row, column + 9 : column + 12] = T[:3, 3]


def write_bodies(
    P: Floats, robot: Robot, loads: CollapsedChain, payload_kg: float, payload_com: Sequence[float]
) -> None:
    """Bodies that ride on the same move become one; the payload keeps its own row, on the last move."""
    last = len(loads.moves)
    for move, (element, *_) in enumerate(loads.moves):
        P[move, layout.CARRIED] = (
            robot.chain.linkage_load_ratio(element) if element in robot.chain.linkage_axes else 0.0
        )
    P[last, layout.CARRIED] = float(bool(robot.chain.linkage_axes))  # whether any is
    bodies: dict[int, list[tuple[float, Floats, Floats]]] = {}
    for link in robot.links:
        move = loads.move_of[link.element]
        if move >= 0 and link.mass != 0.0:
            T = loads.since_move[link.element]
            R = T[:3, :3]
            bodies.setdefault(move, []).append((link.mass, R @ link.com + T[:3, 3], R @ link.inertia @ R.T))
    for move, parts in bodies.items():
        _write_body(P[move], parts)
    at_tool = loads.since_move[-1] @ robot.T_tool
    com = at_tool[:3, :3] @ np.asarray(payload_com) + at_tool[:3, 3]
    _write_body(P[last], [(payload_kg, com, np.zeros((3, 3)))])


def fixed_links_moment(robot: Robot, loads: CollapsedChain) -> Floats:
    """Moment (3,) N·m about the base origin of the links that no joint moves."""
    moment = np.zeros(3)
    for link in robot.links:
        if loads.move_of[link.element] < 0:
            T = loads.since_move[link.element]
            moment += np.cross(T[:3, :3] @ link.com + T[:3, 3], link.mass * np.asarray(robot.gravity))
    return moment


def _write_body(row: Floats, parts: list[tuple[float, Floats, Floats]]) -> None:
    """Mass, centre and inertia about it of bodies that move as one (parallel axes)."""
    mass = sum(part[0] for part in parts)
    if mass == 0.0:
        return
    com = sum((m * c for m, c, _ in parts), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for m, c, own in parts:
        d = c - com
        inertia += own + m * (d @ d * np.eye(3) - np.outer(d, d))
    row[layout.MASS] = mass
    row[layout.COM : layout.COM + 3] = com
    xx, yy, zz, xy, xz, yz = (inertia[a, b] for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))
    row[layout.INERTIA : layout.INERTIA + 6] = xx, yy, zz, xy, xz, yz


@dataclass(frozen=True)
class Chains:
    """The nominal and the identified chain; ``base (4, 4)`` is the identified base frame seen from the wanted one."""

    nominal: CollapsedChain
    identified: CollapsedChain
    base: Floats


def collapse_chains(calibration: Calibration, model: RobotModel, values: Floats) -> Chains:
    """Collapse both chains of a calibration; the identified one is that of ``model`` with ``values``."""
    robot, ideal = calibration.robot, calibration.nominal_in_wanted_frames().model
    found = dict(zip(model.names, values.tolist(), strict=True))
    identified = [found[e.name] if e.name else e.value for e in robot.chain.elements]
    # Seen from the wanted base, so that the frames, too, are part of the error.
    base = np.linalg.solve(np.asarray(ideal.T_base), np.asarray(model.T_base))
    return Chains(
        collapse_constants(robot, nominal_values(robot), np.eye(4), np.asarray(ideal.T_tool)),
        collapse_constants(robot, identified, base, np.asarray(model.T_tool)),
        base,
    )


def nominal_values(robot: Robot) -> list[float]:
    """Value of every element of the chain as it was designed."""
    return [element.value for element in robot.chain.elements]


def write_base(head: Floats, scalars: Floats, form: RunTimeForm, base: Floats, fixed_moment: Floats) -> list[Floats]:
    """Let the base frame (4, 4) move: a constant shift at once, a base mount that deflects as a row of its own."""
    if form.base_compliance is None and not np.any(form.base_shift) and not np.any(form.base_tilt):
        return []
    first = head[0, layout.IDENTIFIED : layout.IDENTIFIED + 12]
    first_move = np.linalg.solve(base, np.vstack([np.column_stack([first[:9].reshape(3, 3), first[9:]]), [0, 0, 0, 1]]))
    moved = base @ pose_from_twist(form.base_shift, form.base_tilt)
    if form.base_compliance is None:
        first[:] = _flat(moved @ first_move)
        return []
    row = np.zeros(layout.COLUMNS)
    row[layout.BASE_FRAME : layout.BASE_FRAME + 12] = _flat(moved)
    row[layout.FIRST_MOVE : layout.FIRST_MOVE + 12] = _flat(first_move)
    row[layout.MOUNT_X], row[layout.MOUNT_Y] = form.base_compliance
    row[layout.FIXED_MOMENT_X], row[layout.FIXED_MOMENT_Y] = fixed_moment[:2]
    scalars[layout.MOUNT] = 1.0
    return [row]


def _flat(T: Floats) -> Floats:
    return np.concatenate([T[:3, :3].ravel(), T[:3, 3]])


_SHAPES: Mapping[Shape, float] = {
    Shape.WAVE: layout.WAVE,
    Shape.LINEAR: layout.LINEAR,
    Shape.SPRING: layout.SPRING,
    Shape.SINES: layout.SINES,
    Shape.LAG: layout.LAG,
    Shape.POLYNOMIAL: layout.POLYNOMIAL,
}
_JOINT: Mapping[str, int] = {
    "offset": layout.DQ,
    "tilt": layout.TILT,
    "tilt_by_vector": layout.TILT_SHARE,
    "tilt_softening_nm": layout.TILT_OWN,
    "backlash": layout.PLAY,
    "backlash_softening_nm": layout.PLAY_OWN,
    "reversal": layout.REVERSAL,
    "compliance": layout.COMPLIANCE,
    "compliance_by_direction": layout.SIDED,
    "hardening": layout.HARDENING,
    "radial_compliance": layout.RADIAL,
}


def joint_rows(form: RunTimeForm, widths: tuple[Floats, Floats]) -> Floats:
    """Rows (n, COLUMNS) of the joints; ``widths`` (n,) N·m of the signs of the load across and about them."""
    rows = np.zeros((len(form.joints), layout.COLUMNS))
    for j, (row, joint) in enumerate(zip(rows, form.joints, strict=True)):
        for name, column in _JOINT.items():
            row[column] = getattr(joint, name)
        row[layout.TILT_SOFT] = widths[0][j]
        row[layout.PLAY_SOFT] = widths[1][j]
        row[layout.XI : layout.XI + 6] = joint.twist
        row[layout.TWISTED] = j in form.twisted
    return rows


def curve_rows(form: RunTimeForm) -> Floats:
    """Rows (curves, COLUMNS), one for each curve."""
    return np.array([_curve(curve) for curve in form.curves]).reshape(-1, layout.COLUMNS)


def _curve(curve: Curve) -> Floats:
    row = np.zeros(layout.COLUMNS)
    row[layout.CURVED], row[layout.SHAPE], row[layout.DRIVER] = curve.joint, _SHAPES[curve.shape], curve.driver
    row[layout.AMPLITUDE_A], row[layout.AMPLITUDE_B], row[layout.FACTOR] = curve.a, curve.b, curve.factor
    row[layout.MOVED] = 0 if curve.twist is None else 1 + curve.twist
    row[layout.EXTRA : layout.EXTRA + len(curve.constants)] = curve.constants
    row[layout.POWERS : layout.POWERS + len(curve.powers)] = curve.powers
    if curve.within is not None:
        row[[layout.FROM, layout.TO, layout.FADE, layout.MEAN]] = curve.within
    return row


def bending_rows(form: RunTimeForm) -> Floats:
    """Rows (2 x bending rows, COLUMNS)."""
    return np.array(
        [row for b in form.bending for row in _bending(b, form.robot.joints[b.joint].kind == "revolute")]
    ).reshape(-1, layout.COLUMNS)


def _bending(bending: BendingRow, revolute: bool) -> Floats:
    rows = np.zeros((2, layout.COLUMNS))
    rows[0, :36], rows[1, :36] = bending.of_joint.ravel(), bending.of_end.ravel()
    rows[0, layout.BENDING_JOINT] = bending.joint
    rows[0, layout.BENDING_LINK : layout.BENDING_LINK + 3] = bending.link
    if bending.of_axis:
        rows[0, layout.OF_AXIS] = 6 if revolute else 3
    rows[0, layout.POWER], rows[0, layout.ROOTED], rows[0, layout.WAY] = bending.reach
    return rows


def doubt_rows(doubts: Sequence[Doubt], n: int) -> Floats:
    """Rows (doubts, COLUMNS), one for each box of joint values in which the version is less sure than it says."""
    rows = np.zeros((len(doubts), layout.COLUMNS))
    bounded = min(n, layout.HIGHEST_OF_BOX - layout.LOWEST_OF_BOX)
    for row, doubt in zip(rows, doubts, strict=True):
        row[layout.LOWEST_OF_BOX : layout.LOWEST_OF_BOX + bounded] = doubt.low[:bounded]
        row[layout.HIGHEST_OF_BOX : layout.HIGHEST_OF_BOX + bounded] = doubt.high[:bounded]
    return rows
