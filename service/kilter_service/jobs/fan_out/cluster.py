"""A Dask cluster as the engine: its scheduler gives the parts of a job to workers on other machines."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from typing import TYPE_CHECKING

from kilter_core.errors import CoreError
from kilter_service.ground.errors import ServiceError
from kilter_service.jobs.fan_out.spread import Opened

if TYPE_CHECKING:
    from distributed import Client

CONNECT_S = 10.0
AWAY_S = 5.0  # how long the connection may be gone before the job fails
CLOSE_S = 2.0
ASK_S, ANSWER_S = 2.0, 1.0  # between two questions for workers, and for an answer: a cancel must not wait longer


class DaskCluster:
    """The cluster whose scheduler listens at ``address``; every part goes there, and none is computed here.

    Raises:
        ServiceError: the package is missing.

    """

    tries_first = False

    def __init__(self, address: str) -> None:
        if find_spec("distributed") is None:
            raise ServiceError(
                f"KILTER_DASK names {address}, and a package is missing: pip install distributed, in the release that "
                "constraints.txt names, or unset KILTER_DASK.",
                code="cluster_away",
                address=address,
            )
        self._address = address

    def pays(self, parts: int, each_s: float) -> bool:
        """Return True: whoever names a cluster wants it to compute."""
        return True

    @contextmanager
    def open_executor(self, parts: int) -> Iterator[Opened]:
        """Connect to the scheduler for these parts alone, so that one that was restarted is found again by the next."""
        from distributed import KilledWorker
        from distributed.comm.core import CommClosedError

        client = self._connect_client()
        executor = client.get_executor(pure=False)  # or it would take the time to see which parts are equal
        try:
            yield Opened(executor, check=_Watch(client, self._unreachable_error))
        except (CancelledError, CommClosedError) as error:  # the scheduler has forgotten the parts
            raise self._unreachable_error() from error
        except RuntimeError as error:
            if not isinstance(error.__cause__, ImportError):
                raise
            raise CoreError(
                f"The scheduler of the cluster at {self._address} cannot read a part of the job: {error.__cause__}. Install "
                "the same Kilter for the scheduler as for its workers, and ask for the job again.",
                code="cluster_differs",
                address=self._address,
            ) from error
        except KilledWorker as error:
            raise CoreError(
                f"Workers of the cluster at {self._address} that computed a part of the job ended, one after the other: "
                f"their memory may be full. Give them more, and see their logs. ({error})",
                code="part_ended",
                address=self._address,
            ) from error
        finally:
            with suppress(Exception):  # a scheduler that is gone has nothing left to cancel
                executor.shutdown(wait=False)
            with suppress(Exception):
                client.close(timeout=CLOSE_S)

    def _connect_client(self) -> Client:
        from distributed import Client

        try:
            return Client(self._address, timeout=CONNECT_S, set_as_default=False, name="kilter")
        except (OSError, ValueError) as error:  # also a timeout
            raise self._unreachable_error() from error

    def _unreachable_error(self) -> CoreError:
        return ServiceError(
            f"The Dask scheduler at {self._address} does not answer. Start it, or correct KILTER_DASK, and ask for the job "
            "again; without KILTER_DASK the worker computes in processes of its own.",
            code="cluster_away",
            address=self._address,
        )


class _Watch:
    """Whether the scheduler is there, and somebody who computes."""

    def __init__(self, client: Client, away: Callable[[], CoreError]) -> None:
        self._client, self._away = client, away
        self._gone_at: float | None = None
        self._ask_at, self._state = 0.0, ""

    def __call__(self) -> str:
        now = time.monotonic()
        if self._client.status != "running":
            self._gone_at = self._gone_at or now
            if now - self._gone_at > AWAY_S:
                raise self._away()
            return "the scheduler is away"
        self._gone_at = None
        if now > self._ask_at:
            self._state = self._query_cluster_state()
            self._ask_at = time.monotonic() + ASK_S
        return self._state

    def _query_cluster_state(self) -> str:
        scheduler = self._client.scheduler
        assert scheduler is not None  # while it is connected
        try:
            known = self._client.sync(scheduler.identity, n_workers=1, callback_timeout=ANSWER_S)
        except (OSError, TimeoutError):
            return "the scheduler does not answer"
        return "" if known["workers"] else "the cluster has no workers yet"
