"""What a job would do, said before it is queued: for campaigns that lack something, and in the words of the refusals."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import httpx
import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_service.ground.db import Database
from kilter_service.ground.db.tables import JobRow

Floats = NDArray[np.float64]
Until = Callable[..., None]

# d, a (mm), alpha (deg) of an arm of six joints, its drawing; what is measured has other lengths.
ROWS = (
    (160.0, 0.0, 90.0),
    (0.0, -420.0, 0.0),
    (0.0, -390.0, 0.0),
    (130.0, 0.0, 90.0),
    (100.0, 0.0, -90.0),
    (100.0, 0.0, 0.0),
)
OFF = np.array([0.3, -0.5, 0.4, 0.2, -0.3, 0.1])  # mm, of each a
MASSES = (4.0, 9.0, 5.0, 2.0, 2.0, 0.5)
TOOL = np.array([40.0, -20.0, 120.0])


def screw(theta: float, d: float, a: float, alpha: float) -> Floats:
    c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1.0]])


def tool_point(q_deg: Floats) -> Floats:
    """The tool point of the arm as it is, mm."""
    T = np.eye(4)
    for (d, a, alpha), off, angle in zip(ROWS, OFF, np.radians(q_deg), strict=True):
        T = T @ screw(angle, d, a + off, np.radians(alpha))
    return np.asarray((T @ np.append(TOOL, 1.0))[:3])


def document(name: str, masses: bool = True) -> dict[str, Any]:
    links = {"links": [{"mass_kg": m, "com_mm": [10.0, 5.0, -20.0]} for m in MASSES]} if masses else {}
    return {
        "name": name, "convention": "dh", "tool": dict(zip(("x_mm", "y_mm", "z_mm"), TOOL.tolist(), strict=True)),
        "joints": [{"name": f"j{k}", "limits_deg": [-170, 170]} for k in range(1, 7)],
        "rows": [{"d_mm": d, "a_mm": a, "alpha_deg": alpha} for d, a, alpha in ROWS], **links,
    }  # fmt: skip


def poses(count: int, still: tuple[int, ...] = (), at: float = 25.0) -> Floats:
    q = np.random.default_rng(4).uniform(-120.0, 120.0, (count, 6))
    q[:, still] = at
    return np.asarray(q)


def columns(q: Floats, repeats: int = 8) -> dict[str, list[float]]:
    """Measured rows, the first poses three times over."""
    q = np.concatenate([q, q[:repeats], q[:repeats]])
    noise = np.random.default_rng(5).normal(0.0, 0.02, (len(q), 3))
    seen = np.array([tool_point(one) for one in q]) + noise
    out = {f"q{j + 1}_deg": q[:, j].tolist() for j in range(6)}
    return out | {f"{axis}_mm": seen[:, k].tolist() for k, axis in enumerate("xyz")}


@pytest.fixture
def arm(client: httpx.Client) -> Callable[..., str]:
    """Store a campaign of an arm, perhaps piece by piece; returns its id."""

    def store(rows: dict[str, list[float]], name: str = "arm", masses: bool = True, piece: int = 10_000) -> str:
        client.post("/v1/robots", json=document(name, masses)).raise_for_status()
        made = client.post(f"/v1/robots/{name}/campaigns", json={"name": "rows", "numbered": True}).raise_for_status()
        campaign = str(made.json()["id"])
        for first in range(0, len(rows["q1_deg"]), piece):
            part = {column: values[first : first + piece] for column, values in rows.items()}
            client.post(f"/v1/campaigns/{campaign}/observations", json=part).raise_for_status()
        return campaign

    return store


def check(client: httpx.Client, kind: str, campaigns: list[str], robot: str = "arm", **job: Any) -> dict[str, Any]:
    answer = client.post("/v1/jobs/check", json={"kind": kind, "robot": robot, "campaigns": campaigns, **job})
    assert answer.status_code == 200, answer.text
    return dict(answer.json())


def test_a_good_campaign_would_run_and_nothing_is_stored(
    client: httpx.Client, arm: Callable[..., str], database: Database
) -> None:
    campaign = arm(columns(poses(60)))
    told = check(client, "identify", [campaign], validation=0.25)
    assert told["would_run"]
    assert not told["problems"]
    assert not told["limited"]
    assert [(c["id"], c["use"], c["rows"], c["poses"]) for c in told["campaigns"]] == [(campaign, "train", 76, 60)]
    assert (told["rows"], told["poses"], told["held_out"]["how"], told["held_out"]["poses"]) == (76, 60, "fraction", 15)
    found = told["identifiability"]
    # An encoder zero of the first and of the last joint, d of the first: base and tool do the same.
    names = {one["name"] for one in found["not_identifiable"]}
    assert found["parameters"] == len(found["identifiable"]) + len(names)
    assert found["rank"] <= found["parameters"]
    assert {f"a_{k}" for k in range(2, 4)} <= set(found["identifiable"])
    assert found["noise_from"] == "repeats"
    assert 0.01 < found["noise_mm"] < 0.03
    assert told["duration_s"]["low"] <= told["duration_s"]["expected"] <= told["duration_s"]["high"]
    assert "rule" in told["duration_s"]["basis"]
    with database.reading() as session:
        assert session.query(JobRow).count() == 0


def test_a_joint_that_never_moves_is_named_with_the_remedy_and_the_remedy_works(
    client: httpx.Client, arm: Callable[..., str]
) -> None:
    still = check(client, "identify", [arm(columns(poses(60, still=(3,))))])["identifiability"]
    named = {one["name"]: one for one in still["not_identifiable"]}
    assert "theta_offset_4" in named
    assert "j4 never moves" in named["theta_offset_4"]["reason"]
    assert "Move joint j4" in named["theta_offset_4"]["remedy"]
    moving = check(client, "identify", [arm(columns(poses(60)))])["identifiability"]
    assert "theta_offset_4" in moving["identifiable"]
    assert still["rank"] < moving["rank"]


def test_planar_poses_ask_for_poses_that_spread_the_joints_and_those_help(
    client: httpx.Client, arm: Callable[..., str]
) -> None:
    planar = check(client, "identify", [arm(columns(poses(60, still=(0, 3, 4, 5), at=0.0)))])["identifiability"]
    spread = [
        one["name"] for one in planar["not_identifiable"] if one["remedy"].startswith("Measure poses that spread")
    ]
    assert spread
    better = check(client, "identify", [arm(columns(poses(60)))])["identifiability"]
    # The remedy was tried on the model with other poses than these: it need not be right of each, but of nearly all.
    assert len(set(spread) & set(better["identifiable"])) >= 0.9 * len(spread)
    assert planar["rank"] < better["rank"]
    assert planar["null_directions"]
    assert all(one["sentence"] for one in planar["null_directions"])


def test_without_loads_what_follows_them_is_not_told(client: httpx.Client, arm: Callable[..., str]) -> None:
    bare = check(
        client, "identify", [arm(columns(poses(60)), "bare", masses=False)], "bare",
        options={"effects": ["axial_compliance"]},
    )["identifiability"]  # fmt: skip
    loaded = check(
        client, "identify", [arm(columns(poses(60)))], options={"effects": ["axial_compliance"]}
    )["identifiability"]  # fmt: skip
    silent = {one["name"]: one["remedy"] for one in bare["not_identifiable"] if one["name"].startswith("compliance")}
    assert {f"compliance_{k}" for k in (2, 3)} <= set(silent)
    assert "second payload" in silent["compliance_2"]
    assert {f"compliance_{k}" for k in (2, 3)} <= set(loaded["identifiable"])


def test_a_hunt_says_which_effects_it_could_test_and_what_the_others_need(
    client: httpx.Client, arm: Callable[..., str]
) -> None:
    told = check(client, "gap", [arm(columns(poses(60)))])
    assert told["would_run"]
    assert told["held_out"]["how"] == "unasked"
    assert told["held_out"]["poses"] in (14, 15, 16)
    testable = {one["id"] for one in told["testability"]["testable"]}
    reasons = {one["id"]: one["reason"] for one in told["testability"]["not_testable"]}
    assert "eccentricity" in testable
    assert "backlash" in testable  # the order of the rows tells from which side joints came
    assert "temperature" in reasons["thermal_growth"]
    assert {one["what"].split()[0] for one in told["missing"]} == {*reasons, "payload_kg"}
    still = check(client, "gap", [arm(columns(poses(60, still=(2,))))])["testability"]["not_testable"]
    assert 3 in next(one["joints"] for one in still if one["id"] == "eccentricity")


def test_what_a_hunt_cannot_test_is_what_its_result_says(
    client: httpx.Client, arm: Callable[..., str], worker: Any, until: Until
) -> None:
    campaign = arm(columns(poses(60)))
    options = {"effects": ["backlash", "thermal_growth"], "resamples": 5, "bootstraps": 99, "permutations": 2}
    first = check(client, "gap", [campaign], options=options)
    told = first["testability"]["not_testable"]
    assert "made and timed here" in first["duration_s"]["basis"]
    worker.start()
    body = {"kind": "gap", "robot": "arm", "campaigns": [campaign], "options": options}
    address = client.post("/v1/jobs", json=body).raise_for_status().headers["location"]
    until(lambda: client.get(address).json()["state"] in ("succeeded", "failed"))
    done = client.get(address).json()
    assert done["state"] == "succeeded", done["error"]
    assert done["result"]["not_testable"] == told
    # The next check of this kind rests on what this job took.
    again = check(client, "gap", [campaign], options=options)["duration_s"]
    assert "1 earlier gap job with the same options" in again["basis"]
    assert again["low"] <= again["expected"] <= again["high"]


def test_what_would_fail_is_said_in_the_words_of_the_failure(client: httpx.Client, arm: Callable[..., str]) -> None:
    few = check(client, "identify", [arm(columns(poses(5), repeats=0))])
    assert not few["would_run"]
    assert [one["code"] for one in few["problems"]] == ["too_few_poses"]
    assert "distinct poses give" in few["problems"][0]["message"]
    assert few["identifiability"] is None
    wrong = columns(poses(60))
    wrong["q2_deg"] = [-value for value in wrong["q2_deg"]]
    with pytest.raises(httpx.HTTPStatusError) as refused:
        arm(wrong)
    sentence = refused.value.response.json()["detail"]
    assert "Joint 2 looks to count the other way round" in sentence
    # Pieces of too few poses are not judged alone: the job says of the whole campaign what the upload would have said.
    told = check(client, "identify", [arm(wrong, piece=10)])
    assert told["problems"][0]["message"] == sentence
    assert [one["code"] for one in told["problems"]] == ["foreign_observations"]
    lacking = check(client, "identify", [arm(columns(poses(60)))], options={"effects": ["thermal_growth"]})
    assert "temperature" in lacking["problems"][0]["message"]


def test_a_campaign_without_rows_would_fail_and_is_named(client: httpx.Client, arm: Callable[..., str]) -> None:
    full = arm(columns(poses(60)))
    empty = client.post("/v1/robots/arm/campaigns", json={"name": "empty"}).raise_for_status().json()["id"]
    told = check(client, "gap", [full, empty])
    assert not told["would_run"]
    assert empty in told["problems"][0]["message"]
    assert [one["rows"] for one in told["campaigns"]] == [76, 0]


@pytest.mark.parametrize(
    "job",
    [
        {"kind": "identify", "campaigns": []},
        {"kind": "identify", "campaigns": ["cmp_0000000000000000"]},
        {"kind": "identify", "campaigns": ["FULL"], "options": {"levle": 2}},
        {"kind": "identify", "campaigns": ["FULL"], "options": {"level": 2, "effects": ["backlash"]}},
        {"kind": "gap", "campaigns": ["FULL"], "validation": {"folds": 4}},
        {"kind": "gap", "campaigns": ["FULL"], "options": {"effects": ["backlsh"]}},
        {"kind": "evaluate", "campaigns": ["FULL"], "options": {"refit": ["tool"]}},
        {"kind": "plan", "options": {"purpose": "separate", "effects": ["backlash", "eccentricity", "drift"]}},
        {"kind": "nonsense", "campaigns": ["FULL"]},
    ],
)
def test_a_refusal_is_that_of_the_job(client: httpx.Client, arm: Callable[..., str], job: dict[str, Any]) -> None:
    full = arm(columns(poses(20)))
    body = {"robot": "arm", **job, "campaigns": [full if c == "FULL" else c for c in job.get("campaigns", [])]}
    posted, checked = client.post("/v1/jobs", json=body), client.post("/v1/jobs/check", json=body)
    assert posted.status_code == checked.status_code >= 400
    said = [
        {k: v for k, v in answer.json().items() if k not in ("instance", "request_id")} for answer in (posted, checked)
    ]
    assert said[0] == said[1]


def test_a_big_campaign_is_thinned_and_that_is_said(
    client: httpx.Client, arm: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("kilter_service.jobs.checking.MOST_ROWS", 40)
    told = check(client, "identify", [arm(columns(poses(70), repeats=0))])
    assert told["would_run"]
    assert told["rows"] == 35
    assert told["campaigns"][0]["rows"] == 70
    assert "One row in 2" in told["limited"][0]


@pytest.mark.parametrize("limit", ["checking.MOST_ROWS", "kinds.evaluate.MOST_CHECKED"])
def test_a_check_of_few_rows_takes_a_small_socket_as_the_job_does(
    client: httpx.Client, arm: Callable[..., str], monkeypatch: pytest.MonkeyPatch, limit: str
) -> None:
    monkeypatch.setattr(f"kilter_service.jobs.{limit}", 12)
    q = poses(60)
    held_by = [2 if k in (27, 30) else 1 for k in range(60)]  # each limit keeps one of the two
    rows = {f"q{j + 1}_deg": q[:, j].tolist() for j in range(6)} | {"socket_id": held_by}
    told = check(client, "evaluate", [arm(rows)])
    assert told["problems"] == []
    assert told["would_run"]
    alone = [1] * 30 + [2] + [1] * 29
    told = check(client, "evaluate", [arm(rows | {"socket_id": alone}, "other")], robot="other")
    assert "Socket 2 holds 1 rows" in told["problems"][0]["message"]


def test_other_kinds_say_what_is_missing(client: httpx.Client, arm: Callable[..., str]) -> None:
    campaign = arm(columns(poses(20)))
    standard = check(client, "evaluate", [campaign], options={"metrics": "iso9283"})
    assert not standard["would_run"] or standard["missing"]
    errors = check(client, "evaluate", [campaign])
    assert errors["would_run"]
    assert (errors["rows"], errors["held_out"]["how"]) == (36, "none")
    nothing = check(client, "plan", [], options={"purpose": "separate"})
    assert "nothing to tell apart" in nothing["problems"][0]["message"]
    loads = check(client, "plan", [], options={"purpose": "identify", "effects": ["axial_compliance"]})
    assert loads["would_run"]
    assert any("payloads_kg" in one["remedy"] for one in loads["missing"])
    cramped = check(
        client, "plan", [], options={"purpose": "identify", "box_mm": [[9000, 9000, 9000], [9001, 9001, 9001]]}
    )
    assert not cramped["would_run"]
    links = check(client, "joint_parameters", [campaign])
    assert not links["would_run"]
    unknown = check(client, "joint_parameters", [], options={"propose": "j9"})
    assert "no joint 'j9'" in unknown["problems"][0]["message"]
