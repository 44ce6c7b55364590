"""How a robot stands and what comes next, as ``today`` says it, of arms that plain numpy moves."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from kilter_service.ground.db import Database
from kilter_service.ground.settings import Settings
from kilter_service.run.app import create_app
from kilter_service.web.auth.token import admin_token
from tests.core.watch.drifting import some_arm
from tests.service import watched_robot
from tests.service.conftest import new_database, ready, served
from tests.service.watched_robot import Watched

CAMERA = {"name": "cell", "mount": "fixed", "width_px": 640, "height_px": 480, "fx_px": 600.0, "fy_px": 600.0,
          "cx_px": 320.0, "cy_px": 240.0}  # fmt: skip
CORNERS_MM = [[0.0, 0.0, 0.0], [30.0, 0.0, 0.0], [0.0, 30.0, 0.0], [30.0, 30.0, 0.0]]
Fleet = tuple[httpx.Client, Database]


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory, migrated: Path) -> Iterator[Fleet]:
    with new_database() as url:
        settings = Settings(data=tmp_path_factory.mktemp("standing"), database_url=url, host="127.0.0.1", token=None)
        ready(settings, migrated)
        database = Database(settings.database)
        with served(create_app(settings)) as client:
            client.headers["Authorization"] = f"Bearer {admin_token(settings)}"
            yield client, database
        database.close()


def stands(client: httpx.Client, robot: str) -> dict[str, Any]:
    return dict(client.get(f"/v1/robots/{robot}/today").raise_for_status().json()["standing"])


def wants(client: httpx.Client, robot: str, **goals: float | None) -> dict[str, Any]:
    client.patch(f"/v1/robots/{robot}", json=goals).raise_for_status()
    return stands(client, robot)


def test_an_alarm_leads_to_the_version_that_corrects_it(fleet: Fleet, monkeypatch: pytest.MonkeyPatch) -> None:
    client, database = fleet
    monkeypatch.setattr(watched_robot, "DAY", datetime.now(UTC) - timedelta(days=20))
    arm = some_arm(np.random.default_rng(3))
    robot = Watched(client, None, arm, "hit")
    assert [one["do"] for one in stands(client, "hit")["steps"]] == ["upload", "plan"]
    campaign = robot.sent(arm, 20, 1, watched_robot.DAY, role="train")
    fresh = stands(client, "hit")
    assert (fresh["state"], fresh["steps"][0]["do"], fresh["steps"][0]["campaign_id"]) == (
        "uncalibrated", "search", campaign,
    )  # fmt: skip
    stages = {one["stage"]: one for one in fresh["first"]}
    assert [name for name, one in stages.items() if one["done"]] == ["describe", "measure", "check"]
    assert stages["search"]["missing"] == "No version was made of the measurements yet."
    assert [one["do"] for one in stages["search"]["steps"]] == ["search"]
    looked_at = {"cameras": [CAMERA], "boards": [{"name": "board", "mount": "flange", "corners_mm": CORNERS_MM}]}
    by_camera = {"name": "pictures", "conditions": looked_at}
    views = client.post("/v1/robots/hit/campaigns", json=by_camera).raise_for_status().json()["id"]
    joints = len(client.get("/v1/robots/hit").json()["joints"])
    columns = {f"q{j}_deg": [10.0 * k + j for k in range(3)] for j in range(1, joints + 1)}
    columns |= {f"{axis}{k}_px": [100.0 * k + n for n in range(3)] for k in range(1, 5) for axis in "uv"}
    client.post(f"/v1/campaigns/{views}/observations", json=columns).raise_for_status()
    of_pictures = stands(client, "hit")["steps"][0]
    assert (of_pictures["do"], of_pictures["campaign_id"]) == ("identify", views)
    assert of_pictures["command"].endswith(f"{views} --validation 0.25 --effects axial_compliance")
    client.post(f"/v1/campaigns/{views}/retire").raise_for_status()
    assert not stages["activate"]["steps"]  # another stage comes first
    client.post(f"/v1/campaigns/{campaign}/retire").raise_for_status()
    first = robot.calibrated(database, 0.25)
    assert [one["stage"] for one in stands(client, "hit")["first"] if not one["done"]] == ["correct"]
    robot.checked_here(database, arm, 100, 5)
    checked = stands(client, "hit")
    # who checks is past the first calibration
    assert (checked["state"], checked["look"], checked["first"]) == ("as_calibrated", "good", [])

    robot.checked_here(database, arm.after("zero_3", 4e-3), 200, 12)
    moved = stands(client, "hit")
    assert (moved["state"], moved["look"], moved["words"]) == ("moved", "bad", "Has moved")
    assert [one["words"] for one in moved["steps"][:2]] == ["Re-zero joint 3", "It was repaired"]
    rezero = moved["steps"][0]
    made = robot.done_here(database, "rezero", [rezero["campaign_id"]], causes=rezero["causes"])["version_id"]
    activate = stands(client, "hit")["steps"][0]
    assert (activate["do"], activate["version_id"]) == ("activate", made)
    assert activate["command"] == f"kilter activate {made}"
    client.post(f"/v1/versions/{made}/activate", json={}).raise_for_status()
    fitted = stands(client, "hit")  # to the rows of the alarm: nothing else says how good it is
    assert (fitted["state"], fitted["steps"][0]["do"]) == ("not_known", "plan_check")
    robot.checked_here(database, arm.after("zero_3", 4e-3), 300, 15)
    assert stands(client, "hit")["state"] == "as_calibrated"
    assert made != first
    errors = client.get("/v1/robots/hit/today").json()["history"]
    assert [one["alarm"] for one in errors] == [False, True, False]
    assert errors[1]["mean_mm"] > 10 * errors[0]["mean_mm"]


def test_good_is_what_is_within_the_tolerance_and_was_checked_in_time(
    fleet: Fleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    client, database = fleet
    monkeypatch.setattr(watched_robot, "DAY", datetime.now(UTC) - timedelta(days=50))
    arm = some_arm(np.random.default_rng(4))
    robot = Watched(client, None, arm, "old")
    robot.calibrated(database, 0.25)
    robot.checked_here(database, arm, 100, 9)
    mean = client.get("/v1/robots/old/today").json()["newest"]["errors"]["identified"]["mean_mm"]
    assert wants(client, "old", tolerance_mm=3 * mean)["words"] == f"Within {3 * mean:g} mm"
    assert wants(client, "old", tolerance_mm=mean)["state"] == "near"
    outside = wants(client, "old", tolerance_mm=mean / 4)
    assert (outside["state"], outside["sentence"]) == ("outside", f"4 times its tolerance of {mean / 4:g} mm.")
    late = wants(client, "old", tolerance_mm=3 * mean, check_interval_days=30)
    assert (late["state"], late["words"], late["look"]) == ("unchecked", "Not checked for 41 days", "warn")
    assert late["steps"][0]["do"] == "plan_check"
    assert wants(client, "old", check_interval_days=45)["state"] == "within"
    again = wants(client, "old", tolerance_mm=None, check_interval_days=None)
    assert (again["state"], again["tolerance_mm"]) == ("as_calibrated", None)
    for wrong in ({"tolerance_mm": 0.0}, {"check_interval_days": 0}):
        assert client.patch("/v1/robots/old", json=wrong).status_code == 422


def test_a_version_that_leaves_more_than_the_nominal_arm_is_called_worse(
    fleet: Fleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The zeros that the version corrects come back by themselves: what it corrects is then its error."""
    client, database = fleet
    monkeypatch.setattr(watched_robot, "DAY", datetime.now(UTC) - timedelta(days=20))
    arm = some_arm(np.random.default_rng(5))
    robot = Watched(client, None, arm, "undone")
    robot.calibrated(database, 0.25)
    mended = arm
    for joint, zero in enumerate(arm.zeros, 1):
        mended = mended.after(f"zero_{joint}", -float(zero))
    robot.checked_here(database, mended, 100, 9)
    found = stands(client, "undone")
    newest = client.get("/v1/robots/undone/today").json()["newest"]["errors"]
    assert (found["state"], found["words"]) == ("worse", "Worse than uncorrected")
    assert found["without_mm"] == newest["uncorrected"]["mean_mm"] < newest["identified"]["mean_mm"]
    # What the nominal arm errs by is computed by the generator alone: its frames are the world's.
    nominal = some_arm(np.random.default_rng(5))
    assert np.isclose(found["without_mm"], _nominal_error(nominal, mended), rtol=0.3)


def _nominal_error(arm: Any, true: Any) -> float:
    q = np.random.default_rng(100).uniform(-2.5, 2.5, (6, 6))
    plain = arm.__class__(**{**arm.__dict__, "zeros": np.zeros(6), "compliance": np.zeros(6)})
    return float(np.mean(np.linalg.norm(true.point(q) - plain.point(q), axis=1)) * 1e3)
