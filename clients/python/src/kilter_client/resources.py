"""Robots, campaigns and versions of a server."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kilter_client.connection import Connection, Document, address

if TYPE_CHECKING:
    from kilter_client.files import Prepared

Sent = Callable[[int, int], None]

PIECE = 1 << 18
UPLOAD_TIMEOUT_S = 600.0


class Robots:
    """The robots."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def add(self, document: Mapping[str, Any]) -> Document:
        """Add a robot (the contract's ``robot.json``); the same document twice changes nothing."""
        return self._connection.post("/v1/robots", document)

    def check(self, document: Mapping[str, Any]) -> Document:
        """Return what a document comes to, without adding it: axes, the arm at zero, reach, what looks wrong."""
        return self._connection.post("/v1/robots/check", document)

    def convert(self, document: Mapping[str, Any], to: str) -> Document:
        """Return the same arm as a document of convention ``to`` (chain, dh, mdh, s_model, poe, cpc, mcpc, urdf)."""
        return self._connection.post(f"/v1/robots/convert?to={to}", document)

    def from_circles(
        self, rows: Prepared, name: str, convention: str = "chain", base: str = "axis", follows: Sequence[str] = ()
    ) -> Document:
        """Find a robot from rows in which one joint moved at a time: its document as ``robot``, and its ``axes``.

        ``follows`` are pairs "j3=j2" of joints that are read against the horizontal.
        """
        response = self._connection.request(
            "POST",
            f"{address('robots', 'from-circles')}",
            content=rows.content,
            headers={"Content-Type": rows.content_type},
            params={"name": name, "to": convention, "base": base, "follows": [*follows]},
        )
        return self._connection.document(response)

    def frame(self, points: Mapping[str, Any]) -> Document:
        """Find a frame from digitised ``points`` or ``features``: its ``pose``, and how far each point is off."""
        return self._connection.post("/v1/frames", points)

    def list(self) -> list[Document]:
        """Return the robots, by name."""
        return list(self._connection.get("/v1/robots")["robots"])

    def get(self, name: str) -> Document:
        """Return a robot with its joints, parameters and document."""
        return self._connection.get(address("robots", name))

    def remove(self, name: str) -> None:
        """Delete a robot nothing was measured on."""
        self._connection.request("DELETE", address("robots", name))


class Campaigns:
    """The measurement campaigns."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def add(
        self,
        robot: str,
        name: str,
        *,
        device: str = "",
        role: str = "train",
        conditions: Mapping[str, Any] | None = None,
        notes: str = "",
        staged: bool = False,
    ) -> Document:
        """Add a campaign to a robot; a ``staged`` one is seen and used by nobody before ``commit``."""
        body: Document = {
            "name": name,
            "device": device,
            "role": role,
            "conditions": dict(conditions or {}),
            "notes": notes,
        }
        if staged:
            body["staged"] = True
        return self._connection.post(address("robots", robot, "campaigns"), body)

    def list(self, robot: str, staged: bool = False) -> list[Document]:
        """Return the campaigns of a robot, oldest first; ``staged`` are those whose parts are not all there."""
        asked = {"staged": "true"} if staged else {}
        return list(self._connection.get(address("robots", robot, "campaigns"), **asked)["campaigns"])

    def commit(self, campaign_id: str, sha256: Sequence[str]) -> Document:
        """Make a staged campaign visible, if it holds exactly the parts of these content hashes."""
        return self._connection.post(address("campaigns", campaign_id, "commit"), {"sha256": [*sha256]})

    def discard(self, campaign_id: str) -> None:
        """Delete a staged campaign with all that was sent to it."""
        self._connection.request("DELETE", address("campaigns", campaign_id))

    def get(self, campaign_id: str) -> Document:
        """Return a campaign and its uploads."""
        return self._connection.get(address("campaigns", campaign_id))

    def upload(self, campaign_id: str, data: Prepared | Path | str, sent: Sent | None = None) -> Document:
        """Send observations: a prepared file, or the path of one with contract columns. The same bytes change nothing.

        ``sent`` is told the bytes sent and their total.
        """
        from kilter_client.files import prepare

        file = prepare(data) if isinstance(data, str | Path) else data
        headers = {"Content-Type": file.content_type, "Content-Length": str(len(file.content))}
        response = self._connection.request(
            "POST",
            address("campaigns", campaign_id, "observations"),
            content=lambda: _pieces(file.content, sent),
            headers=headers,
            timeout=UPLOAD_TIMEOUT_S,
        )
        return self._connection.document(response)


class Versions:
    """The parameter versions."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def list(self, robot: str) -> list[Document]:
        """Return the versions of a robot."""
        return list(self._connection.get(address("robots", robot, "versions"))["versions"])

    def get(self, version_id: str) -> Document:
        """Return a version: parent, job, campaigns, effects, parameters, covariance."""
        return self._connection.get(address("versions", version_id))

    def activate(self, version_id: str, *, force: bool = False, reason: str = "") -> Document:
        """Make a version the one that corrects, unless it predicts worse than the active one.

        ``force`` activates it all the same; the log keeps that and the ``reason``.
        """
        wish = {"force": force, "reason": reason}
        return self._connection.post(address("versions", version_id, "activate"), wish)

    def activations(self, robot: str) -> Sequence[Document]:
        """Return who activated which version of a robot, when and why, newest first."""
        return list(self._connection.get(address("robots", robot, "activations"))["activations"])

    def rollback(self, robot: str) -> Document:
        """Return to the version that was active before."""
        return self._connection.post(address("robots", robot, "rollback"))

    def diff(self, first: str, second: str) -> Document:
        """Compare two versions."""
        return self._connection.get(address("versions", first, "diff", second))

    def residuals(self, version_id: str, campaigns: Sequence[str] = (), form: str = "csv") -> bytes:
        """Return what a version leaves of every row as a file, csv or parquet: of these campaigns, or of all its own."""
        path = address("versions", version_id, "residuals")
        asked = {"format": form, "campaign": [*campaigns]}
        return self._connection.request("GET", path, params=asked, timeout=UPLOAD_TIMEOUT_S).content

    def export(self, version_id: str, form: str = "json") -> bytes:
        """Return a version as a file: json, urdf, dh-csv, ..."""
        return self._connection.request(
            "GET", address("versions", version_id, "export"), params={"format": form}
        ).content


def _pieces(content: bytes, sent: Sent | None) -> Iterator[bytes]:
    for start in range(0, len(content), PIECE):
        piece = content[start : start + PIECE]
        yield piece
        if sent is not None:
            sent(start + len(piece), len(content))
