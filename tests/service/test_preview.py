"""What a version would correct, before it is activated."""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import replace
from typing import Any

import httpx
import numpy as np
import pytest

from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_service.ground.db import Database
from kilter_service.ground.db.tables import JobRow
from kilter_service.robots import store as robots
from kilter_service.versions import store
from kilter_service.versions.predictions.at_pose import drawn
from kilter_service.versions.store import NewVersion
from tests.service.test_versions import Versions, thesis_katana

COUNT = int(os.environ.get("KILTER_PREVIEWS", "12"))  # versions that are looked at; 500 once, by hand


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
    error = twin.truth.predict(there).position - twin.truth.nominal_in_wanted_frames().predict(there).position
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


def test_what_its_limits_hold_back_is_counted(client: httpx.Client, versions: Versions) -> None:
    twin = thesis_katana()
    version = versions.add("small", twin.truth, max_joint_deg=0.0001)
    found = client.get(f"/v1/versions/{version}/preview").raise_for_status().json()
    assert (found["corrected"], found["refused"]) == (500, {})
    assert found["limited"] > 480
    assert found["left_mm"] > 0.5
    assert all(joint["largest_deg"] <= 0.0001 * (1 + 1e-9) for joint in found["joints"])
    one = {f"q{j + 1}_rad": [value] for j, value in enumerate([0.1, 0.6, 0.4, 0.3, 0.2])}
    for asked, word in (({}, "LIMITED"), ({"at_limit": "refuse"}, "CORRECTION_TOO_LARGE")):
        answer = client.post("/v1/robots/katana/correct", params={"version": version, **asked}, json=one)
        assert answer.raise_for_status().json()["status"] == [word]
        assert (answer.json()["left_mm"] == [None]) == (word != "LIMITED")


def test_the_robot_as_drawn_is_left_where_it_is(client: httpx.Client, versions: Versions) -> None:
    version = versions.add("plain", Calibration.nominal(thesis_katana().robot))
    found = client.get(f"/v1/versions/{version}/preview").raise_for_status().json()
    assert found["largest_mm"] == pytest.approx(0.0, abs=1e-6)
    assert client.get("/v1/versions/ver_none/preview").status_code == 404


def six_axes(seed: int) -> dict[str, Any]:
    """A six-axis arm of random lengths, its last three axes through one point."""
    a, b, c, d = np.random.default_rng(seed).uniform(150.0, 600.0, 4).tolist()
    rows = [(b, 50.0, 90.0), (0.0, a, 0.0), (0.0, 30.0, 90.0), (c, 0.0, -90.0), (0.0, 0.0, 90.0), (0.3 * d, 0.0, 0.0)]
    return {
        "name": f"arm{seed}",
        "convention": "dh",
        "rows": [{"d_mm": d_mm, "a_mm": a_mm, "alpha_deg": turn} for d_mm, a_mm, turn in rows],
        "joints": [{"name": f"j{k + 1}", "limits_deg": [-170.0, 170.0]} for k in range(6)],
    }


def stored(database: Database, robot_id: int, number: int, calibration: Calibration) -> str:
    """Store a version as a job would."""
    limits = {"max_joint_deg": 1.0, "max_position_mm": 5.0}
    report = {"parameters": [], "metrics": {}, "noise_mm": 0.01}
    new = NewVersion(calibration.to_document(), report, {"names": [], "matrix": []}, [], limits, None, "test")
    with database.transaction() as session:
        session.add(JobRow(id=f"job_{number:016x}", kind="identify", robot_id=robot_id, request={}, state="succeeded"))
        session.flush()
        return store.add(session, robot_id, f"job_{number:016x}", new)


def random_version(client: httpx.Client, database: Database, seed: int) -> tuple[str, str]:
    """An arm and a version of it with errors of a few arcminutes to degrees and tenths to millimetres."""
    document = six_axes(seed)
    client.post("/v1/robots", json=document).raise_for_status()
    name = document["name"]
    with database.reading() as session:
        robot_id = robots.get(session, name).id
        nominal = Calibration.nominal(robots.core_robot(session, robot_id))
    rng = np.random.default_rng(seed)
    size = 10.0 ** rng.uniform(-4.0, -1.7)  # rad, and a fifth of it in metres
    turns = np.array([any(part in one for part in ("alpha", "theta", "beta", "_r", "phi")) for one in nominal.names])
    values = nominal.values + rng.normal(0.0, np.where(turns, size, 0.2 * size))
    return name, stored(database, robot_id, seed, replace(nominal, values=values))


def test_a_preview_is_the_correction_whatever_the_version(client: httpx.Client, database: Database) -> None:
    """No random version fails, and each preview has the numbers of `correct` at its poses to 1e-9."""
    for seed in range(COUNT):
        name, version = random_version(client, database, seed)
        found = client.get(f"/v1/versions/{version}/preview").raise_for_status().json()
        with database.reading() as session:
            robot = robots.core_robot(session, robots.get(session, name).id)
        poses = drawn(robot)
        sent = {f"q{j + 1}_rad": column.tolist() for j, column in enumerate(poses.T)}
        answer = (
            client.post(f"/v1/robots/{name}/correct", params={"version": version}, json=sent).raise_for_status().json()
        )
        counted = Counter(answer["status"])
        told = {"OK": found["corrected"] - found["damped"] - found["limited"], "DAMPED": found["damped"]}
        told |= {"LIMITED": found["limited"], **found["refused"]}
        assert {k: v for k, v in told.items() if v} == dict(counted), seed
        if not found["corrected"]:
            assert found["largest_mm"] is None
            continue
        columns = {k: np.array(v, dtype=float) for k, v in answer.items() if k.endswith(("_mm", "_rad"))}
        moved = np.sqrt(sum(columns[f"d{axis}_mm"] ** 2 for axis in "xyz"))
        assert found["mean_mm"] == pytest.approx(np.nanmean(moved), rel=1e-9, abs=1e-9)
        assert found["largest_mm"] == pytest.approx(np.nanmax(moved), rel=1e-9, abs=1e-9)
        assert found["left_mm"] == pytest.approx(np.nanmax(columns["left_mm"]), rel=1e-9, abs=1e-9)
        turned = np.degrees(np.stack([columns[f"q{j + 1}_rad"] for j in range(6)], axis=1) - poses)
        assert [one["largest_deg"] for one in found["joints"]] == pytest.approx(
            np.nanmax(np.abs(turned), axis=0), abs=1e-9
        )
