"""Answers that are kept with every active version: an upgrade replays them, and says what it changes of what arms are sent."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from sqlalchemy import select

from kilter_core.errors import CoreError
from kilter_core.observations import Observations
from kilter_core.types import Floats
from kilter_service.contract.stream_messages import Status
from kilter_service.contract.versions import CorrectionLimits
from kilter_service.ground.core import program
from kilter_service.ground.correction_limits import Rules, options_of, rules_today
from kilter_service.ground.db import Database, Session
from kilter_service.ground.db.tables import ActivationRow, ReplayRow
from kilter_service.ground.version import code_version
from kilter_service.ground.wire import to_deg, to_mm
from kilter_service.versions import store
from kilter_service.versions.predictions.preview import drawn

if TYPE_CHECKING:
    from kilter_core.model import Calibration

SETPOINTS = 300  # all over the joint limits
WHOLE_POSE, ANY_LEVERAGE = 6, 1e3  # of joints; of postures, none of which reaches it
BY_ACTIVATION, BY_UPGRADE = "activation", "upgrade"


@dataclass(frozen=True)
class Replay:
    """Task and rules of a correction, ``setpoints (N, n)`` and ``answers (N, n)``, rad or m; NaN where refused."""

    rules: dict[str, Any]
    setpoints: Floats
    answers: Floats


@dataclass(frozen=True)
class Change:
    """The largest change of a version's answers: of a joint in degrees or mm, and of the tool point in mm.

    ``otherwise`` setpoints were refused and are not, or the other way round. ``kept`` is False where no answers were.
    """

    robot: str
    version_id: str
    joint_deg: float
    joint_mm: float
    tool_mm: float
    setpoints: int
    otherwise: int = 0
    kept: bool = True


def correct_setpoints(calibration: Calibration, limits: dict[str, Any], rules: Rules, q: Floats) -> Floats:
    """Return the joints (N, n) that answer setpoints ``q (N, n)``, rad or m; NaN where one is refused."""
    made = program.compile_program(calibration, options_of(CorrectionLimits(**limits), None, rules=rules))
    done = made.correct_rows(q)
    return np.where((done.status == Status.OK)[:, None], done.q, np.nan)


def replay_version(database: Database, version_id: str) -> Replay:
    """Return what a version answers today, under the rules of this release."""
    with database.reading() as session:
        calibration, limits = store.calibration(session, version_id), store.get(session, version_id).limits
    q, rules = drawn(calibration.robot, SETPOINTS), rules_today()
    return Replay(rules, q, correct_setpoints(calibration, limits, rules, q))


def add(session: Session, activation_id: int, replay: Replay, made_by: str = BY_ACTIVATION) -> None:
    """Keep the answers of a version with its activation."""
    row = ReplayRow(activation_id=activation_id, rules=replay.rules, made_by=made_by, code_version=code_version())
    row.setpoints, row.answers = (np.asarray(one, "<f8").tobytes() for one in (replay.setpoints, replay.answers))
    session.add(row)
    session.flush()


def repeat(session: Session, activation_id: int, version_id: str) -> None:
    """Keep with an activation what was kept with the last one of the version, its task and rules too."""
    query = select(ReplayRow).join(ActivationRow, ActivationRow.id == ReplayRow.activation_id)
    query = query.where(ActivationRow.version_id == version_id).order_by(ActivationRow.id.desc()).limit(1)
    before = session.execute(query).scalar_one_or_none()
    if before is not None:
        names = ("rules", "setpoints", "answers", "made_by", "code_version")
        session.add(ReplayRow(activation_id=activation_id, **{name: getattr(before, name) for name in names}))
        session.flush()


def without_answers(session: Session) -> list[int]:
    """Return the activations in use that no answers were kept with: those of earlier releases."""
    kept = set(session.execute(select(ReplayRow.activation_id)).scalars())
    return [entry.id for entry in store.active_entries(session) if entry.id not in kept]


def keep_answers(database: Database) -> None:
    """Keep today's answers of the active versions that have none."""
    with database.reading() as session:
        missing = set(without_answers(session))
        found = [entry for entry in store.active_entries(session) if entry.id in missing]
    for entry in found:
        try:
            replay = replay_version(database, entry.version_id)
        except CoreError:  # nor is it streamed
            continue
        with database.transaction() as session:
            if session.get(ReplayRow, entry.id) is None:
                add(session, entry.id, replay, BY_UPGRADE)


def compare_answers(database: Database, *, before_rules: bool = False) -> Iterator[Change]:
    """Yield how the answers of each active version differ from those that were kept.

    ``before_rules``: they are of a release before 2026-11-23, which kept none; what it answered is estimated.
    """
    with database.reading() as session:
        found = [
            (record, store.calibration(session, record.id), _kept(session, record.robot_id))
            for record in store.active_of_robots(session)
        ]
    for record, calibration, kept in found:
        try:
            yield _compare(record.robot, record.id, calibration, record.limits, kept, before_rules)
        except CoreError:  # nor is it streamed
            continue


def _kept(session: Session, robot_id: int) -> Replay | None:
    entry = store.active_entry(session, robot_id)
    row = None if entry is None else session.get(ReplayRow, entry.id)
    if row is None:
        return None
    n = store.calibration(session, entry.version_id).robot.n_joints if entry is not None else 0
    q, answers = (np.frombuffer(one, "<f8").reshape(-1, n) for one in (row.setpoints, row.answers))
    return Replay(row.rules, q, answers)


def _compare(
    robot: str,
    version_id: str,
    calibration: Calibration,
    limits: dict[str, Any],
    kept: Replay | None,
    before_rules: bool,
) -> Change:
    if kept is None:
        q = drawn(calibration.robot, SETPOINTS)
        now = correct_setpoints(calibration, limits, rules_today(), q)
        n = calibration.robot.n_joints
        earlier = rules_today() | ({"task": "pose"} if n >= WHOLE_POSE else {"least_leverage": ANY_LEVERAGE})
        before = correct_setpoints(calibration, limits, earlier, q) if before_rules else now
    else:
        q, before = kept.setpoints, kept.answers
        now = correct_setpoints(calibration, limits, kept.rules, q)
    refused = np.isnan(before).any(axis=1), np.isnan(now).any(axis=1)
    both = ~refused[0] & ~refused[1]
    sliding = np.array([joint.kind == "prismatic" for joint in calibration.robot.joints])
    moved = np.abs(now[both] - before[both])
    points = [calibration.predict(Observations(q=one[both])).position for one in (before, now)] if both.any() else []
    tool = np.linalg.norm(points[1] - points[0], axis=1).max() if points else 0.0
    return Change(
        robot, version_id, to_deg(moved[:, ~sliding].max(initial=0.0)), to_mm(moved[:, sliding].max(initial=0.0)),
        to_mm(tool), len(q), int(np.sum(refused[0] != refused[1])), kept is not None,
    )  # fmt: skip
