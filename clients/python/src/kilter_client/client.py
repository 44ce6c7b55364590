"""The entry point of the library."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING, Any, TypeVar

from kilter_client.requests.calls import jobs as fleet
from kilter_client.requests.calls import references
from kilter_client.requests.connection import Connection, Reword, locate, waiting
from kilter_client.requests.steps import Steps
from kilter_client.resources import Campaigns, Jobs, Robots, Versions
from kilter_client.verbs import campaigns, jobs, programs, robots, versions
from kilter_client.verbs.progress import rephrase_error

if TYPE_CHECKING:
    import httpx

    from kilter_client.results.record import Records
    from kilter_client.typed.campaigns import Campaign
    from kilter_client.typed.robots import RobotSummary
    from kilter_client.typed.server import JobSummary
    from kilter_client.typed.versions import VersionSummary

T = TypeVar("T")


class Kilter:
    """A Kilter server. Verbs give typed results; ``robots``, ``campaigns``, ``jobs`` and ``versions`` plain documents.

    Without arguments it is the server of KILTER_URL, else the one running on this machine. ``connect`` makes one.

    Example::

        with kilter.connect() as k:
            k.add_robot(preset="ur5e")
            k.upload("ur5e", "a.csv")
            v = k.identify("ur5e", "a.csv", validation=0.3)
            k.activate(v)
            k.correct("ur5e", "path.csv").save("corrected.csv")

    """

    def __init__(
        self,
        url: str | None = None,
        token: str | None = None,
        transport: httpx.BaseTransport | None = None,
        reword: Reword | None = None,
    ) -> None:
        self._connection = Connection(locate(url, token), transport, reword)
        self.robots = _Robots(self._connection)
        self.campaigns = _Campaigns(self._connection)
        self.jobs = _Jobs(self._connection)
        self.versions = _Versions(self._connection)

    @property
    def url(self) -> str:
        """The server's address."""
        return self._connection.url

    def run(self, call: Steps[T]) -> T:
        """Do what a call asks for; a result that it returns can ask for more by itself."""
        return bound(self._connection.run(call), self._connection)

    add_robot = waiting(robots.add_robot)
    check_robot = waiting(robots.check_robot)
    convert_robot = waiting(robots.convert_robot)
    find_robot = waiting(robots.find_robot)
    find_frame = waiting(robots.find_frame)
    robot = waiting(robots.robot)
    set_controller_compensation = waiting(robots.set_controller_compensation)
    set_tolerance = waiting(robots.set_tolerance)
    accept = waiting(robots.accept)
    today = waiting(robots.today)
    bridges = waiting(robots.bridges)
    drift_history = waiting(robots.drift_history)
    drift_list = waiting(robots.drift_list)
    add_repair = waiting(robots.add_repair)
    remove_repair = waiting(robots.remove_repair)
    meshes = waiting(robots.meshes)
    set_mesh = waiting(robots.set_mesh)
    set_urdf_meshes = waiting(robots.set_urdf_meshes)
    remove_mesh = waiting(robots.remove_mesh)
    add_instrument = waiting(campaigns.add_instrument)
    instruments = waiting(campaigns.instruments)
    upload = waiting(campaigns.upload)
    dry_run = waiting(campaigns.dry_run)
    campaign = waiting(campaigns.campaign)
    suspicious = waiting(campaigns.suspicious)
    identify = waiting(jobs.identify)
    gap = waiting(jobs.gap)
    evaluate = waiting(jobs.evaluate)
    plan = waiting(jobs.plan)
    joint_parameters = waiting(jobs.joint_parameters)
    drift = waiting(versions.drift)
    rezero = waiting(versions.rezero)
    check = waiting(jobs.check)
    submit = waiting(jobs.submit)
    job = waiting(jobs.job)
    wait = waiting(jobs.wait)
    cancel = waiting(jobs.cancel)
    identify_fleet = waiting(fleet.identify_fleet)
    fleet_jobs = waiting(fleet.fleet_jobs)
    fleet_job = waiting(fleet.fleet_job)
    wait_for_fleet = waiting(fleet.wait_for_fleet)
    cancel_fleet = waiting(fleet.cancel_fleet)
    version = waiting(versions.version)
    activate = waiting(versions.activate)
    rollback = waiting(versions.rollback)
    activations = waiting(versions.activations)
    preview = waiting(versions.preview)
    diff = waiting(versions.diff)
    residuals = waiting(versions.residuals)
    export = waiting(versions.export)
    correct = waiting(versions.correct)
    torques = waiting(versions.torques)
    filter = waiting(programs.filter)
    change = waiting(versions.change)
    retire = waiting(versions.retire)
    restore = waiting(versions.restore)
    purge = waiting(versions.purge)
    resolve = waiting(references.resolve)
    health = waiting(references.health)
    tombstones = waiting(references.tombstones)
    whoami = waiting(references.whoami)
    login_link = waiting(references.login_link)
    add_token = waiting(references.add_token)
    tokens = waiting(references.tokens)
    revoke_token = waiting(references.revoke_token)
    audit = waiting(references.audit)
    verify_audit = waiting(references.verify_audit)

    def close(self) -> None:
        """Close the connections."""
        self._connection.close()

    def __enter__(self) -> Kilter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Kilter({self.url!r})"


for _kind, _verb in jobs.make_missing_verbs(Kilter).items():
    setattr(Kilter, _kind, waiting(_verb))


def bound(found: T, connection: Connection) -> T:
    """Let a typed result ask over this connection."""
    bind: Any = getattr(found, "bound", None)
    return found if bind is None else bind(connection.run)


class _Robots(Robots):
    def __call__(self, *, retired: bool = False) -> Records[RobotSummary]:
        """Return the robots by name; with ``retired`` also those that are out of use."""
        return self._run(robots.robots(retired=retired))


class _Campaigns(Campaigns):
    def __call__(self, robot: Any, *, retired: bool = False) -> Records[Campaign]:
        """Return the campaigns of a robot, oldest first; with ``retired`` also those that are out of use."""
        return self._run(campaigns.campaigns(robot, retired=retired))


class _Jobs(Jobs):
    def __call__(self, robot: Any = None, *, limit: int = 100) -> Records[JobSummary]:
        """Return the newest jobs, of one robot or of all."""
        return self._run(jobs.jobs(robot, limit=limit))


class _Versions(Versions):
    def __call__(self, robot: Any, *, retired: bool = False) -> Records[VersionSummary]:
        """Return the versions of a robot, newest first; with ``retired`` also those that are out of use."""
        return self._run(versions.versions(robot, retired=retired))


def connect(url: str | None = None, token: str | None = None) -> Kilter:
    """Connect to a server: the one at ``url``, else of KILTER_URL, else the one running on this machine.

    Errors name verbs and their arguments; those of ``Kilter(...)`` are in the server's own words.

    Raises:
        ServerUnreachableError: nothing says where the server is.

    """
    return Kilter(url, token, reword=rephrase_error)
