"""A trajectory in, the corrected trajectory out."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from service.campaigns.assemble import observations
from service.correction.formats import read_trajectory, write_trajectory
from service.correction.ros2 import joint_trajectory
from service.db import Database, Session
from service.errors import ServiceError
from service.robots import store as robots
from service.versions import store as versions
from service.versions.schemas import CorrectionLimits

if TYPE_CHECKING:
    import pyarrow as pa

    from core.compensate import Correction, CorrectOptions
    from core.model import Calibration
    from core.observations import Observations

Floats = NDArray[np.float64]

ROS2 = "ros2-yaml"
ROWS_AT_ONCE = 20_000
STILL = 1e-9  # rad or m: smaller steps are no motion


def correct(
    database: Database, robot: str, version: str | None, path: Path, media: str, form: str | None = None
) -> bytes:
    """Correct a trajectory with a version, by default the active one; ``form`` "ros2-yaml" asks for another format back.

    Raises:
        ObservationError: the file is no trajectory of this robot.
        ServiceError: no such robot or version, or none is active.

    """
    with database.transaction() as session:
        calibration, options = _calibration(session, robot, version)
    kinds = [joint.kind for joint in calibration.robot.joints]
    table, columns = read_trajectory(path, media, kinds)
    rows = observations(table, columns, {})
    parts = [
        _corrected(calibration, rows.select(slice(start, start + ROWS_AT_ONCE)), directions, options)
        for start, directions in _pieces(rows)
    ]
    if form == ROS2:
        return joint_trajectory([joint.name for joint in calibration.robot.joints], rows.t, parts)
    joints = sorted((c for c in columns if c.quantity == "q"), key=lambda c: c.number or 0)
    q = np.concatenate([part.q for part in parts])
    for k, column in enumerate(joints):
        table = table.set_column(table.column_names.index(column.name), column.name, _cells(q[:, k] / column.factor))
    return write_trajectory(_with_verdict(table, parts), media)


def _calibration(session: Session, robot: str, version: str | None) -> tuple[Calibration, CorrectOptions]:
    from core.compensate import CorrectOptions  # loads compiled kernels: not at the start of the API process

    stored = robots.get(session, robot)
    if version is None:
        active = versions.active_row(session, stored.id)
        if active is None:
            raise ServiceError(
                f"Robot {robot!r} has no active version: activate one with POST /v1/versions/{{id}}/activate.",
                code="no_active_version",
                robot=robot,
            )
        version = active.version_id
    row = versions.row_of(session, version)
    if row.robot_id != stored.id:
        raise ServiceError(f"Version {version} is not of robot {robot!r}.", code="option_invalid", version=version)
    limits = CorrectionLimits(**row.limits)
    options = CorrectOptions(
        max_joint_rad=math.radians(limits.max_joint_deg), max_shift_m=limits.max_position_mm * 1e-3
    )
    return versions.calibration(session, version), options


def _pieces(rows: Observations) -> list[tuple[int, Floats]]:
    directions = rows.direction if rows.direction is not None else last_motion(rows.q)
    return [(start, directions[start : start + ROWS_AT_ONCE]) for start in range(0, len(rows), ROWS_AT_ONCE)]


def last_motion(q: Floats) -> Floats:
    """Return the direction {-1, 0, 1} in which each joint last moved, (N, n), for rows that follow one another."""
    step = np.diff(q, axis=0, prepend=q[:1])
    sign = np.where(np.abs(step) > STILL, np.sign(step), 0.0)
    since = np.maximum.accumulate(np.where(sign != 0, np.arange(len(q))[:, None], 0), axis=0)
    return np.take_along_axis(sign, since, axis=0)


def _corrected(calibration: Calibration, rows: Observations, directions: Floats, options: CorrectOptions) -> Correction:
    from core.compensate import correct

    return correct(
        calibration,
        rows.q,
        qd=rows.qd,
        qdd=rows.qdd,
        direction=directions,
        payload_kg=rows.payload_kg,
        options=options,
    )


def _with_verdict(table: pa.Table, parts: list[Correction]) -> pa.Table:
    from core.compensate import Status

    removed = np.concatenate([part.error_removed for part in parts]) * 1e3
    for k, axis in enumerate("xyz"):
        table = table.append_column(f"d{axis}_mm", _cells(removed[:, k]))
    return table.append_column("status", [[Status(code).name for part in parts for code in part.status]])


def _cells(values: Floats) -> pa.Array:
    import pyarrow as pa

    return pa.array(values, pa.float64(), mask=np.isnan(values))
