"""Joints that stand elsewhere from one episode to the next, and what may have moved: told from the readings alone.

A jump is one that is as large as asked, beyond the scatter of single episodes, and stays. Where beginning, end and range of
a joint jump alike, its readings count from elsewhere: the zero moved, or everybody moved the joint differently from then on.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from kilter_files.formats.joints.lerobot.calibration import TICKS, TURN_TICKS
from kilter_files.formats.joints.lerobot.episodes import Episodes
from kilter_files.ground.arrays import Floats

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
