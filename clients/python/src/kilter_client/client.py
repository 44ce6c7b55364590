"""The library's front door."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING

from kilter_client.connection import Connection, Document, address
from kilter_client.jobs import Jobs
from kilter_client.locate import locate
from kilter_client.references import Found, Kind, resolve
from kilter_client.resources import Campaigns, Robots, Versions

if TYPE_CHECKING:
    import httpx

    from kilter_files import Prepared

CORRECT_TIMEOUT_S = 600.0


class Corrected(bytes):
    """A corrected trajectory, as bytes of a file; ``left_out`` are effects of the version that it does not cover."""

    left_out: tuple[str, ...] = ()


class Kilter:
    """A Kilter server: ``robots``, ``campaigns``, ``jobs``, ``versions``, and ``correct`` for trajectories.

    Without arguments it is the server of KILTER_URL, else the one running on this machine.

    Example::

        with Kilter() as kilter:
            kilter.robots.add({"name": "arm", "convention": "preset", "preset": "katana450-chapter4"})
            campaign = kilter.campaigns.add("arm", "first", device="leica-at960")
            kilter.campaigns.upload(campaign["id"], "measured.csv")
            job = kilter.jobs.run("identify", "arm", [campaign["id"]], validation=0.3, options={"level": 1})
            kilter.versions.activate(job["result"]["version_id"])

    """

    def __init__(
        self, url: str | None = None, token: str | None = None, transport: httpx.BaseTransport | None = None
    ) -> None:
        self._connection = Connection(locate(url, token), transport)
        self.robots = Robots(self._connection)
        self.campaigns = Campaigns(self._connection)
        self.jobs = Jobs(self._connection)
        self.versions = Versions(self._connection)

    @property
    def url(self) -> str:
        """The server's address."""
        return self._connection.url

    def health(self) -> Document:
        """Return whether the server is ready, and what it looked at."""
        return self._connection.get("/v1/health")

    def resolve(self, kind: Kind, reference: str, robot: str | None = None) -> Found:
        """Return what stands behind the beginning of an id, a name or ``latest`` of a campaign, version or job.

        Raises:
            NotFoundError: nothing. ConflictError: more than one thing. The sentences list what there is.

        """
        return resolve(self._connection, kind, reference, robot)

    def tombstones(self, robot: str | None = None) -> list[Document]:
        """Return what was purged, newest first: its hash, who purged it, and when."""
        return list(self._connection.get("/v1/tombstones", **({"robot": robot} if robot else {}))["tombstones"])

    def correct(
        self, robot: str, trajectory: Prepared, *, version: str | None = None, form: str | None = None
    ) -> Corrected:
        """Correct a trajectory with the active version (or ``version``: an id or its beginning, a name, ``latest``).

        The answer has the format that was sent; ``form`` "ros2-yaml" asks for a ROS 2 JointTrajectory instead. Its
        ``left_out`` names effects of the version that a correction does not cover.
        """
        version = version and self.versions.id_of(version, robot)
        response = self._connection.request(
            "POST",
            address("robots", robot, "correct"),
            content=trajectory.content,
            headers={"Content-Type": trajectory.content_type, "Accept": "*/*" if form else trajectory.content_type},
            params={name: value for name, value in (("version", version), ("format", form)) if value},
            timeout=CORRECT_TIMEOUT_S,
        )
        corrected = Corrected(response.content)
        corrected.left_out = tuple(filter(None, response.headers.get("Kilter-Not-Corrected", "").split(", ")))
        return corrected

    def close(self) -> None:
        """Close the connections."""
        self._connection.close()

    def __enter__(self) -> Kilter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
