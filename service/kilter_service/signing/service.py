"""New sessions of signed streams."""

from __future__ import annotations

from datetime import UTC, datetime

from kilter_service.contract.streams import NewStreamSession, StreamSession
from kilter_service.corrector.specs import Rules
from kilter_service.db import Database, audited
from kilter_service.errors import ServiceError
from kilter_service.robots import store as robots
from kilter_service.settings import Settings
from kilter_service.signing import sealed, store
from kilter_service.signing.masters import changed, masters_in
from kilter_service.signing.sealed import Session
from kilter_service.tokens import store as tokens

MAX_JOINTS, MAX_POINTS = 16, 4096


def new_session(database: Database, settings: Settings, robot: str, wanted: NewStreamSession) -> StreamSession:
    """Id and keys of a session, derived from the master secret in use.

    It ends with the token that asked for it, and the audit says who did.

    Raises:
        ServiceError: there is no such robot, or the token has ended.

    """
    masters = masters_in(settings.stream_keys_file)
    with database.transaction() as opened:
        robots.get(opened, robot)
        # Asked again here: changes follow one another, so a token that is revoked meanwhile has its sessions ended too.
        lifetime_s = min(wanted.lifetime_h * 3600.0, tokens.left_s(opened))
        session = masters.new_session(lifetime_s)
        expires_at = datetime.fromtimestamp(Session(*sealed.ID.unpack(session)).expires_s, UTC)
        said = {"session": session.hex(), "robot": robot, "stream": wanted.stream, "until": expires_at.isoformat()}
        audited.note(opened, store.THING, None, said)
    secret = masters.all[-1].secret
    return StreamSession(
        site=settings.site,
        robot=robot,
        stream=wanted.stream,
        session=session.hex(),
        key=sealed.session_key(secret, session, settings.site, robot, wanted.stream).hex(),
        announcement_key=sealed.robot_key(secret, settings.site, robot).hex(),
        expires_at=expires_at,
        max_age_ms=Rules().max_age_ns / 1e6,
        max_joints=MAX_JOINTS,
        max_points=MAX_POINTS,
    )


def end_sessions(database: Database, settings: Settings, token_id: str) -> None:
    """End all sessions that a token has asked for; the corrector sees it within half a second.

    Raises:
        ServiceError: the secrets cannot be written here.

    """
    with database.reading() as session:
        found = store.sessions_of(session, token_id)
    if not found:
        return
    try:
        changed(settings.stream_keys_file, lambda now: now.without(found))
    except OSError as error:
        raise ServiceError(
            f"The token is revoked, but its {len(found)} sessions of streams are not: {settings.stream_keys_file} cannot be "
            f"written ({error.strerror}). Where the corrector runs, give {_revoking(found)}.",
            code="sessions_not_ended",
            sessions=[one.hex() for one in found],
        ) from error


def _revoking(sessions: list[bytes]) -> str:
    return "`kilterd stream-keys " + " ".join(f"--revoke {one.hex()}" for one in sessions) + "`"
