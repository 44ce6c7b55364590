"""What a report advises and what objects to its version are one thing, on every way to it."""

from __future__ import annotations

import io
from contextlib import redirect_stdout
from typing import Any

import httpx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilter_client.cli.reports.answer import suggest_for_version
from kilter_client.cli.reports.results import show_job
from kilter_core.identify.comparison import PoseErrors
from kilter_service.contract.versions import CorrectionLimits
from kilter_service.ground.db import Database
from kilter_service.versions.objections import objections_from_report
from tests.core.truth import ur10
from tests.service.test_activation_guard import Lab, codes

ADVICE = "do not activate"


@pytest.fixture
def lab(client: httpx.Client, database: Database) -> Lab:
    client.post("/v1/robots", json=ur10().document()).raise_for_status()
    return Lab(client, database)


@pytest.mark.parametrize(
    ("left", "before", "reach", "said"),
    [
        (7.0, 208.0, 900.0, "too large to correct with"),  # a joint mastered far off, nearly found
        (7.0, 208.0, 2700.0, ""),  # of a large arm that is as little as others leave unidentified
        (180.0, 208.0, 900.0, "may be mixed up, or it is another robot"),
        (443.0, None, None, "may be mixed up, or it is another robot"),  # stored by an earlier release
        (4.0, 208.0, None, ""),
    ],
)
def test_another_robot_is_suspected_only_where_next_to_nothing_is_explained(
    left: float, before: float | None, reach: float | None, said: str
) -> None:
    stages = {"identified": {"mean_mm": left}} | ({} if before is None else {"registration_only": {"mean_mm": before}})
    report = {"metrics": {"train": {"n": 40, **stages}}} | ({} if reach is None else {"workspace": {"reach_mm": reach}})
    found = [one.message for one in objections_from_report(report, CorrectionLimits(max_position_mm=5.0))]
    assert len(found) == bool(said)
    assert all(said in message and "too large to correct with" in message for message in found)
    assert all(("another robot" in message) == ("another robot" in said) for message in found)


def printed(report: dict[str, Any], objections: list[dict[str, Any]]) -> str:
    """What the command prints of a job with this report."""
    job = {"kind": "identify", "id": "job_1", "robot": "arm", "state": "succeeded"}
    out = io.StringIO()
    with redirect_stdout(out):
        advised = suggest_for_version({"id": "ver_1", "active": False, "robot": "arm", "objections": objections})
        show_job(job | {"result": {"version_id": "ver_1", "objections": objections, **report}}, suggested=advised)
    return " ".join(out.getvalue().split())


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 200), st.floats(0.5, 2.0), st.floats(0.8, 1.3), st.floats(0.8, 1.3))
def test_what_a_report_advises_is_what_objects(
    seed: int, poses: int, spread: float, registration: float, geometry: float
) -> None:
    rng = np.random.default_rng(seed)
    found = 1e-4 * rng.lognormal(0.0, spread, poses)
    stages = {"identified": found} | {
        name: found * share * rng.lognormal(0.0, 0.3, poses)
        for name, share in (("registration_only", registration), ("geometry_fitted", geometry))
    }
    report = {"warnings": list(PoseErrors(stages).warnings())}
    advised = {w["code"] for w in report["warnings"] if ADVICE in w["message"]}
    objections = [one.model_dump() for one in objections_from_report(report, CorrectionLimits())]
    assert codes(objections) == advised
    assert ("kilter activate ver_1" in printed(report, objections)) == (not advised)


def test_the_rows_of_another_arm_make_no_version_that_is_activated_unasked(lab: Lab) -> None:
    lab.arm = lab.arm.moved({"a_2": -0.052, "alpha_3": 0.35})
    job = lab.outcome([lab.campaign(lab.readings(80, 1), 1)])
    version = job["result"]["version_id"]
    assert job["result"]["metrics"]["train"]["identified"]["mean_mm"] < 0.2
    assert "another_arm" in codes(job["result"]["objections"])
    assert "another_arm" in codes(lab.client.get(f"/v1/versions/{version}").json()["objections"])
    said = printed(job["result"], job["result"]["objections"])
    assert "not the arm described" in said
    assert "kilter activate" not in said
    answer = lab.activate(version)
    assert answer.status_code == 409
    assert "another_arm" in codes(answer.json()["context"]["objections"])
    assert lab.active() is None
    lab.activate(version, force=True, reason="a link was replaced").raise_for_status()
    assert "another_arm" in codes(lab.log()[0]["objections"])


def test_a_version_stored_before_anyone_looked_is_looked_at_when_it_is_activated(lab: Lab) -> None:
    good = lab.identify([lab.campaign(lab.readings(40, 1), 1)])

    def lengthen(values: dict[str, float]) -> None:
        values["a_2"] -= 0.1

    longer = lab.stored(good, "longer", lengthen)
    assert "another_arm" in codes(lab.activate(longer).json()["context"]["objections"])


def test_rows_astray_are_not_taken_for_another_robot() -> None:
    stages = {"identified": {"mean_mm": 291.0}, "registration_only": {"mean_mm": 293.0}}
    astray = {
        "code": "rows_astray",
        "message": "The tool is not where the joints put it in row 6 by 2910 mm.",
        "rows": [6],
    }
    report = {"metrics": {"validation": {"n": 10, **stages}}, "warnings": [astray]}
    (one,) = objections_from_report(report, CorrectionLimits(max_position_mm=5.0))
    assert "in row 6 by 2910 mm" in one.message
    assert "another robot" not in one.message
