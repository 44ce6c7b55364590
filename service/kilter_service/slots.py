"""How many requests may hold memory at once: more wait, and too many are refused."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager
from typing import ParamSpec, TypeVar

from fastapi import Request
from fastapi.concurrency import run_in_threadpool

from kilter_service.errors import ServiceError
from kilter_service.settings import Settings

P = ParamSpec("P")
T = TypeVar("T")


class Room:
    """Requests of one kind: at most ``most`` inside, of which ``working`` compute and the others wait."""

    def __init__(self, most: int, working: int) -> None:
        self.most, self.inside = most, 0
        self.turn = asyncio.Semaphore(working)

    @contextmanager
    def entered(self) -> Iterator[None]:
        """Take a place.

        Raises:
            ServiceError: the room is full.

        """
        if self.inside >= self.most:
            raise ServiceError(
                f"{self.inside} such requests are being answered already: send it again in a second.",
                code="busy",
                requests=self.inside,
            )
        self.inside += 1
        try:
            yield
        finally:
            self.inside -= 1


class Slots:
    """The rooms of one application. Documents have their own, so that a job can be queued while files are read."""

    def __init__(self, settings: Settings) -> None:
        self.documents = Room(settings.max_requests, settings.max_computing)
        # Reads that compute are open to everybody on loopback: they must not take the others' slots.
        self.reads = Room(settings.max_requests, settings.max_computing)
        self.files = Room(settings.max_requests, settings.max_computing)  # those that wait are on disk


def slots_of(request: Request) -> Slots:
    """Return the slots of the application that serves this request."""
    slots: Slots = request.app.state.slots
    return slots


async def compute(request: Request, work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """Work on a received file in a thread, once a slot is free."""
    async with slots_of(request).files.turn:
        return await run_in_threadpool(work, *args, **kwargs)


async def reading_turn(request: Request) -> AsyncIterator[None]:
    """Let a read that computes (an export, a comparison) wait for a slot; a dependency of its route."""
    room = slots_of(request).reads
    with room.entered():
        async with room.turn:
            yield
