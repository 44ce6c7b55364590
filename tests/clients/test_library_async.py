"""The verbs under asyncio, against a real server."""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from kilter_client import AsyncKilter, JobTimeoutError, Kilter, NotFoundError, UsageError, connect_async

Write = Callable[..., Path]


def verbs(kind: type) -> dict[str, Any]:
    """What a client can do, by name, besides opening and closing."""
    found = {name: value for name, value in vars(kind).items() if callable(value) and not name.startswith("_")}
    return {name: value for name, value in found.items() if name not in ("close", "run")}


def test_both_clients_have_the_same_verbs() -> None:
    waiting, awaited = verbs(Kilter), verbs(AsyncKilter)
    assert set(awaited) - set(waiting) == {"robots", "campaigns", "jobs", "versions"}  # there they are objects too
    assert set(waiting) <= set(awaited)
    for name, verb in waiting.items():
        assert inspect.signature(verb) == inspect.signature(awaited[name]), name
        assert verb.__doc__ == awaited[name].__doc__
        assert not inspect.iscoroutinefunction(verb)
        assert inspect.iscoroutinefunction(awaited[name])


def test_two_jobs_at_once(server: Path, robot: str, write_campaign: Write) -> None:
    told: list[str] = []

    async def main() -> tuple[Any, Any]:
        async with connect_async() as k:
            stored = await k.upload(robot, write_campaign(), name="monday")
            first, second = await asyncio.gather(
                k.identify(robot, stored, level=1, name="one", progress=lambda _, __: told.append("one")),
                k.identify(robot, "monday", level=2, name="two", progress=lambda _, __: told.append("two")),
            )
            assert first.version_id != second.version_id
            assert (await k.activate(first)).id == first.version_id
            assert {one.name for one in await k.versions(robot)} == {"one", "two"}
            corrected = await k.correct(robot, {f"q{i}_deg": [1.0, 2.0] for i in range(1, 6)})
            assert corrected.status == {"OK": 2}
            rows = await k.residuals(second)
            assert len(rows) == 40
            with pytest.raises(UsageError, match=r"await k\.residuals"):
                second.residuals()
            return first, second

    first, second = asyncio.run(main())
    assert len(first.parameters) < len(second.parameters)
    # Both were followed while both went on: the second was heard of before the first had its last word.
    assert told.index("two") < len(told) - 1 - told[::-1].index("one")


def test_errors_under_asyncio(server: Path, robot: str, write_campaign: Write) -> None:
    async def main() -> None:
        async with connect_async() as k:
            with pytest.raises(NotFoundError, match=r"k\.jobs\(\)"):
                await k.job("job_0000000000000000")
            stored = await k.upload(robot, write_campaign())
            with pytest.raises(JobTimeoutError) as caught:
                await k.identify(robot, stored, validation={"folds": 20}, level=2, timeout_s=0, progress=False)
            await k.cancel(caught.value.context["job_id"])

    asyncio.run(main())


class EventsCutOff(httpx.AsyncHTTPTransport):
    """The real network, on which an event stream breaks after its first line."""

    async def handle_async_request(self, request: httpx.Request) -> httpx.Response:
        if request.url.path.endswith("/events"):
            return httpx.Response(200, stream=CutOff())
        return await super().handle_async_request(request)


class CutOff(httpx.AsyncByteStream):
    async def __aiter__(self) -> Any:
        yield b'data: {"state": "running", "progress": {"fraction": 0.1, "stage": "cut"}}\n\ndata: {"sta'
        raise httpx.ReadError("cut off")


def test_without_events_a_wait_looks_again(server: Path, robot: str, write_campaign: Write) -> None:
    async def main() -> Any:
        async with AsyncKilter(transport=EventsCutOff()) as k:
            return await k.identify(robot, await k.upload(robot, write_campaign()), level=1, progress=False)

    assert asyncio.run(main()).version_id


def test_a_waiting_task_can_be_cancelled(server: Path, robot: str, write_campaign: Write) -> None:
    async def main() -> Iterator[Any]:
        async with connect_async() as k:
            stored = await k.upload(robot, write_campaign())
            task = asyncio.create_task(k.identify(robot, stored, validation={"folds": 20}, level=2, progress=False))
            while not (known := await k.jobs(robot)):
                await asyncio.sleep(0.01)
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            assert (await k.cancel(known[0].id))["id"] == known[0].id  # the server went on, and the client can ask
        return iter(())

    asyncio.run(main())
