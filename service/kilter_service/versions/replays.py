"""Answers that are kept with every active version: an upgrade replays them, and says what it changes of what arms are sent."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.errors import CoreError
from kilter_core.observations import Observations
from kilter_core.types import Floats
from kilter_service.contract.streams import Status
from kilter_service.contract.versions import CorrectionLimits
from kilter_service.ground.core import core_correct
from kilter_service.ground.correction_limits import Rules, correction_options, rules_today
from kilter_service.ground.db import Database, Session
from kilter_service.ground.wire import to_deg, to_mm
from kilter_service.versions import store
from kilter_service.versions.predictions.at_pose import drawn
from kilter_service.versions.store import BY_UPGRADE, Replay, kept
from kilter_service.versions.store import add_answer as add

if TYPE_CHECKING:
    from kilter_core.model import Calibration
    from kilter_service.versions.records import ActivationRecord

STORED = "<f8"
SETPOINTS = 300  # all over the joint limits
WHOLE_POSE, ANY_LEVERAGE = 6, 1e3  # of joints; of postures, none of which reaches it


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
    made = core_correct.compile_program(calibration, correction_options(CorrectionLimits(**limits), None, rules=rules))
    done = made.correct_rows(q)
    return np.where((done.status == Status.OK)[:, None], done.q, np.nan)


def first_rules(n_joints: int) -> dict[str, Any]:
    """Rules of releases before 2026-11-23: the whole pose, or the tool point alone where an arm has fewer than six joints."""
    return rules_today() | ({"task": "pose"} if n_joints >= WHOLE_POSE else {"least_leverage": ANY_LEVERAGE})


def replay_version(database: Database, version_id: str, *, before_rules: bool = False) -> Replay:
    """Return what a version answers today, under the rules of this release, or under the :func:`first_rules`."""
    with database.reading() as session:
        calibration, limits = store.calibration(session, version_id), store.get(session, version_id).limits
    q = drawn(calibration.robot, SETPOINTS)
    rules = first_rules(calibration.robot.n_joints) if before_rules else rules_today()
    answers = correct_setpoints(calibration, limits, rules, q)
    return Replay(rules, *(np.asarray(one, STORED).tobytes() for one in (q, answers)))


def keep_answers(database: Database, *, before_rules: bool = False) -> None:
    """Keep rules and answers of the active versions that have none: those of earlier releases.

    ``before_rules``: they are of a release before 2026-11-23, and keep its rules until they are activated anew.
    """
    with database.reading() as session:
        missing = [
            entry
            for entry in store.active_entries(session)
            if store.activation_rules(session, entry.version_id) is None
        ]
    for entry in missing:
        try:
            replay = replay_version(database, entry.version_id, before_rules=before_rules)
        except CoreError:  # nor is it streamed
            continue
        with database.transaction() as session:
            add(session, entry.id, replay, BY_UPGRADE)


def compare_answers(database: Database, *, before_rules: bool = False) -> Iterator[Change]:
    """Yield how the answers of each active version differ from those that were kept.

    ``before_rules``: they are of a release before 2026-11-23, which kept none; then it is what activating them anew changes.
    """
    with database.reading() as session:
        found = [_active(session, entry) for entry in store.active_entries(session)]
    for robot, version_id, calibration, limits, before in found:
        try:
            yield _compare(robot, version_id, calibration, limits, before, before_rules)
        except CoreError:  # nor is it streamed
            continue


def _active(session: Session, entry: ActivationRecord) -> tuple[str, str, Calibration, dict[str, Any], Replay | None]:
    record, calibration = store.get(session, entry.version_id), store.calibration(session, entry.version_id)
    return record.robot, record.id, calibration, record.limits, kept(session, entry.id)


def _compare(
    robot: str,
    version_id: str,
    calibration: Calibration,
    limits: dict[str, Any],
    before_upgrade: Replay | None,
    before_rules: bool,
) -> Change:
    if before_upgrade is None:
        q = drawn(calibration.robot, SETPOINTS)
        now = correct_setpoints(calibration, limits, rules_today(), q)
        earlier = first_rules(calibration.robot.n_joints)
        before = correct_setpoints(calibration, limits, earlier, q) if before_rules else now
    else:
        stored = (before_upgrade.setpoints, before_upgrade.answers)
        q, before = (np.frombuffer(one, STORED).reshape(-1, calibration.robot.n_joints) for one in stored)
        now = correct_setpoints(calibration, limits, before_upgrade.rules, q)
    refused = np.isnan(before).any(axis=1), np.isnan(now).any(axis=1)
    both = ~refused[0] & ~refused[1]
    sliding = np.array([joint.kind == "prismatic" for joint in calibration.robot.joints])
    moved = np.abs(now[both] - before[both])
    points = [calibration.predict(Observations(q=one[both])).position for one in (before, now)] if both.any() else []
    tool = np.linalg.norm(points[1] - points[0], axis=1).max() if points else 0.0
    return Change(
        robot,
        version_id,
        to_deg(moved[:, ~sliding].max(initial=0.0)),
        to_mm(moved[:, sliding].max(initial=0.0)),
        to_mm(tool),
        len(q),
        int(np.sum(refused[0] != refused[1])),
        before_upgrade is not None,
    )
