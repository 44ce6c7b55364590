"""What a version would correct, before it is activated."""

from __future__ import annotations

from typing import Any

import httpx
import numpy as np
import pytest

from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_service.db import Database
from kilter_service.versions.preview import drawn
from tests.service.test_versions import Versions, thesis_katana


@pytest.fixture
def versions(client: httpx.Client, database: Database, katana: Any) -> Versions:
    client.post("/v1/robots", json=katana.document).raise_for_status()
    return Versions(database)


def test_a_version_is_looked_at_without_activating_it(client: httpx.Client, versions: Versions) -> None:
    twin = thesis_katana()
    version = versions.add("a", twin.truth)
    found = client.get(f"/v1/versions/{version}/preview").raise_for_status().json()
    assert (found["within"], found["version_id"]) == ("limits", version)
    assert found["corrected"] + sum(found["refused"].values()) == found["poses"] == 500
    assert client.get("/v1/robots/katana").json()["active_version"] is None
    there = Observations(q=np.radians([found["largest_at"]]))
    error = twin.truth.predict(there).position - twin.truth.wanted().predict(there).position
    assert found["largest_mm"] == pytest.approx(1e3 * float(np.linalg.norm(error)), rel=0.05)
    assert found["mean_mm"] < found["largest_mm"]
    assert [joint["joint"] for joint in found["joints"]] == [joint.name for joint in twin.robot.joints]
    assert all(joint["largest_deg"] > 0 and joint["largest_mm"] is None for joint in found["joints"])


def test_it_reckons_with_the_default_load_as_a_correction_does(
    client: httpx.Client, database: Database, katana: Any
) -> None:
    carrying = katana.document | {"load": {"payload_kg": 0.4, "payload_com_mm": [0.0, 0.0, 50.0]}}
    client.post("/v1/robots", json=carrying).raise_for_status()
    twin = thesis_katana()
    version = Versions(database).add("loaded", twin.truth)
    found = client.get(f"/v1/versions/{version}/preview").raise_for_status().json()
    poses = {f"q{j + 1}_rad": column.tolist() for j, column in enumerate(drawn(twin.robot).T)}
    answer = client.post("/v1/robots/katana/correct", params={"version": version}, json=poses).raise_for_status()
    assert answer.headers["Kilter-Notes"].startswith("The path states no payload: the robot's default load was taken")
    removed = np.array([answer.json()[f"d{axis}_mm"] for axis in "xyz"], dtype=float)
    assert found["mean_mm"] == pytest.approx(float(np.nanmean(np.linalg.norm(removed, axis=0))), rel=1e-9)


def test_what_its_limits_refuse_is_counted(client: httpx.Client, versions: Versions) -> None:
    twin = thesis_katana()
    version = versions.add("small", twin.truth, max_joint_deg=0.0001)
    found = client.get(f"/v1/versions/{version}/preview").raise_for_status().json()
    assert (found["corrected"], found["mean_mm"]) == (0, None)
    assert found["refused"] == {"CORRECTION_TOO_LARGE": 500}
    assert found["largest_mm"] > 0.0


def test_the_robot_as_drawn_is_left_where_it_is(client: httpx.Client, versions: Versions) -> None:
    version = versions.add("plain", Calibration.nominal(thesis_katana().robot))
    found = client.get(f"/v1/versions/{version}/preview").raise_for_status().json()
    assert found["largest_mm"] == pytest.approx(0.0, abs=1e-6)
    assert client.get("/v1/versions/ver_none/preview").status_code == 404
