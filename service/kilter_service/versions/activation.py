"""Which version a robot is corrected with: activate one, if nothing speaks against it, and return to the one before."""

from __future__ import annotations

from dataclasses import replace
from datetime import timedelta
from typing import Any

from kilter_core.errors import FindingDocument
from kilter_service.contract.versions import ActivatedVersion, ActivationWish, VersionSummary
from kilter_service.ground import correction_limits
from kilter_service.ground.core import core_correct
from kilter_service.ground.db import Database, Session
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.errors import ServiceError
from kilter_service.robots import compensation
from kilter_service.robots import store as robots
from kilter_service.versions import replays, store, wire
from kilter_service.versions.ability import CODE as CANNOT
from kilter_service.versions.ability import Ability, ability
from kilter_service.versions.guard import Verdict, judge
from kilter_service.versions.if_match import ANY_STATE, Expected

ACTIVATE, ROLLBACK = "activate", "rollback"
ATTEMPTS = 5
LATELY = timedelta(minutes=10)  # within which somebody else's activation is probably not known yet


def activate(
    database: Database,
    version_id: str,
    actor: str,
    wish: ActivationWish,
    temperature_c: float | None = None,
    expected: Expected = ANY_STATE,
) -> ActivatedVersion:
    """Make a version the one its robot is corrected with; the active one a repeat changes nothing.

    ``temperature_c`` is that of the arm as the corrector knows it: without it thermal growth stays uncorrected.

    Raises:
        ServiceError: something speaks against it and it is not forced; another version is active than ``expected``; or
            others activate all the time.

    """
    with database.reading() as session:
        expected.check(session, _refuse_retired(session, version_id), becomes=version_id)
    uncorrected = _left_out(database, version_id, temperature_c)  # first: what cannot be corrected is not activated
    able = ability(database, version_id, temperature_c)
    replay = replays.replay_version(database, version_id)
    for _ in range(ATTEMPTS):
        verdict = _with_controller(database, _with_ability(judge(database, version_id), able, version_id), version_id)
        verdict = _with_recent_activation(database, verdict, version_id, actor)
        if verdict.objections and not wish.force:
            raise _refusal(version_id, verdict, able)
        summary = _write_activation(database, version_id, actor, wish, verdict, expected, replay)
        if summary is not None:
            return ActivatedVersion(
                **summary.model_dump(),
                **uncorrected,
                forced=wish.force and verdict.active != version_id,
                objections=list(verdict.objections),
                compared=verdict.compared,
                warnings=list(verdict.warnings),
                preview=able.preview,
            )
    raise ServiceError(
        f"While version {version_id} was compared with the active one, others were activated {ATTEMPTS} times: nothing "
        "was changed. Try again.",
        code="activation_overtaken",
        version=version_id,
    )


def _with_ability(verdict: Verdict, able: Ability, version_id: str) -> Verdict:
    """A verdict with what the version can correct now; what its job said of that is older."""
    if verdict.active == version_id:
        return verdict
    others = [one for one in verdict.objections if one.code != CANNOT]
    return replace(verdict, objections=(*able.objections, *others), warnings=(*verdict.warnings, *able.remarks))


def _with_controller(database: Database, verdict: Verdict, version_id: str) -> Verdict:
    """A verdict with what the controller does by itself; of the version that is active already it is a warning."""
    with database.reading() as session:
        robot = robots.by_id(session, store.get(session, version_id).robot_id)
    speaks_against = compensation.objection(robot.name, robot.controller_compensation)
    unknown = compensation.remark(robot.name, robot.controller_compensation)
    if speaks_against is not None and verdict.active != version_id:
        return replace(verdict, objections=(*verdict.objections, speaks_against))
    said = [FindingDocument.make(**one.model_dump()) for one in (speaks_against, unknown) if one is not None]
    return replace(verdict, warnings=(*verdict.warnings, *said))


def _with_recent_activation(database: Database, verdict: Verdict, version_id: str, actor: str) -> Verdict:
    """A verdict that says whose activation of a moment ago this one replaces."""
    with database.reading() as session:
        last = store.active_entry(session, store.get(session, version_id).robot_id)
    if last is None or version_id == last.version_id or actor == last.actor or utc_now() - last.at > LATELY:
        return verdict
    minutes = round((utc_now() - last.at).total_seconds() / 60.0)
    said = (
        f"{last.actor} activated version {last.version_id} {f'{minutes} min' if minutes else 'less than a minute'} ago: "
        "this replaces it. `kilter version rollback` returns to it."
    )
    return replace(verdict, warnings=(FindingDocument.make("activated_lately", said), *verdict.warnings))


def _left_out(database: Database, version_id: str, temperature_c: float | None) -> dict[str, Any]:
    """Effects of a version that setpoints are not corrected for, as fields of the answer."""
    with database.reading() as session:
        calibration = store.calibration(session, version_id)
    made = core_correct.compile_program(calibration, core_correct.CorrectionOptions(temperature_c=temperature_c))
    return correction_limits.fields(made.unsupported, made.where_stated)


def _refuse_retired(session: Session, version_id: str) -> int:
    """Refuse a version that is out of use, or of a robot that is; returns the robot's key."""
    robot_id = store.usable(session, version_id).robot_id
    robots.refuse_retired_robot(session, robot_id)
    return robot_id


def _refusal(version_id: str, verdict: Verdict, able: Ability) -> ServiceError:
    return ServiceError(
        f"Version {version_id} was not activated. {' '.join(o.message for o in verdict.objections)} Identify again, or give "
        'force (`kilter activate --force --reason TEXT`, {"force": true, "reason": TEXT}) if you know why, for '
        "instance because the arm was repaired since; the log keeps it.",
        code="activation_refused",
        version=version_id,
        objections=[objection.model_dump() for objection in verdict.objections],
        compared=None if verdict.compared is None else verdict.compared.model_dump(),
        warnings=list(verdict.warnings),
        preview=None if able.preview is None else able.preview.model_dump(mode="json"),
    )


def _write_activation(
    database: Database,
    version_id: str,
    actor: str,
    wish: ActivationWish,
    verdict: Verdict,
    expected: Expected,
    replay: store.Replay,
) -> VersionSummary | None:
    """Write the activation; None when another version became active since the verdict."""
    with database.transaction() as session:
        robot_id = _refuse_retired(session, version_id)
        expected.check(session, robot_id, becomes=version_id)
        last = store.active_entry(session, robot_id)
        active = None if last is None else last.version_id
        # The active version keeps its rules until somebody activates it anew.
        if active != version_id or store.activation_rules(session, version_id) not in (None, replay.rules):
            if active != verdict.active:
                return None
            entry = store.activate(
                session,
                robot_id,
                version_id,
                ACTIVATE,
                actor,
                forced=wish.force,
                reason=wish.reason,
                objections=[objection.model_dump() for objection in verdict.objections],
            )
            store.add_answer(session, entry, replay)
        return wire.summary(store.get(session, version_id))


def rollback(
    database: Database, robot: str, actor: str, temperature_c: float | None = None, expected: Expected = ANY_STATE
) -> ActivatedVersion:
    """Return to the version that was active before the present one; again, to the one before that. Never refused.

    It returns to the task and rules of that time, too. What was retired since is passed over.

    Raises:
        ServiceError: there is no earlier one, or another version is active than ``expected``.

    """
    with database.transaction() as session:
        robot_id = robots.get(session, robot).id
        expected.check(session, robot_id)
        before = _find_rollback_target(session, robot_id, robot)
        store.repeat(session, store.activate(session, robot_id, before, ROLLBACK, actor), before)
        summary = wire.summary(store.get(session, before))
        compensated = robots.get_compensation(session, robot_id)
    able = ability(database, before, temperature_c)  # after: nothing stands between a person and the way back
    controller = (compensation.objection(robot, compensated), compensation.remark(robot, compensated))
    said = [one.model_dump() for one in (*able.objections, *controller) if one is not None]
    return ActivatedVersion(
        **summary.model_dump(),
        **_left_out(database, before, temperature_c),
        warnings=[*said, *able.remarks],
        preview=able.preview,
    )


def rollback_target(database: Database, robot: str) -> str:
    """Return the version that a roll-back would return to.

    Raises:
        ServiceError: there is no earlier one.

    """
    with database.reading() as session:
        return _find_rollback_target(session, robots.get(session, robot).id, robot)


def _find_rollback_target(session: Session, robot_id: int, robot: str) -> str:
    stack: list[str] = []
    for entry in reversed(store.activations(session, robot_id)):
        if entry.action == ROLLBACK and entry.version_id in stack:
            while stack[-1] != entry.version_id:
                stack.pop()
        elif stack[-1:] != [entry.version_id]:
            stack.append(entry.version_id)
    for version in reversed(stack[:-1]):
        if store.get(session, version).retired_at is None:
            return version
    raise ServiceError(
        f"Robot {robot!r} has no earlier active version: activate one with POST /v1/versions/{{id}}/activate.",
        code="nothing_to_roll_back",
        robot=robot,
    )
