"""Digitised points into a frame.

The nominal arm of a stored robot: its flange at joints, and all joints for a flange.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kilter_core.errors import ObservationError, OptionError
from kilter_service.contract.robot_reports import Flanges, Frame, JointRows, NewFrame, OffPoint, Posture, Postures
from kilter_service.contract.units import PointMm, Pose
from kilter_service.ground.core import core_arm, core_model, core_procedures
from kilter_service.ground.db import Database
from kilter_service.ground.naming import copy_fields
from kilter_service.ground.wire import to_deg, to_metres, to_mm, to_rad
from kilter_service.robots import service

if TYPE_CHECKING:
    from kilter_core.procedures import ReferenceFrame


def find_frame(frame: NewFrame) -> Frame:
    """Find the frame.

    Raises:
        ObservationError: neither or both kinds of points, or points that make no frame.

    """
    if (frame.points is None) == (frame.features is None):
        raise ObservationError("Give points (known and measured) or features (plane, line, origin), one of the two.")
    if frame.points is not None:
        names = [point.name or str(k) for k, point in enumerate(frame.points, 1)]
        made = core_procedures.frame_of_points(
            metres([p.known_mm for p in frame.points]), metres([p.measured_mm for p in frame.points])
        )
    else:
        assert frame.features is not None
        f = frame.features
        names = [f"plane {k}" for k in range(1, len(f.plane_mm) + 1)]
        made = core_procedures.frame_of_features(metres(f.plane_mm), metres(f.line_mm), metres([f.origin_mm])[0])
    return describe_frame(made, names)


def metres(points: Sequence[PointMm]) -> NDArray[np.float64]:
    """Return points (N, 3) in m."""
    return to_metres(np.array(points, dtype=np.float64))


def describe_frame(made: ReferenceFrame, names: Sequence[str]) -> Frame:
    """Say where a frame is, and how well its points fit."""
    left = [OffPoint(name=name, left_mm=to_mm(float(off))) for name, off in zip(names, made.left, strict=True)]
    return Frame(pose=Pose.model_validate(core_arm.pose_document(made.pose)), rms_mm=to_mm(made.rms), points=left)


MOST_WITHOUT_FORM = 200  # poses of one request: some 0.05 s of processor time each


def forward(database: Database, name: str, rows: JointRows) -> Flanges:
    """Return the flange at each row of joints.

    Raises:
        OptionError: another number of joints than the robot has, or a prismatic joint.

    """
    arm = service.arm(database, name)
    if any(joint.kind != "revolute" for joint in arm.joints):
        raise OptionError(f"{name!r} has a prismatic joint: joints_deg are of revolute joints.", option="joints_deg")
    wrong = next((k for k, row in enumerate(rows.joints_deg) if len(row) != arm.n_joints), None)
    if wrong is not None:
        said = f"Row {wrong + 1} has {len(rows.joints_deg[wrong])} joints, {name!r} has {arm.n_joints}."
        raise OptionError(said, option="joints_deg")
    poses = (core_model.flange(arm, q) for q in to_rad(np.array(rows.joints_deg, dtype=np.float64)))
    return Flanges(flanges=[Pose.model_validate(core_arm.pose_document(T)) for T in poses])


def inverse(database: Database, name: str, wanted: Flanges) -> Postures:
    """Return all joints of each pose of the flange.

    Raises:
        RobotError: the arm has not six revolute joints.
        OptionError: more poses than one request computes of an arm without a closed form.

    """
    axes = core_model.read_six_axes(service.arm(database, name))
    if core_model.closed_form_kind(axes) is None and len(wanted.flanges) > MOST_WITHOUT_FORM:
        raise OptionError(
            f"{name!r} has no closed form, and its joints are found for {MOST_WITHOUT_FORM} poses at a time, "
            f"not {len(wanted.flanges)}. Send them in parts.",
            option="flanges",
        )
    rows = [core_model.reaching(axes, core_arm.parse_pose(pose.model_dump())) for pose in wanted.flanges]
    return Postures(
        postures=[[copy_fields(Posture, one, joints_deg=to_deg(one.q).tolist()) for one in row] for row, _ in rows],
        certain=[certain for _, certain in rows],
    )
