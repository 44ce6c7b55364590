"""Joints that stand elsewhere from one episode to the next, and what may have moved: told from the readings alone.

A jump is one that is as large as asked, beyond the scatter of single episodes, and stays. Where beginning, end and range of
a joint jump alike, its readings count from elsewhere: the zero moved, or everybody moved the joint differently from then on.

Readings and goals are both counted from the zero of the servo. A data set has no other witness of where an arm was.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from kilter_files.formats.joints.lerobot.calibration import DEGREES, TICKS, TURN_TICKS, refuse_outside
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

SIDE = 4  # fewest episodes on either side of a jump
NEAR = 8  # episodes on either side that it is judged by
SCATTERS = 5.0  # of single episodes, by which a jump is larger
ALIKE = 0.3  # of a jump, by which others may differ from it
LEAST_SCATTER_DEG = 0.09  # a tick of a servo: of readings that never differ
NORMAL, ROOT_2 = 1.4826, math.sqrt(2.0)  # a normal standard deviation in medians of distances
TRIMMED = 0.82  # mean distance of neighbours, the largest eighth left out, in standard deviations
ZERO, POSTURE, LAG, ROTATION = "zero", "posture", "lag", "rotation"
POSTURES = ("start", "end", "low", "high")
WHOLE_ROTATION_DEG = TICKS * 360.0 / TURN_TICKS
NEAR_ROTATION_DEG = 30.0  # by which what is usual of an episode scatters from task to task


@dataclass(frozen=True)
class Move:
    """A joint whose ``signals`` jumped by ``by_deg`` between two episodes; ``scatter_deg`` is that of single episodes before.

    ``what``: ``zero`` (all that is read of the joint jumped alike), ``posture`` (only how it was parked, or where it went),
    ``lag`` (how far it stays behind its goal at rest), ``rotation`` (all of it by 360 degrees: the servo counts from another).
    """

    joint: str
    before: int
    after: int
    by_deg: float
    scatter_deg: float
    what: str
    signals: tuple[str, ...]


def detect_joint_moves(found: Episodes, least_deg: float) -> list[Move]:
    """Return what moved by ``least_deg`` or more, in the order of the episodes."""
    moves: list[Move] = []
    for k, joint in enumerate(found.joints):
        series = {name: values[:, k] for name, values in found.signals.items()}
        postures = {name: series[name] for name in POSTURES if name in series}
        rotated, postures = _rotations(found, joint, postures)
        lagging = {name: values for name, values in series.items() if name == LAG}
        lags = [_lag(found, joint, lagging[LAG], at) for at in _jumps(lagging, least_deg)]
        stood = [_posture(found, joint, postures, at, least_deg) for at in _jumps(postures, least_deg)]
        moves += [*rotated, *(one for one in stood if not any(_sags(one, lag) for lag in lags)), *lags]
    return sorted(moves, key=lambda move: (move.after, move.joint))


def _rotations(found: Episodes, joint: str, series: Mapping[str, Floats]) -> tuple[list[Move], dict[str, Floats]]:
    """Return where all that is read of a joint jumps by 360 degrees, be it for one episode, and the series without that."""
    if not series:
        return [], {}
    values = np.array([*series.values()])
    steps = np.diff(values, axis=1)
    near = np.abs(np.abs(np.median(steps, axis=0)) - WHOLE_ROTATION_DEG) <= NEAR_ROTATION_DEG
    alike = (np.abs(steps) > WHOLE_ROTATION_DEG / 2.0).all(axis=0) & (np.sign(steps) == np.sign(steps[0])).all(axis=0)
    rotations = np.sign(steps[0]) * (near & alike)
    values[:, 1:] -= WHOLE_ROTATION_DEG * np.cumsum(rotations)
    rest = dict(zip(series, values, strict=True))
    scatter = max(map(_scatter, values))
    moves = [
        Move(
            joint,
            found.numbers[at],
            found.numbers[at + 1],
            float(np.median(steps[:, at])),
            scatter,
            ROTATION,
            tuple(series),
        )
        for at in np.flatnonzero(rotations)
    ]
    return moves, rest


def _posture(found: Episodes, joint: str, series: dict[str, Floats], at: int, least_deg: float) -> Move:
    jumps = {name: (_jump(values, at), _scatter(values)) for name, values in series.items()}
    leader = max(jumps, key=lambda name: abs(jumps[name][0]) / jumps[name][1])
    by, scatter = jumps[leader]
    # A signal that scatters more may differ by more.
    alike = tuple(name for name, (own, s) in jumps.items() if abs(own - by) <= max(ALIKE * abs(by), 2.0 * s))
    moved = tuple(name for name, (own, s) in jumps.items() if _is_one(own, s, least_deg))
    zero = {"start", "end"} <= set(alike) and {"low", "high"} & set(alike) and len(moved) > 1
    signals = alike if zero else moved
    return Move(joint, found.numbers[at - 1], found.numbers[at], by, scatter, ZERO if zero else POSTURE, signals)


def _lag(found: Episodes, joint: str, values: Floats, at: int) -> Move:
    return Move(joint, found.numbers[at - 1], found.numbers[at], _jump(values, at), _scatter(values), LAG, (LAG,))


def _sags(stood: Move, lag: Move) -> bool:
    """Whether a joint stands elsewhere by what it stays behind its goal: goals went on as before, so no zero moved."""
    near = max(ALIKE * abs(stood.by_deg), 2.0 * max(stood.scatter_deg, lag.scatter_deg))
    return abs(stood.after - lag.after) < SIDE and abs(stood.by_deg + lag.by_deg) <= near


def _is_one(by: float, scatter: float, least_deg: float) -> bool:
    return abs(by) >= max(least_deg, SCATTERS * scatter)


def _jumps(series: Mapping[str, Floats], least_deg: float) -> list[int]:
    """Places before which one of the series jumps; of those within a few episodes, the one that parts them best."""
    found: list[tuple[float, float, int]] = []
    for values in series.values():
        scatter = _scatter(values)
        places = ((at, abs(_jump(values, at))) for at in range(SIDE, len(values) - SIDE + 1))
        found += [
            (_mean_deviation_around_step(values, at) / by, -by, at)
            for at, by in places
            if _is_one(by, scatter, least_deg)
        ]
    kept: list[int] = []
    for *_, at in sorted(found):
        if all(abs(at - other) > NEAR for other in kept):
            kept.append(at)
    return sorted(kept)


def _sides(values: Floats, at: int) -> tuple[Floats, Floats]:
    before, after = values[max(0, at - NEAR) : at], values[at : at + NEAR]
    return before[np.isfinite(before)], after[np.isfinite(after)]


def _jump(values: Floats, at: int) -> float:
    """By how much a series jumps before a place; 0 where few values are known."""
    before, after = _sides(values, at)
    return 0.0 if min(len(before), len(after)) < SIDE else float(np.median(after) - np.median(before))


def _mean_deviation_around_step(values: Floats, at: int) -> float:
    """Mean distance of the values on both sides from what is usual there."""
    before, after = _sides(values, at)
    return float(np.mean(np.abs(np.concatenate([before - np.median(before), after - np.median(after)]))))


def _scatter(values: Floats) -> float:
    """Standard deviation of single values about what is usual, from the differences of neighbours: jumps do not enlarge it."""
    steps = np.sort(np.abs(np.diff(values[np.isfinite(values)])))
    if len(steps) < 2 * SIDE - 1:
        return max(float(steps.max()), LEAST_SCATTER_DEG) if len(steps) else LEAST_SCATTER_DEG
    kept = steps[: -max(2, len(steps) // 8)]
    typical, mean = float(np.median(steps)), float(kept.mean())
    return max(NORMAL * typical / ROOT_2, mean / TRIMMED, LEAST_SCATTER_DEG)


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
    lag = np.full(state.shape[1], np.nan) if action is None else _lag_of_episode(state, action)
    return (
        np.median(state[:ends], axis=0),
        np.median(state[-ends:], axis=0),
        state.min(axis=0),
        state.max(axis=0),
        lag,
    )


def _lag_of_episode(state: Floats, action: Floats) -> Floats:
    still = (np.abs(np.diff(state, axis=0)) <= STILL_DEG) & (np.abs(np.diff(action, axis=0)) <= STILL_DEG)
    behind = (action - state)[1:]
    return np.array(
        [np.median(behind[rest, k]) if rest.sum() >= FEWEST_STILL else np.nan for k, rest in enumerate(still.T)]
    )
