"""Robots from circles and frames from points over HTTP."""

from __future__ import annotations

from typing import Any

import httpx
import numpy as np
import pytest

from tests.core.arm.test_documents import poses
from tests.core.procedures.test_circle_points import HOME, circles, horizontal, middle
from tests.core.truth import Arm, Step, ur10


def columns(q: Any, points: Any, units: list[str]) -> dict[str, Any]:
    scale = {"deg": 180.0 / np.pi, "mm": 1e3}
    out = {f"q{j + 1}_{unit}": (q[:, j] * scale[unit]).tolist() for j, unit in enumerate(units)}
    for k in range(points.shape[1]):
        for a, axis in enumerate("xyz"):
            values = [None if np.isnan(v) else 1e3 * v for v in points[:, k, a]]
            out[f"m{k + 1}{axis}_mm"] = values
    return out


@pytest.mark.parametrize("to", ["chain", "mcpc", "poe"])
def test_a_ur10_from_its_circles(shared_client: httpx.Client, to: str) -> None:
    q, points = circles(ur10(), HOME)
    points[::9, 2] = np.nan
    answer = shared_client.post(
        f"/v1/robots/from-circles?name=found&to={to}", json=columns(q, points, ["deg"] * 6)
    ).raise_for_status()
    found = answer.json()
    assert found["robot"]["convention"] == to
    assert [round(axis["arc_deg"]) for axis in found["axes"]] == [82, 86, 86, 82, 86, 86]  # an end may be hidden
    assert all(axis["rms_mm"] < 0.06 for axis in found["axes"])
    some = np.random.default_rng(0).uniform(-2, 2, (20, 6))
    assert np.abs(poses(found["robot"], some)[0] - middle(ur10(), some)).max() < 3e-3
    shared_client.post("/v1/robots", json=found["robot"] | {"name": f"found-{to}"}).raise_for_status()


def test_a_slide_is_told_by_its_unit(shared_client: httpx.Client) -> None:
    steps = (Step("rz", 0.0, 0), Step("tx", 0.4), Step("rz", 0.0, 1), Step("tx", 0.3), Step("tz", 0.0, 2, -1.0))
    q, points = circles(Arm(steps, 3), np.array([0.2, 0.5, 0.1]))
    found = shared_client.post("/v1/robots/from-circles", json=columns(q, points, ["deg", "deg", "mm"])).json()
    assert [axis["kind"] for axis in found["axes"]] == ["revolute", "revolute", "prismatic"]
    assert found["axes"][2]["stroke_mm"] == pytest.approx(300)


def test_a_coupled_axis_is_named_with_the_option_that_uncouples_it(shared_client: httpx.Client) -> None:
    arm = horizontal()
    q, points = circles(arm, np.array([0.2, 0.3, 0.4]), arc=1.2)
    table = columns(q, points, ["deg"] * 3)
    refused = shared_client.post("/v1/robots/from-circles", json=table)
    assert (refused.status_code, refused.json()["code"]) == (400, "circle_not_round")
    assert refused.json()["context"] == {"joint": 2, "follower": 3}
    assert "follows=j3=j2" in refused.json()["detail"]
    found = shared_client.post("/v1/robots/from-circles?follows=j3=j2", json=table).raise_for_status().json()
    some = np.random.default_rng(0).uniform(-1, 1, (20, 3))
    assert np.abs(poses(found["robot"], some)[0] - middle(arm, some)).max() < 2e-3
    odd = shared_client.post("/v1/robots/from-circles?follows=3=2", json=table)
    assert (odd.status_code, "for example j3=j2" in odd.json()["detail"]) == (400, True)


def test_refusals_have_their_codes(shared_client: httpx.Client) -> None:
    q, points = circles(ur10(), HOME, arc=0.4)
    table = columns(q, points, ["deg"] * 6)
    answer = shared_client.post("/v1/robots/from-circles", json=table)
    assert (answer.status_code, answer.json()["code"]) == (400, "arc_too_short")
    del table["q3_deg"]
    assert "numbered 1, 2, 3" in shared_client.post("/v1/robots/from-circles", json=table).json()["detail"]
    bare = {name: values for name, values in columns(q, points, ["deg"] * 6).items() if name.startswith("q")}
    assert "Nothing was measured" in shared_client.post("/v1/robots/from-circles", json=bare).json()["detail"]


def test_a_frame_from_known_points_and_from_features(shared_client: httpx.Client) -> None:
    known = [(0, 0, 0), (400, 0, 0), (0, 300, 0)]
    # Turned a quarter about z and moved.
    measured = [(100, 50, 10), (100, 450, 10), (-200, 50, 10)]
    points = [{"known_mm": k, "measured_mm": m} for k, m in zip(known, measured, strict=True)]
    found = shared_client.post("/v1/frames", json={"points": points}).raise_for_status().json()
    assert found["pose"] == pytest.approx({"x_mm": 100, "y_mm": 50, "z_mm": 10, "rx_deg": 0, "ry_deg": 0, "rz_deg": 90})
    assert [point["name"] for point in found["points"]] == ["1", "2", "3"]
    features = {"plane_mm": measured, "line_mm": measured[:2], "origin_mm": (100, 50, 40)}
    again = shared_client.post("/v1/frames", json={"features": features}).raise_for_status().json()
    assert again["pose"] == pytest.approx(found["pose"])
    both = shared_client.post("/v1/frames", json={"points": points, "features": features})
    assert both.status_code == 400
    flat = shared_client.post("/v1/frames", json={"points": points[:2]})
    assert flat.json()["code"] == "points_collinear"
