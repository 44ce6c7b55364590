"""Replies to questions: signed with the key of the session that asks, over the nonce it sent, else as an announcement.

A question of a session is its id (16 bytes) and a nonce (16 bytes), drawn at random for this question; the selector names the
stream (``?stream=main``). No earlier reply fits a new nonce.
"""

from __future__ import annotations

from kilter_service.stream.signing import sealed
from kilter_service.stream.signing.masters import Masters

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
