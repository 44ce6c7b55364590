"""A server with a measured robot and versions as jobs would store them, without waiting for jobs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import select

from kilter_core.model import Calibration
from kilter_core.twin import thesis_katana
from kilter_service.ground.db import Database
from kilter_service.ground.db.tables import JobRow, RobotRow
from kilter_service.ground.settings import Settings
from kilter_service.run.app import create_app
from kilter_service.versions import store
from kilter_service.versions.store import NewVersion
from kilter_service.web.auth.token import admin_token
from tests.service.conftest import Katana, new_database, ready, served

SCRIPT = "<script>document.title = 'taken'</script>"
LIMITS = {"max_joint_deg": 3.0, "max_position_mm": 20.0}


@dataclass(frozen=True)
class Made:
    """What is on the server: a good version that follows a poor one, and a campaign that neither was fitted to."""

    client: httpx.Client
    database: Database
    robot: str
    campaign: str
    poor: str
    good: str


@contextmanager
def made(folder: Path, migrated: Path, rows: int = 60) -> Iterator[Made]:
    """Serve it."""
    with new_database() as url:
        settings = Settings(data=folder, database_url=url, host="127.0.0.1", token=None)
        ready(settings, migrated)
        database = Database(settings.database)
        with served(create_app(settings)) as client:
            client.headers["Authorization"] = f"Bearer {admin_token(settings)}"
            campaign = Katana().campaign(client, rows, seed=3)
            twin = thesis_katana()
            poor = stored(database, 1, Calibration.nominal(twin.truth.robot), None, 0.9, [])
            good = stored(database, 2, twin.truth, poor, 0.02, [0.031, 0.0007])
            yield Made(client, database, Katana.name, campaign, poor, good)
        database.close()


def made_fixtures(rows: int = 60, active: bool = True) -> tuple[Any, Any]:
    """Fixtures of a module, its `there` and its `server`; the good version is active or not."""

    @pytest.fixture(scope="module")
    def there(tmp_path_factory: pytest.TempPathFactory, migrated: Path) -> Iterator[Made]:
        with made(tmp_path_factory.mktemp("made"), migrated, rows) as found:
            if active:
                found.client.post(f"/v1/versions/{found.good}/activate").raise_for_status()
            yield found

    @pytest.fixture(scope="module")
    def server(there: Made) -> httpx.Client:
        return there.client

    return there, server


def stored(
    database: Database, number: int, calibration: Calibration, parent: str | None, mean: float, known: list[float]
) -> str:
    errors = {"mean_mm": mean, "rms_mm": 1.1 * mean, "p95_mm": 2 * mean, "max_mm": 3 * mean}
    held = {"n": 40, "nominal": {"mean_mm": 1.25}, "registration_only": {"mean_mm": 0.95}, "identified": errors}
    report: dict[str, Any] = {"parameters": [], "metrics": {"train": held, "validation": held}, "noise_mm": 0.01}
    if known:
        value, sigma = known
        report["parameters"] = [
            {"name": "a_2", "unit": "mm", "value": 190 + value, "nominal": 190.0, "sigma": sigma, "identifiable": True},
            {"name": "beta_5", "unit": "deg", "value": 0.0, "nominal": 0.0, "sigma": 1.0, "identifiable": False},
            {"name": "d_5", "unit": "mm", "value": 201.7, "nominal": 200.0, "sigma": 5.0, "identifiable": False},
        ]
    covariance = {"names": ["a_2"], "matrix": [[1e-10]], "units": "SI", "inadequacy_m": 1e-5, "noise_m": 1e-5}
    new = NewVersion(calibration.to_document(), report, covariance, [], LIMITS, parent, "test", f"version {number}")
    with database.transaction() as session:
        robot = session.execute(select(RobotRow.id).where(RobotRow.name == Katana.name)).scalar_one()
        job = f"job_{number:016x}"
        request = {"kind": "identify", "robot": Katana.name, "campaigns": [], "validation": None, "options": {}}
        session.add(JobRow(id=job, kind="identify", robot_id=robot, request=request, state="succeeded"))
        session.flush()
        return store.add(session, robot, job, new)
