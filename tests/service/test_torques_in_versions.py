"""A version with the torques of a log: what is stored of it, and what is judged by the version that it continues."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from kilter_core.twin import thesis_katana
from kilter_service.ground.db import Database
from kilter_service.ground.db.tables import JobRow
from kilter_service.ground.store import list_searches_in_torques
from kilter_service.jobs import store as jobs
from kilter_service.jobs.kind import VersionContent
from kilter_service.versions import store as versions

MODEL = {"base": [1.0], "links": [], "terms": [], "joints": [1, 2]}
MOTION = {
    "joints": [],
    "friction": [],
    "motions": 3,
    "seconds": 9.0,
    "unseen": True,
    "base_parameters": 1,
    "model": MODEL,
}


def succeed(database: Database, job: str, result: dict[str, Any], content: VersionContent | None) -> None:
    with database.transaction() as session:
        jobs.succeed(session, job, result, content)


@pytest.mark.both_databases
def test_a_log_adds_its_torques_to_the_version_that_it_starts_from(
    client: httpx.Client, database: Database, katana: Any
) -> None:
    poses, log = katana.campaign(client, 30), katana.campaign(client, 30, 1)

    def asked(campaign: str, start: str | None) -> str:
        wanted = {"kind": "identify", "robot": "katana", "campaigns": [campaign], "options": {"start": start}}
        return str(client.post("/v1/jobs", json=wanted).raise_for_status().json()["id"])

    found = VersionContent(thesis_katana().truth.to_document(), {"metrics": {}, "parameters": []}, {})
    succeed(database, asked(poses, None), {}, found)
    (first,) = client.get("/v1/robots/katana/versions").json()["versions"]
    without = asked(log, None)
    succeed(database, without, {"motion": MOTION}, None)
    with_start = asked(log, first["id"])
    succeed(database, with_start, {"motion": MOTION, "warnings": [{"code": "one_motion", "message": "One."}]}, None)
    succeed(database, asked(poses, client.get(f"/v1/jobs/{with_start}").json()["result"]["version_id"]), {}, found)
    third, second, again = client.get("/v1/robots/katana/versions").json()["versions"]
    assert again == first
    assert [one["torques"] for one in (third, second, first)] == [True, True, False]
    assert (second["parent_id"], third["parent_id"]) == (first["id"], second["id"])
    whole = client.get(f"/v1/versions/{second['id']}").json()
    assert [(one["id"], one["use"]) for one in whole["campaigns"]] == [(poses, "train"), (log, "torques")]
    assert whole["details"]["motion"]["motions"] == 3
    assert [one["code"] for one in whole["warnings"]] == ["one_motion"]
    with database.reading() as session:
        assert versions.torques(session, third["id"]) == MODEL
        assert versions.torques(session, first["id"]) is None
        assert versions.trainings(session, second["id"]) == versions.trainings(session, first["id"])
        robot = session.get_one(JobRow, without).robot_id
        assert [one for one, _ in list_searches_in_torques(session, robot, 9)] == [with_start, without]
