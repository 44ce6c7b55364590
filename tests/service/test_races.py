"""Equal and contradicting requests at the same time, over a real socket, on SQLite and on PostgreSQL."""

from __future__ import annotations

import random
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import create_engine, make_url, text
from sqlalchemy.exc import DBAPIError

from kilter_core.arm.documents import robot_from_document
from kilter_core.model import Calibration
from kilter_service.campaigns import service as uploads
from kilter_service.ground.db import Database
from kilter_service.ground.db.tables import JobRow
from kilter_service.ground.settings import Settings
from kilter_service.robots import store as robots
from kilter_service.robots.documents import core_document, resolve
from kilter_service.versions import store
from kilter_service.versions.store import NewVersion

THREADS = 24


MOST_AT_ONCE = 12  # uploads that are checked together before the first of them is stored


@pytest.fixture(params=["sqlite", "postgresql"])
def settings(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Settings:
    for name in Settings.model_fields:
        monkeypatch.delenv(f"KILTER_{name.upper()}", raising=False)
    url = None
    if request.param == "postgresql":
        server = make_url(request.getfixturevalue("postgresql"))
        name = f"t{abs(hash(tmp_path)):x}"
        engine = create_engine(server.set(drivername="postgresql+psycopg"), isolation_level="AUTOCOMMIT")
        with engine.connect() as connection:
            connection.execute(text(f"CREATE DATABASE {name}"))
        engine.dispose()
        url = server.set(database=name).render_as_string(hide_password=False)
    return Settings(
        data=tmp_path / "data", database_url=url, port=0, zenoh_listen="tcp/127.0.0.1:0", max_computing=MOST_AT_ONCE
    )


def at_once(calls: list[Callable[[], httpx.Response]], threads: int = THREADS) -> list[httpx.Response]:
    """Make the calls from many threads that begin together."""
    together = threading.Barrier(min(threads, len(calls)))
    waited = threading.local()

    def one(call: Callable[[], httpx.Response]) -> httpx.Response:
        if not hasattr(waited, "done"):
            waited.done = True
            together.wait(30)
        return call()

    with ThreadPoolExecutor(min(threads, len(calls))) as pool:
        return list(pool.map(one, calls))


@pytest.fixture
def versions(client: httpx.Client, database: Database, katana: Any) -> list[str]:
    """Eight versions of the Katana that nothing speaks against."""
    client.post("/v1/robots", json=katana.document).raise_for_status()
    document = Calibration.nominal(robot_from_document(core_document(katana.document).document)).to_document()
    new = NewVersion(document, {}, {"names": [], "matrix": [], "units": "SI"}, [], {}, None, "test")
    with database.transaction() as session:
        robot_id = robots.get(session, katana.name).id
        for k in range(8):
            session.add(JobRow(id=f"job_{k}", kind="identify", robot_id=robot_id, request={}, state="running"))
            session.flush()
            store.add(session, robot_id, f"job_{k}", new)
    return [f"ver_{k}" for k in range(8)]


def history(client: httpx.Client) -> list[tuple[str, str]]:
    log = client.get("/v1/robots/katana/activations").raise_for_status().json()["activations"]
    return [(entry["action"], entry["version_id"]) for entry in reversed(log)]


def replayed(entries: list[tuple[str, str]]) -> list[str]:
    """What was active, oldest first, as a person reads the log; fails where an entry cannot have happened."""
    active: list[str] = []
    for action, version in entries:
        if action == "rollback":
            assert len(active) > 1, "a roll-back to nothing"
            assert version == active[-2], "a roll-back to what was not active before"
            active.pop()
        else:
            assert active[-1:] != [version], "activated twice"
            active.append(version)
    return active


def activate(client: httpx.Client, version: str) -> httpx.Response:
    return client.post(f"/v1/versions/{version}/activate")


def rollback(client: httpx.Client) -> httpx.Response:
    return client.post("/v1/robots/katana/rollback")


def test_parallel_rollbacks_go_back_one_version_each(client: httpx.Client, versions: list[str]) -> None:
    for version in versions:
        activate(client, version).raise_for_status()
    answers = at_once([lambda: rollback(client)] * 6)
    assert [answer.status_code for answer in answers] == [200] * 6
    assert sorted(answer.json()["id"] for answer in answers) == versions[1:7]
    assert replayed(history(client)) == versions[:2]
    assert client.get("/v1/robots/katana").json()["active_version"] == versions[1]
    assert rollback(client).json()["id"] == versions[0]
    assert rollback(client).json()["code"] == "nothing_to_roll_back"


def test_equal_activations_at_once_are_one(client: httpx.Client, versions: list[str]) -> None:
    answers = at_once([lambda: activate(client, versions[0])] * 16)
    assert [answer.status_code for answer in answers] == [200] * 16
    assert all(answer.json()["active"] for answer in answers)
    assert history(client) == [("activate", versions[0])]


def test_eighty_rollbacks_and_activations_leave_a_history_that_can_have_happened(
    client: httpx.Client, versions: list[str]
) -> None:
    activate(client, versions[0]).raise_for_status()
    draw = random.Random(7)
    wishes = [None if draw.random() < 0.5 else draw.choice(versions) for _ in range(80)]
    calls = [lambda w=wish: rollback(client) if w is None else activate(client, w) for wish in wishes]
    answers = at_once(calls)
    refused = {answer.json()["code"] for answer in answers if answer.status_code != 200}
    assert refused <= {"nothing_to_roll_back", "activation_overtaken"}
    entries = history(client)
    active = replayed(entries)
    assert client.get("/v1/robots/katana").json()["active_version"] == active[-1]
    went_back = [a for a, w in zip(answers, wishes, strict=True) if w is None and a.status_code == 200]
    assert sum(action == "rollback" for action, _ in entries) == len(went_back) > 0
    activated = [a for a, w in zip(answers, wishes, strict=True) if w is not None and a.status_code == 200]
    assert len(activated) > len(wishes) / 4


def test_equal_robots_at_once_are_one(client: httpx.Client, katana: Any) -> None:
    answers = at_once([lambda: client.post("/v1/robots", json=katana.document)] * 16)
    assert sorted(answer.status_code for answer in answers) == [200] * 15 + [201]
    assert len({answer.text for answer in answers}) == 1


def test_different_robots_of_one_name_at_once_leave_one(client: httpx.Client, katana: Any) -> None:
    presets = ["katana450-chapter5", "katana450-chapter3", "katana450-chapter4", "ur10"] * 4
    answers = at_once([lambda p=p: client.post("/v1/robots", json=katana.document | {"preset": p}) for p in presets])
    codes = [answer.status_code for answer in answers]
    assert codes.count(201) == 1
    assert codes.count(200) == 3
    assert {answer.json()["code"] for answer in answers if answer.status_code > 201} == {"robot_exists"}


def campaign(client: httpx.Client, katana: Any) -> str:
    client.post("/v1/robots", json=katana.document).raise_for_status()
    return str(
        client.post("/v1/robots/katana/campaigns", json={"name": "c", "numbered": True}).raise_for_status().json()["id"]
    )


def test_equal_uploads_at_once_are_one(client: httpx.Client, katana: Any) -> None:
    where, rows = campaign(client, katana), katana.columns(40)
    answers = at_once([lambda: client.post(f"/v1/campaigns/{where}/observations", json=rows)] * 16)
    assert sorted(answer.status_code for answer in answers) == [200] * 15 + [201]
    assert len({str(answer.json() | {"new": None}) for answer in answers}) == 1
    found = client.get(f"/v1/campaigns/{where}").json()
    assert (found["rows"], len(found["uploads"])) == (40, 1)


def test_uploads_with_different_columns_at_once_leave_a_campaign_of_one_kind(
    client: httpx.Client, katana: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    where = campaign(client, katana)
    bodies = [
        katana.columns(20, seed=k) | ({"temperature_c": [20.0] * 20} if k % 2 else {}) for k in range(MOST_AT_ONCE)
    ]
    together, check = threading.Barrier(len(bodies)), uploads.checked_chunks

    def checked_together(*args: Any) -> Any:
        """The check itself; all uploads have passed it before the first is stored."""
        done = check(*args)
        together.wait(60)
        return done

    monkeypatch.setattr(uploads, "checked_chunks", checked_together)
    answers = at_once([lambda b=b: client.post(f"/v1/campaigns/{where}/observations", json=b) for b in bodies])
    kept = [len(body) for body, answer in zip(bodies, answers, strict=True) if answer.status_code == 201]
    assert len(kept) == 6
    assert len(set(kept)) == 1
    for refused in (answer.json() for answer in answers if answer.status_code != 201):
        assert (refused["status"], refused["code"]) == (400, "observations_invalid")
        assert refused["context"]["columns"] == ["temperature_c"]
        assert "temperature_c" in refused["detail"]
    assert {len(upload["columns"]) for upload in client.get(f"/v1/campaigns/{where}").json()["uploads"]} == set(kept)


def test_who_only_reads_can_change_nothing(database: Database, katana: Any) -> None:
    with pytest.raises(DBAPIError, match="read"), database.reading() as session:
        robots.add(session, "other", katana.document, resolve(katana.document))
    with database.transaction() as session:  # the pool gives the same connection again
        robots.add(session, "other", katana.document, resolve(katana.document))
    with database.reading() as session:
        assert robots.find(session, "other") is not None


def test_who_reads_sees_one_moment_and_who_changes_sees_the_last(database: Database, katana: Any) -> None:
    with database.reading() as session:
        assert robots.find(session, "other") is None
        with database.transaction() as writer:
            robots.add(writer, "other", katana.document, resolve(katana.document))
        assert robots.find(session, "other") is None
    with database.transaction() as session:
        assert robots.find(session, "other") is not None


def test_who_changes_waits_for_its_turn_before_it_reads(database: Database, katana: Any) -> None:
    inside, seen = threading.Event(), []

    def second() -> None:
        inside.set()
        with database.transaction() as session:
            seen.append(robots.find(session, "other"))

    with database.transaction() as session:
        assert robots.find(session, "other") is None
        thread = threading.Thread(target=second)
        thread.start()
        assert inside.wait(30)
        thread.join(0.3)
        assert thread.is_alive()
        robots.add(session, "other", katana.document, resolve(katana.document))
    thread.join(30)
    assert seen[0] is not None
