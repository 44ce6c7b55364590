"""What a robot document comes to, before it is added: axes, the arm at zero, reach, and what looks wrong."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.types import Floats
from kilter_service.contract.robot_reports import AxisReport, RobotCheck, Zero
from kilter_service.contract.robots import RobotDocument
from kilter_service.contract.units import Pose
from kilter_service.ground.core import core_arm, core_model, transforms
from kilter_service.ground.wire import to_deg, to_mm, to_rad
from kilter_service.robots.documents import core_document
from kilter_service.robots.wire import joint_summary, notes_on_missing_directions, said_of_drives, unsaid_drives

if TYPE_CHECKING:
    from kilter_core.arm import Robot, Screws


SAMPLES = 4000
FREE_SHIFT_M = 0.5  # reach of a prismatic joint without limits

SMALL_M, LARGE_M = 0.02, 20.0
RADIANS = (math.pi / 2, math.pi)  # numbers that are seldom degrees
NEAR = 0.001
LOW_G, HIGH_G = 9.7, 9.9
ONE_TURN, TWO_TURNS = to_rad(7.0), to_rad(800.0)


def check(document: RobotDocument) -> RobotCheck:
    """Report on a document; nothing is stored.

    Raises:
        RobotError: the document cannot be an arm.

    """
    posted = document.model_dump(mode="json", exclude_none=True)
    understood = core_document(posted)
    robot = core_arm.robot_from_document(understood.document)
    screws = core_model.arm_screws(core_model.Calibration.nominal(robot))
    base = robot.T_base
    placed = screws.compose_with_poses(base, np.eye(4))
    reach = _reach(robot, placed)
    return RobotCheck(
        name=robot.name,
        joints=[joint_summary(joint) for joint in robot.joints],
        axes=_axes(robot, placed),
        zero=_zero(robot, placed),
        reach_mm=to_mm(reach),
        drives=said_of_drives(robot),
        suspicious=implausible(robot, placed, reach, posted),
        notes=[*understood.notes, *notes_on_missing_directions(robot)],
    )


def _axes(robot: Robot, screws: Screws) -> list[AxisReport]:
    out = []
    for k in range(len(screws)):
        z, p = screws.direction[k], screws.point[k]
        angle, distance = (None, None) if k == 0 else _angle_and_distance(screws, k)
        out.append(
            AxisReport(
                joint=robot.joints[screws.joint[k]].name,
                kind="prismatic" if screws.prismatic[k] else "revolute",
                ratio=float(screws.ratio[k]),
                drive=robot.chain.elements[robot.chain.driven[k]].drive,
                point_mm=_mm(p),
                direction=_round_vector(z),
                angle_to_previous_deg=angle,
                distance_to_previous_mm=distance,
            )
        )
    return out


def _angle_and_distance(screws: Screws, k: int) -> tuple[float, float]:
    """Angle (deg) and shortest distance (mm) between an axis and the one before."""
    a, b = screws.direction[k - 1], screws.direction[k]
    gap, normal = screws.point[k] - screws.point[k - 1], np.cross(a, b)
    sine = float(np.linalg.norm(normal))
    away = abs(gap @ normal) / sine if sine > 1e-9 else float(np.linalg.norm(np.cross(gap, a)))
    return round(to_deg(math.atan2(sine, float(a @ b))), 9), round(to_mm(float(away)), 9)


def _zero(robot: Robot, screws: Screws) -> Zero:
    """Points of the arm at zero: base, the frames on the axes, and the tool."""
    flange = robot.T_base @ core_arm.screws_of_chain(robot.chain).home
    points = [robot.T_base[:3, 3], *screws.point, flange[:3, 3], screws.home[:3, 3]]
    xyz, rpy = transforms.xyz_rpy_from_pose(screws.home)
    millimetres, degrees = _mm(xyz), _round_vector(to_deg(rpy))
    tool = Pose(
        x_mm=millimetres[0],
        y_mm=millimetres[1],
        z_mm=millimetres[2],
        rx_deg=degrees[0],
        ry_deg=degrees[1],
        rz_deg=degrees[2],
    )
    return Zero(points_mm=[_mm(point) for point in points], tool=tool)


def _reach(robot: Robot, screws: Screws) -> float:
    """Largest distance (m) of the tool point from the first axis' origin over random poses within the limits."""
    free = np.array([math.pi if joint.kind == "revolute" else FREE_SHIFT_M for joint in robot.joints])
    lower = np.maximum(robot.limits[:, 0], -free)
    upper = np.minimum(robot.limits[:, 1], free)
    # Limits that exclude zero altogether may lie outside one turn: then they are taken as they are.
    lower, upper = (
        np.where(lower < upper, lower, robot.limits[:, 0]),
        np.where(lower < upper, upper, robot.limits[:, 1]),
    )
    q = np.random.default_rng(0).uniform(lower, upper, (SAMPLES, robot.n_joints))
    return float(np.linalg.norm(screws.poses(q)[:, :3, 3] - screws.point[0], axis=1).max())


def _mm(values: Floats) -> tuple[float, float, float]:
    return _round_vector(to_mm(values))


def _round_vector(values: Floats) -> tuple[float, float, float]:
    """Three numbers without the noise of the last digits."""
    x, y, z = (round(float(value), 9) + 0.0 for value in values)
    return x, y, z


def implausible(robot: Robot, screws: Screws, reach_m: float, posted: dict[str, Any]) -> list[str]:
    """Return a sentence for each thing that looks wrong, with its remedy; none of them is an error."""
    return [
        *_sizes(reach_m, posted.get("convention")),
        *_radians(posted),
        *_limits(robot),
        *_chain_axes(robot, screws),
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


def _chain_axes(robot: Robot, screws: Screws) -> Iterator[str]:
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


# Of public data sheets no arm carries more than it weighs, or more than 50 kg per m3 of its reach's cube; the smallest
# SCARAs carry some kg at 0.2 m. Lengths of the links add up to more than the reach of a data sheet.
PER_REACH_KG, LEAST_KG = 50.0, 10.0
# A description may state masses for some links only, or numbers that fill a field.
PER_REACH_BESIDE_MASSES_KG, LEAST_BESIDE_MASSES_KG = 15.0, 1.0


def heaviest_likely_payload(robot: Robot) -> tuple[float, str]:
    """Return the largest payload (kg) that an arm of this mass, else of this reach, may carry, and what that rests on."""
    mass, reach = sum(link.mass for link in robot.links), longest_reach(robot)
    if mass > 0:
        by_reach = PER_REACH_BESIDE_MASSES_KG * reach**3 + LEAST_BESIDE_MASSES_KG
        return max(mass, by_reach), f"the links of the arm weigh {mass:.3g} kg"
    return PER_REACH_KG * reach**3 + LEAST_KG, f"the arm reaches {reach:.2g} m at most"


def longest_reach(robot: Robot) -> float:
    """Return the sum of all lengths and strokes of the arm and its tool (m): no point of the workspace is farther out."""
    lengths = sum(abs(e.value) for e in robot.chain.elements if not e.axis.rotates)
    strokes = [max(abs(j.lower), abs(j.upper)) for j in robot.joints if j.kind == "prismatic"]
    return float(lengths + sum(strokes) + np.linalg.norm(robot.T_tool[:3, 3]))
