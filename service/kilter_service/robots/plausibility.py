"""Plausibility of a robot document: wrong units, missing limits, axes that cannot be told apart."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_service.ground.core import core_arm
from kilter_service.ground.wire import to_deg, to_mm, to_rad
from kilter_service.robots.drives import unsaid_drives
from kilter_service.robots.likely_payload import heaviest_likely_payload

if TYPE_CHECKING:
    from kilter_core.arm import Robot, Screws

SMALL_M, LARGE_M = 0.02, 20.0
RADIANS = (math.pi / 2, math.pi)  # numbers that are seldom degrees
NEAR = 0.001
LOW_G, HIGH_G = 9.7, 9.9
ONE_TURN, TWO_TURNS = to_rad(7.0), to_rad(800.0)


def implausible(robot: Robot, screws: Screws, reach_m: float, posted: dict[str, Any]) -> list[str]:
    """Return a sentence for each thing that looks wrong, with its remedy; none of them is an error."""
    return [
        *_sizes(reach_m, posted.get("convention")),
        *_radians(posted),
        *_limits(robot),
        *_axes(robot, screws),
        *_loads(robot, reach_m),
        *unsaid_drives(robot),
    ]


def _sizes(reach_m: float, convention: str | None) -> Iterator[str]:
    urdf = convention == "urdf"
    if reach_m < SMALL_M:
        said = "kilometres? A URDF counts in metres" if urdf else "metres? Fields ending in _mm are millimetres"
        yield f"The arm reaches {to_mm(reach_m):.3g} mm: are its lengths in {said}."
    if reach_m > LARGE_M:
        said = (
            "millimetres? A URDF counts in metres." if urdf else "micrometres, or is a DH row of parallel axes meant?"
        )
        yield f"The arm reaches {reach_m:.4g} m: are its lengths in {said}"


def _radians(posted: dict[str, Any]) -> Iterator[str]:
    for where, rows in (("rows", posted.get("rows") or ()), ("elements", posted.get("elements") or ())):
        for k, row in enumerate(rows):
            turned = where == "rows" or str(row.get("axis", "")).startswith("R")
            names = [n for n in row if n.endswith("_deg")] if where == "rows" else ["value"] if turned else []
            for name in names:
                value = abs(float(row.get(name) or 0.0))
                if any(abs(value - number) < NEAR for number in RADIANS):
                    yield f"{where}[{k}].{name} is {row[name]:g}, taken as degrees: it looks like radians."


def _limits(robot: Robot) -> Iterator[str]:
    without = [j.name for j in robot.joints if not (math.isfinite(j.lower) and math.isfinite(j.upper))]
    if without:
        yield f"No limits for {', '.join(without)}: with them, swapped columns and wrong units are caught at upload."
    turning = [j for j in robot.joints if j.kind == "revolute" and j.name not in without]
    if turning and all(max(abs(j.lower), abs(j.upper)) < ONE_TURN for j in turning):
        yield "All limits are within 7 degrees: they look like radians."
    for j in turning:
        if max(abs(j.lower), abs(j.upper)) > TWO_TURNS:
            yield f"Joint {j.name} rotates to {to_deg(max(abs(j.lower), abs(j.upper))):.0f} deg: is that meant?"
    for j in robot.joints:
        if not j.lower <= 0.0 <= j.upper:
            yield f"Zero lies outside the limits of {j.name}: the zero pose is one that the arm cannot take."


def _axes(robot: Robot, screws: Screws) -> Iterator[str]:
    for k in range(1, len(screws)):
        names = f"{robot.joints[screws.joint[k - 1]].name} and {robot.joints[screws.joint[k]].name}"
        if screws.joint[k] == screws.joint[k - 1] or screws.prismatic[k] or screws.prismatic[k - 1]:
            continue
        sine = float(np.linalg.norm(np.cross(screws.direction[k - 1], screws.direction[k])))
        gap = screws.point[k] - screws.point[k - 1]
        aside = float(np.linalg.norm(np.cross(gap, screws.direction[k])))
        coupled = any(np.count_nonzero(screws.joint == screws.joint[i]) > 1 for i in (k - 1, k))
        if sine < 1e-9 and aside < 1e-9 and not coupled:
            yield f"{names} rotate about the same axis: their offsets cannot be told apart, and one of them looks missing."
        elif 1e-6 < sine < math.sin(core_arm.PARALLEL_RAD):
            yield f"The axes of {names} are {to_deg(math.asin(sine)):.4f} deg from parallel: nominal axes are exact."


def _loads(robot: Robot, reach_m: float) -> Iterator[str]:
    g = float(np.linalg.norm(robot.gravity))
    if not LOW_G < g < HIGH_G:
        yield f"Gravity is {g:.4g} m/s2: on Earth it is 9.81."
    if not robot.has_masses:
        yield "No link has a mass: effects that follow the load cannot be identified without."
    most, why = heaviest_likely_payload(robot)
    if robot.load is not None and robot.load.mass > most:
        yield f"load.payload_kg is {robot.load.mass:.6g}, but {why}: if it is in grams, divide it by 1000."
    for k, link in enumerate(robot.links):
        away = float(np.linalg.norm(link.com))
        if link.mass > 0 and away > max(reach_m, SMALL_M):
            yield f"links[{k}]: the centre of mass lies {to_mm(away):.0f} mm away, farther than the arm reaches."
        moments = np.linalg.eigvalsh(link.inertia)
        if moments[0] < -1e-12 or moments[2] > moments[0] + moments[1] + 1e-9:
            yield f"links[{k}]: no body has this inertia (its principal moments break the triangle inequality)."
