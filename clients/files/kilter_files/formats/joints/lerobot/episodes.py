"""A data set episode by episode: where each joint began, ended and went, and how far it stayed behind its goal at rest.

Readings and goals are both counted from the zero of the servo. A data set has no other witness of where an arm was.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from kilter_files.formats.joints.lerobot.calibration import DEGREES, refuse_outside
from kilter_files.formats.joints.lerobot.dataset import STATE, open_dataset, parquet_file, refuse_unfinished
from kilter_files.formats.joints.lerobot.log import (
    BLOCK,
    Block,
    Recorded,
    arm_joint_names,
    open_recorded_joints,
    refuse_leader,
    refuse_whole_rotations,
)
from kilter_files.formats.reader import LogHints
from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import fault

ACTION = "action"
ENDS = 10  # rows from which a beginning and an end are taken
STILL_DEG = 0.2  # between two rows: a servo at rest reads either of two ticks
FEWEST_STILL = 5  # rows at rest from which a lag is taken
LEAST_ROWS = 3
SIGNALS = ("start", "end", "low", "high", "lag")


@dataclass(frozen=True)
class Episodes:
    """Of each episode its number (E,), and of each signal the joints (E, n), degrees; NaN where an episode does not show it.

    ``start`` and ``end``: the first and last readings. ``low`` and ``high``: the range of the readings. ``lag``: goal less
    reading where both rest.
    """

    joints: tuple[str, ...]
    numbers: tuple[int, ...]
    signals: dict[str, Floats]


def read_episodes(path: Path, hints: LogHints) -> Episodes:
    """Read a data set; one episode is in memory at a time. Numbers in DEGREES need no calibration.

    Raises:
        FileError: nothing says what the numbers mean, it holds two arms, it is half written, its videos have other lengths than
            its rows, a servo wraps within an episode, or does not reach an angle with the calibration that is given.

    """
    recorded = _open_with_optional_calibration(path, hints)
    refuse_unfinished(recorded.dataset)
    numbers, found = [], []
    for number, state, action in _episodes(recorded):
        if len(state) >= LEAST_ROWS:
            numbers.append(number)
            found.append(_signals(state, action))
    signals = {name: np.array([one[k] for one in found]) for k, name in enumerate(SIGNALS)} if found else {}
    return Episodes(recorded.joints, tuple(numbers), signals)


def _open_with_optional_calibration(path: Path, hints: LogHints) -> Recorded:
    if hints.calibration is not None or hints.norm_mode != DEGREES:
        return open_recorded_joints(path, hints)
    dataset = open_dataset(path)
    refuse_leader(dataset)
    joints = arm_joint_names(dataset, hints.order)
    return Recorded(dataset, joints, tuple(dataset.names.index(name) for name in joints), None, DEGREES)


def _episodes(recorded: Recorded) -> Iterator[tuple[int, Floats, Floats | None]]:
    """Number, readings (rows, n) and goals (rows, n) of each episode; no goals where they are not of the same joints."""
    waiting: list[tuple[Floats, Floats | None]] = []
    number = -1
    for name in recorded.dataset.rows_of_files():
        for episode, state, action in _blocks(recorded.dataset.folder / name, recorded):
            for first, last in _runs(episode):
                if waiting and int(episode[first]) != number:
                    yield (number, *_stack_states_and_actions(waiting))
                    waiting = []
                number = int(episode[first])
                waiting.append((state[first:last], None if action is None else action[first:last]))
    if waiting:
        yield (number, *_stack_states_and_actions(waiting))


def _runs(episode: Floats) -> Iterator[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(episode)) + 1
    starts = [0, *edges.tolist(), len(episode)]
    yield from pairwise(starts)


def _stack_states_and_actions(parts: list[tuple[Floats, Floats | None]]) -> tuple[Floats, Floats | None]:
    actions = [action for _, action in parts if action is not None]
    return np.vstack([state for state, _ in parts]), np.vstack(actions) if len(actions) == len(parts) else None


def _blocks(path: Path, recorded: Recorded) -> Iterator[tuple[Floats, Floats, Floats | None]]:
    file = parquet_file(path)
    names = set(file.schema_arrow.names)
    missing = {STATE, "episode_index"} - names
    if missing:
        raise fault(path, f"has no column {sorted(missing)[0]!r}", "Export the data set again.")
    with_action = ACTION in names
    columns = [STATE, "episode_index", *([ACTION] if with_action else [])]
    last, rows = None, 0
    for batch in file.iter_batches(BLOCK, columns=columns):
        state = _degrees(batch.column(STATE), len(batch), recorded)
        action = _degrees(batch.column(ACTION), len(batch), recorded) if with_action else None
        if state is None:
            what = f"its rows do not have the {len(recorded.dataset.names)} numbers that info.json names"
            raise fault(path, what, "Export the data set again.", column=STATE)
        block = Block(state, np.asarray(batch.column("episode_index"), dtype=np.float64), np.zeros(0))
        refuse_whole_rotations(path, recorded.joints, block, last, rows)
        if recorded.calibration is not None:
            for k, (joint, servo) in enumerate(zip(recorded.joints, recorded.servos, strict=True)):
                refuse_outside(recorded.calibration, path, joint, servo, state[:, k], rows)
        last, rows = block, rows + len(state)
        yield block.episode, state, action


def _degrees(column: object, rows: int, recorded: Recorded) -> Floats | None:
    """The joints (rows, n) of a column of lists, degrees; None where its lists are not those of the readings."""
    flat = np.asarray(column.flatten(), dtype=np.float64)  # type: ignore[attr-defined]
    if len(flat) != rows * len(recorded.dataset.names):
        return None
    values = flat.reshape(rows, -1)[:, recorded.places]
    if recorded.calibration is not None:
        for k, servo in enumerate(recorded.servos):
            values[:, k] = recorded.calibration.degrees(servo, values[:, k], recorded.mode)
    return values


def _signals(state: Floats, action: Floats | None) -> tuple[Floats, ...]:
    """Start, end, low, high and lag (n,) of an episode."""
    ends = min(ENDS, len(state))
    lag = np.full(state.shape[1], np.nan) if action is None else _lag(state, action)
    return (
        np.median(state[:ends], axis=0),
        np.median(state[-ends:], axis=0),
        state.min(axis=0),
        state.max(axis=0),
        lag,
    )


def _lag(state: Floats, action: Floats) -> Floats:
    still = (np.abs(np.diff(state, axis=0)) <= STILL_DEG) & (np.abs(np.diff(action, axis=0)) <= STILL_DEG)
    behind = (action - state)[1:]
    return np.array(
        [np.median(behind[rest, k]) if rest.sum() >= FEWEST_STILL else np.nan for k, rest in enumerate(still.T)]
    )
