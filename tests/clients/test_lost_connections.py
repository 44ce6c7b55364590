"""Connections that break while a client works: nothing is lost, nothing is done twice, and errors name the request."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from kilter_client import AsyncKilter, JobCancelledError, Kilter, ServerUnreachableError
from kilter_client.requests import steps
from tests.clients.cutting_proxy import CuttingProxy
from tests.clients.test_restart import server_in
from tests.service.forked import children_of

Write = Callable[..., Path]
PRESET = {"convention": "preset", "preset": "katana450-chapter4"}


@pytest.fixture
def proxy(server: Path) -> Iterator[CuttingProxy]:
    """A proxy in front of the running server."""
    port = urlsplit(json.loads((server / "server.json").read_text())["url"]).port
    assert port is not None
    with CuttingProxy(port).running() as proxy:
        yield proxy


def test_a_read_whose_answer_was_lost_is_sent_again(proxy: CuttingProxy, robot: str) -> None:
    proxy.cut_next("GET /v1/robots", 2)
    with Kilter(proxy.url) as k:
        assert robot in [one.name for one in k.robots()]
    tries = proxy.sent("GET /v1/robots")
    assert len(tries) == 3
    assert len({one["x-request-id"] for one in tries}) == 1


def test_under_asyncio_too(proxy: CuttingProxy, robot: str) -> None:
    proxy.cut_next("GET /v1/robots", 2)

    async def main() -> list[str]:
        async with AsyncKilter(proxy.url) as k:
            return [one.name for one in await k.robots()]

    assert robot in asyncio.run(main())


def test_campaigns_uploads_and_jobs_are_done_once(
    proxy: CuttingProxy, kilter: Kilter, robot: str, write_campaign: Write
) -> None:
    with Kilter(proxy.url) as k:
        proxy.cut_next(f"POST /v1/robots/{robot}/campaigns")
        campaign = k.campaigns.add(robot, "monday")["id"]
        proxy.cut_next(f"POST /v1/campaigns/{campaign}/observations")
        k.campaigns.upload(campaign, write_campaign(20))
        proxy.cut_next("POST /v1/jobs")
        job = k.jobs.submit("identify", robot, [campaign])["id"]
    assert [len(proxy.sent(f"POST {path}")) for path in (f"/v1/robots/{robot}", "/v1/campaigns", "/v1/jobs")] == [2] * 3
    assert [one.rows for one in kilter.campaigns(robot)] == [20]
    assert [one.id for one in kilter.jobs(robot)] == [job]


def test_a_staged_campaign_is_committed_again(proxy: CuttingProxy, kilter: Kilter, robot: str, tmp_path: Path) -> None:
    rows = tmp_path / "rows.csv"
    rows.write_text("q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,x_mm,y_mm,z_mm\n" + "1,2,3,4,5,100,200,300\n" * 20_000)
    proxy.cuts = _each_first("/commit ")
    with Kilter(proxy.url) as k:
        assert k.upload(robot, rows, name="staged").rows == 20_000
    assert [one.rows for one in kilter.campaigns(robot)] == [20_000]


def test_what_could_be_done_twice_is_sent_once(proxy: CuttingProxy, kilter: Kilter, robot: str) -> None:
    proxy.cut_next("POST /v1/robots")
    with Kilter(proxy.url) as k, pytest.raises(ServerUnreachableError) as caught:
        k.robots.add(PRESET | {"name": f"{robot}.b"})
    sent = proxy.sent("POST /v1/robots")
    assert len(sent) == 1
    assert caught.value.request_id == sent[0]["x-request-id"]
    assert f"{robot}.b" in [one.name for one in kilter.robots()]


def test_sending_again_has_an_end(proxy: CuttingProxy, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(steps, "PATIENCE_S", 0.5)
    proxy.cut_next("GET", 1000)
    with Kilter(proxy.url) as k, pytest.raises(ServerUnreachableError, match="does not answer"):
        k.robots()
    assert 3 <= len(proxy.sent("GET")) <= 5


def test_where_nobody_ever_answered_is_said_at_once(no_settings: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(steps.RetryPolicy, "_consume_wait_s", lambda self: pytest.fail("it waits"))
    with Kilter("http://127.0.0.1:1", "secret") as k, pytest.raises(ServerUnreachableError, match="kilterd serve"):
        k.robots()


def test_refusals_name_the_request(proxy: CuttingProxy) -> None:
    with Kilter(proxy.url) as k, pytest.raises(Exception, match="nobody") as caught:
        k.robot("nobody")
    assert getattr(caught.value, "request_id", None) == proxy.sent("GET /v1/robots/nobody")[0]["x-request-id"]


def test_events_go_on_where_they_broke(proxy: CuttingProxy, kilter: Kilter, robot: str, write_campaign: Write) -> None:
    """The connection breaks behind the first event and again in place of the last: each is told, and told once."""
    campaign = kilter.campaigns.add(robot, "monday")["id"]
    kilter.campaigns.upload(campaign, write_campaign(60))
    before, job = (kilter.jobs.submit("gap", robot, [campaign])["id"] for _ in range(2))  # the second one waits
    left = {b"event: progress": "after", b"event: end": "drop"}

    def cuts(head: str, piece: bytes) -> str:
        here = [mark for mark in left if f"{job}/events " in head and mark in piece]
        return left.pop(here[0]) if here else ""

    proxy.cuts = cuts
    told: list[tuple[float, str]] = []
    with Kilter(proxy.url) as k, ThreadPoolExecutor() as pool:
        waiting = pool.submit(k.jobs.wait, job, lambda fraction, stage: told.append((fraction, stage)))
        _until(lambda: len(proxy.sent(f"GET /v1/jobs/{job}/events")) > 1 or waiting.done())
        for one in (before, job):
            kilter.jobs.cancel(one)
        with pytest.raises(JobCancelledError):
            waiting.result(200)
    follows = proxy.sent(f"GET /v1/jobs/{job}/events")
    assert "last-event-id" not in follows[0]
    assert follows[1]["last-event-id"]
    assert len(told) == len(set(told)), told
    assert [stage for _, stage in (told[0], told[-1])] == ["queued", "cancelled"], told
    assert left == {}


def test_a_server_that_is_killed_meanwhile(
    tmp_path: Path, no_settings: None, monkeypatch: pytest.MonkeyPatch, write_campaign: Write
) -> None:
    """The API is killed while it works, then the whole server, which comes back at another port."""
    monkeypatch.setenv("KILTER_DATA", str(tmp_path / "data"))
    monkeypatch.setattr(steps, "PATIENCE_S", 200.0)  # on a busy machine it starts slowly
    (tmp_path / "data").mkdir()
    files = [write_campaign(10, f"{seed}.csv", seed) for seed in range(9)]
    done: list[Any] = []

    def work(k: Kilter) -> None:
        for number, file in enumerate(files):
            campaign = k.campaigns.add("arm", f"c{number}")["id"]
            done.append(k.campaigns.upload(campaign, file)["total_rows"])

    with server_in(tmp_path / "data") as first, Kilter() as k:
        k.robots.add(PRESET | {"name": "arm"})
        before, worker = k.url, threading.Thread(target=work, args=(k,))
        worker.start()
        _until(lambda: len(done) >= 3 or not worker.is_alive())
        os.kill(_api_of(first.pid), signal.SIGKILL)
        _until(lambda: len(done) >= 6 or not worker.is_alive())
        first.kill()
        first.wait()
        with server_in(tmp_path / "data"):
            worker.join(300)
            assert done == [10] * len(files)
            assert [(one.name, one.rows) for one in k.campaigns("arm")] == [(f"c{n}", 10) for n in range(len(files))]
            assert k.url != before  # found by the request above, where all was sent before the server was killed


def _api_of(supervisor: int) -> int:
    """The API process of a server, which may just be started again."""
    _until(lambda: "api" in children_of(supervisor))
    return children_of(supervisor)["api"]


def _until(reached: Callable[[], bool]) -> None:
    end = time.monotonic() + 200
    while not reached():
        assert time.monotonic() < end
        time.sleep(0.005)


def _each_first(part: str) -> Callable[[str, bytes], str]:
    """Lose the first answer to a request whose head has this part."""
    left = ["drop"]
    return lambda head, _: left.pop() if part in head and left else ""
