"""A trajectory in, the corrected trajectory out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kilter_core.errors import ObservationError, OptionError
from kilter_core.types import Floats
from kilter_files.ground.later import pa
from kilter_service.campaigns.keeping import REMEDY, counted_as_nothing
from kilter_service.contract.columns import LOAD_PARTS, PAYLOAD_CENTRE
from kilter_service.contract.versions import CorrectionLimits
from kilter_service.ground import correction_outcome as outcome
from kilter_service.ground.correction_limits import correction_options, where_sentences
from kilter_service.ground.correction_outcome import OK, flag_names
from kilter_service.ground.db import Database, Session
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.limits import MAX_ROS2_ROWS, MAX_TRAJECTORY_CELLS, MAX_TRAJECTORY_ROWS
from kilter_service.ground.tables import reading
from kilter_service.ground.tables.assemble import observations, with_default_load
from kilter_service.ground.tables.columns import Column, read_columns
from kilter_service.ground.tables.writing import write_table
from kilter_service.ground.wire import to_deg, to_metres, to_mm
from kilter_service.robots import compensation
from kilter_service.robots import store as robots
from kilter_service.versions import store as versions
from kilter_service.versions.records import VersionRecord

if TYPE_CHECKING:
    from kilter_core.arm import Robot
    from kilter_core.correct import CorrectionOptions
    from kilter_core.model import Calibration
    from kilter_core.observations import Observations
    from kilter_service.ground.correction_outcome import Outcome


FOLLOW_THE_LOAD = frozenset({"moments", "payload_kg"})


class Carried(NamedTuple):
    """Mass (kg) and centre (mm, tool frame) as the request states them for the whole path; None: not stated."""

    payload_kg: float | None = None
    payload_com_mm: tuple[float, float, float] | None = None


def under(rows: Observations, carried: Carried, robot: Robot) -> Observations:
    """Return the rows with the load of the request, or the robot's own, where they state none.

    Raises:
        OptionError: the rows state a payload and so does the request, or the request says where but not how heavy.

    """
    if carried.payload_kg is None:
        if carried.payload_com_mm is not None:
            raise OptionError(
                "payload_com_mm says where the payload has its centre, not how heavy it is: give payload_kg too.",
                option="payload_com_mm",
            )
        return with_default_load(rows, robot)
    if rows.payload_kg is not None:
        raise OptionError(
            "The path has a column payload_kg, and payload_kg is given for the whole path too: give one of them.",
            option="payload_kg",
        )
    return rows.carrying(carried.payload_kg, [to_metres(value) for value in carried.payload_com_mm or (0.0, 0.0, 0.0)])


def load_notes(
    calibration: Calibration, stated: bool, not_corrected: Collection[str], carried: Carried
) -> tuple[str, ...]:
    """Say which load was taken where the path states none, and what that means for effects that follow the load."""
    following = _following(calibration, not_corrected)
    if stated or carried.payload_kg is not None or not following:
        return ()
    load = calibration.robot.load
    if load is not None:
        return (
            f"The path states no payload: the robot's default load was taken, {describe_load(load.mass, load.com)}.",
        )
    return (
        f"{counted_as_nothing('The path states', following)} It was corrected as with nothing on the tool. "
        f"{REMEDY.format(whole='path')}",
    )


def describe_load(mass: float, com: Sequence[float]) -> str:
    """Say a load in words."""
    at = ", ".join(f"{to_mm(value):.6g}" for value in com)
    return f"{mass:.6g} kg at ({at}) mm in the tool frame"


def _following(calibration: Calibration, not_corrected: Collection[str]) -> list[str]:
    """Effects of the arm with values that read the load, by name."""
    model = calibration.model
    return [
        key
        for (key, where), effect in zip(model.effect_slices().items(), model.effects, strict=True)
        if effect.stage != "measurement"
        and not effect.nuisance
        and effect.needs & FOLLOW_THE_LOAD
        and key not in not_corrected
        and np.any(calibration.values[where])
    ]


# What a trajectory may say; whatever else a file of observations has is a measurement.
QUANTITIES = frozenset(
    {
        "q",
        "qd",
        "qdd",
        "dir",
        "t",
        "payload",
        *PAYLOAD_CENTRE,
        "temperature",
        "base_tilt_x",
        "base_tilt_y",
        *LOAD_PARTS[0],
        "session",
        "pose_id",
        "row",
    }
)


def read_trajectory(
    path: Path, media: str, kinds: Sequence[str], most_rows: int = MAX_TRAJECTORY_ROWS
) -> tuple[pa.Table, tuple[Column, ...]]:
    """Read a trajectory for joints of these ``kinds``.

    Raises:
        ObservationError: as for an upload; or a column that does not belong to a trajectory, or an empty cell.

    """
    columns = read_columns(reading.column_names(path, media), kinds)
    for column in columns:
        if column.quantity in ("fx", "mx", "load_fx", "load_mx"):
            raise ObservationError(
                f"Column {column.name!r}: a correction does not know forces yet to come, only masses. Leave "
                "the column out; what the force bends stays uncorrected.",
                column=column.name,
            )
        if column.quantity not in QUANTITIES:
            raise ObservationError(
                f"Column {column.name!r} is a measurement: leave it out of a trajectory.", column=column.name
            )
    table = reading.whole_table(path, media, min(most_rows, MAX_TRAJECTORY_CELLS // len(columns)))
    for column in columns:
        if table.column(column.name).null_count:
            row = int(table.column(column.name).is_null().to_numpy().argmax()) + 1
            raise ObservationError(
                f"Row {row}, column {column.name!r} is empty: give every cell.", row=row, column=column.name
            )
    return table, columns


NANO = 1_000_000_000


def joint_trajectory(
    names: Sequence[str], t: NDArray[np.float64] | None, found: Outcome, notes: Sequence[str] = ()
) -> bytes:
    """Write positions (rad, m) over the time from the first row; comments have the notes, and what is left of rows.

    Raises:
        ObservationError: no ``t_s``, times that do not rise, or a row that was refused: a trajectory has no gaps.

    """
    if t is None:
        raise ObservationError("A JointTrajectory needs the time of each point: add the column 't_s'.", column="t_s")
    late = np.flatnonzero(np.diff(t) <= 0)
    if len(late):
        row = int(late[0]) + 2
        raise ObservationError(f"Row {row}, column 't_s': the time must rise from row to row.", row=row, column="t_s")
    _refuse_gaps(found)
    return "".join((*(f"# {note}\n" for note in notes), *_lines(names, t - t[0], found))).encode()


def _refuse_gaps(found: Outcome) -> None:
    bad = np.flatnonzero(~found.answered_rows)
    if len(bad):
        word = found.words[int(bad[0])]
        raise ObservationError(
            f"Row {int(bad[0]) + 1} is not corrected ({word}), {len(bad)} rows in all: a JointTrajectory cannot have a "
            "gap. Take CSV, which marks such rows, or leave them out.",
            row=int(bad[0]) + 1,
            status=word,
        )


def _lines(names: Sequence[str], t: NDArray[np.float64], found: Outcome) -> Iterator[str]:
    yield "header:\n  stamp: {sec: 0, nanosec: 0}\n  frame_id: ''\njoint_names:\n"
    yield from (f"- '{name.replace(chr(39), chr(39) * 2)}'\n" for name in names)
    yield "points:\n"
    times, left = np.round(t * NANO).astype(np.int64).tolist(), to_mm(found.remaining_errors).tolist()
    for time, row, word, kept in zip(times, found.done.q.tolist(), found.words, left, strict=True):
        remark = "" if word == OK else f"  # {word}: {kept:.3g} mm left"
        yield f"- positions: [{', '.join(_yaml(value) for value in row)}]{remark}\n"
        yield f"  time_from_start: {{sec: {time // NANO}, nanosec: {time % NANO}}}\n"


def _yaml(value: float) -> str:
    """Every digit; YAML takes 1e-05 for text unless it has a point."""
    text = repr(value)
    return text.replace("e", ".0e") if "e" in text and "." not in text else text


ROS2 = "ros2-yaml"
MOST_NAMED = 20  # rows that a refusal names
NOTHING_STATED = Carried()


class Wanted(NamedTuple):
    """How to correct: ``version`` None is the active one, ``task`` None that of its activation.

    ``at_limit`` and ``hold``, joints from 1, None what the limits of the version say.

    ``form`` "ros2-yaml" is another format than the one sent.
    ``strict``: a row that is not corrected to within what is stated is an error.
    """

    version: str | None = None
    form: str | None = None
    task: Literal["position", "pose"] | None = None
    strict: bool = False
    at_limit: Literal["saturate", "refuse"] | None = None
    hold: tuple[int, ...] | None = None


AS_ALWAYS = Wanted()


class Answer(NamedTuple):
    """The corrected file, the effects of the version that a correction leaves out, and what else to know, in words.

    ``u95`` says what the intervals of the file are of.
    """

    content: bytes
    not_corrected: tuple[str, ...]
    notes: tuple[str, ...]
    u95: str


def correct(
    database: Database,
    robot: str,
    path: Path,
    media: str,
    wanted: Wanted = AS_ALWAYS,
    temperature_c: float | None = None,
    carried: Carried = NOTHING_STATED,
) -> Answer:
    """Correct a trajectory.

    ``temperature_c`` is that of the arm where the trajectory does not say, and ``carried`` is the load on its tool.

    Raises:
        ObservationError: the file is not a trajectory of this robot.
        OptionError: the load is stated twice, or half; or a task that the arm has too few joints for.
        ServiceError: no such robot or version, or none is active; or ``strict``, and a row is not within what is stated.

    """
    with database.reading() as session:
        row, options = _version(session, robot, wanted, temperature_c)
        calibration, known = versions.calibration(session, row.id), versions.load_predictive(session, row.id)
        compensated = compensation.sentence(robot, robots.get_compensation(session, row.robot_id))
    kinds = [joint.kind for joint in calibration.robot.joints]
    table, columns = read_trajectory(path, media, kinds, MAX_ROS2_ROWS if wanted.form == ROS2 else MAX_TRAJECTORY_ROWS)
    stated = observations(table, columns, {})
    rows = under(stated, carried, calibration.robot)
    found = outcome.correct(calibration, rows, options, known)
    if wanted.strict:
        _refuse_what_is_left(found)
    left_out = found.done.not_corrected
    told = load_notes(calibration, stated.payload_kg is not None, left_out, carried)
    where = where_sentences(found.done.where_stated)
    notes = (*told, *where, *outcome.summary(found), *([compensated] if compensated else ()))
    if wanted.form == ROS2:
        names = [joint.name for joint in calibration.robot.joints]
        return Answer(joint_trajectory(names, rows.t, found, notes), left_out, notes, found.u95_kind)
    content = write_table(with_verdict(_with_joints(table, columns, found), found), media)
    return Answer(content, left_out, notes, found.u95_kind)


def _with_joints(table: pa.Table, columns: Sequence[Column], found: outcome.Outcome) -> pa.Table:
    """The table with the corrected joints in place of the wanted ones."""
    joints = sorted((c for c in columns if c.quantity == "q"), key=lambda c: c.number or 0)
    for k, column in enumerate(joints):
        readings = cells(found.done.q[:, k] / column.factor)
        table = table.set_column(table.column_names.index(column.name), column.name, readings)
    return table


def _refuse_what_is_left(found: outcome.Outcome) -> None:
    """Refuse a trajectory with a row that is not corrected to within what is stated."""
    words = np.array(found.words)
    rows = np.flatnonzero(words != outcome.OK)
    if not len(rows):
        return
    counts = ", ".join(f"{word} {count}" for word, count in Counter(words[rows].tolist()).items())
    named = ", ".join(str(row + 1) for row in rows[:MOST_NAMED].tolist())
    known = found.remaining_errors[rows]
    worst = None if np.isnan(known).all() else to_mm(float(np.nanmax(known)))
    raise ServiceError(
        f"{len(rows)} of {len(words)} rows are not corrected to within what is stated ({counts}), the first of them row "
        f"{int(rows[0]) + 1}{'' if worst is None else f'; at worst {worst:.2g} mm are left'}. Nothing is answered. Without "
        "strict the answer has every row with its status and left_mm; another path keeps away from singularities and limits.",
        code="rows_not_reached",
        rows=f"{named}{' ...' if len(rows) > MOST_NAMED else ''}",
        counts=dict(Counter(words[rows].tolist())),
        worst_left_mm=worst,
    )


def _version(
    session: Session, robot: str, wanted: Wanted, temperature_c: float | None
) -> tuple[VersionRecord, CorrectionOptions]:
    stored, version = robots.get(session, robot), wanted.version
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
    limits, rules = CorrectionLimits(**row.limits), versions.activation_rules(session, version)
    return row, correction_options(limits, temperature_c, wanted.task, wanted.at_limit, wanted.hold, rules)


def with_verdict(table: pa.Table, found: Outcome) -> pa.Table:
    """Add to a trajectory what was removed of the error, what is left, half the interval that holds it, and the status."""
    done = found.done
    columns = (
        _along("d", done.error_removed) | {"left_mm": cells(to_mm(found.remaining_errors))} | _along("left_", done.left)
    )
    if found.turns:
        columns["left_deg"] = cells(to_deg(done.left_rad))
    columns |= _along("u95_", found.u95)
    columns["flags"] = pa.array([flag_names(one) for one in done.flags.tolist()], pa.string())
    columns["status"] = pa.array(found.words, pa.string())
    for name, column in columns.items():
        table = table.append_column(name, column)
    return table


def _along(name: str, values: Floats) -> dict[str, pa.Array]:
    """Columns in mm of vectors (N, 3) m."""
    return {f"{name}{axis}_mm": cells(to_mm(values[:, k])) for k, axis in enumerate("xyz")}


def cells(values: Floats) -> pa.Array:
    """Return a column; a cell without a number is empty."""
    return pa.array(values, pa.float64(), mask=np.isnan(values))
