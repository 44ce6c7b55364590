"""A trajectory in, the corrected trajectory out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from kilter_service.campaigns.assemble import observations
from kilter_service.contract.versions import CorrectionLimits
from kilter_service.correction import load
from kilter_service.correction.formats import read_trajectory, write_trajectory
from kilter_service.correction.ros2 import joint_trajectory
from kilter_service.correction.uncertainty import uncertainty
from kilter_service.correction.wire import cells, options_of, with_verdict
from kilter_service.db import Database, Session
from kilter_service.errors import ServiceError
from kilter_service.limits import MAX_ROS2_ROWS, MAX_TRAJECTORY_ROWS
from kilter_service.robots import store as robots
from kilter_service.versions import store as versions
from kilter_service.versions.records import VersionRecord

if TYPE_CHECKING:
    from kilter_core.correct.program import CorrectionOptions


ROS2 = "ros2-yaml"
NOTHING_STATED = load.Carried()


class Answer(NamedTuple):
    """The corrected file, the effects of the version that a correction leaves out, and what else to know, in words."""

    content: bytes
    not_corrected: tuple[str, ...]
    notes: tuple[str, ...]


def correct(
    database: Database,
    robot: str,
    version: str | None,
    path: Path,
    media: str,
    form: str | None = None,
    temperature_c: float | None = None,
    carried: load.Carried = NOTHING_STATED,
) -> Answer:
    """Correct a trajectory with a version, by default the active one; ``form`` "ros2-yaml" asks for another format back.

    ``temperature_c`` is that of the arm where the trajectory does not say, and ``carried`` is the load on its tool.

    Raises:
        ObservationError: the file is not a trajectory of this robot.
        OptionError: the load is stated twice, or half.
        ServiceError: no such robot or version, or none is active.

    """
    from kilter_core.correct.walker import correct_trajectory  # loads compiled kernels: not at the start of the process

    with database.reading() as session:
        row, options = _version(session, robot, version, temperature_c)
        calibration, known = versions.calibration(session, row.id), versions.known(session, row.id)
    kinds = [joint.kind for joint in calibration.robot.joints]
    table, columns = read_trajectory(path, media, kinds, MAX_ROS2_ROWS if form == ROS2 else MAX_TRAJECTORY_ROWS)
    stated = observations(table, columns, {})
    rows = load.under(stated, carried, calibration.robot)
    done = correct_trajectory(calibration, rows, options)
    notes = load.load_notes(calibration, stated.payload_kg is not None, done.not_corrected, carried)
    if form == ROS2:
        names = [joint.name for joint in calibration.robot.joints]
        return Answer(joint_trajectory(names, rows.t, done), done.not_corrected, notes)
    joints = sorted((c for c in columns if c.quantity == "q"), key=lambda c: c.number or 0)
    for k, column in enumerate(joints):
        readings = cells(done.q[:, k] / column.factor)
        table = table.set_column(table.column_names.index(column.name), column.name, readings)
    u95 = uncertainty(calibration, done, known, temperature_c)
    return Answer(write_trajectory(with_verdict(table, done, u95), media), done.not_corrected, notes)


def _version(
    session: Session, robot: str, version: str | None, temperature_c: float | None
) -> tuple[VersionRecord, CorrectionOptions]:
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
    return row, options_of(CorrectionLimits(**row.limits), temperature_c)
