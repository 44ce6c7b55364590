"""A running Kilter with something in it: an arm, campaigns, versions and jobs for requests to meet."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from kilter_core.twin import thesis_katana
from kilter_service.ground.db import Database, revision
from kilter_service.ground.settings import Settings
from kilter_service.robots import store as robots
from kilter_service.run.app import create_app
from kilter_service.versions import store
from kilter_service.versions.store import NewVersion
from kilter_service.web.auth.token import admin_token
from tests.service.conftest import served

ARM = {"name": "arm", "convention": "preset", "preset": "katana450-chapter5"}
FOUND = {"names": [], "matrix": [], "units": "SI"}
SAID: dict[str, Any] = {"parameters": [], "metrics": {"train": {"n": 1}}, "noise_mm": 0.01}
LIMITS = {"max_joint_deg": 1.0, "max_position_mm": 5.0}
ANSWER_S = 300.0  # the first request of its kind may compile kernels, on a busy machine for a minute


class World:
    """A client with the admin token, and the ids and names that exist, by the parameter that takes them."""

    def __init__(self, client: httpx.Client, database: Database) -> None:
        self.client, self._database = client, database
        self.known: dict[str, list[str]] = {}

    def fill(self) -> None:
        """Add two arms, one with campaigns, versions and jobs."""
        self.client.post("/v1/robots", json=ARM).raise_for_status()
        self.client.post("/v1/robots", json={**ARM, "name": "empty"}).raise_for_status()
        campaigns = [self._campaign(seed, rows=20) for seed in range(3)]
        campaigns.append(self._campaign(9, rows=0, staged=True))
        versions, jobs = self._versions(campaigns)
        wanted = {"name": "somebody", "role": "viewer", "robots": ["arm"]}
        token = str(self.client.post("/v1/tokens", json=wanted).raise_for_status().json()["id"])
        fleets = [
            str(self.client.post("/v1/fleet-jobs", json=asked).raise_for_status().json()["id"])
            for asked in ({"robots": ["arm", "empty"]}, {"options": {"level": 1}})
        ]
        mended = self.client.post("/v1/robots/arm/repairs", json={"what": "gear"}).raise_for_status()
        repair = str(mended.json()["id"])
        self.known = {
            "robot": ["arm", "arm", "empty"], "campaign": campaigns, "version": versions, "job": jobs,
            "a": [*versions, "nominal"], "b": [*versions, "nominal"], "token": [token], "fleet_job": fleets,
            "link": ["base", "1", "2"], "bridge": ["rsi", "egm", "fci"], "repair": [repair],
            "reference": [*campaigns, *versions, *jobs, "latest"],
        }  # fmt: skip

    def _campaign(self, seed: int, rows: int, **more: Any) -> str:
        wanted = {"name": f"seed {seed}", **more}
        found = self.client.post("/v1/robots/arm/campaigns", json=wanted).raise_for_status().json()["id"]
        if rows:
            columns = _measured(rows, seed)
            self.client.post(f"/v1/campaigns/{found}/observations", json=columns).raise_for_status()
        return str(found)

    def _versions(self, campaigns: list[str]) -> tuple[list[str], list[str]]:
        wish = {"kind": "identify", "robot": "arm", "campaigns": campaigns[:1], "validation": campaigns[1:2]}
        jobs = [str(self.client.post("/v1/jobs", json=wish).raise_for_status().json()["id"]) for _ in range(3)]
        new = NewVersion(thesis_katana().truth.to_document(), SAID, FOUND, [], LIMITS, None, "test")
        with self._database.transaction() as session:
            arm = robots.get(session, "arm").id
            return [store.add(session, arm, job, new) for job in jobs[:2]], jobs


def _measured(rows: int, seed: int) -> Mapping[str, list[float]]:
    twin = thesis_katana()
    limits = twin.robot.limits
    q = np.random.default_rng(seed).uniform(limits[:, 0], limits[:, 1], (rows, twin.robot.n_joints))
    found = twin.observe(q, noise_m=1e-5, seed=seed).position
    assert found is not None
    columns = {f"q{j + 1}_deg": np.degrees(q[:, j]).tolist() for j in range(q.shape[1])}
    return columns | {f"{axis}_mm": (1e3 * found[:, k]).tolist() for k, axis in enumerate("xyz")}


@contextmanager
def world(folder: Path, database_url: str | None = None) -> Iterator[World]:
    """Serve a filled Kilter from a folder, on SQLite or on the PostgreSQL named."""
    settings = Settings(data=folder, database_url=database_url, host="127.0.0.1", port=0, token=None)
    database = Database(settings.database)
    try:
        revision.migrate(database)
        with served(create_app(settings)) as client:
            client.timeout = httpx.Timeout(ANSWER_S)
            client.headers["Authorization"] = f"Bearer {admin_token(settings)}"
            found = World(client, database)
            found.fill()
            yield found
    finally:
        database.close()
