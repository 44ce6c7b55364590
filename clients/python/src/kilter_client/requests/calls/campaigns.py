"""Calls about campaigns."""

from __future__ import annotations

import binascii
import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from kilter_client.requests.calls.references import place, resolve_id
from kilter_client.requests.steps import (
    Document,
    Request,
    Sent,
    Steps,
    address,
    get,
    idempotency_header,
    post,
    read,
    send_with_retries,
)

if TYPE_CHECKING:
    from kilter_files import Prepared


UPLOAD_TIMEOUT_S = 600.0


def add(robot: str, wanted: Mapping[str, Any]) -> Steps[Document]:
    """Add a campaign to a robot."""
    return post(address("robots", robot, "campaigns"), _drop_unstated_fields(wanted), idempotency_header())


def _drop_unstated_fields(wanted: Mapping[str, Any]) -> Document:
    """A campaign as it is sent: without what is false or not stated, so that an earlier server takes it."""
    return {
        key: value
        for key, value in wanted.items()
        if value or key not in ("staged", "numbered", "measured_at", "instrument")
    }


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
    yield from send_with_retries(Request("DELETE", address("campaigns", campaign_id)))


def fetch_document(campaign: str, robot: str | None = None) -> Steps[Document]:
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
    answer = yield from send_with_retries(Request("GET", path, params={"format": form}))
    return answer.content


def upload(campaign: str, file: Prepared, sent: Sent | None = None, robot: str | None = None) -> Steps[Document]:
    """Send observations."""
    found = yield from resolve_id("campaign", campaign, robot)
    return (yield from send(found, file, sent))


def send(campaign_id: str, file: Prepared, sent: Sent | None = None) -> Steps[Document]:
    """Send observations to a campaign of this id."""
    request = Request(
        "POST",
        address("campaigns", campaign_id, "observations"),
        content=file.content,
        headers={"Content-Type": file.content_type, "Content-Digest": _digest(file.sha256)} | idempotency_header(),
        timeout_s=UPLOAD_TIMEOUT_S,
        sent=sent,
    )
    return (yield from read(request))


def check(
    robot: str, rows: Prepared, wanted: Mapping[str, Any] | None = None, into: str | None = None
) -> Steps[Document]:
    """Check observations as an upload to the campaign ``wanted``, or to the one with the id ``into``; nothing is stored.

    Raises:
        ObservationError: what the upload would be refused with.

    """
    path = address("robots", robot, "observations", "check")
    content, headers = rows.content, {"Content-Type": rows.content_type, "Content-Digest": _digest(rows.sha256)}
    if wanted is not None:
        content, kind = _form(_drop_unstated_fields(wanted), rows)
        headers = {"Content-Type": kind, "Content-Digest": _digest(hashlib.sha256(content).hexdigest())}
    params = {} if into is None else {"campaign": into}
    asked = Request("POST", path, params=params, content=content, headers=headers, timeout_s=UPLOAD_TIMEOUT_S)
    return (yield from read(asked))


def _form(campaign: Document, file: Prepared) -> tuple[bytes, str]:
    """A campaign and its rows as one body (RFC 7578), and its media type."""
    mark = os.urandom(16).hex()
    part = f"--{mark}\r\nContent-Disposition: form-data; name="
    head = f'{part}"campaign"\r\nContent-Type: application/json\r\n\r\n{json.dumps(campaign)}\r\n'
    head += f'{part}"rows"; filename="rows"\r\nContent-Type: {file.content_type}\r\n\r\n'
    return head.encode() + file.content + f"\r\n--{mark}--\r\n".encode(), f"multipart/form-data; boundary={mark}"


def _digest(sha256: str) -> str:
    """The hash of what is sent (RFC 9530): the server refuses bytes that changed on their way."""
    return f"sha-256=:{binascii.b2a_base64(bytes.fromhex(sha256), newline=False).decode()}:"


def add_instrument(instrument: Mapping[str, Any]) -> Steps[Document]:
    """Add an instrument."""
    return post("/v1/instruments", {key: value for key, value in instrument.items() if value is not None})


def list_instruments() -> Steps[list[Document]]:
    """Return the instruments, by name."""
    found = yield from get("/v1/instruments")
    return list(found["instruments"])
