"""The audit: what every change leaves, that the database keeps it as it is, and that a change of it is seen."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import sqlite3
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi import FastAPI
from sqlalchemy import text
from sqlalchemy.exc import DBAPIError

from kilter_core.twin import thesis_katana
from kilter_service.ground.caller import CALLER, Caller
from kilter_service.ground.db import Database, revision
from kilter_service.ground.db.tables import CampaignRow, JobRow, RobotRow
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import DATABASE_FILE, Settings
from kilter_service.jobs.work import store as lease
from kilter_service.jobs.work.runner import Runner
from kilter_service.page.audit import REFUSED
from kilter_service.run.app import create_app
from kilter_service.versions import store
from kilter_service.versions.store import NewVersion
from kilter_service.web import audit
from kilter_service.web.audit import Head
from kilter_service.web.auth.token import admin_token

from .postgresql import programs, running_postgresql

ROBOT = {"name": "arm", "convention": "preset", "preset": "katana450-chapter5"}


def entries(client: httpx.Client, **asked: Any) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = client.get("/v1/audit", params=asked).raise_for_status().json()["entries"]
    return found


def chain_holds(found: list[dict[str, Any]]) -> bool:
    """Computed here once more, as somebody would who trusts no code of Kilter."""
    before = ""
    for number, entry in enumerate(found, 1):
        hashed = hashlib.sha256((before + "\n" + entry["content"]).encode()).hexdigest()
        if (entry["number"], entry["previous"], entry["sha256"]) != (number, before, hashed):
            return False
        before = hashed
    return True


def test_a_change_leaves_who_what_from_where_before_and_after(client: httpx.Client) -> None:
    client.post("/v1/robots", json=ROBOT).raise_for_status()
    client.patch("/v1/robots/arm", json={"remarks": "first"}).raise_for_status()
    made = client.post("/v1/tokens", json={"name": "anna", "role": "admin"}).json()
    headers = {"Authorization": f"Bearer {made['token']}"}
    client.patch("/v1/robots/arm", json={"remarks": "second"}, headers=headers).raise_for_status()
    last = entries(client)[-1]
    assert (last["actor"], last["token_id"], last["role"]) == ("anna", made["id"], "admin")
    assert (last["route"], json.loads(last["place"])) == ("PATCH /v1/robots/{robot}", {"robot": "arm"})
    assert last["address"] == "127.0.0.1"
    (change,) = last["changes"]
    assert change["thing"] == "robots/1"
    assert (json.loads(change["before"]), json.loads(change["after"])) == ({"remarks": "first"}, {"remarks": "second"})
    assert chain_holds(entries(client))


def test_what_changes_nothing_or_is_refused_leaves_nothing(client: httpx.Client) -> None:
    client.post("/v1/robots", json=ROBOT).raise_for_status()
    before = len(entries(client))
    assert client.post("/v1/robots", json=ROBOT).status_code == 200
    client.get("/v1/robots").raise_for_status()
    assert client.post("/v1/robots/check", json=ROBOT).status_code == 200
    assert client.post("/v1/robots/arm/rollback").status_code == 409
    assert client.post("/v1/robots", json={**ROBOT, "preset": "katana450-chapter4"}).status_code == 409
    assert len(entries(client)) == before == 1


def refused(client: httpx.Client) -> list[tuple[str, str, str, dict[str, Any]]]:
    """Refused requests in the audit, and that it is whole with them."""
    found = entries(client)
    assert chain_holds(found)
    return [
        (one["actor"], one["address"], one["route"], json.loads(one["changes"][0]["after"]))
        for one in found
        if one["changes"][0]["thing"] == "refused"
    ]


def test_refused_requests_are_in_the_audit_in_groups(
    settings: Settings, database: Database, serve: Callable[[FastAPI], httpx.Client]
) -> None:
    app = create_app(settings)
    client = serve(app)
    client.headers["Authorization"] = f"Bearer {admin_token(settings)}"
    made = client.post("/v1/tokens", json={"name": "anna", "role": "viewer"}).json()
    for _ in range(3):
        given = client.post("/v1/robots", json=ROBOT, headers={"Authorization": f"Bearer {made['token']}"})
        assert given.status_code == 403
        assert client.get("/v1/robots", headers={"Authorization": "Bearer nonsense"}).status_code == 401
    assert client.get("/v1/robots", headers={"Host": "evil.example"}).status_code == 421
    assert client.post("/login", data={"token": "nonsense"}, headers={"Authorization": ""}).status_code == 401
    assert client.get("/v1/robots/nobody").status_code == 404
    app.state.refusals.write()
    here = "127.0.0.1"
    assert refused(client) == [
        ("anna", here, "POST /v1/robots", {"code": "role_too_low", "times": 3}),
        ("anybody", here, "GET /v1/robots", {"code": "token_wrong", "times": 3}),
        ("anybody", here, "GET (none)", {"code": "host_refused", "times": 1}),
        ("anybody", here, "POST /login", {"code": "token_wrong", "times": 1}),
    ]
    app.state.refusals.write()
    assert len(refused(client)) == 4
    page = client.get("/audit").raise_for_status().text
    assert "was refused 3 times at POST /v1/robots: the role does not suffice" in page
    assert "was refused once at POST /login: a wrong token" in page
    assert not re.search(r"<td[^>]*>\s*(added robot|logged in)", page)  # what was asked for was not done
    assert set(REFUSED) == audit.NOTED | {"several"}


def test_nobody_fills_the_audit_by_being_refused(client: httpx.Client, database: Database) -> None:
    counted = audit.Refusals(database, first_s=3600.0)
    for number in range(1000):
        counted.count(audit.Group("token_wrong", Caller("anybody", "viewer", address=f"10.0.0.{number}")))
    counted.close()
    found = refused(client)
    assert len(found) == audit.MOST_GROUPS + 1
    assert sum(one[3]["times"] for one in found) == 1000
    assert found[-1][2:] == ("(several)", {"code": "several", "times": 1000 - audit.MOST_GROUPS})


def test_refused_requests_are_written_by_themselves_and_more_slowly_while_they_go_on(
    client: httpx.Client, database: Database, until: Callable[..., None]
) -> None:
    group = audit.Group("token_wrong", Caller("anybody", "viewer", address="10.0.0.1"))
    soon = audit.Refusals(database, first_s=0.02)
    soon.count(group)
    until(lambda: len(refused(client)) == 1)
    soon.close()
    counted = audit.Refusals(database, first_s=400.0)
    pauses = []
    for times in (2, 1, 0):
        for _ in range(times):
            counted.count(group)
        counted._due()
        pauses.append(counted._pause_s)
    counted.close()
    assert pauses == [audit.LONGEST_S, audit.LONGEST_S, 400.0]
    assert [one[3]["times"] for one in refused(client)] == [1, 2, 1]


def test_refused_requests_wait_for_a_database_that_is_away(
    tmp_path: Path, client: httpx.Client, database: Database
) -> None:
    away = Database(f"sqlite:///{tmp_path / 'none' / 'none.sqlite'}")
    counted = audit.Refusals(away, first_s=3600.0)
    counted.count(audit.Group("token_wrong", Caller("anybody", "viewer")))
    counted.write()
    counted._database = database
    counted.close()
    assert [one[3]["times"] for one in refused(client)] == [1]
    away.close()


def test_an_activation_says_which_version_was_active_before(client: httpx.Client, database: Database) -> None:
    client.post("/v1/robots", json=ROBOT).raise_for_status()
    report: dict[str, Any] = {"parameters": [], "metrics": {}, "noise_mm": 0.01}
    limits = {"max_joint_deg": 1.0, "max_position_mm": 5.0}
    for end in ("a", "b"):
        new = NewVersion(
            thesis_katana().truth.to_document(), report, {"names": [], "matrix": []}, [], limits, None, "t"
        )
        asked = {"kind": "identify", "robot": "arm"}
        with database.transaction() as session:
            session.add(JobRow(id=f"job_{end}", kind="identify", robot_id=1, request=asked, state="succeeded"))
            session.flush()
            store.add(session, 1, f"job_{end}", new)
    for version in ("ver_a", "ver_b"):
        client.post(f"/v1/versions/{version}/activate", json={"force": True, "reason": "a test"}).raise_for_status()
    client.post("/v1/robots/arm/rollback").raise_for_status()
    changes = [c for entry in entries(client) for c in entry["changes"] if c["thing"] == "active_version"]
    assert [(c["before"], c["after"]) for c in changes] == [
        ("", '"ver_a"'),
        ('"ver_a"', '"ver_b"'),
        ('"ver_b"', '"ver_a"'),
    ]


@pytest.mark.both_databases
def test_a_version_of_a_worker_is_in_the_audit_of_whoever_asked_for_it(
    client: httpx.Client, database: Database, katana: Any
) -> None:
    campaign = katana.campaign(client, 60)
    made = client.post("/v1/tokens", json={"name": "anna", "role": "operator"}).json()
    wanted = {"kind": "identify", "robot": "katana", "campaigns": [campaign], "options": {"level": 1}}
    headers = {"Authorization": f"Bearer {made['token']}"}
    job = client.post("/v1/jobs", json=wanted, headers=headers).raise_for_status().json()["id"]
    before = len(entries(client))
    with database.transaction() as session:
        claim = lease.claim(session, "here", ["identify"])
    assert claim is not None
    Runner(database).run(claim)

    told = client.get(f"/v1/jobs/{job}").json()
    version = told["result"]["version_id"]
    assert told["asked_by"] == "anna"
    assert [one["asked_by"] for one in client.get("/v1/jobs").json()["jobs"]] == ["anna"]
    (entry,) = entries(client)[before:]
    assert (entry["actor"], entry["token_id"], entry["role"]) == ("anna", made["id"], "operator")
    assert (entry["address"], entry["route"]) == ("127.0.0.1", "kilterd worker")
    assert json.loads(entry["place"]) == {"job": job}
    changed = {change["thing"]: change for change in entry["changes"]}
    assert set(changed) == {f"versions/{version}", f"jobs/{job}", "robots/1"}  # which counts its versions
    assert changed[f"versions/{version}"]["before"] == ""
    sha256 = client.get(f"/v1/versions/{version}").json()["sha256"]
    assert json.loads(changed[f"versions/{version}"]["after"])["sha256"] == sha256
    assert chain_holds(entries(client))
    assert CALLER.get() is None


def test_a_version_that_an_earlier_kilter_was_asked_for_says_that_nobody_is_known(
    client: httpx.Client, database: Database, katana: Any
) -> None:
    campaign = katana.campaign(client, 60)
    wanted = {"kind": "identify", "robot": "katana", "campaigns": [campaign], "options": {"level": 1}}
    job = client.post("/v1/jobs", json=wanted).raise_for_status().json()["id"]
    with database.transaction() as session:
        session.get_one(JobRow, job).asked_by = {}
        claim = lease.claim(session, "here", ["identify"])
    assert claim is not None
    Runner(database).run(claim)
    assert entries(client)[-1]["actor"] == "unknown"
    assert client.get(f"/v1/jobs/{job}").json()["asked_by"] == ""
    assert [one["asked_by"] for one in client.get("/v1/jobs").json()["jobs"]] == [""]


def test_the_audit_comes_in_pages(client: httpx.Client) -> None:
    client.post("/v1/robots", json=ROBOT).raise_for_status()
    for number in range(5):
        client.patch("/v1/robots/arm", json={"remarks": str(number)}).raise_for_status()
    first = client.get("/v1/audit", params={"limit": 4}).json()
    rest = client.get("/v1/audit", params={"limit": 4, "after": first["next"]}).json()
    assert [entry["number"] for entry in first["entries"] + rest["entries"]] == [1, 2, 3, 4, 5, 6]
    assert rest["next"] is None


def filled(database: Database, count: int = 4) -> None:
    token = CALLER.set(Caller("anna", "admin", route="PATCH /v1/robots/{robot}"))
    try:
        with database.transaction() as session:
            session.add(RobotRow(id=1, name="arm", document={}, chain=None))
        for number in range(count - 1):
            with database.transaction() as session:
                session.get_one(RobotRow, 1).remarks = str(number)
    finally:
        CALLER.reset(token)


STATEMENTS = (
    "UPDATE audit SET content = 'x' WHERE number = 2",
    "DELETE FROM audit WHERE number = 4",
    "DELETE FROM audit",
    "INSERT INTO audit (number, previous, sha256, content) VALUES (6, '', 'y', 'x')",
    "INSERT INTO audit (number, previous, sha256, content) VALUES (5, '', 'y', 'x')",
    "INSERT INTO audit (number, previous, sha256, content) SELECT 2, previous, 'y', 'x' FROM audit WHERE number = 2",
)


@pytest.mark.parametrize("statement", [*STATEMENTS, "INSERT OR REPLACE INTO audit VALUES (2, '', 'y', 'x')"])
def test_the_database_refuses_to_change_it(database: Database, statement: str) -> None:
    if not database.url.startswith("sqlite"):
        pytest.skip("PostgreSQL has a test of its own")
    filled(database)
    with pytest.raises(DBAPIError, match="audit"), database.transaction() as session:
        session.execute(text(statement))
    assert audit.verify(database).number == 4


def broken_off(database: Database) -> None:
    with database.transaction() as session:
        session.get_one(RobotRow, 1).remarks = "lost"
        session.flush()
        raise RuntimeError


def test_one_change_and_its_entry_stand_or_fall_together(database: Database) -> None:
    filled(database)
    token = CALLER.set(Caller("anna", "admin"))
    try:
        with pytest.raises(RuntimeError):
            broken_off(database)
        with database.transaction() as session:
            session.add(CampaignRow(id="cmp_1", name="c", robot_id=1, device="", role="train", conditions={}, notes=""))
    finally:
        CALLER.reset(token)
    with database.reading() as session:
        assert session.get_one(RobotRow, 1).remarks == "2"
        contents = session.execute(text("SELECT content FROM audit ORDER BY number")).scalars().all()
    assert len(contents) == 5
    assert "lost" not in "".join(contents)


@pytest.mark.parametrize(
    ("statement", "whole"),
    [
        ("UPDATE audit SET content = replace(content, 'anna', 'otto') WHERE number = 2", 1),
        ("UPDATE audit SET previous = '0' WHERE number = 3", 2),
        ("DELETE FROM audit WHERE number = 1", 0),
        ("DELETE FROM audit WHERE number = 3", 2),
    ],
)
def test_a_change_past_the_database_is_seen_in_its_file(
    settings: Settings, database: Database, tmp_path: Path, statement: str, whole: int
) -> None:
    if settings.database_url is not None:
        pytest.skip("the database is PostgreSQL")
    filled(database)
    database.close()
    copy = tmp_path / "copy.sqlite"
    shutil.copy(settings.data / DATABASE_FILE, copy)
    with sqlite3.connect(copy) as raw:
        for trigger in ("update", "delete", "insert"):
            raw.execute(f"DROP TRIGGER audit_{trigger}")
        raw.execute(statement)
    raw.close()
    opened = Database(f"sqlite:///{copy}")
    with pytest.raises(ServiceError, match=f"up to {whole} are whole") as caught:
        audit.verify(opened)
    assert caught.value.code == "audit_broken"
    opened.close()


def test_a_cut_end_is_seen_by_whoever_noted_the_last_entry(database: Database) -> None:
    filled(database)
    noted = audit.verify(database)
    with database.reading() as session:
        found = list(audit.store.everything(session))
    assert audit.verify_entries(found, noted) == noted
    assert audit.verify_entries(found[:3]).number == 3
    with pytest.raises(ServiceError, match="does not hold entry 4"):
        audit.verify_entries(found[:3], noted)
    with pytest.raises(ServiceError, match="does not hold entry 4"):
        audit.verify_entries(found, Head(4, "0" * 64))


@pytest.mark.skipif(programs() is None, reason="PostgreSQL is not installed")
def test_many_writers_on_postgresql_keep_one_chain() -> None:
    with running_postgresql() as url:
        databases = [Database(url) for _ in range(2)]  # as two processes have
        revision.migrate(databases[0])
        filled(databases[0])

        def change(number: int) -> None:
            CALLER.set(Caller(f"writer-{number}", "operator"))
            with databases[number % 2].transaction() as session:
                session.get_one(RobotRow, 1).remarks = f"by {number}"

        with ThreadPoolExecutor(8) as pool:
            list(pool.map(change, range(40)))
        assert audit.verify(databases[1]).number == 44
        for statement in (*STATEMENTS, "TRUNCATE audit"):
            with pytest.raises(DBAPIError, match="audit"), databases[0].transaction() as session:
                session.execute(text(statement))
        assert audit.verify(databases[0]).number == 44
        for database in databases:
            database.close()
