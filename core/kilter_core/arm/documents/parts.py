"""Poses, joints and links of a robot document (mm, degrees) in SI.

A robot as plain numbers (SI): what is stored of it, so that it stays what it is whatever becomes of its source.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from kilter_core.arm.chain import Axis, Chain, Element
from kilter_core.arm.robot import CENTRE_M, MASS_SHARE, Joint, Link, Payload, Robot
from kilter_core.errors import RobotError
from kilter_core.transforms import pose_from_xyz_rpy
from kilter_core.types import Floats

MM = 1e-3
STIFFNESS = "drive_stiffness_nm_rad"
Document = Mapping[str, Any]


def parse_pose(pose: Document | None) -> Floats:
    """Pose (4, 4) of x_mm ... rz_deg; the identity when None."""
    pose = pose or {}
    xyz = np.array([pose.get(f"{k}_mm", 0.0) for k in "xyz"]) * MM
    rpy = np.radians([pose.get(f"r{k}_deg", 0.0) for k in "xyz"])
    return pose_from_xyz_rpy(xyz, rpy)


def parse_joint(i: int, joint: Document, kind: str) -> Joint:
    """Joint ``i`` (from 0) of ``kind`` "revolute" or "prismatic".

    Raises:
        RobotError: limits in the wrong order, or the drive of an axis that follows a joint.

    """
    if joint.get("drive") is not None:
        raise RobotError(
            f"Joint {i + 1} has drive {joint['drive']!r}, which says who carries the load on an axis that follows a joint: "
            "give it to that axis (drive of its element or of its axis; in a URDF of the mimic joint).",
            field=f"joints[{i}].drive",
        )
    unit, scale = ("mm", MM) if kind == "prismatic" else ("deg", math.pi / 180.0)
    limits = joint.get(f"limits_{unit}") or (None, None)
    lower, upper = (
        bound if value is None else float(value) * scale
        for value, bound in zip(limits, (-math.inf, math.inf), strict=True)
    )
    if not lower < upper:
        raise RobotError(
            f"Joint {i + 1} has limits {list(limits)}: the first must be below the second.", field=f"joints[{i}].limits"
        )
    return Joint(
        str(joint.get("name") or f"j{i + 1}"), kind, lower, upper, joint.get("gear_ratio"), _stiffness(joint, i, kind)
    )


def _stiffness(joint: Document, i: int, kind: str) -> float | None:
    stiffness = joint.get(STIFFNESS)
    if stiffness is None:
        return None
    if kind == "prismatic" or not float(stiffness) > 0.0:
        raise RobotError(
            f"Joint {i + 1} has {STIFFNESS} {stiffness!r}: give N m/rad above 0, of a revolute joint; or leave it out.",
            field=f"joints[{i}].{STIFFNESS}",
        )
    return float(stiffness)


def parse_links(links: Sequence[Document], frames: tuple[int, ...], chain: Chain) -> tuple[Link, ...]:
    """Links in the frames after the chain elements ``frames``, one for each joint, then the bodies on other moving axes.

    Those axes are driven by joints that drive several (mimic joints, parallelograms).

    Raises:
        RobotError: another number of links than joints, a negative mass, or an axis that is none or the joint's own.

    """
    own = [i for i, link in enumerate(links) if link.get("on_axis") is None]
    if own and len(own) != len(frames):
        raise RobotError(
            f"There are {len(own)} links for {len(frames)} joints: give each joint one, with mass_kg 0 where it has none.",
            field="links",
        )
    of_joints = [_link(i, links[i], frame) for i, frame in zip(own, frames, strict=False)]
    others = [_link(i, link, _other_axis(i, link, frames, chain)) for i, link in enumerate(links) if i not in own]
    if others and not own:
        of_joints = [_link(j, {}, frame) for j, frame in enumerate(frames)]
    return (*of_joints, *others)


def _other_axis(i: int, link: Document, frames: tuple[int, ...], chain: Chain) -> int:
    """Element of the moving axis that a link names, which must be none of the joints' own."""
    number, axes = int(link["on_axis"]), chain.driven
    if not 1 <= number <= len(axes):
        raise RobotError(
            f"links[{i}] is on axis {number}, the arm has the moving axes 1 to {len(axes)}, counted from the base.",
            field=f"links[{i}].on_axis",
        )
    element = axes[number - 1]
    if element in frames or element in chain.primary:
        raise RobotError(
            f"links[{i}] is on axis {number}, which is that of a joint itself: leave on_axis out, and give it as "
            "the link of that joint. Only further axes of a joint (mimic) have bodies of their own.",
            field=f"links[{i}].on_axis",
        )
    return element


def payload_sigma_of(document: Document | None) -> tuple[float, float]:
    """How well payloads are known: share of the mass, and m of the place.

    Raises:
        RobotError: a width that is not above 0.

    """
    given = {k: v for k, v in (document or {}).items() if v is not None}
    for name, value in given.items():
        if not value > 0:
            message = f"payload_sigma.{name} is {value}: give a standard deviation above 0, or leave it out."
            raise RobotError(message, field=f"payload_sigma.{name}")
    percent, centre = given.get("mass_percent"), given.get("com_mm")
    return (
        MASS_SHARE if percent is None else float(percent) / 100.0,
        CENTRE_M if centre is None else float(centre) * MM,
    )


def parse_load(document: Document | None) -> Payload | None:
    """What the robot carries where no payload is stated.

    Raises:
        RobotError: no mass, or a negative one.

    """
    if document is None:
        return None
    mass = document.get("payload_kg")
    if mass is None or not 0.0 <= mass < math.inf:
        raise RobotError(f"load.payload_kg is {mass}: give a mass, 0 or more.", field="load.payload_kg")
    x, y, z = (float(value) * MM for value in document.get("payload_com_mm") or (0.0, 0.0, 0.0))
    return Payload(float(mass), (x, y, z))


def _link(i: int, link: Document, element: int) -> Link:
    mass = float(link.get("mass_kg") or 0.0)
    if mass < 0:
        raise RobotError(f"links[{i}] has a mass of {mass} kg: a mass cannot be negative.", field=f"links[{i}].mass_kg")
    for name in ("mass_sigma_kg", "com_sigma_mm"):
        if link.get(name) is not None and not link[name] > 0:
            message = f"links[{i}] has a {name} of {link[name]}: give a standard deviation above 0, or leave it out."
            raise RobotError(message, field=f"links[{i}].{name}")
    mass_sigma, com_sigma = link.get("mass_sigma_kg"), link.get("com_sigma_mm")
    xx, yy, zz, xy, xz, yz = link.get("inertia_kg_m2") or (0.0,) * 6
    return Link(
        element=element,
        mass=mass,
        com=np.array(link.get("com_mm") or (0.0, 0.0, 0.0), dtype=np.float64) * MM,
        inertia=np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], dtype=np.float64),
        mass_sigma=None if mass_sigma is None else float(mass_sigma),
        com_sigma=None if com_sigma is None else float(com_sigma) * MM,
    )


FORMAT = "kilter-chain/1"


def resolved_document(robot: Robot) -> dict[str, Any]:
    """Write a robot as JSON-able numbers that give it back bit by bit: m, rad, kg; limits that are not there are null.

    Its name is left out: the same arm under two names is one arm.
    """
    document: dict[str, Any] = {
        "format": FORMAT,
        "joints": [_joint(joint) for joint in robot.joints],
        "elements": [_element(element) for element in robot.chain.elements],
        "links": [_link_resolved(link) for link in robot.links],
        "gravity_m_s2": robot.gravity.tolist(),
        "T_base": robot.T_base.tolist(),
        "T_tool": robot.T_tool.tolist(),
        "payload_sigma": [float(sigma) for sigma in robot.payload_sigma],
    }
    # Only where there is one: robots stored earlier keep their hash.
    load = robot.load
    return document | ({} if load is None else {"load": {"mass_kg": load.mass, "com_m": list(load.com)}})


def robot_from_resolved(name: str, document: Mapping[str, Any]) -> Robot:
    """Build the robot that :func:`resolved_document` wrote."""
    elements = tuple(
        Element(Axis[e["axis"].upper()], e["value"], e["name"], e["joint"], e["ratio"], e["spare"], e.get("drive"))
        for e in document["elements"]
    )
    share, centre = document["payload_sigma"]
    load = document.get("load")
    x, y, z = (0.0, 0.0, 0.0) if load is None else load["com_m"]
    return Robot(
        name=name,
        joints=tuple(_parse_joint(joint) for joint in document["joints"]),
        chain=Chain(elements, len(document["joints"])),
        links=tuple(_parse_link(link) for link in document["links"]),
        gravity=np.array(document["gravity_m_s2"], dtype=np.float64),
        T_base=np.array(document["T_base"], dtype=np.float64),
        T_tool=np.array(document["T_tool"], dtype=np.float64),
        payload_sigma=(share, centre),
        load=None if load is None else Payload(load["mass_kg"], (x, y, z)),
    )


def _joint(joint: Joint) -> dict[str, Any]:
    lower, upper = (float(bound) if math.isfinite(bound) else None for bound in (joint.lower, joint.upper))
    ratio = None if joint.gear_ratio is None else float(joint.gear_ratio)
    told = {"name": joint.name, "kind": joint.kind, "lower": lower, "upper": upper, "gear_ratio": ratio}
    return told | ({} if joint.drive_stiffness is None else {"drive_stiffness": float(joint.drive_stiffness)})


def _parse_joint(joint: Mapping[str, Any]) -> Joint:
    lower = -math.inf if joint["lower"] is None else joint["lower"]
    upper = math.inf if joint["upper"] is None else joint["upper"]
    return Joint(joint["name"], joint["kind"], lower, upper, joint["gear_ratio"], joint.get("drive_stiffness"))


def _element(element: Element) -> dict[str, Any]:
    return {
        "axis": element.axis.name.capitalize(),
        "value": float(element.value),
        "name": element.name,
        "joint": element.joint,
        "ratio": float(element.ratio),
        "spare": element.dependent,
        **({} if element.drive is None else {"drive": element.drive}),  # robots stored earlier keep their hash
    }


def _link_resolved(link: Link) -> dict[str, Any]:
    return {
        "element": link.element,
        "mass_kg": float(link.mass),
        "com_m": link.com.tolist(),
        "inertia_kg_m2": link.inertia.tolist(),
        "mass_sigma_kg": link.mass_sigma,
        "com_sigma_m": link.com_sigma,
    }


def _parse_link(link: Mapping[str, Any]) -> Link:
    return Link(
        element=link["element"],
        mass=link["mass_kg"],
        com=np.array(link["com_m"], dtype=np.float64),
        inertia=np.array(link["inertia_kg_m2"], dtype=np.float64),
        mass_sigma=link["mass_sigma_kg"],
        com_sigma=link["com_sigma_m"],
    )
