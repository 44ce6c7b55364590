"""Which search in torques a path and a search in poses go by: the newest that has a model, whatever ran since."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from kilter_service.ground.db import Database
from kilter_service.ground.db.tables import JobRow
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.store import get_search_in_torques

MODEL = {"base": [1.0, 2.0], "links": []}
# As searches in poses store it, fits, earlier searches in torques, and those that have a model.
RESULTS: list[dict[str, Any]] = [
    {"motion": {"model": MODEL}},
    {"verdict": "closed"},
    {"motion": None},
    {"motion": {"joints": [], "model": None}},
]


@pytest.mark.both_databases
def test_the_newest_with_a_model_is_found(client: httpx.Client, database: Database, katana: Any) -> None:
    campaign = katana.campaign(client, 30)
    wanted = {"kind": "gap", "robot": "katana", "campaigns": [campaign]}
    refused = client.post("/v1/jobs", json={**wanted, "options": {"masses_from": "newest"}})
    assert (refused.status_code, refused.json()["code"]) == (409, "no_torque_model")
    ids = [client.post("/v1/jobs", json=wanted).json()["id"] for _ in RESULTS]
    with database.transaction() as session:
        for one, result in zip(ids, RESULTS, strict=True):
            row = session.get_one(JobRow, one)
            row.state, row.result = "succeeded", result
            robot = row.robot_id
    with database.reading() as session:
        found, _, model = get_search_in_torques(session, robot)
        assert (found, model) == (ids[0], MODEL)
        with pytest.raises(ServiceError, match=ids[1]):
            get_search_in_torques(session, robot, ids[1])
    asked = client.post("/v1/jobs", json={**wanted, "options": {"masses_from": "newest"}})
    assert asked.status_code == 202
    assert asked.json()["options"]["masses_from"] == ids[0]
