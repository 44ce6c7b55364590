"""How many requests may hold memory and compute at once: each kind of work has a room, so none holds up another."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import Any, ParamSpec, TypeVar

from fastapi import Request
from fastapi.concurrency import run_in_threadpool

from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings
from kilter_service.web.auth.policy import Kind, Rule

P = ParamSpec("P")
T = TypeVar("T")


class Room:
    """Requests of one kind: ``places`` are open at once, ``slots`` of them compute, the others wait for ``wait_s`` (None: on).

    ``places_each`` and ``slots_each`` are those that one person may take; None: all.
    """

    def __init__(
        self,
        slots: int,
        places: int,
        slots_each: int | None = None,
        places_each: int | None = None,
        wait_s: float | None = None,
    ) -> None:
        self.slots, self.places, self.wait_s = slots, places, wait_s
        self.slots_each, self.places_each = slots_each or slots, places_each or places
        self.open, self.computing = Counter[str](), Counter[str]()  # requests by person
        self._freed = asyncio.Condition()

    @property
    def is_full(self) -> bool:
        """Whether all slots are taken."""
        return self.computing.total() >= self.slots

    @contextmanager
    def entered(self, person: str) -> Iterator[None]:
        """Take a place.

        Raises:
            ServiceError: all are taken, or all that this person may take.

        """
        if self.open[person] >= self.places_each < self.places:
            raise ServiceError(
                f"{self.open[person]} such requests of yours are open, more are not taken: send it again when one has ended.",
                code="too_many_open",
                retry_after_s=1,
            )
        if self.open.total() >= self.places:
            raise ServiceError(
                f"{self.places} such requests are being answered already: send it again in a second.", code="busy"
            )
        self.open[person] += 1
        try:
            yield
        finally:
            self.open -= Counter([person])

    async def take_slot(self, person: str, wait_s: float | None) -> None:
        """Wait for a slot.

        Raises:
            ServiceError: none became free in time.

        """
        try:
            async with asyncio.timeout(wait_s), self._freed:
                await self._freed.wait_for(lambda: not self.is_full and self.computing[person] < self.slots_each)
                self.computing[person] += 1
        except TimeoutError:
            raise ServiceError(
                f"For {wait_s:g} s other requests of this kind have been computing: send it again in a while.",
                code="busy",
            ) from None

    async def release_slot(self, person: str) -> None:
        """Give a slot back."""
        self.computing -= Counter([person])
        async with self._freed:
            self._freed.notify_all()


def rooms_with(settings: Settings) -> Mapping[Kind, Room]:
    """Return the room of each kind of work."""
    slots, places = settings.max_computing, settings.max_requests
    shared = max(1, slots // 2), max(1, places // 2)  # half of it stays free for the others' arms
    return {
        "corrections": Room(slots, places, *shared),
        "stops": Room(2 * slots, places, slots, shared[1]),  # who activates may roll back meanwhile
        "drops": Room(slots, places, slots_each=1, places_each=4, wait_s=10.0),
        "files": Room(slots, places),  # those that wait are on disk
        "checks": Room(slots, places),  # documents that only compute
        "documents": Room(slots, places),
        "reads": Room(slots, places),  # open to everybody on loopback
    }


def room_of(request: Request, kind: Kind) -> Room:
    """Return the room that a request of this kind computes in, and keep it for `in_turn`."""
    request.state.room = request.app.state.rooms[kind]
    request.state.has_slot = False
    return request.state.room  # type: ignore[no-any-return]


async def compute(request: Request, work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """Work on what was received in a thread, once a slot is free."""
    return await in_turn(request, partial(run_in_threadpool, work, *args, **kwargs))


async def in_turn(request: Request, work: Callable[[], Awaitable[T]]) -> T:
    """Do something once the request has a slot of its room; where the time of the route is limited, for so long.

    A thread cannot be stopped: work that is not waited for any more keeps its slot until it ends, so there are never more
    such threads than slots.

    Raises:
        ServiceError: it took too long, or others did.

    """
    if request.state.has_slot:
        return await work()
    rule: Rule = request.state.rule
    room: Room = request.state.room
    person: str = request.state.caller.sender
    limit_s: float | None = request.app.state.settings.compute_limit_s if rule.instead else None
    await room.take_slot(person, limit_s or room.wait_s)
    request.state.has_slot = True
    if limit_s is None:
        return await _run_and_release(room, person, work)
    task = asyncio.create_task(_run_and_release(room, person, work))
    done, _ = await asyncio.wait({task}, timeout=limit_s)
    if not done:
        task.add_done_callback(_forget)
        raise ServiceError(
            f"It computes for longer than the {limit_s:g} s that an answer may take here (KILTER_COMPUTE_LIMIT_S on the "
            f"server). {rule.instead}",
            code="compute_limit",
            limit_s=limit_s,
        )
    return task.result()


async def _run_and_release(room: Room, person: str, work: Callable[[], Awaitable[T]]) -> T:
    try:
        return await work()
    finally:
        await room.release_slot(person)


def _forget(task: asyncio.Task[Any]) -> None:
    """Take the error of work whose answer nobody waits for, so that the event loop does not report it."""
    if not task.cancelled():
        task.exception()
