"""A command that waits for a job outlives the server: killed and started again, at another port, it shows the result."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest

from kilter_client import Kilter, ServerUnreachableError
from kilter_client.requests.calls import jobs as waiting
from tests.clients.conftest import server_in

Write = Callable[..., Path]


@pytest.fixture
def until_the_end() -> Iterator[Callable[[subprocess.Popen[str]], subprocess.Popen[str]]]:
    """Ends a process that a failing test leaves."""
    kept: list[subprocess.Popen[str]] = []

    def keep(process: subprocess.Popen[str]) -> subprocess.Popen[str]:
        kept.append(process)
        return process

    yield keep
    for process in kept:
        with process:
            process.kill()


def test_a_wait_goes_on_after_a_restart(
    tmp_path: Path,
    no_settings: None,
    write_campaign: Write,
    monkeypatch: pytest.MonkeyPatch,
    until_the_end: Callable[[subprocess.Popen[str]], subprocess.Popen[str]],
) -> None:
    data = tmp_path / "data"
    data.mkdir()
    monkeypatch.setenv("KILTER_DATA", str(data))
    kilter_command = Path(sys.executable).with_name("kilter")
    with server_in(data) as first:
        with Kilter() as kilter:
            kilter.robots.add({"name": "arm", "convention": "preset", "preset": "katana450-chapter4"})
            campaign = kilter.campaigns.add("arm", "monday")["id"]
            kilter.campaigns.upload(campaign, write_campaign(60))
            job = kilter.jobs.submit("gap", "arm", [campaign])["id"]
            watching = until_the_end(
                subprocess.Popen(
                    [kilter_command, "server", "jobs", "watch", job],
                    stdout=subprocess.PIPE,
                    stderr=subprocess.PIPE,
                    text=True,
                )
            )
            while kilter.jobs.get(job)["state"] != "running":
                time.sleep(0.02)
            before = kilter.url
        first.kill()
        first.wait()
        assert watching.stderr is not None
        said = watching.stderr.readline()
        assert "the server does not answer, waiting up to 120 s for it" in said
        with server_in(data):
            out, err = watching.communicate(timeout=240)
            assert watching.returncode == 0, err
            assert "gap search of arm 1: succeeded" in out
            with Kilter() as kilter:
                assert kilter.url != before


def test_patience_has_an_end_that_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    def nobody(request: httpx.Request) -> httpx.Response:
        raise httpx.ConnectError("nobody")

    monkeypatch.setattr(waiting, "PATIENCE_S", 0.3)
    stages: list[str] = []
    kilter = Kilter("http://kilter.test", "secret", httpx.MockTransport(nobody))
    with (
        kilter,
        pytest.raises(ServerUnreachableError, match=r"`kilter server jobs watch job_0000000000000000` follows it"),
    ):
        kilter.jobs.wait("job_" + "0" * 16, lambda _, stage: stages.append(stage))
    assert set(stages) == {waiting.AWAY}


@pytest.mark.parametrize("status", [500, 502, 503])
def test_a_server_that_starts_is_asked_again(status: int) -> None:
    answers = [httpx.Response(status, json={"code": "not_ready", "detail": "Later."})] * 3

    def answer(request: httpx.Request) -> httpx.Response:
        return (
            answers.pop() if answers else httpx.Response(200, json={"id": "job_1", "state": "succeeded", "result": {}})
        )

    with Kilter("http://kilter.test", "secret", httpx.MockTransport(answer)) as kilter:
        assert kilter.jobs.wait("job_" + "0" * 16)["state"] == "succeeded"
