"""The time that an answer which stores nothing may compute, with requests that really take long."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Any

import httpx
import pytest
from fastapi import FastAPI

from kilter_service.ground.db import Database
from kilter_service.ground.settings import Settings
from kilter_service.run.app import create_app
from kilter_service.web.auth.policy import RULES
from kilter_service.web.auth.token import admin_token
from kilter_service.web.bodies import Room
from tests.service.conftest import Katana, Serve, wait_for

LIMIT_S = 0.3
ROWS = 30_000  # seconds of a check at level 3


class Limited:
    """An application whose limit is short until `relax`, and a robot with many rows."""

    def __init__(self, app: FastAPI, client: httpx.Client, settings: Settings) -> None:
        self.app, self.client, self.settings = app, client, settings
        client.headers["Authorization"] = f"Bearer {admin_token(settings)}"

    def limit(self, seconds: float) -> None:
        self.app.state.settings = self.settings.model_copy(update={"compute_limit_s": seconds})

    def free(self, room: Room) -> bool:
        return not room.is_full

    @property
    def rooms(self) -> Mapping[str, Room]:
        rooms: Mapping[str, Room] = self.app.state.rooms
        return rooms


@pytest.fixture
def limited(settings: Settings, database: Database, serve: Serve) -> Limited:
    settings = settings.model_copy(update={"max_computing": 1})
    app = create_app(settings)
    return Limited(app, serve(app), settings)


def check_of(campaign: str) -> dict[str, Any]:
    return {"kind": "identify", "robot": "katana", "campaigns": [campaign], "options": {"level": 3}}


def test_a_check_that_takes_too_long_is_refused_and_keeps_its_slot_until_it_ends(
    limited: Limited, katana: Katana
) -> None:
    small, large = katana.campaign(limited.client, 60, 1), katana.campaign(limited.client, ROWS, 2)
    limited.limit(LIMIT_S)
    refused = limited.client.post("/v1/jobs/check", json=check_of(large))
    assert (refused.status_code, refused.json()["code"]) == (422, "compute_limit")
    for word in ("0.3 s", "KILTER_COMPUTE_LIMIT_S", "submit it as a job"):
        assert word in refused.json()["detail"]
    assert not limited.free(limited.rooms["checks"])

    # The only slot is taken: who comes next waits, and computes nothing beside it.
    threads = threading.active_count()
    waited = limited.client.post("/v1/jobs/check", json=check_of(small))
    assert (waited.status_code, waited.json()["code"]) == (503, "busy")
    assert threading.active_count() <= threads + 1
    # The remedy works meanwhile: jobs and their lists have slots of their own.
    job = limited.client.post("/v1/jobs", json=check_of(large))
    assert job.status_code == 202
    assert limited.client.get(f"/v1/jobs/{job.json()['id']}").status_code == 200

    wait_for(lambda: limited.free(limited.rooms["checks"]))
    limited.limit(120.0)
    for _ in range(2):  # no slot was lost, none was won
        assert limited.client.post("/v1/jobs/check", json=check_of(small)).status_code == 200
        assert limited.free(limited.rooms["checks"])


def test_a_path_that_takes_too_long_is_refused_and_leaves_no_file(limited: Limited, katana: Katana) -> None:
    katana.campaign(limited.client, 20, 1)
    columns = {name: values * 2000 for name, values in katana.columns(100, 3).items() if name.startswith("q")}
    path = f"/v1/robots/{katana.name}/correct"
    limited.limit(1e-6)
    refused = limited.client.post(path, json=columns)
    assert (refused.status_code, refused.json()["code"]) == (422, "compute_limit")
    assert "in parts" in refused.json()["detail"]
    wait_for(lambda: limited.free(limited.rooms["corrections"]))
    assert not [file for file in (limited.settings.data / "tmp").rglob("*") if file.is_file() and file.name != ".lock"]


def test_a_read_that_takes_too_long_is_refused(limited: Limited, database: Database, katana: Katana) -> None:
    from tests.service.made_versions import store_version

    katana.campaign(limited.client, 2000, 1)
    version = store_version(database, katana.name, 1)
    limited.limit(1e-6)
    refused = limited.client.get(f"/v1/versions/{version}/preview")
    assert (refused.status_code, refused.json()["code"]) == (422, "compute_limit")
    wait_for(lambda: limited.free(limited.rooms["reads"]))
    limited.limit(120.0)
    assert limited.client.get(f"/v1/versions/{version}/preview").status_code == 200


def test_what_is_stored_has_no_limit(limited: Limited, katana: Katana) -> None:
    """Its answer says that it is stored: whoever got another would send it again."""
    limited.limit(1e-9)
    campaign = katana.campaign(limited.client, 2000, 1)
    assert limited.client.get(f"/v1/campaigns/{campaign}").json()["rows"] == 2000


def test_every_route_that_only_computes_is_limited() -> None:
    timed = {route for route, rule in RULES.items() if rule.instead}
    assert timed == {
        "GET /v1/versions/{version}/preview", "GET /v1/versions/{a}/diff/{b}", "GET /v1/versions/{version}/residuals",
        "GET /v1/versions/{version}/export", "POST /v1/robots/check", "POST /v1/robots/convert",
        "POST /v1/robots/from-circles", "POST /v1/robots/{robot}/correct", "POST /v1/robots/{robot}/torques",
        "POST /v1/frames", "POST /v1/jobs/check",
        "POST /v1/robots/{robot}/forward", "POST /v1/robots/{robot}/inverse",
        "POST /v1/robots/{robot}/observations/check", "GET /v1/campaigns/{campaign}/suspicious",
        "GET /v1/campaigns/{campaign}/observations", "GET /v1/robots/{robot}/acceptance",
        "GET /v1/robots/{robot}/drift", "GET /v1/drift",
    }  # fmt: skip
