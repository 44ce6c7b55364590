"""Robots, campaigns and versions of a server, as the documents it sends."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kilter_client.requests.calls import campaigns, robots, versions
from kilter_client.requests.methods import documented
from kilter_client.requests.steps import Document, Sent
from kilter_client.resources.references import Kept, Resource
from kilter_files import prepare

if TYPE_CHECKING:
    from kilter_files import Prepared


class Robots(Resource):
    """The robots."""

    add = documented(robots.add)
    check = documented(robots.check)
    convert = documented(robots.convert)
    from_circles = documented(robots.from_circles)
    frame = documented(robots.frame)
    list = documented(robots.list_robots)
    get = documented(robots.one)
    compensation = documented(robots.compensate)
    today = documented(robots.today)
    bridges = documented(robots.bridges)
    announce_bridge = documented(robots.announce_bridge)
    drift = documented(robots.drift)
    drifts = documented(robots.drifts)
    remove = documented(robots.remove)
    note = documented(robots.note)
    stream_session = documented(robots.stream_session)

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

    list = documented(campaigns.list_campaigns)
    commit = documented(campaigns.commit)
    discard = documented(campaigns.discard)
    get = documented(campaigns.one)
    rows = documented(campaigns.rows)
    suspicious = documented(campaigns.suspicious)

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

    list = documented(versions.list_versions)
    get = documented(versions.one)

    def activate(self, version: str, *, force: bool = False, reason: str = "", robot: str | None = None) -> Document:
        """Make a version the one that corrects, unless it predicts worse than the active one.

        ``force`` activates it nevertheless; the log records this and the ``reason``.
        """
        return self._run(versions.activate(version, force, reason, robot))

    activations = documented(versions.activations)
    rollback = documented(versions.rollback)
    diff = documented(versions.diff)
    residuals = documented(versions.residuals)
    export = documented(versions.export)
