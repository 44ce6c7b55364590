"""The joints of a data set of LeRobot, block by block or as one log, in degrees from the middle of each servo's range."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from kilter_files.formats.joints.lerobot.calibration import (
    DEGREES,
    NORM_MODES,
    Calibration,
    read_calibration,
    refuse_outside,
    servo_name_for_joint,
)
from kilter_files.formats.joints.lerobot.dataset import (
    ACTION,
    FINISH,
    STATE,
    Dataset,
    open_dataset,
    parquet_file,
    refuse_short_videos,
)
from kilter_files.formats.reader import LogHints
from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import fault
from kilter_files.ground.later import np
from kilter_files.tables.table import JointLog, checked_log

BLOCK = 65_536  # rows
BETWEEN_S = 1.0  # by which episodes follow one another in a log
GRIPPER, SIDES, OLD_PREFIX = "gripper", ("left_", "right_"), "main_"
SPEED = ".vel"  # of LeKiwi's base: x.vel, y.vel, theta.vel stand among what its servos read
HALF_ROTATION_DEG = 180.0
ZEROS = ("new", "old")


@dataclass(frozen=True)
class Recorded:
    """A data set with the joints wanted of it and what their numbers mean.

    ``servos`` are the joints as the ``calibration`` calls them; where that is None, the numbers are degrees of the old zero.
    """

    dataset: Dataset
    joints: tuple[str, ...]
    places: tuple[int, ...]
    calibration: Calibration | None
    mode: str
    servos: tuple[str, ...] = ()


@dataclass(frozen=True)
class Block:
    """Rows of a file: ``angles (n, joints)`` degrees, ``episode (n,)`` and ``time_s (n,)`` within the episode.

    ``commands (n, joints)`` degrees are what the joints were told, None where the data set does not say.
    """

    angles: Floats
    episode: Floats
    time_s: Floats
    commands: Floats | None = None


def open_recorded_joints(path: Path, hints: LogHints) -> Recorded:
    """Open a data set for its joints.

    Raises:
        FileError: nothing says what its numbers mean, it holds two arms, or the calibration is of another arm.

    """
    dataset = open_dataset(path)
    if hints.calibration is None:
        refuse_leader(dataset)
    if hints.topic not in (None, STATE):
        what = f"{hints.topic!r} is not what the arm's servos read: an action is what the leader commanded"
        raise fault(path, what, f"Leave --topic out: {STATE} is read.")
    joints = arm_joint_names(dataset, hints.order)
    places = tuple(dataset.names.index(name) for name in joints)
    if hints.zero == "old":
        return Recorded(dataset, joints, places, None, DEGREES)
    if any(name.startswith(OLD_PREFIX) for name in joints):
        what = "was recorded with the old zero (the arm stretched out; joints are called main_...)"
        raise fault(dataset.folder, what, "Say so with --zero old, and use a robot whose zero is there.")
    if hints.calibration is None:
        remedy = "Give the JSON of the arm that recorded it with --calibration, and --norm-mode."
        raise fault(dataset.folder, "does not say what its numbers mean", remedy)
    if hints.norm_mode not in NORM_MODES:
        what = "nothing says in which norm mode it was recorded" if hints.norm_mode is None else "has no such norm mode"
        raise fault(dataset.folder, what, f"Give --norm-mode: {' or '.join(NORM_MODES)}.")
    calibration = read_calibration(hints.calibration)
    if calibration.of_a_leader and "leader" not in dataset.robot_type:
        what = f"is of a leader, the data set of {dataset.robot_type or 'a follower'}"
        raise fault(calibration.path, what, "Give the calibration of the follower, in .../calibration/robots/.")
    if not calibration.of_a_leader:
        refuse_leader(dataset, f", and nothing says that {calibration.path} is")
    servos = tuple(servo_name_for_joint(calibration, joint) for joint in joints)
    return Recorded(dataset, joints, places, calibration, hints.norm_mode, servos)


def refuse_leader(dataset: Dataset, besides: str = "") -> None:
    """Refuse what a leader recorded where its own calibration does not say that it is meant.

    Raises:
        FileError: the data set is of a leader.

    """
    if "leader" in dataset.robot_type:
        what = f"is of a leader, {dataset.robot_type}{besides}"
        remedy = (
            "Give the data set of the follower, or the calibration of the leader, in .../calibration/teleoperators/."
        )
        raise fault(dataset.folder, what, remedy)


def blocks(recorded: Recorded) -> Iterator[Block]:
    """Rows of the data set in their order, so many at a time that memory stays flat.

    Raises:
        FileError: a file with other rows than the episodes say, an angle beyond the calibration, 360 degrees between two rows.

    """
    dataset, last = recorded.dataset, None
    for name, expected in dataset.rows_of_files().items():
        path, rows = dataset.folder / name, 0
        for block in _of_file(path, recorded):
            _refuse(recorded, path, block, last, rows)
            rows, last = rows + len(block.angles), block
            yield block
        if rows != expected:
            raise fault(path, f"has {rows} rows, its episodes have {expected}", FINISH)


def log_of_dataset(path: Path, hints: LogHints) -> JointLog:
    """Read all of a data set as a joint log; its episodes follow one another, a second apart.

    Raises:
        FileError: as :func:`open_recorded_joints` and :func:`blocks`, or videos with other lengths than their rows.

    """
    recorded = open_recorded_joints(path, hints)
    refuse_short_videos(recorded.dataset)
    found = list(blocks(recorded))
    q, episode, time = (
        np.concatenate([getattr(one, name) for one in found]) for name in ("angles", "episode", "time_s")
    )
    columns = {f"q{k + 1}_deg": q[:, k] for k in range(len(recorded.joints))}
    commands = [one.commands for one in found if one.commands is not None]
    if len(commands) == len(found):
        columns |= {f"cmd{k + 1}_deg": values for k, values in enumerate(np.concatenate(commands).T)}
    log = checked_log(path, columns | {"t_s": time + _starts(recorded.dataset)[episode.astype(int)]}, [], "row")
    log = replace(log, notes=tuple(log_notes(recorded)))
    if recorded.calibration is None:
        return log
    cut = recorded.calibration.seam_warnings(recorded.servos)
    return replace(log, warnings=(*log.warnings, *cut), calibration_sha256=recorded.calibration.sha256)


def log_notes(recorded: Recorded) -> Iterator[str]:
    """What is to be known of a log: its joints, its zero, and the hash of its calibration."""
    dataset = recorded.dataset
    yield dataset.summary_text
    yield f"q1 to q{len(recorded.joints)} are {', '.join(recorded.joints)}"
    if recorded.calibration is None:
        yield "zero: old, the arm stretched out"
        return
    yield "zero: new, the middle of each range"
    yield f"LeRobot calibration {recorded.calibration.path.name} ({recorded.mode}), SHA-256 {recorded.calibration.sha256}"


def _starts(dataset: Dataset) -> Floats:
    lengths = np.array([episode.length / dataset.fps + BETWEEN_S for episode in dataset.episodes])
    return np.concatenate([[0.0], np.cumsum(lengths)[:-1]])


def arm_joint_names(dataset: Dataset, order: Sequence[str]) -> tuple[str, ...]:
    """The joints of the arm: all but the gripper and the speeds of a base, of one arm."""
    for name in order:
        if name not in dataset.names:
            raise fault(dataset.folder, f"has no joint {name!r}", f"It has {', '.join(dataset.names)}.")
    if order:
        return tuple(order)
    sides = [side for side in SIDES if any(name.startswith(side) for name in dataset.names)]
    if len(sides) > 1:
        own = ",".join(name for name in dataset.names if name.startswith(sides[0]) and GRIPPER not in name)
        raise fault(dataset.folder, "holds two arms", f"Name the joints of one: --joint-order {own}.")
    return tuple(name for name in dataset.names if GRIPPER not in name and not name.endswith(SPEED))


def _of_file(path: Path, recorded: Recorded) -> Iterator[Block]:
    """The rows of a file, as they are calibrated."""
    file = parquet_file(path)
    missing = [name for name in (STATE, "episode_index", "timestamp") if name not in file.schema_arrow.names]
    if missing:
        raise fault(path, f"has no column {missing[0]!r}", "Export the data set again.")
    told = ACTION in file.schema_arrow.names and recorded.dataset.has_actions
    for batch in file.iter_batches(BLOCK, columns=[STATE, "episode_index", "timestamp", *([ACTION] if told else [])]):
        yield Block(
            _angles(path, recorded, batch, STATE),
            np.asarray(batch.column("episode_index"), dtype=np.float64),
            np.asarray(batch.column("timestamp"), dtype=np.float64),
            _angles(path, recorded, batch, ACTION) if told else None,
        )


def _angles(path: Path, recorded: Recorded, batch: Any, column: str) -> Floats:
    """Angles (n, joints) degrees of a column, as they are calibrated."""
    flat = np.asarray(batch.column(column).flatten(), dtype=np.float64)
    if len(flat) != len(batch) * len(recorded.dataset.names):
        what = f"its rows do not have the {len(recorded.dataset.names)} numbers that info.json names"
        raise fault(path, what, FINISH, column=column)
    values = flat.reshape(len(batch), -1)[:, recorded.places]
    if recorded.calibration is not None:
        for k, servo in enumerate(recorded.servos):
            values[:, k] = recorded.calibration.degrees(servo, values[:, k], recorded.mode)
    return values


def refuse_whole_rotations(path: Path, joints: Sequence[str], block: Block, last: Block | None, rows: int) -> None:
    """Refuse 360 degrees from one row to the next of an episode; ``last`` is the block before, ``rows`` how many came before.

    Raises:
        FileError: a joint jumps so.

    """
    before = 0 if last is None else 1
    angles = block.angles if last is None else np.vstack([last.angles[-1:], block.angles])
    episode = block.episode if last is None else np.concatenate([last.episode[-1:], block.episode])
    far = (np.abs(np.diff(angles, axis=0)) > HALF_ROTATION_DEG) & (np.diff(episode) == 0)[:, None]
    if far.any():
        row, k = (int(v) for v in np.argwhere(far)[0])
        what = "jumps by 360 degrees: the servo wraps within its range"
        remedy = "Calibrate the arm in the middle of its range and record again."
        raise fault(path, what, remedy, row=rows + row + 2 - before, column=joints[k])


def _refuse(recorded: Recorded, path: Path, block: Block, last: Block | None, rows: int) -> None:
    """Refuse what no arm does: beyond its servos' range, or 360 degrees from one row to the next."""
    refuse_whole_rotations(path, recorded.joints, block, last, rows)
    if recorded.calibration is not None:
        for k, (joint, servo) in enumerate(zip(recorded.joints, recorded.servos, strict=True)):
            refuse_outside(recorded.calibration, path, joint, servo, block.angles[:, k], rows)
