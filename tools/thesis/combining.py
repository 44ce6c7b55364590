"""Influence weights and joint tilting together (thesis, future work 6.2), on several makes of arm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.robot import Robot
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.model import Calibration
from kilter_core.plan.iso9283_poses import iso_poses
from kilter_core.types import Floats
from tools.thesis.arms import ELBOW, KATANA, SKEWED, Arm, Make, built
from tools.thesis.experiments import UNSEEN, by_inclinometer, mean_mm, measured

MAKES: Mapping[str, Make] = {"Katana 450": KATANA, "elbow arm, 6 axes": ELBOW, "skewed Katana": SKEWED}
BASE_MM = (55.0, 55.0, 201.5)
TOOL_MM = 130.0
PLAIN = IdentifyOptions(base="fixed", tool="fixed", level=2)
FULL = replace(PLAIN, level=3)
# What is said of tilting, by which method the geometry is found.
TREATMENTS: Mapping[str, IdentifyOptions] = {
    "no tilting, least squares": PLAIN,
    "no tilting, influence": replace(PLAIN, method="influence"),
    "tilting measured first, least squares": replace(FULL, tilt_first=True),
    "tilting measured first, influence": replace(FULL, tilt_first=True, method="influence"),
    "tilting identified too, least squares": FULL,
    "tilting identified too, influence": replace(FULL, method="influence"),
}


def robot_of(make: Make) -> Robot:
    """The make as Kilter is given it."""
    joints = [{"name": f"j{k + 1}", "limits_deg": list(limits)} for k, limits in enumerate(make.limits_deg)]
    elements: list[dict[str, Any]] = []
    for name, axis, value in make.elements:
        if name[0] == "q":
            elements.append({"joint": f"j{name[1:]}", "axis": "Rz"})
        else:
            elements.append({"name": name, "axis": axis.capitalize(), "value": value})
    links = [{"mass_kg": m, "com_mm": list(com)} for m, com in zip(make.mass, make.com_mm, strict=True)]
    frame = dict.fromkeys(("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg"), 0.0)
    base = {**frame, **dict(zip(("x_mm", "y_mm", "z_mm"), BASE_MM, strict=True))}
    return robot_from_document({
        "name": "arm", "convention": "chain", "joints": joints, "elements": elements, "links": links,
        "base": base, "tool": {**frame, "z_mm": TOOL_MM},
    })  # fmt: skip


def poses(robot: Robot, count: int) -> tuple[Floats, Floats]:
    """Joints to calibrate with (count, n) and never to calibrate with (60, n)."""
    q = iso_poses(robot, count + UNSEEN, seed=0)
    return q[:count], q[count:]


def compared(robot: Robot, make: Make, seed: int, calibrate: Floats, unseen: Floats) -> dict[str, float]:
    """Mean |ΔP| mm on poses not used, before and by every treatment."""
    arm: Arm = built(seed, make)
    rows, start = measured(arm, calibrate, seed), by_inclinometer(robot, arm, seed)
    out = {"before": mean_mm(Calibration.nominal(robot), arm, unseen)}
    for name, options in TREATMENTS.items():
        found = identify(robot, rows, options=options, start=start if options.tilt_first else None).calibration
        out[name] = mean_mm(found, arm, unseen)
    return out
