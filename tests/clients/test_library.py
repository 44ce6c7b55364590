"""The library against a real server."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest

from kilter_client import (
    ConflictError,
    JobCancelledError,
    JobFailedError,
    JobTimeoutError,
    Kilter,
    NotAuthorisedError,
    NotFoundError,
    ObservationError,
    PayloadError,
    prepare,
)
from kilter_client.resources import event_data

Write = Callable[..., Path]


@pytest.fixture
def campaign(kilter: Kilter, robot: str, write_campaign: Write) -> str:
    made = kilter.campaigns.add(robot, "first", device="twin", conditions={"payload_kg": 0.4})
    kilter.campaigns.upload(made["id"], write_campaign())
    return str(made["id"])


def test_robots(kilter: Kilter, robot: str) -> None:
    assert robot in [found["name"] for found in kilter.robots.list()]
    assert len(kilter.robots.get(robot)["joints"]) == 5
    kilter.robots.remove(robot)
    with pytest.raises(NotFoundError) as caught:
        kilter.robots.get(robot)
    assert caught.value.code == "robot_not_found"


def test_a_field_nobody_knows_is_refused(kilter: Kilter) -> None:
    with pytest.raises(PayloadError, match="colour"):
        kilter.robots.add({"name": "a", "convention": "preset", "preset": "ur10", "colour": "red"})


def test_changes_need_the_token(server: Path) -> None:
    with Kilter(token="wrong") as kilter, pytest.raises(NotAuthorisedError) as caught:
        kilter.robots.add({"name": "a", "convention": "preset", "preset": "ur10"})
    assert caught.value.code == "token_wrong"


def test_the_same_bytes_twice_change_nothing(kilter: Kilter, campaign: str, write_campaign: Write) -> None:
    path = write_campaign()
    sent: list[tuple[int, int]] = []
    done = kilter.campaigns.upload(campaign, prepare(path), lambda some, all_: sent.append((some, all_)))
    size = path.stat().st_size
    assert done["new"] is False
    assert done["sha256"] == prepare(path).sha256
    assert sent[-1] == (size, size)
    assert kilter.campaigns.get(campaign)["rows"] == 40


def test_parquet_and_json_go_as_they_are(kilter: Kilter, robot: str, write_campaign: Write, tmp_path: Path) -> None:
    from pyarrow import csv, parquet

    table = csv.read_csv(write_campaign())
    parquet.write_table(table, tmp_path / "a.parquet")
    (tmp_path / "a.json").write_text(json.dumps(table.to_pydict()))
    for name in ("a.parquet", "a.json"):
        made = kilter.campaigns.add(robot, name)
        done = kilter.campaigns.upload(made["id"], tmp_path / name)
        assert done["rows"] == 40
        assert done["sha256"] == prepare(tmp_path / name).sha256


def test_a_bad_row_is_named_and_nothing_is_stored(kilter: Kilter, robot: str, write_campaign: Write) -> None:
    path = write_campaign()
    head, first, *rest = path.read_text().splitlines()
    path.write_text("\n".join([head, first, first.replace(first.split(",")[0], "400", 1), *rest]))
    made = kilter.campaigns.add(robot, "bad")
    with pytest.raises(ObservationError, match=r"Row 2, column 'q1_deg'") as caught:
        kilter.campaigns.upload(made["id"], path)
    assert caught.value.context["row"] == 2
    assert kilter.campaigns.get(made["id"])["rows"] == 0


def test_identify_follows_the_events(kilter: Kilter, robot: str, campaign: str) -> None:
    seen: list[tuple[float, str]] = []
    job = kilter.jobs.run("identify", robot, [campaign], 0.3, {"level": 1}, lambda f, s: seen.append((f, s)))
    assert job["state"] == "succeeded"
    assert seen[-1][0] == 1.0
    assert [fraction for fraction, _ in seen] == sorted(fraction for fraction, _ in seen)
    block = job["result"]["metrics"]["validation"]
    assert block["identified"]["mean_mm"] < 0.03 < block["registration_only"]["mean_mm"]
    assert job["id"] in [known["id"] for known in kilter.jobs.list(robot)]
    _versions(kilter, robot, job)


def _versions(kilter: Kilter, robot: str, job: dict[str, object]) -> None:
    first = job["result"]["version_id"]  # type: ignore[index]
    campaign = job["campaigns"][0]  # type: ignore[index]
    again = kilter.jobs.run("identify", robot, [campaign], options={"level": 2, "fix": ["alpha_*"]})
    second = again["result"]["version_id"]
    assert {version["id"] for version in kilter.versions.list(robot)} == {first, second}
    assert kilter.versions.get(first)["job_id"] == job["id"]
    with pytest.raises(ConflictError):
        kilter.versions.rollback(robot)
    kilter.versions.activate(first)
    kilter.versions.activate(second)
    assert kilter.robots.get(robot)["active_version"] == second
    assert kilter.versions.rollback(robot)["id"] == first
    assert kilter.versions.diff(first, second)["parameters"]
    assert json.loads(kilter.versions.export(first))


class EventsRefused(httpx.HTTPTransport):
    """The real network, behind a proxy that does not pass event streams."""

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        if request.url.path.endswith("/events"):
            return httpx.Response(502)
        return super().handle_request(request)


class EventsCutOff(httpx.HTTPTransport):
    """The real network, on which an event stream breaks after its first line."""

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        if request.url.path.endswith("/events"):
            return httpx.Response(200, stream=CutOff())
        return super().handle_request(request)


class CutOff(httpx.SyncByteStream):
    def __iter__(self) -> Iterator[bytes]:
        yield b'data: {"state": "running", "progress": {"fraction": 0.1, "stage": "cut"}}\n\ndata: {"sta'
        raise httpx.ReadError("cut off")


@pytest.mark.parametrize("transport", [EventsRefused, EventsCutOff])
def test_without_events_a_wait_polls(
    server: Path, robot: str, campaign: str, transport: type[httpx.HTTPTransport]
) -> None:
    with Kilter(transport=transport()) as kilter:
        job = kilter.jobs.run("identify", robot, [campaign], options={"level": 1})
    assert job["result"]["version_id"]


def test_a_failed_job_is_an_exception_with_its_code(kilter: Kilter, robot: str, write_campaign: Write) -> None:
    made = kilter.campaigns.add(robot, "few")
    kilter.campaigns.upload(made["id"], write_campaign(poses=4))
    with pytest.raises(JobFailedError) as caught:
        kilter.jobs.run("identify", robot, [made["id"]])
    assert caught.value.code == "too_few_poses"
    assert caught.value.job["state"] == "failed"


def test_a_cancelled_job(kilter: Kilter, robot: str, campaign: str) -> None:
    job = kilter.jobs.submit("identify", robot, [campaign], {"folds": 20}, {"level": 2})
    kilter.jobs.cancel(job["id"])
    with pytest.raises(JobCancelledError) as caught:
        kilter.jobs.wait(job["id"])
    assert caught.value.code == "cancelled"


def test_a_wait_has_an_end(kilter: Kilter, robot: str, campaign: str) -> None:
    job = kilter.jobs.submit("identify", robot, [campaign], {"folds": 20}, {"level": 2})
    with pytest.raises(JobTimeoutError):
        kilter.jobs.wait(job["id"], timeout_s=0)
    kilter.jobs.cancel(job["id"])


def test_an_unknown_job(kilter: Kilter) -> None:
    with pytest.raises(NotFoundError):
        kilter.jobs.wait("job_none")


def test_events_of_several_lines_and_comments() -> None:
    lines = iter(["event: progress", 'data: {"a":', "data: 1}", "", ": still here", "", "data: no json", ""])
    assert list(event_data(lines)) == [{"a": 1}, None]


def test_health(kilter: Kilter) -> None:
    assert kilter.health()["status"] == "ready"
    assert kilter.url.startswith("http://127.0.0.1:")
