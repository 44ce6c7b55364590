"""What a robot document comes to, before it is added: axes, the arm at zero, reach, and what looks wrong."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from kilter_core.types import Floats
from kilter_service.contract.robot_reports import AxisReport, RobotCheck, Zero
from kilter_service.contract.robots import RobotDocument
from kilter_service.contract.units import Pose
from kilter_service.ground.core import core_arm, core_model, transforms
from kilter_service.ground.wire import to_deg, to_mm
from kilter_service.robots.directions import notes_on_missing_directions
from kilter_service.robots.documents import core_document
from kilter_service.robots.drives import said_of_drives
from kilter_service.robots.plausibility import implausible
from kilter_service.robots.wire import joint_summary

if TYPE_CHECKING:
    from kilter_core.arm import Robot, Screws


SAMPLES = 4000
FREE_SHIFT_M = 0.5  # reach of a prismatic joint without limits


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
