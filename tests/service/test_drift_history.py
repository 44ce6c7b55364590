"""The checks of a robot day after day, made by a real worker: charts, marks, since when, all robots, metrics, retention."""

from __future__ import annotations

import html
from datetime import UTC, datetime, timedelta
from typing import Any

import httpx
import numpy as np
import pytest

from kilter_service.ground.db import Database
from kilter_service.jobs.work import store
from kilter_service.robots import store as robots
from kilter_service.versions import store as versions
from kilter_service.versions.drift.store import of_all_causes
from kilter_service.versions.drift.wire import KeptCharts, StoredCheck, chance_words, control_charts
from tests.core.watch.drifting import DriftingArm, some_arm
from tests.service.conftest import WorkerProcess
from tests.service.test_budgets import TRACKER
from tests.service.watched_robot import DAY, Until, Watched


@pytest.fixture
def arm() -> DriftingArm:
    return some_arm(np.random.default_rng(3))


def gauges(client: httpx.Client) -> dict[str, float]:
    lines = client.get("/metrics").raise_for_status().text.splitlines()
    return {line.rsplit(" ", 1)[0]: float(line.rsplit(" ", 1)[1]) for line in lines if line.startswith("kilter_drift_")}


def test_what_creeps_is_seen_by_all_checks_together(
    client: httpx.Client, worker: WorkerProcess, until: Until, arm: DriftingArm, database: Database
) -> None:
    worker.start()
    watched, other = (Watched(client, until, arm, name) for name in ("creeping", "fresh"))
    assert watched.history()["state"] == "never"
    version = watched.calibrated()
    before = [watched.checked_here(database, arm, 100 + day, day) for day in range(25)]
    assert [one["verdict"] for one in before] == 25 * ["ok"]
    found = watched.history()
    assert (found["state"], found["checks"]) == ("ok", 25)
    charts = {one["name"]: one for one in found["charts"]}
    assert {"zero_2", "sag_2", "scale", "base_x", "tool_z"} <= set(charts)
    assert charts["zero_2"]["unit"] == "deg"
    assert charts["zero_2"]["up"][:2] == [None, None]
    assert not any(one["alarms"] for one in found["charts"])
    size = np.median([one["value"] for made in before for one in made["smallest"] if one["name"] == "zero_2"])
    step = 0.5 * float(np.radians(size))
    after = [watched.checked_here(database, arm.after("zero_2", step), 200 + day, 25 + day) for day in range(15)]
    assert sum(one["verdict"] == "ok" for one in after) >= 13  # a single check hardly sees it
    assert after[-1]["verdict"] == "ok"
    found = watched.history()
    assert found["state"] == "creeping", found["sentence"]
    assert gauges(client)['kilter_drift_creeping{robot="creeping"}'] == 1.0
    assert gauges(client)['kilter_drift_verdict{robot="creeping",verdict="ok"}'] == 1.0
    chart = {one["name"]: one for one in found["charts"]}["zero_2"]
    assert chart["alarms"]
    assert chart["since"] is not None
    assert DAY + timedelta(days=12) <= datetime.fromisoformat(chart["since"]) <= DAY + timedelta(days=28)
    assert found["sentence"].startswith("creeping: ")
    assert "since 2026-09-" in found["sentence"]

    crashed = watched.checked(arm.after("zero_3", 4e-3), 300, 45)
    assert crashed["verdict"] == "moved"
    assert "zero of joint 3 by 0.2" in crashed["sentence"]
    assert " since 2026-10-10" in crashed["sentence"]  # the day on which a check last agreed
    assert watched.history()["state"] == "moved"
    told = [(one["robot"], one["state"]) for one in client.get("/v1/drift").raise_for_status().json()["robots"]]
    assert told == [("creeping", "moved"), ("fresh", "never")]
    seen = gauges(client)
    assert seen['kilter_drift_creeping{robot="creeping"}'] == 0.0  # it has moved: the check says so
    assert seen['kilter_drift_verdict{robot="creeping",verdict="moved"}'] == 1.0
    assert seen['kilter_drift_verdict{robot="creeping",verdict="ok"}'] == 0.0
    assert seen['kilter_drift_p_value{robot="creeping"}'] < 1e-6
    assert seen['kilter_drift_last_check_timestamp_seconds{robot="creeping"}'] == (DAY + timedelta(days=45)).timestamp()

    # A version of what moved begins a history of its own, and the marks say so.
    last = found["history"][-1]["campaign_id"]
    campaign = watched.history()["last"]["campaign_id"]
    assert campaign != last
    made = watched.done("rezero", [campaign])["version_id"]
    client.post(f"/v1/versions/{made}/activate", json={"force": True, "reason": "test"}).raise_for_status()
    found = watched.history()
    assert [one["what"] for one in found["marks"] if one["what"] != "repaired"] == ["activated", "re-zeroed"]
    assert (found["state"], found["checks"], found["version_id"]) == ("never", 0, made)
    assert len(found["history"]) == 41
    assert [one["version_id"] for one in found["history"]] == 41 * [version]
    assert gauges(client) == {}
    # Nothing was measured since: what was sent before shows the arm as it was, and says nothing of the tolerance.
    refused = client.get("/v1/robots/creeping/acceptance", params={"tolerance_mm": 1.0})
    assert (refused.status_code, refused.json()["code"]) == (409, "nothing_held_out")
    watched.sent(arm, 8, 500, DAY + timedelta(days=44))  # sent late, and measured before it moved
    since = watched.sent(arm.after("zero_3", 4e-3), 8, 501, DAY + timedelta(days=45, hours=1))
    judged = client.get("/v1/robots/creeping/acceptance", params={"tolerance_mm": 1.0}).raise_for_status().json()
    assert [one["id"] for one in judged["campaigns"]] == [since]
    assert judged["campaigns"][0]["largest_mm"] < 0.5
    watched.checked(arm.after("zero_3", 4e-3), 301, 46)
    assert watched.history()["state"] == "ok"
    watched.checked(arm, 302, 47)  # back on its old marks: wrong for the new version
    watched.checked(arm.after("zero_3", 4e-3), 303, 48)
    found = watched.history()
    assert (found["state"], found["checks"]) == ("ok", 3)
    assert [one["at"][:10] for one in found["marks"] if (one["what"], one["version_id"]) == ("repaired", made)] == [
        "2026-10-19"
    ]
    assert {len(chart["up"]) for chart in found["charts"]} == {3}

    with database.reading() as session:  # however old, checks are kept: they are the history
        gone = store.ended_before(session, datetime.now(UTC) + timedelta(days=1), 1000)
    assert not set(gone) & {one["job_id"] for one in watched.history()["history"]}
    assert other.history()["sentence"] == "It has no active version that could be checked."


def test_a_date_that_was_set_back_changes_the_order_and_nothing_else(
    client: httpx.Client, worker: WorkerProcess, until: Until, arm: DriftingArm
) -> None:
    worker.start()
    watched = Watched(client, until, arm, "clock")
    watched.calibrated()
    campaign = watched.sent(arm, 6, 1001, DAY + timedelta(days=5))
    watched.done("drift", [campaign])
    early = watched.checked(arm, 1002, 3)
    (remark,) = [one for one in early["warnings"] if one["code"].startswith("dated")]
    assert remark["code"] == "dated_before_last_check"
    assert "is dated 2026-09-04 07:00, before the last check of this version (2026-09-06 07:00)" in remark["message"]
    assert not [one for one in watched.done("drift", [campaign])["warnings"] if one["code"].startswith("dated")]
    anew = watched.sent(arm.after("base", 0.2), 6, 1003, DAY + timedelta(days=6))
    watched.done("drift", [anew], new_setup=["base"])
    found = watched.history()
    assert watched.history()["charts"] == found["charts"]
    told = [(one["at"][:10], one["whole"]) for one in found["history"]]
    assert told == [("2026-09-04", True), ("2026-09-06", True), ("2026-09-07", False)]
    assert found["last"]["campaign_id"] == anew

    # The same rows under another date are one check, the one that was made last; retired, it is as if it had not been made.
    copy = watched.sent(arm, 6, 1001, DAY - timedelta(days=9))
    assert copy != campaign
    warned = [one["code"] for one in watched.done("drift", [copy])["warnings"] if one["code"].startswith("dated")]
    assert warned == ["dated_before_last_check", "dated_before_fit"]
    assert [one["at"][:10] for one in watched.history()["history"]] == ["2026-08-23", "2026-09-04", "2026-09-07"]
    client.post(f"/v1/campaigns/{copy}/retire").raise_for_status()
    assert [one["at"][:10] for one in watched.history()["history"]] == ["2026-09-04", "2026-09-06", "2026-09-07"]


def test_the_number_of_today_is_that_of_the_newest_check(
    client: httpx.Client, arm: DriftingArm, database: Database
) -> None:
    watched = Watched(client, None, arm, "today")
    version = watched.calibrated(database)

    def today() -> dict[str, Any]:
        return dict(client.get("/v1/robots/today/today").raise_for_status().json())

    assert today()["newest"]["source"] == "fitted"
    watched.checked_here(database, arm, 400, 0)
    checked = watched.history()["last"]
    found = today()
    assert (found["newest"]["source"], found["newest"]["job_id"]) == ("check", checked["job_id"])
    assert [one["id"] for one in found["newest"]["campaigns"]] == [checked["campaign_id"]]
    assert found["sentences"][0].startswith("Mean error ")
    assert "on the rows of a check, which no fit used" in found["sentences"][0]
    assert "measured on 2026-09-01" in found["sentences"][0]
    assert (found["changed"], found["not_evaluated"]) == (False, [])
    evaluated = watched.done_here(database, "evaluate", [checked["campaign_id"]])["metrics"][checked["campaign_id"]]
    assert found["newest"]["errors"]["identified"] == evaluated["identified"]
    assert found["newest"]["errors"]["budget"] == evaluated["budget"]
    assert "registration_only" not in found["newest"]["errors"]

    watched.checked_here(database, arm.after("zero_2", 4e-3), 401, 1)
    found = today()
    assert found["changed"]
    assert found["newest"]["errors"]["identified"]["mean_mm"] > 0.5
    assert "more than chance explains: the arm, or what it was measured with, has changed" in found["sentences"][1]
    said = watched.history()["last"]["sentence"]
    assert said.startswith("moved: zero of joint 2 by 0.2")
    assert found["newest"]["alarm"] == said
    assert "The check says so too. Where the instrument was set up anew: `kilter check today" in found["compared"]
    card = html.unescape(client.get("/").raise_for_status().text)
    assert said.partition(". ")[0].removeprefix("moved: zero of ") in card
    assert "on the rows of a check, which no fit used" in card
    assert "more than chance explains" in card
    assert "Today: Mean error" in client.get(f"/versions/{version}").raise_for_status().text


def test_the_poses_of_a_re_zeroing_measured_anew_are_new_rows_and_its_own_rows_are_not(
    client: httpx.Client, arm: DriftingArm, database: Database
) -> None:
    client.post("/v1/instruments", json=TRACKER).raise_for_status()
    watched = Watched(client, None, arm, "planned")
    watched.calibrated(database)
    moved = arm.after("zero_3", 4e-3)
    said = watched.sent(moved, 6, 1, DAY, where=5)
    made = watched.done_here(database, "rezero", [said])
    assert made["metrics"]["train"]["budget"]["expanded_mm"] > 0.05
    with database.reading() as session:
        (version,) = [one.id for one in versions.of_robot(session, robots.get(session, "planned").id) if one.parent_id]
    watched.activated(version)

    def accepted() -> httpx.Response:
        return client.get("/v1/robots/planned/acceptance", params={"tolerance_mm": 1.0, "instrument": "tracker"})

    assert accepted().json()["code"] == "nothing_held_out"
    watched.sent(moved, 6, 1, DAY + timedelta(days=1), where=5)  # the same numbers under another date
    assert accepted().json()["code"] == "nothing_held_out"
    later = watched.sent(moved, 6, 2, DAY + timedelta(days=2), where=5)  # the same poses on another day
    watched.done_here(database, "drift", [later])
    found = accepted().raise_for_status().json()
    assert ([one["id"] for one in found["campaigns"]], found["decision"]) == ([later], "accepted")
    assert found["campaigns"][0]["after"]["mean_mm"] < 0.2


def test_charts_are_kept_until_a_check_comes_or_its_day_is_another() -> None:
    number = {"name": "value", "unit": "deg", "u95": 0.01}

    def made(values: list[float], days: list[int]) -> list[StoredCheck]:
        looked = [
            {"name": "zero_1", "words": "zero of joint 1", "numbers": [{**number, "change": one}]} for one in values
        ]
        return [
            StoredCheck(f"job_{k}", "cmp", DAY + timedelta(days=day), {"verdict": "ok", "looked_at": [one]})
            for k, (one, day) in enumerate(zip(looked, days, strict=True))
        ]

    kept, values, days = KeptCharts(2), [0.1, 0.12, 0.11, 0.13, 0.9], [1, 2, 3, 4, 5]
    first = kept.get_charts(made(values, days))
    assert kept.get_charts(made(values, days)) is first
    assert first == control_charts(made(values, days))
    more = kept.get_charts(made([*values, 0.2], [*days, 6]))
    assert len(more[0].values) == 6
    other = made([0.1, 0.12, 0.9, 0.11, 0.13], [1, 2, 5, 3, 4])
    assert kept.get_charts(sorted(other, key=lambda one: one.at))[0].values[-1] == 0.9
    assert kept.get_charts(made(values, days)) is not first  # of three, the oldest went


def test_charts_sum_what_was_stored_to_be_summed_and_mix_it_with_nothing_else() -> None:
    def made(summed: list[float | None]) -> list[StoredCheck]:
        numbers = [{"name": "value", "unit": "deg", "change": 0.1 * k, "u95": 0.01, "summed": one}
                   for k, one in enumerate(summed)]  # fmt: skip
        return [
            StoredCheck(f"job_{k}", "cmp", DAY + timedelta(days=k), {
                "verdict": "ok", "looked_at": [{"name": "zero_1", "words": "zero of joint 1", "numbers": [one]}],
            })
            for k, one in enumerate(numbers)
        ]  # fmt: skip

    assert control_charts(made([3.0, 4.0, 5.0]))[0].values == [3.0, 4.0, 5.0]
    assert control_charts(made([None, 4.0, 5.0]))[0].values == pytest.approx(
        [0.0, 0.1, 0.2]
    )  # the first of an earlier release


def test_one_check_that_shows_less_or_states_no_temperature_ends_no_chart() -> None:
    """A season without its temperature is a drift; a chart of all checks but one is a chart."""

    def made(temperatures: list[float | None], without: int | None = None) -> list[StoredCheck]:
        rng, out = np.random.default_rng(4), []
        for day, felt in enumerate(temperatures):
            season = 23.0 + 8.0 * np.sin(2.0 * np.pi * day / 250.0)
            change = 0.5 * season + float(rng.normal(0.0, 0.3))
            number = {"name": "value", "unit": "deg", "u95": None if day == without else 0.6, "change": change}
            looked = [{"name": "zero_1", "words": "zero of joint 1", "numbers": [{**number, "summed": change}]}]
            at = DAY + timedelta(days=day)
            result = {"verdict": "ok", "looked_at": looked, "temperature_c": None if felt is None else season}
            out.append(StoredCheck(f"job_{day}", "cmp", at, result))
        return out

    (season,) = control_charts(made([0.0] * 120))
    assert not season.alarms
    (one_missing,) = control_charts(made([*[0.0] * 60, None, *[0.0] * 59]))
    assert not one_missing.alarms
    assert one_missing.up[60] is None
    assert control_charts(made([None] * 120))[0].alarms
    (one_shows_less,) = control_charts(made([0.0] * 120, without=70))
    assert (one_shows_less.values[70], one_shows_less.up[70]) == (None, None)
    assert one_shows_less.up[71] is not None
    assert max(one for one in one_shows_less.up if one is not None) < one_shows_less.limit


def test_a_chance_that_no_number_holds_is_not_nothing() -> None:
    assert [chance_words(one) for one in (0.0, 2e-14, 0.31)] == ["less than one in a million"] * 2 + ["0.3"]
    assert chance_words(0.234, 2) == "0.23"


@pytest.mark.parametrize(
    ("stored", "summed"),
    [
        ({"joint_log": False, "unseen": ["tool"], "new_setup": []}, True),
        ({"joint_log": True, "unseen": ["tool"], "new_setup": []}, False),
        ({"joint_log": False, "unseen": ["base"], "new_setup": []}, True),
        ({"unseen": ["base", "scale"], "new_setup": []}, False),  # as an earlier release stored a joint log
        ({"unseen": ["zero of joint 6"], "new_setup": []}, True),
        ({"joint_log": False, "unseen": [], "new_setup": ["base"]}, False),
    ],
)
def test_checks_by_a_joint_log_alone_are_not_summed(stored: dict[str, Any], summed: bool) -> None:
    assert of_all_causes(stored) is summed
