"""Robots, campaigns and versions of a server, as the documents it sends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kilter_client.requests.calls import campaigns, robots, versions
from kilter_client.requests.connection import Connection
from kilter_client.requests.steps import Document, Sent
from kilter_client.resources.references import Kept
from kilter_files import prepare

if TYPE_CHECKING:
    from kilter_client.requests.exported import Exported
    from kilter_files import Prepared


class Robots:
    """The robots."""

    def __init__(self, connection: Connection) -> None:
        self._run = connection.run

    def add(self, document: Mapping[str, Any]) -> Document:
        """Add a robot (the contract's ``robot.json``); the same document twice changes nothing."""
        return self._run(robots.add(document))

    def check(self, document: Mapping[str, Any]) -> Document:
        """Return what a document comes to, without adding it: axes, the arm at zero, reach, what looks wrong."""
        return self._run(robots.check(document))

    def convert(self, document: Mapping[str, Any], to: str) -> Document:
        """Return the same arm as a document of convention ``to`` (chain, dh, mdh, s_model, poe, cpc, mcpc, urdf)."""
        return self._run(robots.convert(document, to))

    def from_circles(
        self, rows: Prepared, name: str, convention: str = "chain", base: str = "axis", follows: Sequence[str] = ()
    ) -> Document:
        """Find a robot from rows in which one joint moved at a time: its document as ``robot``, and its ``axes``.

        ``follows`` are pairs "j3=j2" of joints that are read against the horizontal.
        """
        return self._run(robots.from_circles(rows, name, convention, base, follows))

    def frame(self, points: Mapping[str, Any]) -> Document:
        """Find a frame from digitised ``points`` or ``features``: its ``pose``, and how far each point is off."""
        return self._run(robots.frame(points))

    def list(self, retired: bool = False) -> list[Document]:
        """Return the robots, by name; with ``retired`` also those that are out of use."""
        return self._run(robots.list_robots(retired))

    def get(self, name: str) -> Document:
        """Return a robot with its joints, parameters and document."""
        return self._run(robots.one(name))

    def compensation(self, name: str, compensation: str) -> Document:
        """Say whether the controller of a robot corrects by itself: none, factory, kilter or unknown."""
        return self._run(robots.compensate(name, compensation))

    def today(self, name: str) -> Document:
        """Return how good a robot is today, and what is missing in its active version."""
        return self._run(robots.today(name))

    def bridges(self, name: str) -> Document:
        """Return the bridges of a robot: those that run first."""
        return self._run(robots.bridges(name))

    def announce_bridge(self, name: str, run: str, news: Mapping[str, Any]) -> Document:
        """Say to the server what the bridge of this ``run`` does; it is shown, and controls nothing."""
        return self._run(robots.announce_bridge(name, run, news))

    def drift(self, name: str) -> Document:
        """Return the checks of a robot and how it stands by them."""
        return self._run(robots.drift(name))

    def drifts(self) -> Document:
        """Return how all robots stand by their checks, the worst first."""
        return self._run(robots.drifts())

    def remove(self, name: str) -> None:
        """Delete a robot nothing was measured on."""
        self._run(robots.remove(name))

    def note(self, name: str, remarks: str) -> Document:
        """Add a note to a robot, replacing the previous one."""
        return self._run(robots.note(name, remarks))

    def stream_session(
        self, name: str, stream: str = "main", lifetime_h: float = 24.0, take_over: bool = False
    ) -> Document:
        """Return id and keys of a new session of a stream; whoever has them can send setpoints on it.

        A stream that somebody else holds is refused, unless it is taken over: that ends the other's session.
        """
        return self._run(robots.stream_session(name, stream, lifetime_h, take_over))

    def retire(self, name: str) -> Document:
        """Take a robot out of use; the active version keeps correcting."""
        return self._run(robots.do(name, "retire"))

    def restore(self, name: str) -> Document:
        """Bring a robot back into use."""
        return self._run(robots.do(name, "restore"))

    def purge(self, name: str) -> Document:
        """Delete a robot without campaigns and versions; returns what is left: its hash, who and when."""
        return self._run(robots.do(name, "purge"))


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
        measured_at: str | None = None,
        instrument: str | None = None,
    ) -> Document:
        """Add a campaign to a robot; a ``staged`` one is seen and used by nobody before ``commit``.

        A name that another campaign of the robot has is refused; ``numbered`` puts a number behind it instead.
        """
        wanted = {
            "name": name,
            "device": device,
            "role": role,
            "conditions": dict(conditions or {}),
            "notes": notes,
            "staged": staged,
            "numbered": numbered,
            "measured_at": measured_at,
            "instrument": instrument,
        }
        return self._run(campaigns.add(robot, wanted))

    def check(self, robot: str, rows: Prepared) -> Document:
        """Check rows as an upload to a new campaign would; nothing is stored.

        Raises:
            ObservationError: what the upload would be refused with.

        """
        return self._run(campaigns.check(robot, rows))

    def list(self, robot: str, staged: bool = False, retired: bool = False) -> list[Document]:
        """Return the campaigns of a robot, oldest first; ``staged`` are those whose parts are not all there.

        With ``retired`` also those that are out of use.
        """
        return self._run(campaigns.list_campaigns(robot, staged, retired))

    def commit(self, campaign_id: str, sha256: Sequence[str]) -> Document:
        """Make a staged campaign visible, if it holds exactly the parts of these content hashes."""
        return self._run(campaigns.commit(campaign_id, sha256))

    def discard(self, campaign_id: str) -> None:
        """Delete a staged campaign with all that was sent to it."""
        self._run(campaigns.discard(campaign_id))

    def get(self, campaign: str, robot: str | None = None) -> Document:
        """Return a campaign and its uploads."""
        return self._run(campaigns.one(campaign, robot))

    def rows(self, campaign: str, form: str = "csv", robot: str | None = None) -> bytes:
        """Return the rows of a campaign as a file (csv, parquet, json), with the columns of their upload."""
        return self._run(campaigns.rows(campaign, form, robot))

    def suspicious(self, campaign: str, robot: str | None = None) -> Document:
        """Return the rows of a campaign that look wrong, and who says so."""
        return self._run(campaigns.suspicious(campaign, robot))

    def upload(
        self, campaign: str, data: Prepared | Path | str, sent: Sent | None = None, robot: str | None = None
    ) -> Document:
        """Send observations: a prepared file, or the path of one with contract columns. The same bytes change nothing.

        ``sent`` is told the bytes sent and their total.
        """
        file = prepare(data) if isinstance(data, str | Path) else data
        return self._run(campaigns.upload(campaign, file, sent, robot))


class Versions(Kept):
    """The parameter versions. An id may be its beginning, a name, or ``latest`` with its robot."""

    kind = "version"

    def list(self, robot: str, retired: bool = False) -> list[Document]:
        """Return the versions of a robot, newest first; with ``retired`` also those that are out of use."""
        return self._run(versions.list_versions(robot, retired))

    def get(self, version: str, robot: str | None = None) -> Document:
        """Return a version: parent, job, campaigns, effects, parameters, covariance."""
        return self._run(versions.one(version, robot))

    def activate(self, version: str, *, force: bool = False, reason: str = "", robot: str | None = None) -> Document:
        """Make a version the one that corrects, unless it predicts worse than the active one.

        ``force`` activates it nevertheless; the log records this and the ``reason``.
        """
        return self._run(versions.activate(version, force, reason, robot))

    def activations(self, robot: str) -> Sequence[Document]:
        """Return who activated which version of a robot, when and why, newest first."""
        return self._run(versions.activations(robot))

    def rollback(self, robot: str) -> Document:
        """Return to the version that was active before."""
        return self._run(versions.rollback(robot))

    def diff(self, first: str, second: str, robot: str | None = None) -> Document:
        """Compare two versions; ``nominal`` stands for the nominal robot."""
        return self._run(versions.diff(first, second, robot))

    def residuals(
        self, version: str, campaigns: Sequence[str] = (), form: str = "csv", robot: str | None = None
    ) -> bytes:
        """Return what a version leaves of every row as a file, csv or parquet: of these campaigns, or of all its own."""
        return self._run(versions.residuals(version, campaigns, form, robot))

    def export(self, version: str, form: str = "json", robot: str | None = None) -> Exported:
        """Return a version as a file: json, urdf, dh-csv, ...; its ``notes`` say what it leaves out."""
        return self._run(versions.export(version, form, robot))
