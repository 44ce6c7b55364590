"""New sessions of signed streams."""

from __future__ import annotations

from datetime import UTC, datetime

from kilter_service.contract.streams import NewStreamSession, StreamSession
from kilter_service.corrector.specs import Rules
from kilter_service.db import Database
from kilter_service.robots import service as robots
from kilter_service.settings import Settings
from kilter_service.signing import sealed
from kilter_service.signing.masters import masters_in
from kilter_service.signing.sealed import Session

MAX_JOINTS, MAX_POINTS = 16, 4096


def new_session(database: Database, settings: Settings, robot: str, wanted: NewStreamSession) -> StreamSession:
    """Id and keys of a session, derived from the master secret in use.

    Raises:
        ServiceError: there is no such robot.

    """
    robots.get(database, robot)
    masters = masters_in(settings.stream_keys_file)
    session = masters.new_session(wanted.lifetime_h * 3600.0)
    secret = masters.all[-1].secret
    return StreamSession(
        site=settings.site,
        robot=robot,
        stream=wanted.stream,
        session=session.hex(),
        key=sealed.session_key(secret, session, settings.site, robot, wanted.stream).hex(),
        announcement_key=sealed.robot_key(secret, settings.site, robot).hex(),
        expires_at=datetime.fromtimestamp(Session(*sealed.ID.unpack(session)).expires_s, UTC),
        max_age_ms=Rules().max_age_ns / 1e6,
        max_joints=MAX_JOINTS,
        max_points=MAX_POINTS,
    )
