"""A search in commands and readings from record to report: what the joints of a simulator lack, and what had absorbed it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from kilter_core.errors import ObservationError
from kilter_core.rollout.fit import BASE
from kilter_core.rollout.record import JointRecord
from kilter_core.rollout.search import FEWEST_BLOCKS, JointFindings, search_joint, split_episodes
from kilter_core.types import Progress, unheard

FOLLOWS = 0.6  # correlation of a reading with its command, below which it follows another or none
SCALE = 3.0  # of a reading over its command, beyond which one of them has another unit
LEAST_MOTION_RAD = 0.01
LATEST_S = 0.4  # that a reading may come after its command


@dataclass(frozen=True)
class RolloutReport:
    """What the joints of a record lack; ``resting`` are joints that hardly moved. ``unseen`` where whole episodes judge."""

    joints: tuple[JointFindings, ...]
    resting: tuple[str, ...]
    episodes: int
    held_episodes: tuple[int, ...]
    seconds: float

    @property
    def unseen(self) -> bool:
        """Whether episodes that no choice saw have judged."""
        return bool(self.held_episodes)


@dataclass(frozen=True)
class Absorbed:
    """A number of the servo that a fit without the effects makes ``times`` as large as one with them."""

    name: str
    without: float
    found: float

    @property
    def times(self) -> float:
        """How many times too large it comes out."""
        return self.without / max(self.found, 1e-300)


def find_missing_motion(
    records: Sequence[JointRecord],
    logs: Sequence[int],
    held_logs: Sequence[int] = (),
    seed: int = 0,
    progress: Progress | None = None,
) -> RolloutReport:
    """Fit the servo of each joint by simulation, find what it lacks, and judge that on episodes that were never used.

    ``logs (E,)`` says from which file each episode comes: what each of several shows is replicated. Those of ``held_logs``
    are held out; where none is named, ``seed`` chooses a third of the episodes.

    Raises:
        ObservationError: commands of another joint or unit, too short a record, or nothing moves.

    """
    progress = progress or unheard
    moving = [record for record in records if np.ptp(record.command) > LEAST_MOTION_RAD]
    if not moving:
        raise ObservationError(
            "No joint is told to move in this log: record motions of all joints.", code="log_at_rest"
        )
    for record in moving:
        _refuse_other_command(record, moving)
    seconds = float(sum(one.t[-1] - one.t[0] for one in moving[0].episodes))
    if int(moving[0].block.max()) + 1 < FEWEST_BLOCKS:
        raise ObservationError(
            f"The log has {seconds:.0f} s of motion, and a search needs {FEWEST_BLOCKS} s: record longer motions.",
            code="log_too_short",
        )
    split = split_episodes(moving[0], seed, np.isin(logs, held_logs))
    done: list[JointFindings] = []

    def search(record: JointRecord) -> JointFindings:
        found = search_joint(record, split, logs)
        done.append(found)
        progress(len(done) / len(moving), f"joint {record.name}")
        return found

    progress(0.0, "servo of each joint")
    with ThreadPoolExecutor(max(1, min(len(moving), os.cpu_count() or 1))) as pool:
        joints = tuple(pool.map(search, moving))
    held = np.unique(moving[0].episode[split.held]).tolist() if split.whole else []
    names = {record.name for record in moving}
    return RolloutReport(
        joints, tuple(r.name for r in records if r.name not in names), len(moving[0].episodes), tuple(held), seconds
    )


def list_absorbed(found: JointFindings) -> list[Absorbed]:
    """Return the numbers of the servo, with what a fit without the effects found makes of them."""
    return [
        Absorbed(number.name, float(found.base.p[number.place]), float(found.fit.p[number.place])) for number in BASE
    ]


def _refuse_other_command(record: JointRecord, records: Sequence[JointRecord]) -> None:
    """Refuse a reading that does not follow its command, or in another unit."""
    own = _follow(record, record)
    if own < FOLLOWS:
        best = max(records, key=lambda other: _follow(record, other))
        where = (
            f"it follows that of {best.name}: put the columns in the order of the model's joints"
            if _follow(record, best) > max(FOLLOWS, own) and best is not record
            else "the log is of another arm, or its columns have another order"
        )
        raise ObservationError(
            f"The reading of {record.name} does not follow its command (correlation {own:.2f}); {where}.",
            code="command_mismatch",
            joint=record.name,
        )
    ratio = float(np.std(record.reading)) / max(float(np.std(record.command)), 1e-12)
    if ratio > SCALE or ratio < 1.0 / SCALE:
        raise ObservationError(
            f"The reading of {record.name} moves {ratio:.3g} times as far as its command: one of them has another unit "
            "(ticks, degrees, radians). Name the columns by their unit, q1_deg and cmd1_deg or q1_rad and cmd1_rad.",
            code="command_unit",
            joint=record.name,
        )


def _follow(record: JointRecord, other: JointRecord) -> float:
    """Largest correlation of a reading with a command that may come some time before."""
    best = -1.0
    step = float(np.median(np.diff(record.episodes[0].t)))
    for late in range(0, max(1, round(LATEST_S / step)), max(1, round(0.02 / step))):
        a, b = record.reading[late:], other.command[: len(other.command) - late]
        if min(float(np.std(a)), float(np.std(b))) > 0.0:
            best = max(best, float(np.corrcoef(a, b)[0, 1]))
    return best
