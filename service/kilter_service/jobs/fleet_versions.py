"""Versions of other robots of a type: one of each, and none that a prior of the type had a part in."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING

from kilter_service.ground.core import core_identify
from kilter_service.ground.db import Session
from kilter_service.robots import store as robots
from kilter_service.versions import store as versions
from kilter_service.versions.records import VersionRecord

if TYPE_CHECKING:
    pass


def fleet_versions(
    session: Session, robot_id: int, allowed: Collection[str] | None
) -> tuple[core_identify.FleetVersion, ...]:
    """Return a version of every other robot in use with the same nominal chain: the active one, else the newest.

    Of robots only those ``allowed`` to whoever asked, None: all. Versions that were identified with a prior of the type, or
    continue one that was, are passed over: a fleet must not learn from itself.
    """
    robot, found = robots.core_robot(session, robot_id), []
    for other in robots.others_in_use(session, robot_id):
        if other.chain is None or (allowed is not None and other.name not in allowed):
            continue
        if not core_identify.same_type(robot, other.robot()):
            continue
        made = _of_robot(session, other.id)
        if made is not None:
            calibration, covariance = versions.calibration(session, made.id), versions.covariance(session, made.id)
            found.append(core_identify.FleetVersion.from_calibration(other.name, made.id, calibration, covariance))
    return tuple(found)


def _of_robot(session: Session, robot_id: int) -> VersionRecord | None:
    """Return the active version of a robot, else its newest that says what it knows and asked no fleet."""
    known = {one.id: one for one in versions.of_robot(session, robot_id, with_retired=True)}
    made = [
        one
        for one in known.values()
        if one.retired_at is None and one.covariance.get("names") and not _asked_fleet(one, known)
    ]
    return next((one for one in made if one.active), made[0] if made else None)


def _asked_fleet(version: VersionRecord, known: Mapping[str, VersionRecord]) -> bool:
    """Whether a prior of the type had a part in a version, or in one that it continues."""
    following: VersionRecord | None = version
    while following is not None:
        if (following.report.get("prior") or {}).get("source"):
            return True
        following = known.get(following.parent_id or "")
    return False
