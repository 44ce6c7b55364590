"""Calls about campaigns."""

from __future__ import annotations

import binascii
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from kilter_client.requests.calls.kept import place
from kilter_client.requests.steps import (
    Document,
    Request,
    Sent,
    Steps,
    address,
    answer_of,
    get,
    idempotency_header,
    post,
    read,
)

if TYPE_CHECKING:
    from kilter_files import Prepared

UPLOAD_TIMEOUT_S = 600.0


def add(robot: str, wanted: Mapping[str, Any]) -> Steps[Document]:
    """Add a campaign to a robot; what is false or not stated is not sent, so that an earlier server takes it."""
    body = {
        key: value
        for key, value in wanted.items()
        if value or key not in ("staged", "numbered", "measured_at", "instrument")
    }
    return post(address("robots", robot, "campaigns"), body, idempotency_header())


def list_campaigns(robot: str, staged: bool = False, retired: bool = False) -> Steps[list[Document]]:
    """Return the campaigns of a robot, oldest first; ``staged`` are those whose parts are not all there.

    With ``retired`` also those that are out of use.
    """
    found = yield from get(address("robots", robot, "campaigns"), staged=staged or None, retired=retired or None)
    return list(found["campaigns"])


def commit(campaign_id: str, sha256: Sequence[str]) -> Steps[Document]:
    """Make a staged campaign visible, if it holds exactly the parts of these content hashes."""
    return post(address("campaigns", campaign_id, "commit"), {"sha256": [*sha256]}, again=True)


def discard(campaign_id: str) -> Steps[None]:
    """Delete a staged campaign with all that was sent to it."""
    yield from answer_of(Request("DELETE", address("campaigns", campaign_id)))


def one(campaign: str, robot: str | None = None) -> Steps[Document]:
    """Return a campaign and its uploads."""
    path = yield from place("campaign", campaign, robot)
    return (yield from get(path))


def suspicious(campaign: str, robot: str | None = None) -> Steps[Document]:
    """Return the rows of a campaign that look wrong, and who says so."""
    path = yield from place("campaign", campaign, robot, "suspicious")
    return (yield from get(path))


def rows(campaign: str, form: str = "csv", robot: str | None = None) -> Steps[bytes]:
    """Return the rows of a campaign as a file (csv, parquet, json), with the columns of their upload."""
    path = yield from place("campaign", campaign, robot, "observations")
    answer = yield from answer_of(Request("GET", path, params={"format": form}))
    return answer.content


def upload(campaign: str, file: Prepared, sent: Sent | None = None, robot: str | None = None) -> Steps[Document]:
    """Send observations."""
    path = yield from place("campaign", campaign, robot, "observations")
    request = Request(
        "POST",
        path,
        content=file.content,
        headers={"Content-Type": file.content_type, "Content-Digest": _digest(file)} | idempotency_header(),
        timeout_s=UPLOAD_TIMEOUT_S,
        sent=sent,
    )
    return (yield from read(request))


def check(robot: str, file: Prepared) -> Steps[Document]:
    """Check observations as an upload would; nothing is stored."""
    path = address("robots", robot, "observations", "check")
    headers = {"Content-Type": file.content_type, "Content-Digest": _digest(file)}
    return (yield from read(Request("POST", path, content=file.content, headers=headers, timeout_s=UPLOAD_TIMEOUT_S)))


def _digest(file: Prepared) -> str:
    """The hash of what is sent (RFC 9530): the server refuses bytes that changed on their way."""
    return f"sha-256=:{binascii.b2a_base64(bytes.fromhex(file.sha256), newline=False).decode()}:"
