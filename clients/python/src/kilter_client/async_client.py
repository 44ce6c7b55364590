"""The library under asyncio: the verbs of ``Kilter``, awaited."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING, TypeVar

from kilter_client.requests.calls import access, fleet, references, server
from kilter_client.requests.connection import AsyncConnection
from kilter_client.requests.methods import awaited
from kilter_client.requests.server_address import locate
from kilter_client.requests.steps import Steps
from kilter_client.verbs import campaigns as measured
from kilter_client.verbs import drifts, keeping, programs
from kilter_client.verbs import dry_run as dry_runs
from kilter_client.verbs import instruments as gauges
from kilter_client.verbs import jobs as computed
from kilter_client.verbs import meshes as shapes
from kilter_client.verbs import robots as described
from kilter_client.verbs import versions as made
from kilter_client.verbs.error_wording import reworded

if TYPE_CHECKING:
    import httpx

T = TypeVar("T")


class AsyncKilter:
    """A Kilter server under asyncio; the verbs are those of ``Kilter``, with the same arguments and results.

    Example::

        async with kilter.connect_async() as k:
            jobs = [k.identify("ur5e", "a.csv", level=level) for level in (1, 2)]
            first, second = await asyncio.gather(*jobs)

    """

    def __init__(
        self, url: str | None = None, token: str | None = None, transport: httpx.AsyncBaseTransport | None = None
    ) -> None:
        self._connection = AsyncConnection(locate(url, token), transport, reworded)

    @property
    def url(self) -> str:
        """The server's address."""
        return self._connection.url

    async def run(self, call: Steps[T]) -> T:
        """Do what a call asks for."""
        return await self._connection.run(call)

    add_robot = awaited(described.add_robot)
    check_robot = awaited(described.check_robot)
    convert_robot = awaited(described.convert_robot)
    find_robot = awaited(described.find_robot)
    find_frame = awaited(described.find_frame)
    robot = awaited(described.robot)
    set_controller_compensation = awaited(described.set_controller_compensation)
    accept = awaited(described.accept)
    today = awaited(described.today)
    bridges = awaited(described.bridges)
    drift_history = awaited(described.drift_history)
    drift_list = awaited(described.drift_list)
    add_repair = awaited(described.add_repair)
    remove_repair = awaited(described.remove_repair)
    robots = awaited(described.robots)
    meshes = awaited(shapes.meshes)
    set_mesh = awaited(shapes.set_mesh)
    set_urdf_meshes = awaited(shapes.set_urdf_meshes)
    remove_mesh = awaited(shapes.remove_mesh)
    add_instrument = awaited(gauges.add_instrument)
    instruments = awaited(gauges.instruments)
    upload = awaited(measured.upload)
    dry_run = awaited(dry_runs.dry_run)
    campaign = awaited(measured.campaign)
    suspicious = awaited(measured.suspicious)
    campaigns = awaited(measured.campaigns)
    identify = awaited(computed.identify)
    gap = awaited(computed.gap)
    evaluate = awaited(computed.evaluate)
    plan = awaited(computed.plan)
    joint_parameters = awaited(computed.joint_parameters)
    drift = awaited(drifts.drift)
    rezero = awaited(drifts.rezero)
    check = awaited(computed.check)
    submit = awaited(computed.submit)
    job = awaited(computed.job)
    wait = awaited(computed.wait)
    cancel = awaited(computed.cancel)
    jobs = awaited(computed.jobs)
    identify_fleet = awaited(fleet.identify_fleet)
    fleet_jobs = awaited(fleet.fleet_jobs)
    fleet_job = awaited(fleet.fleet_job)
    wait_for_fleet = awaited(fleet.wait_for_fleet)
    cancel_fleet = awaited(fleet.cancel_fleet)
    version = awaited(made.version)
    activate = awaited(made.activate)
    rollback = awaited(made.rollback)
    activations = awaited(made.activations)
    preview = awaited(made.preview)
    diff = awaited(made.diff)
    residuals = awaited(made.residuals)
    export = awaited(made.export)
    correct = awaited(made.correct)
    filter = awaited(programs.filter)
    versions = awaited(made.versions)
    change = awaited(keeping.change)
    retire = awaited(keeping.retire)
    restore = awaited(keeping.restore)
    purge = awaited(keeping.purge)
    resolve = awaited(references.resolve)
    health = awaited(server.health)
    tombstones = awaited(server.tombstones)
    whoami = awaited(access.whoami)
    login_link = awaited(access.login_link)
    add_token = awaited(access.add_token)
    tokens = awaited(access.tokens)
    revoke_token = awaited(access.revoke_token)
    audit = awaited(access.audit)
    verify_audit = awaited(access.verify_audit)

    async def close(self) -> None:
        """Close the connections."""
        await self._connection.close()

    async def __aenter__(self) -> AsyncKilter:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    def __repr__(self) -> str:
        return f"AsyncKilter({self.url!r})"


def connect_async(url: str | None = None, token: str | None = None) -> AsyncKilter:
    """Connect as ``connect`` does, for use under asyncio.

    Raises:
        ServerUnreachableError: nothing says where the server is.

    """
    return AsyncKilter(url, token)
