"""Robots, campaigns and versions of a server."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kilter_client.connection import Connection, Document, address
from kilter_client.references import Kept, id_of

if TYPE_CHECKING:
    from kilter_files import Prepared

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

    def list(self, retired: bool = False) -> list[Document]:
        """Return the robots, by name; with ``retired`` also those that are out of use."""
        return list(self._connection.get("/v1/robots", **_also(retired))["robots"])

    def get(self, name: str) -> Document:
        """Return a robot with its joints, parameters and document."""
        return self._connection.get(address("robots", name))

    def remove(self, name: str) -> None:
        """Delete a robot nothing was measured on."""
        self._connection.request("DELETE", address("robots", name))

    def note(self, name: str, remarks: str) -> Document:
        """Keep a note with a robot, in the place of the one before."""
        return self._connection.patch(address("robots", name), {"remarks": remarks})

    def retire(self, name: str) -> Document:
        """Take a robot out of use; the version that is active goes on correcting."""
        return self._connection.post(address("robots", name, "retire"))

    def restore(self, name: str) -> Document:
        """Bring a robot back into use."""
        return self._connection.post(address("robots", name, "restore"))

    def purge(self, name: str) -> Document:
        """Delete a robot without campaigns and versions; returns what is left: its hash, who and when."""
        return self._connection.post(address("robots", name, "purge"))


class Campaigns(Kept):
    """The measurement campaigns. An id may be its beginning, a name, or ``latest`` with its robot."""

    kind = "campaign"

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
        numbered: bool = False,
    ) -> Document:
        """Add a campaign to a robot; a ``staged`` one is seen and used by nobody before ``commit``.

        A name that another campaign of the robot has is refused; ``numbered`` puts a number behind it instead.
        """
        body: Document = {
            "name": name,
            "device": device,
            "role": role,
            "conditions": dict(conditions or {}),
            "notes": notes,
        }
        body |= {key: True for key, wanted in (("staged", staged), ("numbered", numbered)) if wanted}
        return self._connection.post(address("robots", robot, "campaigns"), body)

    def list(self, robot: str, staged: bool = False, retired: bool = False) -> list[Document]:
        """Return the campaigns of a robot, oldest first; ``staged`` are those whose parts are not all there.

        With ``retired`` also those that are out of use.
        """
        asked = ({"staged": "true"} if staged else {}) | _also(retired)
        return list(self._connection.get(address("robots", robot, "campaigns"), **asked)["campaigns"])

    def commit(self, campaign_id: str, sha256: Sequence[str]) -> Document:
        """Make a staged campaign visible, if it holds exactly the parts of these content hashes."""
        return self._connection.post(address("campaigns", campaign_id, "commit"), {"sha256": [*sha256]})

    def discard(self, campaign_id: str) -> None:
        """Delete a staged campaign with all that was sent to it."""
        self._connection.request("DELETE", address("campaigns", campaign_id))

    def get(self, campaign: str, robot: str | None = None) -> Document:
        """Return a campaign and its uploads."""
        return self._connection.get(self._address(campaign, robot))

    def upload(
        self, campaign: str, data: Prepared | Path | str, sent: Sent | None = None, robot: str | None = None
    ) -> Document:
        """Send observations: a prepared file, or the path of one with contract columns. The same bytes change nothing.

        ``sent`` is told the bytes sent and their total.
        """
        from kilter_files import prepare

        file = prepare(data) if isinstance(data, str | Path) else data
        headers = {"Content-Type": file.content_type, "Content-Length": str(len(file.content))}
        response = self._connection.request(
            "POST",
            self._address(campaign, robot, "observations"),
            content=lambda: _pieces(file.content, sent),
            headers=headers,
            timeout=UPLOAD_TIMEOUT_S,
        )
        return self._connection.document(response)


class Versions(Kept):
    """The parameter versions. An id may be its beginning, a name, or ``latest`` with its robot."""

    kind = "version"

    def list(self, robot: str, retired: bool = False) -> list[Document]:
        """Return the versions of a robot, newest first; with ``retired`` also those that are out of use."""
        return list(self._connection.get(address("robots", robot, "versions"), **_also(retired))["versions"])

    def get(self, version: str, robot: str | None = None) -> Document:
        """Return a version: parent, job, campaigns, effects, parameters, covariance."""
        return self._connection.get(self._address(version, robot))

    def activate(self, version: str, *, force: bool = False, reason: str = "", robot: str | None = None) -> Document:
        """Make a version the one that corrects, unless it predicts worse than the active one.

        ``force`` activates it all the same; the log keeps that and the ``reason``.
        """
        wish = {"force": force, "reason": reason}
        return self._connection.post(self._address(version, robot, "activate"), wish)

    def activations(self, robot: str) -> Sequence[Document]:
        """Return who activated which version of a robot, when and why, newest first."""
        return list(self._connection.get(address("robots", robot, "activations"))["activations"])

    def rollback(self, robot: str) -> Document:
        """Return to the version that was active before."""
        return self._connection.post(address("robots", robot, "rollback"))

    def diff(self, first: str, second: str, robot: str | None = None) -> Document:
        """Compare two versions."""
        return self._connection.get(self._address(first, robot, "diff", self.id_of(second, robot)))

    def residuals(
        self, version: str, campaigns: Sequence[str] = (), form: str = "csv", robot: str | None = None
    ) -> bytes:
        """Return what a version leaves of every row as a file, csv or parquet: of these campaigns, or of all its own."""
        path = self._address(version, robot, "residuals")
        used = [id_of(self._connection, "campaign", campaign, robot) for campaign in campaigns]
        asked = {"format": form, "campaign": used}
        return self._connection.request("GET", path, params=asked, timeout=UPLOAD_TIMEOUT_S).content

    def export(self, version: str, form: str = "json", robot: str | None = None) -> bytes:
        """Return a version as a file: json, urdf, dh-csv, ..."""
        path = self._address(version, robot, "export")
        return self._connection.request("GET", path, params={"format": form}).content


def _also(retired: bool) -> dict[str, str]:
    return {"retired": "true"} if retired else {}


def _pieces(content: bytes, sent: Sent | None) -> Iterator[bytes]:
    for start in range(0, len(content), PIECE):
        piece = content[start : start + PIECE]
        yield piece
        if sent is not None:
            sent(start + len(piece), len(content))
