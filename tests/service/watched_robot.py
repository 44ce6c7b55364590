"""A robot that is measured day after day, and checked by a worker or, quicker, in this process."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

import httpx
import numpy as np
from pydantic import TypeAdapter

from kilter_service.contract.jobs.registry import NewJob
from kilter_service.ground.db import Database
from kilter_service.jobs import store as jobs
from kilter_service.jobs.registry import get_job_kind
from kilter_service.jobs.work import store
from kilter_service.jobs.work.runner import Runner
from kilter_service.robots import store as robots
from tests.core.watch.drifting import DriftingArm, some_poses

Until = Callable[..., None]
NOISE = 5e-5
DAY = datetime(2026, 9, 1, 7, 0, tzinfo=UTC)


class Watched:
    """A robot that is measured again and again over HTTP."""

    def __init__(self, client: httpx.Client, until: Until | None, arm: DriftingArm, name: str) -> None:
        self.client, self.until, self.arm, self.name = client, until, arm, name
        client.post("/v1/robots", json={**arm.document(), "name": name}).raise_for_status()

    def sent(
        self,
        arm: DriftingArm,
        poses: int,
        seed: int,
        at: datetime,
        role: str = "validation",
        where: int | None = None,
        temperature_c: float | None = None,
    ) -> str:
        """Send rows of random poses, those of the seed ``where`` if it is given."""
        rng = np.random.default_rng(seed)
        q = some_poses(poses, rng if where is None else np.random.default_rng(where))
        seen = arm.measured(q, rng, NOISE).position
        assert seen is not None
        body: dict[str, Any] = {"name": f"{at:%Y-%m-%d}", "numbered": True, "role": role, "measured_at": at.isoformat()}
        body |= {} if temperature_c is None else {"conditions": {"temperature_c": temperature_c}}
        made = self.client.post(f"/v1/robots/{self.name}/campaigns", json=body).raise_for_status().json()["id"]
        columns = {f"q{k + 1}_deg": np.degrees(q[:, k]).tolist() for k in range(6)}
        columns |= {f"{axis}_mm": (seen[:, k] * 1e3).tolist() for k, axis in enumerate("xyz")}
        self.client.post(f"/v1/campaigns/{made}/observations", json=columns).raise_for_status()
        return str(made)

    def done(self, kind: str, campaigns: list[str], **options: Any) -> dict[str, Any]:
        body = {"kind": kind, "robot": self.name, "campaigns": campaigns, "options": options}
        job = self.client.post("/v1/jobs", json=body).raise_for_status().json()["id"]

        def read() -> dict[str, Any]:
            return dict(self.client.get(f"/v1/jobs/{job}").json())

        assert self.until is not None
        self.until(lambda: read()["state"] in ("succeeded", "failed"))
        assert read()["state"] == "succeeded", read()["error"]
        return dict(read()["result"])

    def calibrated(
        self, database: Database | None = None, validation: float | None = None, temperature_c: float | None = None
    ) -> str:
        """Fit and activate a version; in this process where a database is given, which may hold out a fraction."""
        effects: list[Any] = [{"id": "axial_compliance", "joints": [2, 3]}]
        fit = [self.sent(self.arm, 60, 1, DAY - timedelta(days=1), temperature_c=temperature_c)]
        asked: dict[str, Any] = {"effects": effects, "noise_mm": 0.05, "masses": "as_stated"}
        done = (
            self.done("identify", fit, **asked)
            if database is None
            else self.done_here(database, "identify", fit, validation, **asked)
        )
        return self.activated(done["version_id"])

    def activated(self, made: str) -> str:
        """Activate a version."""
        self.client.post(f"/v1/versions/{made}/activate", json={"force": True, "reason": "test"}).raise_for_status()
        return str(made)

    def checked(self, arm: DriftingArm, seed: int, day: int) -> dict[str, Any]:
        return self.done("drift", [self.sent(arm, 6, seed, DAY + timedelta(days=day))])

    def checked_here(self, database: Database, arm: DriftingArm, seed: int, day: float) -> dict[str, Any]:
        """Check in this process as a worker does: many days take seconds."""
        return self.done_here(database, "drift", [self.sent(arm, 6, seed, DAY + timedelta(days=day))])

    def done_here(
        self, database: Database, kind: str, campaigns: list[str], validation: float | None = None, **options: Any
    ) -> dict[str, Any]:
        """Compute a job in this process as a worker does."""
        asked = {"kind": kind, "robot": self.name, "campaigns": campaigns, "options": options}
        asked |= {} if validation is None else {"validation": validation}
        job = TypeAdapter[Any](NewJob).validate_python(asked)
        with database.transaction() as session:
            made = jobs.add(session, robots.get(session, self.name).id, job)
            output = get_job_kind(kind).run(jobs.load(session, made), lambda fraction, stage: None)
            jobs.succeed(session, made, output.result, output.version)
            result = jobs.get(session, made).result
        assert result is not None
        return result

    def failed_here(self, database: Database, kind: str, campaigns: list[str]) -> dict[str, Any]:
        """Run a job in this process as a worker runs it; returns why it failed."""
        job = TypeAdapter[Any](NewJob).validate_python({"kind": kind, "robot": self.name, "campaigns": campaigns})
        with database.transaction() as session:
            made = jobs.add(session, robots.get(session, self.name).id, job)
            claim = store.claim(session, "here", [kind])
        assert claim is not None
        assert claim.job_id == made
        Runner(database).run(claim)
        done = self.client.get(f"/v1/jobs/{made}").raise_for_status().json()
        assert done["state"] == "failed"
        return dict(done["error"])

    def history(self) -> dict[str, Any]:
        return dict(self.client.get(f"/v1/robots/{self.name}/drift").raise_for_status().json())
