"""How calls are run: what goes over the wire, what a silent server does to a wait, where a server is found again."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest

from kilter_client import AsyncKilter, Kilter, PayloadError, ServerUnreachableError
from kilter_client.requests.calls import jobs as waiting
from kilter_client.requests.calls.jobs import AWAY
from kilter_client.requests.steps import Pause, Relocate, Request, send_with_retries
from kilter_client.verbs.progress import in_words

JOB = "job_" + "0" * 16
Answer = Callable[[httpx.Request], httpx.Response]


def client(answer: Answer) -> Kilter:
    return Kilter("http://kilter.test", "secret", httpx.MockTransport(answer))


def async_client(answer: Answer) -> AsyncKilter:
    return AsyncKilter("http://kilter.test", "secret", httpx.MockTransport(answer))


def test_a_load_goes_with_the_trajectory_and_notes_come_back() -> None:
    asked: list[httpx.URL] = []

    def answer(request: httpx.Request) -> httpx.Response:
        asked.append(request.url)
        headers = {"Kilter-Notes": "one | two", "Kilter-Not-Corrected": "drift, settling", "Content-Type": "text/csv"}
        return httpx.Response(200, headers=headers, content=b"q1_deg,status\n1,OK\n")

    with client(answer) as k:
        done = k.correct("arm", {"q1_deg": [1.0]}, payload_kg=0.5, payload_com_mm=(1, 2.5, 0))
        k.correct("arm", {"q1_deg": [1.0]}, payload_kg=0.0)
    assert (done.notes, done.left_out) == (("one", "two"), ("drift", "settling"))
    assert dict(asked[0].params) == {"payload_kg": "0.5", "payload_com_mm": "1.0,2.5,0.0"}
    assert dict(asked[1].params) == {"payload_kg": "0.0"}


def nobody(request: httpx.Request) -> httpx.Response:
    raise httpx.ConnectError("nobody")


def test_patience_has_an_end_that_says_how_to_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(waiting, "PATIENCE_S", 0.2)
    stages: list[str] = []
    with (
        client(nobody) as k,
        pytest.raises(ServerUnreachableError, match=f"`kilter server jobs watch {JOB}` follows it"),
    ):
        k.jobs.wait(JOB, lambda _, stage: stages.append(stage))
    assert set(stages) == {AWAY}
    assert in_words(f"`kilter server jobs watch {JOB}` follows it.") == f'`k.wait("{JOB}")` follows it.'


@pytest.mark.parametrize("status", [500, 502, 503])
def test_a_server_that_starts_is_asked_again(status: int) -> None:
    left = [httpx.Response(status, json={"code": "not_ready", "detail": "Later."})] * 3

    def answer(request: httpx.Request) -> httpx.Response:
        done = {"id": JOB, "kind": "plan", "state": "succeeded", "result": {"count": 3}}
        return left.pop() if left else httpx.Response(200, json=done)

    with client(answer) as k:
        assert k.wait(JOB, progress=False)["count"] == 3
    left += [httpx.Response(status, json={"code": "not_ready", "detail": "Later."})] * 3

    async def main() -> Any:
        async with async_client(answer) as k:
            return await k.wait(JOB, progress=False)

    assert asyncio.run(main())["count"] == 3


def test_a_wait_without_answers_ends_at_its_time() -> None:
    with client(nobody) as k, pytest.raises(Exception, match=r"still without an answer after 0\.1 s"):
        k.jobs.wait(JOB, timeout_s=0.1)


def test_a_server_that_was_started_again_is_found(
    tmp_path: Path, no_settings: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("KILTER_DATA", str(tmp_path))
    file = tmp_path / "server.json"
    file.write_text('{"url": "http://127.0.0.1:1"}')
    asked: list[str] = []

    def answer(request: httpx.Request) -> httpx.Response:
        asked.append(f"{request.url.port} {request.headers['authorization']}")
        if request.url.port == 1:
            file.write_text('{"url": "http://127.0.0.1:2"}')
            (tmp_path / "token").write_text("new")
            raise httpx.ConnectError("gone")
        return httpx.Response(200, json={"id": JOB, "kind": "plan", "state": "succeeded", "result": {}})

    (tmp_path / "token").write_text("old")
    with Kilter(transport=httpx.MockTransport(answer)) as k:
        k.jobs.wait(JOB)
        assert k.url == "http://127.0.0.1:2"
    assert asked == ["1 Bearer old", "1 Bearer old", "2 Bearer new"]


def test_steps_can_be_read_without_sending() -> None:
    """A call says what it asks; nobody needs a server to see it."""
    call = send_with_retries(Request("GET", "/v1/robots"))
    asked = next(call)
    assert isinstance(asked, Request)
    busy = type("Busy", (), {"status": 503, "headers": {"retry-after": "2"}, "content": b"{}", "url": ""})
    wait = call.send(busy)
    assert isinstance(wait, Pause)
    assert 2.0 < wait.seconds <= 2.2  # not all clients that were told so come back at once
    assert next(call) == Relocate()
    assert next(call) == asked


def test_a_progress_that_raises_lets_go_of_the_call() -> None:
    closed: list[bool] = []

    def answer(request: httpx.Request) -> httpx.Response:
        return httpx.Response(200, text='data: {"state": "running", "progress": {"fraction": 0.1, "stage": "a"}}\n\n')

    def stop(fraction: float, stage: str) -> None:
        raise KeyboardInterrupt

    from kilter_client.requests.calls.jobs import wait

    def call() -> Any:
        try:
            return (yield from wait(JOB, stop, None))
        finally:
            closed.append(True)

    with client(answer) as k, pytest.raises(KeyboardInterrupt):
        k.run(call())
    assert closed == [True]


def test_a_field_that_nobody_knows_is_said_in_place() -> None:
    detail = "body.colour: there is no such field."
    refused = httpx.Response(422, json={"code": "request_invalid", "detail": detail})

    async def main() -> None:
        async with async_client(lambda request: refused) as k:
            with pytest.raises(PayloadError, match=r"^colour: there is"):
                await k.add_robot({"name": "a", "colour": "red"})

    asyncio.run(main())
