"""Jobs that ended long ago are purged, and what versions and robots need stays."""

from __future__ import annotations

import json
from datetime import timedelta
from typing import Any

import httpx
import pytest

from kilter_service.ground.db import Database
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.db.tables import FleetJobRow, FleetRobotRow, JobRow
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings
from kilter_service.jobs.work import worker as service
from kilter_service.run.backup import service as backup
from tests.service.conftest import Katana
from tests.service.made_versions import store_version
from tests.service.test_backup import kilterd

OLD, YOUNG = timedelta(days=40), timedelta(days=2)


def ended(
    database: Database, name: str, age: timedelta, kind: str = "plan", state: str = "succeeded", **result: Any
) -> str:
    at = utc_now() - age
    finished = at if state in ("succeeded", "failed", "cancelled") else None
    row = JobRow(id=f"job_{name}", kind=kind, robot_id=1, request={}, state=state, created_at=at, finished_at=finished,
                 result=result)  # fmt: skip
    with database.transaction() as session:
        session.add(row)
    return row.id


def left(database: Database) -> set[str]:
    with database.reading() as session:
        return {row.id for row in session.query(JobRow)}


@pytest.mark.both_databases
def test_old_jobs_go_and_what_is_needed_stays(
    client: httpx.Client, database: Database, settings: Settings, katana: Katana
) -> None:
    client.post("/v1/robots", json=katana.document).raise_for_status()
    first, second = store_version(database, "katana", 1), store_version(database, "katana", 2)
    client.post(f"/v1/versions/{second}/activate", json={"force": True, "reason": "test"}).raise_for_status()
    with database.transaction() as session:
        for number in (1, 2):
            session.get_one(JobRow, f"job_{number:016x}").finished_at = utc_now() - OLD
    kept = {f"job_{number:016x}" for number in (1, 2)}
    kept |= {
        ended(database, "young", YOUNG),
        ended(database, "running", OLD, state="running"),
        ended(database, "of_active", OLD, "evaluate", version_id=second),
        ended(database, "newest_search", OLD, "gap"),
        ended(database, "of_fleet", OLD),
    }
    with database.transaction() as session:
        session.add(FleetJobRow(id="fleet_1", request={}))
        session.flush()
        session.add(FleetRobotRow(fleet_id="fleet_1", robot_id=1, job_id="job_of_fleet"))
    gone = {
        ended(database, "of_inactive", OLD, "evaluate", version_id=first),
        ended(database, "earlier_search", OLD + YOUNG, "gap"),
        ended(database, "failed_search", OLD - YOUNG, "gap", "failed"),
        *(ended(database, f"old_{number}", OLD) for number in range(service.AT_ONCE)),
    }
    said = kilterd(settings, "purge-jobs", "--older-than", "30d", "--dry-run").stdout
    assert said == f"{len(gone)} jobs would be purged.\n"
    assert kilterd(settings, "purge-jobs", "--older-than", "30d").stdout.startswith(f"{len(gone)} jobs were purged")
    assert left(database) == kept
    entries = client.get("/v1/audit").raise_for_status().json()["entries"]
    named = {change["thing"] for one in entries if one["route"] == "kilterd purge-jobs" for change in one["changes"]}
    assert {f"jobs/{job}" for job in gone} <= named
    assert backup.verify_stored(settings).damaged == []
    assert client.get(f"/v1/versions/{first}").status_code == 200
    assert service.purge(database, timedelta(days=30), "test") == 0


def test_a_worker_purges_where_a_setting_says_so(client: httpx.Client, database: Database, katana: Katana) -> None:
    client.post("/v1/robots", json=katana.document).raise_for_status()
    for number in range(service.AT_ONCE + 1):
        ended(database, f"old_{number}", OLD)
    clock = [0.0]
    service.Retention(database, 0, lambda: clock[0]).purge_if_due()
    assert len(left(database)) == service.AT_ONCE + 1
    retention = service.Retention(database, 30, lambda: clock[0])
    counts = []
    for _ in range(3):
        retention.purge_if_due()
        counts.append(len(left(database)))
    assert counts == [1, 0, 0]
    ended(database, "later", OLD)
    retention.purge_if_due()
    assert left(database) == {"job_later"}
    clock[0] += service.EVERY_S
    retention.purge_if_due()
    assert left(database) == set()
    entries = json.dumps(client.get("/v1/audit").json()["entries"])
    assert "kilterd worker" in entries


@pytest.mark.parametrize("text", ["30", "0d", "d", "-1d", "1.5d", "30 days"])
def test_an_age_has_its_unit(text: str) -> None:
    with pytest.raises(ServiceError, match="give an age such as 12h, 30d or 8w"):
        service.parse_age(text)
