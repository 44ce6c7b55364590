"""Readings of inclinometers as a campaign: the same as among the options of the job, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import httpx
import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.model import Calibration
from kilter_core.observations import Observations

Until = Callable[..., None]
Columns = dict[str, list[float | None]]
JOINT, AXES = 2, "xyz"  # j2 of the Katana


def finished(client: httpx.Client, until: Until, **job: Any) -> dict[str, Any]:
    body = {"kind": "joint_parameters", "robot": "katana", **job}
    address = client.post("/v1/jobs", json=body).raise_for_status().headers["location"]
    until(lambda: client.get(address).json()["state"] in ("succeeded", "failed"))
    done: dict[str, Any] = client.get(address).json()
    assert done["state"] == "succeeded", done["error"]
    return dict(done["result"])


def upload(client: httpx.Client, columns: Columns) -> httpx.Response:
    made = client.post("/v1/robots/katana/campaigns", json={"name": "tilts", "numbered": True}).raise_for_status()
    address = f"/v1/campaigns/{made.json()['id']}"
    answer = client.post(f"{address}/observations", json=columns)
    answer.headers["campaign"] = str(made.json()["id"])
    return answer


def as_columns(readings: list[dict[str, Any]]) -> Columns:
    """One row for each reading, as a person would who fills in a table."""
    out: Columns = {f"q{j + 1}_deg": [r["q_deg"][j] for r in readings] for j in range(len(readings[0]["q_deg"]))}
    for axis in sorted({r["axis"] for r in readings}):
        out[f"tilt{JOINT}{axis}_deg"] = [r["reading_deg"] if r["axis"] == axis else None for r in readings]
    return out | {"payload_kg": [r["payload_kg"] for r in readings], "session": [r["series"] for r in readings]}


def test_a_campaign_of_readings_gives_what_the_readings_give(
    client: httpx.Client, katana: Any, worker: Any, until: Until
) -> None:
    client.post("/v1/robots", json=katana.document).raise_for_status()
    worker.start()
    planned = finished(client, until, options={"propose": f"j{JOINT}", "count": 12, "payloads_kg": [0.0, 0.5]})
    rng = np.random.default_rng(2)
    readings = [
        {**one, "reading_deg": float(0.02 * rng.standard_normal()), "series": int(k % 2)}
        for k, one in enumerate(planned["configurations"])
    ]
    given = finished(client, until, options={"readings": readings})
    answer = upload(client, as_columns(readings))
    assert answer.status_code in (200, 201), answer.text
    campaign = answer.headers["campaign"]
    kept = finished(client, until, campaigns=[campaign])
    assert kept["measured_by"] == given["measured_by"] == "inclinometer"
    assert [p["name"] for p in kept["parameters"]] == [p["name"] for p in given["parameters"]]
    for one, other in zip(kept["parameters"], given["parameters"], strict=True):
        assert one["readings"] == other["readings"]
        assert one["value"] == pytest.approx(other["value"], rel=1e-9)
        assert one["sigma"] == pytest.approx(other["sigma"], rel=1e-9)
    version = client.get(f"/v1/versions/{kept['version_id']}").json()
    assert [used["id"] for used in version["campaigns"]] == [campaign]
    told = client.post("/v1/jobs/check", json={"kind": "joint_parameters", "robot": "katana", "campaigns": [campaign]})
    assert told.json()["would_run"]
    assert told.json()["rows"] == 12


@pytest.mark.parametrize(
    ("name", "column", "said"),
    [
        ("tilt9x_deg", "tilt9x_deg", "of joint 9"),
        ("tilt2x", "tilt2x", "no unit"),
        ("tilt2x_mm", "tilt2x_mm", "unit 'mm'"),
        ("tilt2w_deg", "tilt2w_deg", "Near it: tilt2"),
        ("tilt00x_deg", "tilt00x_deg", "is unknown"),
        ("tilt0z_deg", "tilt0z_deg", "about the vertical of this robot"),
    ],
)
def test_a_wrong_name_is_refused(shared_client: httpx.Client, katana: Any, name: str, column: str, said: str) -> None:
    shared_client.post("/v1/robots", json=katana.document).raise_for_status()
    rows: Columns = {f"q{j}_deg": [0.0, 1.0] for j in range(1, 6)}
    answer = upload(shared_client, {**rows, name: [0.1, 0.2]})
    assert answer.status_code == 400
    assert answer.json()["context"]["column"] == column
    assert said in answer.json()["detail"]


def test_a_row_without_any_reading_is_refused(client: httpx.Client, katana: Any) -> None:
    client.post("/v1/robots", json=katana.document).raise_for_status()
    rows: Columns = {f"q{j}_deg": [0.0, 1.0, 2.0] for j in range(1, 6)}
    answer = upload(client, {**rows, "tilt2x_deg": [0.1, None, None], "tilt2z_deg": [None, 0.1, None]})
    assert answer.status_code == 400
    assert (answer.json()["context"]["row"], answer.json()["context"]["column"]) == (3, "tilt2x_deg")


def test_inclinometers_and_encoders_are_two_jobs(client: httpx.Client, katana: Any) -> None:
    client.post("/v1/robots", json=katana.document).raise_for_status()
    rows: Columns = {f"q{j}_deg": [0.0, 1.0] for j in range(1, 6)}
    tilts = upload(client, {**rows, "tilt2x_deg": [0.1, 0.2]}).headers["campaign"]
    links = upload(client, {**rows, **{f"link{j}_deg": [0.0, 1.0] for j in range(1, 6)}}).headers["campaign"]
    body = {"kind": "joint_parameters", "robot": "katana", "campaigns": [tilts, links]}
    told = client.post("/v1/jobs/check", json=body).json()
    assert not told["would_run"]
    assert links in told["problems"][0]["message"]
    assert "two jobs" in told["problems"][0]["message"]


def test_readings_of_the_base_measure_no_joint_and_fit_beside_the_tool(
    client: httpx.Client, katana: Any, worker: Any, until: Until
) -> None:
    client.post("/v1/robots", json=katana.document).raise_for_status()
    worker.start()
    rng = np.random.default_rng(4)
    robot = robot_from_document(katana.document)
    q = np.degrees(robot.limits.mean(axis=1)) + rng.uniform(-25.0, 25.0, (40, 5))
    place = Calibration.nominal(robot).predict(Observations(np.radians(q))).position * 1e3
    rows: Columns = {f"q{j + 1}_deg": q[:, j].tolist() for j in range(5)}
    base = upload(client, rows | {"tilt0x_deg": rng.normal(0.0, 1e-3, 40).tolist()}).headers["campaign"]
    told = client.post(
        "/v1/jobs/check", json={"kind": "joint_parameters", "robot": "katana", "campaigns": [base]}
    ).json()
    assert not told["would_run"]
    assert "of the base alone" in told["problems"][0]["message"]
    xyz = (place + rng.normal(0.0, 0.02, place.shape)).T.tolist()
    tool = upload(client, rows | dict(zip(("x_mm", "y_mm", "z_mm"), xyz, strict=True))).headers["campaign"]
    done = finished(client, until, kind="identify", campaigns=[tool, base], options={"effects": ["base_compliance"]})
    levels = next(kind for kind in done["measurements"] if kind["kind"] == "inclination")
    assert levels["numbers"] == 39
    assert levels["noise"] == pytest.approx(1e-3, rel=0.4)
    assert "base_compliance_x" in levels["known_because_of_it"]
