"""A version that is unsure says so in a corrected file: in its rows, its intervals and its notes, and over the stream."""

from __future__ import annotations

import json
from dataclasses import replace

import httpx
import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.correct.program import compile_program
from kilter_core.model import Calibration
from kilter_core.model.calibration import Doubt
from kilter_service.contract.versions import CorrectionLimits
from kilter_service.ground.db import Database
from kilter_service.jobs.kind import JobInput, JobOutput, VersionContent
from kilter_service.jobs.work.runner import with_doubts
from kilter_service.stream.corrector.active import Active, DatabaseSource
from kilter_service.stream.corrector.wire import Flag
from tests.core.truth import ur10
from tests.service.test_versions import Versions, joints, streamed, trajectory, twin, versions

__all__ = ["twin", "versions"]

KNOWN = {"names": ["base_x"], "matrix": [[1e-8]], "units": "SI", "inadequacy_m": 3e-5, "noise_m": 1e-5}
UNSURE = {"UNSURE", "LIMITED"}  # backlash is on its way from one side to the other in some rows


@pytest.mark.both_databases
def test_rows_near_what_was_set_aside_are_unsure_and_their_intervals_wider(
    client: httpx.Client, versions: Versions, twin: object
) -> None:
    box = Doubt.everywhere(5, 4e-4, "a pose near these was set aside.")
    box.low[1], box.high[1] = np.radians([35.0, 45.0])
    truth: Calibration = twin.truth  # type: ignore[attr-defined]
    plain, doubted = (
        client.post(
            "/v1/robots/katana/correct", params={"version": versions.add(name, one, KNOWN)}, json=trajectory(60)
        )
        for name, one in (("plain", truth), ("doubted", replace(truth, doubts=(box,))))
    )
    before, after = plain.json(), doubted.json()
    inside = (np.array(trajectory(60)["q2_deg"]) >= 35.0) & (np.array(trajectory(60)["q2_deg"]) <= 45.0)
    assert 5 < inside.sum() < 55
    assert [w in UNSURE for w in np.array(after["status"])[inside]] == [True] * int(inside.sum())
    assert np.array_equal(np.array(after["status"])[~inside], np.array(before["status"])[~inside])
    assert np.array_equal(["UNSURE" in (f or "") for f in after["flags"]], inside)
    grown = np.array(after["u95_x_mm"]) - np.array(before["u95_x_mm"])
    assert grown == pytest.approx(np.where(inside, 0.4, 0.0), abs=1e-9)
    assert f"{inside.sum()} of 60 rows are unsure: a pose near these was set aside." in doubted.headers["Kilter-Notes"]
    assert plain.headers["Kilter-U95"] == "along a path, relative to the instrument"
    rows = {name: cells for name, cells in trajectory(5).items() if name != "t_s"}
    apart = client.post("/v1/robots/katana/correct", params={"version": versions.add("b", truth)}, json=rows)
    assert apart.headers["Kilter-U95"] == "for poses, relative to the instrument"


@pytest.mark.both_databases
def test_a_refuted_version_says_so_in_every_row_in_the_notes_and_over_the_stream(
    client: httpx.Client, versions: Versions, twin: object, database: Database
) -> None:
    truth: Calibration = twin.truth  # type: ignore[attr-defined]
    refuted = replace(truth, doubts=(Doubt.everywhere(5, 0.0, "held-out rows refute it."),))
    version = versions.add("refuted", refuted, KNOWN)
    client.post(f"/v1/versions/{version}/activate", json={"force": True, "reason": "a test"}).raise_for_status()
    answer = client.post("/v1/robots/katana/correct", json=trajectory(40))
    assert set(answer.json()["status"]) <= UNSURE
    assert "UNSURE" in answer.json()["status"]
    assert "This version is unsure everywhere: held-out rows refute it." in answer.headers["Kilter-Notes"].split(" | ")
    yaml = client.post("/v1/robots/katana/correct", params={"format": "ros2-yaml"}, json=trajectory(40)).text
    assert "# This version is unsure everywhere: held-out rows refute it." in yaml.splitlines()
    strict = client.post("/v1/robots/katana/correct", params={"strict": "true"}, json=trajectory(40))
    assert strict.json()["code"] == "rows_not_reached"

    source = DatabaseSource(database.url)
    source.stamp()
    (active,) = source.load().values()
    assert json.loads(active.announcement())["unsure"] == ["held-out rows refute it."]
    flags = [one.header.flags for one in streamed(active, joints(trajectory(40)), 1.0 / 39)]
    assert all(flag & Flag.UNSURE for flag in flags)
    sure = Active("katana", version, 1, 1, compile_program(truth))
    assert not any(one.header.flags & Flag.UNSURE for one in streamed(sure, joints(trajectory(40)), 1.0 / 39))


def test_what_a_report_says_against_its_version_makes_it_unsure() -> None:
    robot = robot_from_document(ur10().document())
    content = VersionContent(
        Calibration.nominal(robot).to_document(),
        {"warnings": [{"code": "confirmation_worse", "message": "It predicts the confirmation worse than geometry."}]},
        {},
        CorrectionLimits(),
    )
    job = JobInput.__new__(JobInput)
    object.__setattr__(job, "robot", robot)
    found = with_doubts(JobOutput({}, content), job).version
    assert found is not None
    (doubt,) = Calibration.from_document(robot, found.calibration).doubts
    assert doubt.whole
    assert doubt.reason == "It predicts the confirmation worse than geometry."
    good = replace(content, report={"warnings": []})
    assert with_doubts(JobOutput({}, good), job).version is good
