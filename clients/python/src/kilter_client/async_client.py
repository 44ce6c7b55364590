"""The library under asyncio: the verbs of ``Kilter``, awaited."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING, TypeVar

from kilter_client.requests.calls import jobs as fleet
from kilter_client.requests.calls import references
from kilter_client.requests.connection import AsyncConnection, locate, make_async_method
from kilter_client.requests.steps import Steps
from kilter_client.verbs import campaigns as measured
from kilter_client.verbs import jobs as computed
from kilter_client.verbs import programs
from kilter_client.verbs import robots as described
from kilter_client.verbs import versions as made
from kilter_client.verbs.progress import rephrase_error

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
        self._connection = AsyncConnection(locate(url, token), transport, rephrase_error)

    @property
    def url(self) -> str:
        """The server's address."""
        return self._connection.url

    async def run(self, call: Steps[T]) -> T:
        """Do what a call asks for."""
        return await self._connection.run(call)

    add_robot = make_async_method(described.add_robot)
    check_robot = make_async_method(described.check_robot)
    convert_robot = make_async_method(described.convert_robot)
    find_robot = make_async_method(described.find_robot)
    find_frame = make_async_method(described.find_frame)
    robot = make_async_method(described.robot)
    set_controller_compensation = make_async_method(described.set_controller_compensation)
    set_tolerance = make_async_method(described.set_tolerance)
    accept = make_async_method(described.accept)
    today = make_async_method(described.today)
    bridges = make_async_method(described.bridges)
    drift_history = make_async_method(described.drift_history)
    drift_list = make_async_method(described.drift_list)
    add_repair = make_async_method(described.add_repair)
    remove_repair = make_async_method(described.remove_repair)
    robots = make_async_method(described.robots)
    meshes = make_async_method(described.meshes)
    set_mesh = make_async_method(described.set_mesh)
    set_urdf_meshes = make_async_method(described.set_urdf_meshes)
    remove_mesh = make_async_method(described.remove_mesh)
    add_instrument = make_async_method(measured.add_instrument)
    instruments = make_async_method(measured.instruments)
    upload = make_async_method(measured.upload)
    dry_run = make_async_method(measured.dry_run)
    campaign = make_async_method(measured.campaign)
    suspicious = make_async_method(measured.suspicious)
    campaigns = make_async_method(measured.campaigns)
    identify = make_async_method(computed.identify)
    gap = make_async_method(computed.gap)
    evaluate = make_async_method(computed.evaluate)
    plan = make_async_method(computed.plan)
    joint_parameters = make_async_method(computed.joint_parameters)
    drift = make_async_method(made.drift)
    rezero = make_async_method(made.rezero)
    check = make_async_method(computed.check)
    submit = make_async_method(computed.submit)
    job = make_async_method(computed.job)
    wait = make_async_method(computed.wait)
    cancel = make_async_method(computed.cancel)
    jobs = make_async_method(computed.jobs)
    identify_fleet = make_async_method(fleet.identify_fleet)
    fleet_jobs = make_async_method(fleet.fleet_jobs)
    fleet_job = make_async_method(fleet.fleet_job)
    wait_for_fleet = make_async_method(fleet.wait_for_fleet)
    cancel_fleet = make_async_method(fleet.cancel_fleet)
    version = make_async_method(made.version)
    activate = make_async_method(made.activate)
    rollback = make_async_method(made.rollback)
    activations = make_async_method(made.activations)
    preview = make_async_method(made.preview)
    diff = make_async_method(made.diff)
    residuals = make_async_method(made.residuals)
    export = make_async_method(made.export)
    correct = make_async_method(made.correct)
    torques = make_async_method(made.torques)
    filter = make_async_method(programs.filter)
    versions = make_async_method(made.versions)
    change = make_async_method(made.change)
    retire = make_async_method(made.retire)
    restore = make_async_method(made.restore)
    purge = make_async_method(made.purge)
    resolve = make_async_method(references.resolve)
    health = make_async_method(references.health)
    tombstones = make_async_method(references.tombstones)
    whoami = make_async_method(references.whoami)
    login_link = make_async_method(references.login_link)
    add_token = make_async_method(references.add_token)
    tokens = make_async_method(references.tokens)
    revoke_token = make_async_method(references.revoke_token)
    audit = make_async_method(references.audit)
    verify_audit = make_async_method(references.verify_audit)

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


for _kind, _verb in computed.make_missing_verbs(AsyncKilter).items():
    setattr(AsyncKilter, _kind, make_async_method(_verb))


def connect_async(url: str | None = None, token: str | None = None) -> AsyncKilter:
    """Connect as ``connect`` does, for use under asyncio.

    Raises:
        ServerUnreachableError: nothing says where the server is.

    """
    return AsyncKilter(url, token)
