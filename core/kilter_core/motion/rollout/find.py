"""A search in commands and readings from record to report: what the joints of a simulator lack, and what had absorbed it."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from kilter_core.errors import ObservationError
from kilter_core.motion.rollout.effects import Number
from kilter_core.motion.rollout.fit import BASE, JointFit, fit_base, simulate
from kilter_core.motion.rollout.record import JointRecord
from kilter_core.motion.rollout.search import (
    FEWEST_BLOCKS,
    GAIN,
    JointFindings,
    Split,
    drop_contradicted,
    gain_on,
    judge_anew,
    judge_unseen,
    refit,
    refit_joint,
    search_joint,
    split_episodes,
)
from kilter_core.types import Bools, Floats, Progress, unheard

FOLLOWS = 0.6  # correlation of a reading with its command, below which it follows another or none
SCALE = 3.0  # of a reading over its command, beyond which one of them has another unit
LEAST_MOTION_RAD = 0.01
Replay = Callable[[Mapping[str, JointFit]], Mapping[str, Floats]]
PASSES, SETTLED = 10, 0.99  # in which an arm is settled at most; share that a joint leaves when it is
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

    number: Number
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
    replay: Replay | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> RolloutReport:
    """JointFit the servo of each joint by simulation, find what it lacks, and judge that on episodes that were never used.

    ``logs (E,)`` says from which file each episode comes: what each of several shows is replicated. Those of ``held_logs``
    are held out; where none is named, ``seed`` chooses a third of the episodes. ``replay`` simulates the whole arm with
    these fits of its joints and returns the readings (R,) of each: a joint by itself says what an effect changes, the whole
    arm what it reads.

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
    progress(0.0, "servo of each joint")
    with ThreadPoolExecutor(max(1, min(len(moving), os.cpu_count() or 1))) as pool:
        joints = _search_arm(moving, split, logs, replay, pool, progress)
    joints = _judge_on_unseen(joints, replay)
    held = np.unique(moving[0].episode[split.held]).tolist() if split.whole else []
    names = {record.name for record in moving}
    return RolloutReport(
        tuple(joints),
        tuple(r.name for r in records if r.name not in names),
        len(moving[0].episodes),
        tuple(held),
        seconds,
    )


def _search_arm(
    records: Sequence[JointRecord],
    split: Split,
    logs: Sequence[int],
    replay: Replay | None,
    pool: ThreadPoolExecutor,
    progress: Progress,
) -> list[JointFindings]:
    """Search all joints; then those with findings anew, one after the other with the whole arm as it is by then.

    What one joint lacks moves its neighbours: the joint that gains most is believed first, and the others have to show
    theirs in an arm that has it.
    """
    if replay is not None and len(records) > 1:  # a joint alone is its whole arm
        records = _settle_servos(records, split.train, replay, pool)
    joints = _search_each(records, split, logs, pool, lambda x: progress(0.4 * x, "each joint"))
    if replay is None:
        return joints
    believed: set[str] = set()
    again = {one.record.name for one in joints}
    while again:
        best = _find_most_certain(joints, believed, split, replay)
        if best is not None:
            believed.add(best)
        progress(0.4 + 0.4 * len(believed) / len(joints), "the arm as a whole")
        arm = _correct([one.record for one in joints], _fits_of(joints, believed), replay)
        joints = _renew(joints, arm, again - believed, split, logs, pool)
        again = {one.record.name for one in joints if one.judged} - believed if best is not None else set()
    if len(joints) == 1:
        return joints
    if believed:
        arm = _correct([one.record for one in joints], [one.believed for one in joints], replay)
        joints = _renew(joints, arm, believed, split, logs, pool)
    joints = _settle_arm(joints, replay, pool)
    return list(pool.map(lambda one: judge_anew(one, logs), joints))


def _settle_servos(
    records: Sequence[JointRecord], train: Bools, replay: Replay, pool: ThreadPoolExecutor
) -> list[JointRecord]:
    """Correct each joint by the arm as its servos are fitted, as long as the joint leaves less by it.

    Readings tell the motion of carried joints, and so their load, but smoothed: what is missing looks like an effect.
    """
    records = list(records)
    fits = list(pool.map(lambda one: fit_base(one, train), records))
    for _ in range(PASSES):
        arm = _correct(records, fits, replay)
        new = list(pool.map(lambda one, fit: refit(one, fit, (), train), arm, fits))
        better = [one.cost < SETTLED * fit.cost for one, fit in zip(new, fits, strict=True)]
        if not any(better):
            break
        fits = [one if gains else fit for one, fit, gains in zip(new, fits, better, strict=True)]
        records = [one if gains else old for one, old, gains in zip(arm, records, better, strict=True)]
    return records


def _settle_arm(joints: list[JointFindings], replay: Replay, pool: ThreadPoolExecutor) -> list[JointFindings]:
    """Fit the joints, with what they lack, in turn with the arm in which they move, until no joint leaves less."""
    for _ in range(PASSES):
        before = [one.rms(one.believed, one.split.train) for one in joints]
        arm = _correct([one.record for one in joints], [one.believed for one in joints], replay)
        joints = list(pool.map(refit_joint, joints, arm))
        after = [one.rms(one.believed, one.split.train) for one in joints]
        if all(new > SETTLED * old for new, old in zip(after, before, strict=True)):
            break
    return joints


def _find_most_certain(joints: Sequence[JointFindings], believed: set[str], split: Split, replay: Replay) -> str | None:
    """Name the joint that gains most by what it lacks, if the whole arm gains by it too on the rows that choose."""
    open_ones = [one for one in joints if one.judged and one.record.name not in believed]
    open_ones.sort(key=lambda one: one.rms(one.fit, split.train) / max(one.rms(one.base, split.train), 1e-12))
    fits = {one.record.name: fit for one, fit in zip(joints, _fits_of(joints, believed), strict=True)}
    for one in open_ones:
        name, record = one.record.name, one.record
        without, with_it = (record.reading - replay(fits | {name: fit})[name] for fit in (one.base, one.fit))
        if gain_on(record, one.split.train, without, with_it) > GAIN:
            return name
    return None


def _fits_of(joints: Sequence[JointFindings], believed: set[str]) -> list[JointFit]:
    return [one.believed if one.record.name in believed else one.base for one in joints]


def _search_each(
    records: Sequence[JointRecord],
    split: Split,
    logs: Sequence[int],
    pool: ThreadPoolExecutor,
    share_done: Callable[[float], None],
) -> list[JointFindings]:
    done: list[JointFindings] = []
    for found in pool.map(lambda record: search_joint(record, split, logs), records):
        done.append(found)
        share_done(len(done) / len(records))
    return done


def _renew(
    joints: Sequence[JointFindings],
    arm: Sequence[JointRecord],
    again: set[str],
    split: Split,
    logs: Sequence[int],
    pool: ThreadPoolExecutor,
) -> list[JointFindings]:
    """Search the joints ``again`` in the arm as it is corrected now; the others keep what they have."""
    records = [record for record in arm if record.name in again]
    found = {one.record.name: one for one in _search_each(records, split, logs, pool, lambda _: None)}
    return [found.get(one.record.name, one) for one in joints]


def _correct(records: Sequence[JointRecord], fits: Sequence[JointFit], replay: Replay) -> list[JointRecord]:
    """Give each joint what the whole arm reads beyond it."""
    whole = replay({record.name: fit for record, fit in zip(records, fits, strict=True)})
    found = []
    for record, fit in zip(records, fits, strict=True):
        alone = simulate(replace(record, correction=None), fit.p)
        beyond = whole[record.name] - alone
        found.append(replace(record, correction=beyond if np.isfinite(beyond).all() else None))
    return found


def _judge_on_unseen(joints: Sequence[JointFindings], replay: Replay | None) -> list[JointFindings]:
    """Judge each effect by what the whole arm leaves on unseen rows with it and without it; what these contradict goes."""
    if replay is None:
        return [drop_contradicted(found, found.judged) for found in joints]
    fits = {found.record.name: found.believed for found in joints}
    whole = replay(fits)
    judged = []
    for found in joints:
        kept = []
        for one in found.judged:
            without = replay(fits | {found.record.name: one.without})[found.record.name]
            kept.append(judge_unseen(found, one, without, whole[found.record.name]))
        judged.append(drop_contradicted(found, kept))
    return judged


def list_absorbed(found: JointFindings) -> list[Absorbed]:
    """Return the numbers of the servo, with what a fit without the effects found makes of them."""
    return [Absorbed(number, float(found.base.p[number.place]), float(found.fit.p[number.place])) for number in BASE]


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
