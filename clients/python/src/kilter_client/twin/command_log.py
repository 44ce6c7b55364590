"""Logs of commands and readings: episodes by session, by a gap in time, or as the data set has them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from kilter_client.errors import FileError
from kilter_client.twin.settled import UNITS
from kilter_files import read_joints
from kilter_files.ground.later import np
from kilter_files.tables import JointLog

if TYPE_CHECKING:
    from kilter_files.formats import LogHints
    from kilter_files.ground import Floats

GAP_ROWS = 10  # of usual steps without a row, by which an episode ends
DROPPED = 1.5  # of a usual step, beyond which a row is missing
FEWEST_ROWS = 50
COMMAND = re.compile(r"cmd(\d+)_(deg|rad|mm|m)")
REMEDY = "Add cmd1_deg, cmd2_deg, ... (the position that each joint was told) beside q1_deg, q2_deg, ..."


@dataclass(frozen=True)
class CommandEpisode:
    """Times (N,) s, commands and readings (N, n), rad and m, and what the arm carried, kg."""

    t: Floats
    command: Floats
    reading: Floats
    payload_kg: float = 0.0


@dataclass(frozen=True)
class CommandLog:
    """A file with its episodes; ``dropped`` rows are missing in them."""

    path: Path
    episodes: tuple[CommandEpisode, ...]
    dropped: int


def read_command_log(
    path: Path, joints: int, hints: LogHints | None = None, column_map: Path | None = None
) -> CommandLog:
    """Read a log of ``joints`` joints.

    Raises:
        FileError: no time, no commands, another number of joints, or no episode of 50 rows.

    """
    log = read_joints(path, column_map, hints)
    if log.t_s is None:
        raise _fault(path, "has no clock", "Add t_s, seconds from the start.")
    if len(log.joints) != joints:
        what = f"has {len(log.joints)} joints, the model {joints} with actuators"
        raise _fault(path, what, "Say which of the model's joints they are: --joints A,B,C.")
    commands = {int(m[1]): (name, m[2]) for name in log.columns if (m := COMMAND.fullmatch(name))}
    missing = [f"cmd{k}" for k in range(1, joints + 1) if k not in commands]
    if missing:
        raise _fault(path, f"has no command of joint {missing[0][3:]}", REMEDY)
    command = np.column_stack([log.columns[commands[k][0]] * UNITS[commands[k][1]] for k in range(1, joints + 1)])
    reading = np.column_stack([log.columns[name] * UNITS[name.partition("_")[2]] for name in log.joints])
    parts = [part for part in _episodes(log) if len(part) >= FEWEST_ROWS]
    if not parts:
        raise _fault(path, f"has no episode of {FEWEST_ROWS} rows", "Record longer motions.")
    t = log.t_s
    usual = float(np.median(np.diff(t)))
    dropped = sum(
        int(np.sum(np.round(np.diff(t[part]) / usual - 1.0)[np.diff(t[part]) > DROPPED * usual])) for part in parts
    )
    carried = log.columns.get("payload_kg", np.zeros(len(t)))
    episodes = tuple(
        CommandEpisode(t[part] - t[part[0]], command[part], reading[part], float(carried[part[0]])) for part in parts
    )
    return CommandLog(path, episodes, dropped)


def _episodes(log: JointLog) -> Iterator[Floats]:
    """Rows of each episode: of one session and payload, without a gap in time."""
    t = log.t_s
    assert t is not None
    ends = np.diff(t) > GAP_ROWS * float(np.median(np.diff(t)))
    for name in ("session", "payload_kg"):
        if name in log.columns:
            ends |= np.diff(log.columns[name]) != 0
    return iter(np.split(np.arange(len(t)), np.flatnonzero(ends) + 1))


def _fault(path: Path, what: str, remedy: str) -> FileError:
    return FileError(f"{path}: {what}. {remedy}", file=str(path), code="command_log")
