"""A trajectory in, the corrected trajectory out."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from service.campaigns.assemble import observations
from service.contract.versions import CorrectionLimits
from service.correction.follow import Corrected, corrected
from service.correction.formats import read_trajectory, write_trajectory
from service.correction.ros2 import joint_trajectory
from service.correction.uncertainty import uncertainty
from service.corrector.frames import Status
from service.db import Database, Session
from service.errors import ServiceError
from service.limits import MAX_ROS2_ROWS, MAX_TRAJECTORY_ROWS
from service.robots import store as robots
from service.versions import store as versions
from service.versions.records import VersionRecord

if TYPE_CHECKING:
    import pyarrow as pa

    from core.correction import CorrectionOptions

Floats = NDArray[np.float64]

ROS2 = "ros2-yaml"


def correct(
    database: Database,
    robot: str,
    version: str | None,
    path: Path,
    media: str,
    form: str | None = None,
    temperature_c: float | None = None,
) -> tuple[bytes, tuple[str, ...]]:
    """Correct a trajectory with a version, by default the active one; ``form`` "ros2-yaml" asks for another format back.

    ``temperature_c`` is that of the arm where the trajectory does not say. Returns the file, and the effects of the
    version that a correction leaves out.

    Raises:
        ObservationError: the file is no trajectory of this robot.
        ServiceError: no such robot or version, or none is active.

    """
    with database.reading() as session:
        row, options = _version(session, robot, version, temperature_c)
        calibration, known = versions.calibration(session, row.id), versions.known(session, row.id)
    kinds = [joint.kind for joint in calibration.robot.joints]
    table, columns = read_trajectory(path, media, kinds, MAX_ROS2_ROWS if form == ROS2 else MAX_TRAJECTORY_ROWS)
    rows = observations(table, columns, {})
    done = corrected(calibration, rows, options)
    if form == ROS2:
        names = [joint.name for joint in calibration.robot.joints]
        return joint_trajectory(names, rows.t, done), done.not_corrected
    joints = sorted((c for c in columns if c.quantity == "q"), key=lambda c: c.number or 0)
    for k, column in enumerate(joints):
        cells = _cells(done.q[:, k] / column.factor)
        table = table.set_column(table.column_names.index(column.name), column.name, cells)
    u95 = uncertainty(calibration, rows, done, known, temperature_c)
    return write_trajectory(_with_verdict(table, done, u95), media), done.not_corrected


def _version(
    session: Session, robot: str, version: str | None, temperature_c: float | None
) -> tuple[VersionRecord, CorrectionOptions]:
    from core.correction import CorrectionOptions  # loads compiled kernels: not at the start of the API process

    stored = robots.get(session, robot)
    if version is None:
        active = versions.active_entry(session, stored.id)
        if active is None:
            raise ServiceError(
                f"Robot {robot!r} has no active version: activate one with POST /v1/versions/{{id}}/activate.",
                code="no_active_version",
                robot=robot,
            )
        version = active.version_id
    row = versions.get(session, version)
    if row.robot_id != stored.id:
        raise ServiceError(f"Version {version} is not of robot {robot!r}.", code="option_invalid", version=version)
    limits = CorrectionLimits(**row.limits)
    options = CorrectionOptions(
        largest_rad=math.radians(limits.max_joint_deg),
        largest_m=limits.max_position_mm * 1e-3,
        farthest_m=limits.max_position_mm * 1e-3,
        temperature_c=temperature_c,
    )
    return row, options


def _with_verdict(table: pa.Table, done: Corrected, u95: Floats) -> pa.Table:
    removed = done.error_removed * 1e3
    for k, axis in enumerate("xyz"):
        table = table.append_column(f"d{axis}_mm", _cells(removed[:, k]))
    for k, axis in enumerate("xyz"):
        table = table.append_column(f"u95_{axis}_mm", _cells(u95[:, k] * 1e3))
    return table.append_column("status", [[Status(code).name for code in done.status.tolist()]])


def _cells(values: Floats) -> pa.Array:
    import pyarrow as pa

    return pa.array(values, pa.float64(), mask=np.isnan(values))
