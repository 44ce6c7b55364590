"""Pixels from the upload to the version: columns, conditions, refusals, and a job that fits them."""

from __future__ import annotations

import io
from dataclasses import replace
from typing import Any

import httpx
import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from kilter_core.observations import Observations
from tests.core.campaigns import held
from tests.core.pixel_scene import HOME, Scene, eye_to_hand, grid

MM = 1e3
SCENE = eye_to_hand()


def described(scene: Scene) -> dict[str, Any]:
    """Cameras and boards as a campaign names them."""
    cameras = [
        {
            "name": e.name, "mount": e.mount, "width_px": e.size[0], "height_px": e.size[1],
            "fx_px": e.focal[0], "fy_px": e.focal[1], "cx_px": e.centre[0], "cy_px": e.centre[1],
            "distortion_model": "brown", "distortion": list(e.distortion),
        }
        for e in scene.eyes
    ]  # fmt: skip
    boards = [{"name": s.name, "mount": s.mount, "corners_mm": (MM * s.corners).tolist()} for s in scene.sheets]
    return {"cameras": cameras, "boards": boards}


def columns(rows: Observations) -> dict[str, list[Any]]:
    """Views as they are uploaded; corners that were not seen are empty."""
    out: dict[str, list[Any]] = {f"q{j + 1}_deg": np.degrees(rows.q[:, j]).tolist() for j in range(6)}
    for k in range(rows.pixels.shape[1]):
        for axis, letter in enumerate("uv"):
            out[f"{letter}{k + 1}_px"] = [None if np.isnan(v) else float(v) for v in rows.pixels[:, k, axis]]
    return out | {"pose_id": rows.pose_id.tolist()}


def csv(table: dict[str, list[Any]]) -> str:
    """The same as text."""
    lines = [",".join(table)]
    lines += [",".join("" if cell is None else str(cell) for cell in row) for row in zip(*table.values(), strict=True)]
    return "\n".join(lines) + "\n"


def seen(count: int = 60, seed: int = 1) -> Observations:
    rng = np.random.default_rng(seed)
    return SCENE.observed(SCENE.poses(count, rng), rng, 0.1)


def campaign(client: httpx.Client, conditions: dict[str, Any], name: str = "views") -> str:
    client.post("/v1/robots", json=SCENE.drawn.document() | {"name": "watched"})
    asked = {"name": name, "conditions": conditions, "device": "camera"}
    return str(client.post("/v1/robots/watched/campaigns", json=asked).raise_for_status().json()["id"])


def send(client: httpx.Client, campaign_id: str, text: str) -> httpx.Response:
    return client.post(
        f"/v1/campaigns/{campaign_id}/observations", content=text.encode(), headers={"content-type": "text/csv"}
    )


def test_views_become_a_version(client: httpx.Client, worker: Any, until: Any) -> None:
    made = campaign(client, described(SCENE))
    table = columns(seen()) | {"camera": ["cell"] * 60, "board": ["board"] * 60}
    assert send(client, made, csv(table)).raise_for_status().json()["rows"] == 60
    assert client.get(f"/v1/campaigns/{made}").json()["conditions"]["cameras"][0]["name"] == "cell"
    worker.start()
    options = {"effects": [{"id": "axial_compliance", "joints": [2, 3]}], "masses": "as_stated"}
    asked = {"kind": "identify", "robot": "watched", "campaigns": [made], "validation": 0.25, "options": options}
    job = client.post("/v1/jobs", json=asked).raise_for_status().json()["id"]
    until(lambda: client.get(f"/v1/jobs/{job}").json()["state"] in ("succeeded", "failed"))
    found = client.get(f"/v1/jobs/{job}").json()
    assert found["state"] == "succeeded", found["error"]
    result = found["result"]
    assert result["pixels"]["noise_px"] == pytest.approx(0.1, rel=0.1)
    assert result["noise_mm"] is None  # a corner's noise is of pixels, and no length
    assert result["pixels"]["validation"]["rms_mm"] < 0.05
    assert 0.1 < result["pixels"]["given_mm"] < 20.0
    assert result["pixels"]["shuffled_mm"] > 100.0
    assert result["metrics"]["validation"]["identified"]["mean_mm"] < 0.05
    camera = result["cameras"][0]
    assert camera["frame"] == "base"
    place = np.array([camera[f"{k}_mm"] for k in "xyz"])
    assert np.abs(place - MM * SCENE.eyes[0].pose.translation).max() < 1.0
    # The version corrects like any other, and predicts views it never saw.
    path = {f"q{j + 1}_deg": [10.0, 12.0] for j in range(6)} | {"t_s": [0.0, 1.0]}
    asked = {"version": result["version_id"]}
    corrected = client.post("/v1/robots/watched/correct", params=asked, json=path).raise_for_status()
    assert corrected.status_code == 200
    other = campaign(client, described(SCENE), "others")
    send(client, other, csv(columns(seen(20, 9)))).raise_for_status()
    asked = {"kind": "evaluate", "robot": "watched", "campaigns": [other], "options": {"version": result["version_id"]}}
    job = client.post("/v1/jobs", json=asked).raise_for_status().json()["id"]
    until(lambda: client.get(f"/v1/jobs/{job}").json()["state"] in ("succeeded", "failed"))
    found = client.get(f"/v1/jobs/{job}").json()
    assert found["state"] == "succeeded", found["error"]
    errors = found["result"]["metrics"][other]
    assert errors["identified"]["mean_mm"] < 0.05 < errors["registration_only"]["mean_mm"]
    # Row by row what is left is as large as an evaluation says, and a view that was bumped is seen in its row.
    left = rows_left(client, result["version_id"], other)
    length = np.linalg.norm([left[f"d{axis}_mm"] for axis in "xyz"], axis=0)
    assert np.mean(length) == pytest.approx(errors["identified"]["mean_mm"], rel=0.05)
    asked = {"version": result["version_id"], "campaign": other}
    places = client.get("/robots/watched/places.json", params=asked).raise_for_status().json()
    assert np.mean(np.linalg.norm(places["left"]["identified"], axis=1)) == pytest.approx(np.mean(length), rel=0.05)
    bumped = columns(seen(20, 9))
    for k in range(1, 49):
        if bumped[f"u{k}_px"][7] is not None:
            bumped[f"u{k}_px"][7] += 30.0
    odd = campaign(client, described(SCENE), "bumped")
    send(client, odd, csv(bumped)).raise_for_status()
    sizes = rows_left(client, result["version_id"], odd)["residual_sigma"]
    assert np.argmax(sizes) == 7


def rows_left(client: httpx.Client, version: str, campaign_id: str) -> dict[str, list[float]]:
    """What a version leaves of each row, by column."""
    asked = {"campaign": campaign_id, "format": "json"}
    found: dict[str, list[float]] = (
        client.get(f"/v1/versions/{version}/residuals", params=asked).raise_for_status().json()
    )
    return found


def test_poses_are_planned_for_the_cameras_of_a_campaign_or_a_version(
    client: httpx.Client, worker: Any, until: Any
) -> None:
    made = campaign(client, described(SCENE))
    send(client, made, csv(columns(seen(40)))).raise_for_status()
    worker.start()

    def ended(kind: str, campaigns: list[str], **options: Any) -> dict[str, Any]:
        asked = {"kind": kind, "robot": "watched", "campaigns": campaigns, "options": options}
        job = client.post("/v1/jobs", json=asked).raise_for_status().json()["id"]
        until(lambda: client.get(f"/v1/jobs/{job}").json()["state"] in ("succeeded", "failed"))
        return dict(client.get(f"/v1/jobs/{job}").json())

    def all_in_sight(plan: dict[str, Any]) -> bool:
        q = np.radians([[pose[f"q{j}_deg"] for j in range(1, 7)] for pose in plan["result"]["poses"]])
        return len(q) == 12 and not np.isnan(SCENE.pixels(q, SCENE.eyes[0], SCENE.sheets[0])).any()

    asked = {"purpose": "identify", "method": "views", "count": 12}
    assert all_in_sight(ended("plan", [made], **asked))
    version = ended("identify", [made], effects=["axial_compliance"])["result"]["version_id"]
    assert all_in_sight(ended("plan", [], version=version, within="limits", effects=["backlash"], **asked))
    refused = ended("plan", [], **asked)
    assert (refused["state"], refused["error"]["code"]) == ("failed", "cameras_missing")
    assert "name a version that was identified" in refused["error"]["message"]
    assert all_in_sight(ended("plan", [], purpose="identify", count=12)) is False


def test_a_version_by_views_judges_a_tracker_and_is_rezeroed(client: httpx.Client, worker: Any, until: Any) -> None:
    made = campaign(client, described(SCENE))
    send(client, made, csv(columns(seen()))).raise_for_status()
    worker.start()

    def ended(kind: str, campaigns: list[str], **options: Any) -> dict[str, Any]:
        asked = {"kind": kind, "robot": "watched", "campaigns": campaigns, "options": options}
        job = client.post("/v1/jobs", json=asked).raise_for_status().json()["id"]
        until(lambda: client.get(f"/v1/jobs/{job}").json()["state"] in ("succeeded", "failed"))
        found = client.get(f"/v1/jobs/{job}").json()
        assert found["state"] == "succeeded", found["error"]
        return dict(found["result"])

    soft = [{"id": "axial_compliance", "joints": [2, 3]}]
    version = ended("identify", [made], effects=soft, masses="as_stated")["version_id"]
    assert client.get(f"/v1/versions/{version}").json()["covariance"]["noise_of"] == "pixels"

    rng = np.random.default_rng(4)
    q = np.tile(SCENE.poses(20, rng), (2, 1))
    points = MM * (SCENE.tools(q)[0] + 5e-6 * rng.standard_normal((40, 3)))
    table = {f"q{j + 1}_deg": np.degrees(q[:, j]).tolist() for j in range(6)}
    table |= {f"{axis}_mm": points[:, k].tolist() for k, axis in enumerate("xyz")}
    tracked = campaign(client, {}, "tracked")
    send(client, tracked, csv(table)).raise_for_status()
    asked = {"tolerance_mm": 1.0, "version": version, "campaign": tracked, "refit": "base,tool"}
    (judged,) = client.get("/v1/robots/watched/acceptance", params=asked).raise_for_status().json()["campaigns"]
    sizes = {one["source"]: one["standard_mm"] for one in judged["budget"]["contributions"]}
    assert sizes["repeatability"] == pytest.approx(0.005, rel=0.3)  # the tracker's, and not a corner's 0.1 mm
    assert judged["guard_band_mm"] < 0.02

    crashed = SCENE.poses(12, rng)
    bumped = SCENE.observed(crashed + np.radians(0.2) * np.eye(6)[2], rng, 0.1)
    views = campaign(client, described(SCENE), "bumped")
    send(client, views, csv(columns(replace(bumped, q=crashed)))).raise_for_status()
    again = ended("rezero", [views], version=version)
    (row,) = again["parameters"]
    assert row["name"] == "theta_offset_3"
    assert again["metrics"]["train"]["identified"]["mean_mm"] < 0.05
    assert client.get(f"/v1/versions/{again['version_id']}").json()["parent_id"] == version


def test_a_campaign_of_sockets_settles_the_scale_of_a_board(client: httpx.Client, worker: Any, until: Any) -> None:
    scene, rng = eye_to_hand(yielding=np.zeros(6), scale=1e-3), np.random.default_rng(6)
    conditions = described(scene)
    conditions["boards"][0]["scale_sigma_percent"] = 0.1
    views = campaign(client, conditions)
    send(client, views, csv(columns(scene.observed(scene.poses(40, rng), rng, 0.1)))).raise_for_status()
    feet = scene.tools(HOME[None])[0] + np.array([[0.05, 0.25, 0.1], [-0.05, -0.25, -0.1]])
    q = [held(scene.built, scene.poses(20, rng), lambda p, c=foot: (p - c, np.eye(3))) for foot in feet]
    q = [one[np.abs(one).max(axis=1) < 2.4][:8] for one in q]  # within the limits of the joints
    assert min(map(len, q)) >= 6
    table = {f"q{j + 1}_deg": np.degrees(np.concatenate(q)[:, j]).tolist() for j in range(6)}
    table |= {"socket_id": [1] * len(q[0]) + [2] * len(q[1])}
    sockets = campaign(client, {}, "sockets")
    answer = send(client, sockets, csv(table))
    assert answer.status_code == 201, answer.text
    worker.start()
    options = {"socket_distances_mm": {"1-2": MM * float(np.linalg.norm(feet[0] - feet[1]))}}
    asked = {
        "kind": "identify",
        "robot": "watched",
        "campaigns": [views, sockets],
        "options": options,
        "validation": 0.2,
    }
    job = client.post("/v1/jobs", json=asked).raise_for_status().json()["id"]
    until(lambda: client.get(f"/v1/jobs/{job}").json()["state"] in ("succeeded", "failed"))
    found = client.get(f"/v1/jobs/{job}").json()
    assert found["state"] == "succeeded", found["error"]
    assert found["result"]["boards"][0]["scale_percent"] == pytest.approx(0.1, abs=0.02)
    assert {row["kind"] for row in found["result"]["measurements"]} == {"pixels", "contacts"}
    assert "board_scale" not in [w.get("gauge") for w in found["result"]["warnings"]]
    version = found["result"]["version_id"]
    refused = client.get(f"/v1/versions/{version}/residuals", params={"campaign": sockets})
    assert refused.status_code == 400
    assert "evaluate them (kilter version evaluate), or name other campaigns" in refused.json()["detail"]
    assert len(rows_left(client, version, views)["row"]) == 40  # the remedy: name the others


@pytest.mark.parametrize(
    ("change", "code", "says"),
    [
        ({"camera": ["cell", "cell", "door"]}, "camera_unknown", "Row 3, column 'camera' is 'door'"),
        ({"board": [1, 2, 1]}, "board_unknown", "Row 2, column 'board'"),
        ({"u1_px": [100.0, 100.0, 2500.0], "v1_px": [100.0] * 3}, "outside_picture", "Row 3, column 'u1_px'"),
        ({"u2_px": [None] * 3, "v2_px": [5.0, 5.0, 5.0]}, "observations_invalid", "Row 1, column 'u2_px'"),
        ({"u49_px": [5.0] * 3, "v49_px": [5.0] * 3}, "corner_unknown", "Row 1, column 'u49_px'"),
        ({"su1_px": [0.1, 0.0, 0.1], "sv1_px": [0.1] * 3}, "observations_invalid", "Row 2, column 'su1_px'"),
        ({"su50_px": [0.1] * 3, "sv50_px": [0.1] * 3}, "observations_invalid", "'u50_px' is missing"),
        ({"u3_mm": [0.1] * 3}, "observations_invalid", "has the unit 'mm'"),
    ],
)
def test_odd_views_are_refused_with_their_place(
    shared_client: httpx.Client, change: dict[str, list[Any]], code: str, says: str
) -> None:
    made = campaign(shared_client, described(SCENE), f"odd {says}")
    refused = send(shared_client, made, csv(columns(seen(3)) | change))
    assert refused.status_code == 400
    assert refused.json()["code"] == code
    assert says in refused.json()["detail"]
    assert shared_client.get(f"/v1/campaigns/{made}").json()["rows"] == 0


def test_views_need_their_cameras(shared_client: httpx.Client) -> None:
    refused = send(shared_client, campaign(shared_client, {}, "none"), csv(columns(seen(3))))
    assert refused.json()["code"] == "cameras_missing"
    two = described(SCENE)
    two["cameras"] = [two["cameras"][0], two["cameras"][0] | {"name": "door"}]
    refused = send(shared_client, campaign(shared_client, two, "two"), csv(columns(seen(3))))
    assert refused.json()["code"] == "cameras_missing"
    two["cameras"][1]["distortion"] = [0.1]
    asked = {"name": "odd", "conditions": two}
    refused = shared_client.post("/v1/robots/watched/campaigns", json=asked)
    assert refused.json()["code"] == "camera_invalid"


def test_a_single_mark_is_no_board_and_the_remedy_is_told(shared_client: httpx.Client) -> None:
    led = described(SCENE)
    led["boards"][0]["corners_mm"] = [[0.0, 0.0, 0.0]]
    shared_client.post("/v1/robots", json=SCENE.drawn.document() | {"name": "watched"})
    refused = shared_client.post("/v1/robots/watched/campaigns", json={"name": "led", "conditions": led})
    assert refused.status_code == 422
    assert "conditions.boards.0.corners_mm" in refused.text
    assert "of a mark that two cameras see send the place (x_mm, y_mm, z_mm)" in refused.text


def test_names_come_in_json_and_parquet_too(shared_client: httpx.Client) -> None:
    table = columns(seen(3)) | {"camera": ["cell", "1", "cell"]}
    made = campaign(shared_client, described(SCENE), "json")
    address = f"/v1/campaigns/{made}/observations"
    assert shared_client.post(address, json=table).raise_for_status().json()["rows"] == 3
    file = io.BytesIO()
    parquet.write_table(pa.table(table), file)
    made = campaign(shared_client, described(SCENE), "parquet")
    sent = shared_client.post(
        f"/v1/campaigns/{made}/observations", content=file.getvalue(),
        headers={"content-type": "application/vnd.apache.parquet"},
    )  # fmt: skip
    assert sent.raise_for_status().json()["rows"] == 3
    whole = shared_client.post(
        "/v1/robots/watched/observations/check", content=csv(table).encode(), headers={"content-type": "text/csv"}
    )
    assert whole.status_code in (200, 404)


def test_a_search_by_views_becomes_a_version(client: httpx.Client, worker: Any, until: Any) -> None:
    """The rows of its errors are the poses that the search took the views as; the job once ended there in an error."""
    made = campaign(client, described(SCENE), "searched")
    assert send(client, made, csv(columns(seen(40)))).raise_for_status().json()["rows"] == 40
    worker.start()
    options = {"effects": ["axial_compliance"], "budget_s": 20}
    asked = {"kind": "gap", "robot": "watched", "campaigns": [made], "validation": 0.25, "options": options}
    job = client.post("/v1/jobs", json=asked).raise_for_status().json()["id"]
    until(lambda: client.get(f"/v1/jobs/{job}").json()["state"] in ("succeeded", "failed"))
    found = client.get(f"/v1/jobs/{job}").json()
    assert found["state"] == "succeeded", found["error"]
    metrics = client.get(f"/v1/versions/{found['result']['version_id']}").json()["metrics"]
    assert (metrics["train"]["n"], metrics["validation"]["n"]) == (30, 10)
    assert metrics["validation"]["identified"]["mean_mm"] < 0.2 * metrics["validation"]["registration_only"]["mean_mm"]
    assert found["result"]["gap"]["lengths"] == "by_views"
    shown = client.get(f"/jobs/{job}", headers={"accept": "text/html"}).text
    assert "mm by views rms" in shown
    assert "how far an effect moves the tool is in mm at the tool" in shown


@pytest.mark.parametrize(
    ("part", "code", "said"),
    [
        ({"boards": [described(SCENE)["boards"][0] | {"corners_mm": (MM * grid(6, 8)).tolist()}]},
         "corners_misplaced", "its columns and rows are swapped"),
        ({"cameras": [described(SCENE)["cameras"][0] | {"fx_px": 1650.0, "fy_px": 1652.0}]},
         "intrinsics_differ", "another camera, zoom, focus or picture size"),
    ],
)  # fmt: skip
def test_a_job_says_which_description_is_of_something_else(
    client: httpx.Client, worker: Any, until: Any, part: dict[str, Any], code: str, said: str
) -> None:
    """Its rows are kept: the campaign with the right description takes them."""
    made = campaign(client, described(SCENE) | part)
    send(client, made, csv(columns(seen(30)))).raise_for_status()
    worker.start()
    asked = {"kind": "identify", "robot": "watched", "campaigns": [made], "options": {}}
    job = client.post("/v1/jobs", json=asked).raise_for_status().json()["id"]
    until(lambda: client.get(f"/v1/jobs/{job}").json()["state"] in ("succeeded", "failed"))
    error = client.get(f"/v1/jobs/{job}").json()["error"]
    assert error["code"] == code
    assert said in error["message"]
    assert said in " ".join(client.get(f"/jobs/{job}", headers={"accept": "text/html"}).text.split())
    assert client.get(f"/v1/campaigns/{made}").json()["rows"] == 30
