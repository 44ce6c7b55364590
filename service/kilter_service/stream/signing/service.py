"""New sessions of signed streams.

Replies to questions: signed with the key of the session that asks, over the nonce it sent, else as an announcement.

A question of a session is its id (16 bytes) and a nonce (16 bytes), drawn at random for this question; the selector names the
stream (``?stream=main``). No earlier reply fits a new nonce.
"""

from __future__ import annotations

from datetime import UTC, datetime

from kilter_service.contract.streams import MAX_AGE_NS, NewStreamSession, StreamSession
from kilter_service.contract.wording import Remark
from kilter_service.ground.caller import CALLER
from kilter_service.ground.db import Database, audited
from kilter_service.ground.db import Session as Opened
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings
from kilter_service.robots import compensation
from kilter_service.robots import store as robots
from kilter_service.stream import store
from kilter_service.stream.signing import sealed
from kilter_service.stream.signing.masters import Masters, load_masters, update_masters_file
from kilter_service.stream.signing.sealed import Session
from kilter_service.stream.store import Holder
from kilter_service.web import store as tokens

MAX_JOINTS, MAX_POINTS = 16, 4096


def new_session(database: Database, settings: Settings, robot: str, wanted: NewStreamSession) -> StreamSession:
    """Id and keys of a session, derived from the master secret in use.

    It ends with the token that asked for it, and the audit says who did. A stream that somebody else holds is taken over
    only when that is asked for; then the sessions of the others end.

    Raises:
        ServiceError: there is no such robot, its controller corrects already, the token has ended, or somebody else holds
            the stream.

    """
    masters = load_masters(settings.stream_keys_file)
    with database.transaction() as opened:
        compensated = robots.get(opened, robot).controller_compensation
        compensation.refuse(robot, compensated)
        # Asked again here: changes follow one another, so a token that is revoked meanwhile has its sessions ended too.
        lifetime_s = min(wanted.lifetime_h * 3600.0, tokens.left_s(opened))
        session = masters.new_session(lifetime_s)
        others = _sessions_of_others(opened, masters, robot, wanted.stream)
        if others and not wanted.take_over:
            raise _stream_held_error(robot, wanted.stream, others[-1])
        expires_at = datetime.fromtimestamp(Session(*sealed.ID.unpack(session)).expires_s, UTC)
        said = {"session": session.hex(), "robot": robot, "stream": wanted.stream, "until": expires_at.isoformat()}
        before = [{"session": other.session.hex(), "of": other.actor} for other in others] or None
        audited.note(opened, store.THING, before, said)
        if others:
            _revoke_sessions(settings, [other.session for other in others])  # at last, for it cannot be taken back
    secret, unknown = masters.all[-1].secret, compensation.remark(robot, compensated)
    return StreamSession(
        site=settings.site,
        robot=robot,
        stream=wanted.stream,
        session=session.hex(),
        key=sealed.session_key(secret, session, settings.site, robot, wanted.stream).hex(),
        announcement_key=sealed.robot_key(secret, settings.site, robot).hex(),
        expires_at=expires_at,
        max_age_ms=MAX_AGE_NS / 1e6,
        max_joints=MAX_JOINTS,
        max_points=MAX_POINTS,
        warnings=[] if unknown is None else [Remark(**unknown.model_dump())],
    )


def end_sessions(database: Database, settings: Settings, token_id: str) -> None:
    """End all sessions that a token has asked for; the corrector sees it within half a second.

    Raises:
        ServiceError: the secrets cannot be written here.

    """
    with database.reading() as session:
        found = store.sessions_of_token(session, token_id)
    if found:
        _revoke_sessions(settings, found)


def _sessions_of_others(opened: Opened, masters: Masters, robot: str, stream: str) -> list[Holder]:
    """Sessions of a stream that are valid and that another login asked for; a controller renews its own."""
    caller = CALLER.get()
    me = (caller.actor, caller.token_id) if caller is not None else None
    return [
        held
        for held in store.holders(opened, robot, stream)
        if (held.actor, held.token_id) != me
        and held.session not in masters.revoked
        and masters.find(Session(*sealed.ID.unpack(held.session)).master) is not None
    ]


def _stream_held_error(robot: str, stream: str, by: Holder) -> ServiceError:
    until = datetime.fromtimestamp(Session(*sealed.ID.unpack(by.session)).expires_s, UTC)
    return ServiceError(
        f"Stream {stream!r} of robot {robot!r} is held by {by.actor!r} since {by.since:%Y-%m-%d %H:%M} UTC, until "
        f"{until:%Y-%m-%d %H:%M} UTC at the latest: use another name for this stream, or take it over with take_over=true "
        "(`kilter server stream-session --take-over`), which ends that session within a second.",
        code="stream_held",
        holder=by.actor,
        since=by.since.isoformat(),
        until=until.isoformat(),
    )


def _revoke_sessions(settings: Settings, found: list[bytes]) -> None:
    try:
        update_masters_file(settings.stream_keys_file, lambda now: now.with_sessions_revoked(found))
    except OSError as error:
        raise ServiceError(
            f"The {len(found)} sessions of streams are not ended, for {settings.stream_keys_file} cannot be written "
            f"({error.strerror}); a token that was to be revoked is. Where the corrector runs, give {_revoking(found)}.",
            code="sessions_not_ended",
            sessions=[one.hex() for one in found],
        ) from error


def _revoking(sessions: list[bytes]) -> str:
    return "`kilterd stream-keys " + " ".join(f"--revoke {one.hex()}" for one in sessions) + "`"


HEAD = sealed.SESSION_BYTES + sealed.NONCE_BYTES


def reply(
    masters: Masters, question: bytes, address: str, site: str, robot: str, stream: str | None, document: bytes
) -> bytes:
    """A document, signed for whoever asked."""
    session, nonce = question[: sealed.SESSION_BYTES], question[sealed.SESSION_BYTES :]
    key = masters.session_key(session, site, robot, stream) if stream and len(question) == HEAD else None
    if key is None:
        return masters.sign_announcement(address, site, robot, document)
    return sealed.signed_document(document, sealed.reply_tag(key, nonce, address, document).hex())
