"""How many requests may hold memory at once: more wait, and too many are refused."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, ParamSpec, TypeVar

from fastapi import Request
from fastapi.concurrency import run_in_threadpool

from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings
from kilter_service.web.auth.policy import Rule

P = ParamSpec("P")
T = TypeVar("T")


class ConcurrencyLimit:
    """Requests of one kind: at most ``most`` inside, of which ``working`` compute and the others wait."""

    def __init__(self, most: int, working: int) -> None:
        self.most, self.inside = most, 0
        self.turn = asyncio.Semaphore(working)

    @contextmanager
    def entered(self) -> Iterator[None]:
        """Take a place.

        Raises:
            ServiceError: it is full.

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
    """The limits of one application. Documents have their own, so that a job can be queued while files are read."""

    def __init__(self, settings: Settings) -> None:
        self.documents = ConcurrencyLimit(settings.max_requests, settings.max_computing)
        self.checks = ConcurrencyLimit(settings.max_requests, settings.max_computing)  # documents that only compute
        # Reads that compute are open to everybody on loopback: they must not take the others' slots.
        self.reads = ConcurrencyLimit(settings.max_requests, settings.max_computing)
        self.files = ConcurrencyLimit(settings.max_requests, settings.max_computing)  # those that wait are on disk


def slots_of(request: Request) -> Slots:
    """Return the slots of the application that serves this request."""
    slots: Slots = request.app.state.slots
    return slots


async def compute(request: Request, work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """Work on a received file in a thread, once a slot is free."""
    return await in_turn(request, slots_of(request).files, partial(run_in_threadpool, work, *args, **kwargs))


async def in_turn(request: Request, limit: ConcurrencyLimit, work: Callable[[], Awaitable[T]]) -> T:
    """Do something once a slot is free; where the time of the route is limited, for so long.

    A thread cannot be stopped: work that is not waited for any more keeps its slot until it ends, so there are never more
    such threads than slots.

    Raises:
        ServiceError: it took too long, or others did.

    """
    rule: Rule = request.state.rule
    if not rule.instead:
        async with limit.turn:
            return await work()
    limit_s: float = request.app.state.settings.compute_limit_s
    await _slot(limit, limit_s)
    task = asyncio.create_task(_released(limit, work))
    done, _ = await asyncio.wait({task}, timeout=limit_s)
    if not done:
        task.add_done_callback(_forgotten)
        raise ServiceError(
            f"It computes for longer than the {limit_s:g} s that an answer may take here (KILTER_COMPUTE_LIMIT_S on the "
            f"server). {rule.instead}",
            code="compute_limit",
            limit_s=limit_s,
        )
    return task.result()


async def _slot(limit: ConcurrencyLimit, limit_s: float) -> None:
    try:
        async with asyncio.timeout(limit_s):
            await limit.turn.acquire()
    except TimeoutError:
        raise ServiceError(
            f"For {limit_s:g} s other requests have been computing: send it again in a while.", code="busy"
        ) from None


async def _released(limit: ConcurrencyLimit, work: Callable[[], Awaitable[T]]) -> T:
    try:
        return await work()
    finally:
        limit.turn.release()


def _forgotten(task: asyncio.Task[Any]) -> None:
    """Take the error of work whose answer nobody waits for, so that the event loop does not report it."""
    if not task.cancelled():
        task.exception()
