"""From a repair on an arm is another one: its checks, sums and comparisons begin anew, until the repair is taken back."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any

import httpx
import numpy as np

from kilter_service.ground.db import Database
from kilter_service.page.shared.control_chart import draw_check_history as drawn
from kilter_service.versions.drift import service as drift
from kilter_service.versions.today import service as today
from tests.core.watch.drifting import some_arm
from tests.service.watched_robot import DAY, Watched

TOLERANCE = {"tolerance_mm": 1.0}


def gauges(client: httpx.Client) -> list[str]:
    return [line for line in client.get("/metrics").text.splitlines() if line.startswith("kilter_drift_verdict")]


def test_checks_and_comparisons_begin_anew_with_a_repair(client: httpx.Client, database: Database) -> None:
    arm = some_arm(np.random.default_rng(3))
    robot = Watched(client, None, arm, "mended")
    robot.calibrated(database)
    for day in range(4):
        assert robot.checked_here(database, arm, 100 + day, day)["verdict"] == "ok"
    assert robot.checked_here(database, arm.after("zero_3", 4e-3), 110, 5)["verdict"] == "moved"
    before = robot.history()
    assert (before["state"], before["checks"], before["repaired_at"]) == ("moved", 5, None)
    assert len(before["charts"][0]["up"]) == 5
    assert gauges(client)

    done = DAY + timedelta(days=5, hours=3)
    asked = {"what": "gear of joint 3 replaced", "at": done.isoformat()}
    made = client.post("/v1/robots/mended/repairs", json=asked)
    assert made.status_code == 201
    repair = made.json()
    assert (
        client.post("/v1/robots/mended/repairs", json=asked).json()["id"] == repair["id"]
    )  # the same one twice is one
    found = robot.history()
    assert (found["state"], found["checks"], found["charts"], found["last"]) == ("never", 0, [], None)
    assert found["sentence"].startswith("Not checked since the repair of 2026-09-06 (gear of joint 3 replaced): ")
    (mark,) = [one for one in found["marks"] if one["what"] == "repair"]
    assert (mark["note"], mark["repair_id"]) == (asked["what"], repair["id"])
    assert datetime.fromisoformat(mark["at"]) == done
    assert len(found["history"]) == 5  # nothing is forgotten
    assert not gauges(client)
    nothing = client.get("/v1/robots/mended/acceptance", params=TOLERANCE)
    assert (nothing.status_code, nothing.json()["code"]) == (409, "nothing_held_out")
    assert nothing.json()["detail"].startswith(
        "No row since the repair of 2026-09-06 (gear of joint 3 replaced) with a measured"
    )

    said = client.get("/v1/robots/mended/today").raise_for_status().json()["sentences"]
    assert any("from before the repair of 2026-09-06 (gear of joint 3 replaced)" in one for one in said)

    # The new gear sits elsewhere: no day before the repair is one on which a check last agreed.
    moved = robot.checked_here(database, arm.after("zero_3", -2e-3), 120, 6)
    assert (moved["verdict"], moved["agreed_at"]) == ("moved", None)
    assert " since 2026" not in moved["sentence"]
    for day in range(4):
        robot.checked_here(database, arm, 130 + day, 8 + day)
    found = robot.history()
    assert (found["state"], found["checks"]) == ("ok", 5)
    assert {len(one["up"]) for one in found["charts"]} == {5}
    figures = drawn(drift.of_robot(database, "mended"), today.of_robot(database, "mended"))
    assert figures.errors is not None
    assert "repair 2026-09-06" in figures.errors.svg()
    judged = client.get("/v1/robots/mended/acceptance", params=TOLERANCE).raise_for_status().json()
    assert [one["id"] for one in judged["campaigns"]] == [found["last"]["campaign_id"]]

    said = client.get("/v1/robots/mended/today").raise_for_status().json()["sentences"]
    assert not any("before the repair" in one for one in said)

    # A repair that was none is taken back: everything counts again.
    client.delete(f"/v1/robots/mended/repairs/{repair['id']}").raise_for_status()
    found = robot.history()
    assert (found["checks"], found["repaired_at"]) == (10, None)
    assert not [one for one in found["marks"] if one["what"] == "repair"]


def test_a_repair_to_come_of_no_robot_or_without_words_is_refused(client: httpx.Client) -> None:
    arm = some_arm(np.random.default_rng(3))
    robot, other = (Watched(client, None, arm, name) for name in ("mended", "other"))

    def refused(answer: httpx.Response) -> tuple[int, str]:
        return answer.status_code, answer.json()["code"]

    def post(body: dict[str, Any], name: str = robot.name) -> httpx.Response:
        return client.post(f"/v1/robots/{name}/repairs", json=body)

    later = (datetime.now(UTC) + timedelta(days=1)).isoformat()
    assert refused(post({"what": "gear", "at": later})) == (400, "repair_to_come")
    assert refused(post({"what": ""})) == (422, "payload_invalid")
    assert refused(post({"what": "   "})) == (422, "payload_invalid")
    assert refused(post({"what": "gear", "at": "2026-09-01T07:00:00"})) == (422, "payload_invalid")  # in which zone?
    assert refused(post({"what": "gear"}, "nobody")) == (404, "robot_not_found")
    made = post({"what": "gear"}).raise_for_status().json()["id"]
    assert refused(client.delete(f"/v1/robots/{other.name}/repairs/{made}")) == (404, "repair_not_found")
    assert robot.history()["sentence"] == "It has no active version that could be checked."
    client.delete(f"/v1/robots/mended/repairs/{made}").raise_for_status()
    assert refused(client.delete(f"/v1/robots/mended/repairs/{made}")) == (404, "repair_not_found")
