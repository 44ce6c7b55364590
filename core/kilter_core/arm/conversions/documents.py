"""A robot as a document of another convention: the same poses at the same joint readings."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from kilter_core.arm.conventions import PARALLEL_RAD, Row, rotation_to
from kilter_core.arm.conversions.tables import Screws, chain_frames, link_table, screws_of_chain
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.documents.parts import STIFFNESS
from kilter_core.arm.robot import CENTRE_M, MASS_SHARE, Joint, Link, Robot, moved_link
from kilter_core.errors import OptionError, RobotError
from kilter_core.parameters import degrees, display_unit_and_scale, mm
from kilter_core.transforms import inverse, xyz_rpy_from_pose
from kilter_core.types import Floats

Document = dict[str, Any]

LEVEL = 1e-12
STEEP = 0.7
SAME_M = 1e-9


def robot_document(robot: Robot, convention: str) -> Document:
    """Document of ``robot`` in ``convention`` chain, poe, cpc, mcpc, s_model, dh or mdh; poses, masses and limits are kept.

    Raises:
        OptionError: another convention. RobotError: a joint that drives several axes, which only chain and poe can say;
            axes less than a degree from parallel, which dh and s_model cannot.

    """
    if convention not in WRITERS:
        raise OptionError(
            f"There is no convention {convention!r} to convert to: give {', '.join(WRITERS)}.", option="to"
        )
    document = {
        "name": robot.name,
        "convention": convention,
        "gravity_m_s2": _float_list(robot.gravity),
        "joints": [_joint(joint) for joint in robot.joints],
        "base": pose_document(robot.T_base),
        "tool": pose_document(robot.T_tool),
        **WRITERS[convention](robot),
    }
    _refuse_other_poses(robot, document)
    share, centre = robot.payload_sigma
    stated = {"payload_sigma": {"mass_percent": 100.0 * share, "com_mm": mm(centre)}}
    document |= stated if robot.payload_sigma != (MASS_SHARE, CENTRE_M) else {}
    document |= load_document(robot)
    return document | ({"links": _links(robot, document)} if robot.links else {})


def pose_document(T: Floats) -> dict[str, float]:
    """Pose (4, 4) as x_mm ... rz_deg."""
    xyz, rpy = xyz_rpy_from_pose(T)
    lengths = dict(zip(("x_mm", "y_mm", "z_mm"), _float_list(mm(xyz)), strict=True))
    return lengths | dict(zip(("rx_deg", "ry_deg", "rz_deg"), _float_list(degrees(rpy)), strict=True))


def load_document(robot: Robot) -> Document:
    """The default load as ``load`` of a robot document; nothing where there is none."""
    if robot.load is None:
        return {}
    return {"load": {"payload_kg": robot.load.mass, "payload_com_mm": [mm(value) for value in robot.load.com]}}


def _chain(robot: Robot) -> Document:
    return {"elements": [_element(robot, k) for k in range(len(robot.chain.elements))]}


def _element(robot: Robot, k: int) -> Document:
    e = robot.chain.elements[k]
    axis = e.axis.name.capitalize()
    out: Document = {"axis": axis, "value": degrees(e.value) if e.axis.rotates else mm(e.value)}
    out |= {"fixed": True} if e.name is None else {"name": e.name}
    out |= {} if e.joint is None else {"joint": robot.joints[e.joint].name, "ratio": e.ratio}
    out |= {} if e.drive is None else {"drive": e.drive}
    return out | ({"spare": True} if e.dependent else {})


def _poe(robot: Robot) -> Document:
    screws = screws_of_chain(robot.chain)
    drives = [robot.chain.elements[k].drive for k in robot.chain.driven]
    axes = [
        {
            "joint": robot.joints[screws.joint[k]].name,
            "type": _kind(screws, k),
            "direction": _float_list(screws.direction[k]),
            "point_mm": _float_list(mm(screws.point[k])),
            "ratio": float(screws.ratio[k]),
            **({} if drives[k] is None else {"drive": drives[k]}),
        }
        for k in range(len(screws))
    ]
    return {"axes": axes, "home": pose_document(screws.home)}


def _cpc(robot: Robot) -> Document:
    screws = screws_of_chain(robot.chain).one_axis_per_joint()
    frame, rows = np.eye(4), []
    for k in range(len(screws)):
        b = frame[:3, :3].T @ screws.direction[k]
        frame = frame @ rotation_to(b)
        x, y = _shifts(frame, screws, k)
        frame = frame @ _shift(x, y)
        rows.append({"type": _kind(screws, k), "b": _float_list(b), "x_mm": mm(x), "y_mm": mm(y)})
    end = inverse(frame) @ screws.home
    b = end[:3, 2]
    beta = rotation_to(b)[:3, :3].T @ end[:3, :3]
    shift = end[:3, :3].T @ end[:3, 3]
    flange = {"b": _float_list(b), "beta_deg": degrees(math.atan2(beta[1, 0], beta[0, 0]))}
    return {"rows": rows, "flange": flange | dict(zip(("x_mm", "y_mm", "z_mm"), _float_list(mm(shift)), strict=True))}


def _mcpc(robot: Robot) -> Document:
    screws = screws_of_chain(robot.chain).one_axis_per_joint()
    # A first axis along the base's x is where the model is singular: then the base frame is rotated about its z.
    base = _rotation("z", _to_level(screws.direction[0])) if abs(screws.direction[0, 0]) > STEEP else np.eye(4)
    frame, rows = base, list[Document]()
    for k in range(len(screws)):
        z = frame[:3, :3].T @ screws.direction[k]
        if rows:
            # The joint before is given a zero in which beta is 0: with beta near 90 degrees the model would be singular.
            zero = _to_level(z)
            rows[-1]["theta_offset_deg"] = degrees(zero)
            frame = frame @ _rotation("z", zero)
            z = frame[:3, :3].T @ screws.direction[k]
        alpha = math.atan2(-z[1], z[2])
        beta = 0.0 if rows else math.atan2(z[0], math.hypot(z[1], z[2]))
        frame = frame @ _rotation("x", alpha) @ _rotation("y", beta)
        x, y = _shifts(frame, screws, k)
        frame = frame @ _shift(x, y)
        rows.append(
            {
                "type": _kind(screws, k),
                "alpha_deg": degrees(alpha),
                "beta_deg": degrees(beta),
                "x_mm": mm(x),
                "y_mm": mm(y),
            }
        )
    end = inverse(frame) @ screws.home
    document: Document = {"rows": rows, "flange": _xyz_flange(end)}
    if np.array_equal(base, np.eye(4)):
        return document
    rotated = {"base": pose_document(robot.T_base @ base), "gravity_m_s2": _float_list(base[:3, :3].T @ robot.gravity)}
    return document | rotated


def _to_level(z: Floats) -> float:
    """Angle about z, 90 degrees at most, after which the direction ``z (3,)`` has no x."""
    if math.hypot(z[0], z[1]) < LEVEL:
        return 0.0
    zero = math.atan2(z[0], -z[1])
    return zero - math.copysign(math.pi, zero) if abs(zero) > math.pi / 2 else zero


def _xyz_flange(end: Floats) -> Document:
    """Rx(alpha) Ry(beta) Rz(gamma) Tx Ty Tz of a pose (4, 4)."""
    R = end[:3, :3]
    # The transpose is Rz(-gamma) Ry(-beta) Rx(-alpha): URDF's order.
    _, rpy = xyz_rpy_from_pose(np.block([[R.T, np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]]))
    angles = dict(zip(("alpha_deg", "beta_deg", "gamma_deg"), _float_list(-degrees(rpy)), strict=True))
    return angles | dict(zip(("x_mm", "y_mm", "z_mm"), _float_list(mm(R.T @ end[:3, 3])), strict=True))


def _table(convention: str) -> Callable[[Robot], Document]:
    def write(robot: Robot) -> Document:
        table = link_table(screws_of_chain(robot.chain), hayati=convention == "mdh")
        rows, tool = (table.mdh_rows(), table.mdh_tool()) if convention == "mdh" else (table.dh_rows(), table.tool)
        back = table.base[:3, :3].T
        return {
            "rows": [_row(row, convention) for row in rows],
            "base": pose_document(robot.T_base @ table.base),
            "tool": pose_document(tool @ robot.T_tool),
            "gravity_m_s2": _float_list(back @ robot.gravity),
        }

    return write


def _row(row: Row, convention: str) -> Document:
    out: Document = {
        "type": "prismatic" if row.prismatic else "revolute",
        "theta_offset_deg": degrees(row.theta_offset),
        "d_mm": None if row.d is None else mm(row.d),
        "a_mm": mm(row.a),
        "alpha_deg": degrees(row.alpha),
    }
    if convention == "s_model":
        return out | {"gamma_deg": degrees(row.gamma), "b_mm": mm(row.b)}
    return out | ({"beta_deg": degrees(row.beta)} if row.beta is not None else {})


WRITERS: Mapping[str, Callable[[Robot], Document]] = MappingProxyType(
    {
        "chain": _chain,
        "poe": _poe,
        "cpc": _cpc,
        "mcpc": _mcpc,
        "dh": _table("dh"),
        "mdh": _table("mdh"),
        "s_model": _table("s_model"),
    }
)


def _refuse_other_poses(robot: Robot, document: Document) -> None:
    """Tables drop the tilt of axes that are almost parallel: say so instead of writing another arm."""
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (8, robot.n_joints))
    here, there = _poses(robot, q), _poses(robot_from_document(document), q)
    apart = float(np.abs(here - there).max())
    if apart > SAME_M:
        raise RobotError(
            f"As {document['convention']} the arm is {mm(apart):.3g} mm off: it has axes less than "
            f"{degrees(PARALLEL_RAD):.0f} degree from parallel. Take mdh (with beta), poe, cpc or mcpc.",
            apart_m=apart,
        )


def _poses(robot: Robot, q: Floats) -> Floats:
    return screws_of_chain(robot.chain).compose_with_poses(robot.T_base, robot.T_tool).poses(q)


def _links(robot: Robot, document: Document) -> list[Document]:
    """Masses in the frames of the new document: the same bodies, seen from other frames fixed to them."""
    places = [_place(robot, k) for k in range(len(robot.links))]
    other = robot_from_document({**document, "links": places})
    base = inverse(other.T_base) @ robot.T_base
    before, after = chain_frames(robot.chain), chain_frames(other.chain)
    return [
        place | _link(moved_link(link, inverse(after[twin.element + 1]) @ base @ before[link.element + 1]))
        for place, link, twin in zip(places, robot.links, other.links, strict=True)
    ]


def _place(robot: Robot, k: int) -> Document:
    """Where a link is: that of a joint says nothing, the others name their moving axis."""
    if k < robot.n_joints:
        return {}
    return {"on_axis": robot.chain.driven.index(robot.links[k].element) + 1}


def _link(link: Link) -> Document:
    inertia = link.inertia
    six = [inertia[i, k] for i, k in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    return {
        "mass_kg": link.mass,
        "com_mm": _float_list(mm(link.com)),
        "inertia_kg_m2": [float(value) for value in six],
        **({} if link.mass_sigma is None else {"mass_sigma_kg": link.mass_sigma}),
        **({} if link.com_sigma is None else {"com_sigma_mm": mm(link.com_sigma)}),
    }


def _joint(joint: Joint) -> Document:
    unit, scale = display_unit_and_scale("m" if joint.kind == "prismatic" else "rad")
    out: Document = {"name": joint.name}
    if math.isfinite(joint.lower) and math.isfinite(joint.upper):
        out[f"limits_{unit}"] = [joint.lower * scale, joint.upper * scale]
    return out | drive_document(joint)


def drive_document(joint: Joint) -> Document:
    """What is known of the drive of a joint: its gear ratio, its stiffness."""
    told = {"gear_ratio": joint.gear_ratio, STIFFNESS: joint.drive_stiffness}
    return {name: value for name, value in told.items() if value is not None}


def _kind(screws: Screws, k: int) -> str:
    return "prismatic" if screws.prismatic[k] else "revolute"


def _shifts(frame: Floats, screws: Screws, k: int) -> tuple[float, float]:
    """Shift across an axis, from the frame whose z is along it to the axis; none for a prismatic axis."""
    if screws.prismatic[k]:
        return 0.0, 0.0
    across = frame[:3, :3].T @ (screws.point[k] - frame[:3, 3])
    return float(across[0]), float(across[1])


def _shift(x: float, y: float) -> Floats:
    out = np.eye(4)
    out[0, 3], out[1, 3] = x, y
    return out


def _rotation(axis: str, angle: float) -> Floats:
    k = "xyz".index(axis)
    a, b, out = (k + 1) % 3, (k + 2) % 3, np.eye(4)
    out[a, a] = out[b, b] = math.cos(angle)
    out[b, a] = math.sin(angle)
    out[a, b] = -out[b, a]
    return out


def _float_list(values: Floats) -> list[float]:
    return [float(value) + 0.0 for value in values]
