"""A robot as plain numbers (SI): what is stored of it, so that it stays what it is whatever becomes of its source."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from kilter_core.arm.chain import Axis, Chain, Element
from kilter_core.arm.robot import Joint, Link, Payload, Robot

FORMAT = "kilter-chain/1"


def resolved_document(robot: Robot) -> dict[str, Any]:
    """Write a robot as JSON-able numbers that give it back bit by bit: m, rad, kg; limits that are not there are null.

    Its name is left out: the same arm under two names is one arm.
    """
    document: dict[str, Any] = {
        "format": FORMAT,
        "joints": [_joint(joint) for joint in robot.joints],
        "elements": [_element(element) for element in robot.chain.elements],
        "links": [_link(link) for link in robot.links],
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


def _link(link: Link) -> dict[str, Any]:
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
