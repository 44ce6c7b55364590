"""A version that predicts worse is not activated; campaigns measured on Pinocchio's arm, which shares no code with core."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import httpx
import numpy as np
import pytest
from numpy.typing import NDArray
from sqlalchemy import select, update

from kilter_core.identify.holdout import split
from kilter_core.observations.repeats import rounded_poses
from kilter_service.contract.jobs.gap import GAP, GapOptions
from kilter_service.contract.jobs.identify import IDENTIFY, IdentifyOptions
from kilter_service.contract.jobs.registry import NewJob
from kilter_service.contract.versions import ActivationWish
from kilter_service.ground.db import Database
from kilter_service.ground.db.tables import JobRow, VersionRow
from kilter_service.jobs import store as jobs
from kilter_service.jobs.work import store as lease
from kilter_service.jobs.work.runner import Runner
from kilter_service.robots import store as robots
from kilter_service.versions import activation, guard, store
from kilter_service.versions.store import NewVersion
from tests.core.campaigns import table_errors
from tests.core.truth import Arm, some_pose, ur10

Floats = NDArray[np.float64]
NOISE_MM = 0.05


def some_arm(seed: int = 1) -> Arm:
    """A UR10 with an error in every entry of its table, somewhere before the tracker."""
    rng = np.random.default_rng(seed)
    arm = ur10(base=some_pose(rng, 2.0), tool=some_pose(rng, 0.2))
    return arm.moved(table_errors(arm, rng))


@dataclass
class Lab:
    """A UR10 in Kilter, and what it really is like."""

    client: httpx.Client
    database: Database
    arm: Arm = field(default_factory=some_arm)

    def readings(self, poses: int, seed: int) -> Floats:
        return np.random.default_rng(seed).uniform(-2.0, 2.0, (poses, 6))

    def campaign(
        self, q: Floats, seed: int, *, noise_mm: float = NOISE_MM, arm: Arm | None = None, **columns: Any
    ) -> str:
        """Measure the arm at joint readings and upload that as a new campaign."""
        noise = np.random.default_rng([seed, 9]).normal(0.0, noise_mm, (len(q), 3))
        points = 1e3 * (arm or self.arm).poses(q)[0] + noise
        rows = {f"q{j + 1}_deg": np.degrees(q[:, j]).tolist() for j in range(6)} | columns
        return self.upload(rows | {f"{axis}_mm": points[:, k].tolist() for k, axis in enumerate("xyz")})

    def upload(self, rows: dict[str, Any], piece: int = 10_000) -> str:
        """Store rows as a new campaign, perhaps in pieces: too few poses to be judged by themselves come in mixed up."""
        made = (
            self.client.post("/v1/robots/arm/campaigns", json={"name": "c", "numbered": True})
            .raise_for_status()
            .json()["id"]
        )
        for first in range(0, len(rows["q1_deg"]), piece):
            part = {name: values[first : first + piece] for name, values in rows.items()}
            self.client.post(f"/v1/campaigns/{made}/observations", json=part).raise_for_status()
        return str(made)

    def outcome(self, campaigns: list[str], validation: Any = None, **options: Any) -> dict[str, Any]:
        """Do an identify job as the worker does it; returns the job."""
        job = IDENTIFY.request(
            kind="identify", robot="arm", campaigns=campaigns, validation=validation, options=IdentifyOptions(**options)
        )
        return self.done(job)

    def done(self, job: NewJob) -> dict[str, Any]:
        """Do a job as the worker does it; returns it as it ended."""
        with self.database.transaction() as session:
            job_id = jobs.add(session, robots.get(session, "arm").id, job)
            claim = lease.claim(session, "here", [job.kind])
        assert claim is not None
        assert claim.job_id == job_id
        Runner(self.database).run(claim)
        done: dict[str, Any] = self.client.get(f"/v1/jobs/{job_id}").raise_for_status().json()
        return done

    def search(self, campaign: str, **options: Any) -> str:
        """Do a gap job as the worker does it, with few resamples."""
        few = {"bootstraps": 19, "resamples": 5, "permutations": 3, "next_poses": 0}
        job = GAP.request(kind="gap", robot="arm", campaigns=[campaign], options=GapOptions(**few | options))
        done = self.done(job)
        assert done["state"] == "succeeded", done
        return str(done["result"]["version_id"])

    def identify(self, campaigns: list[str], validation: Any = None, **options: Any) -> str:
        job = self.outcome(campaigns, validation, **options)
        assert job["state"] == "succeeded", job
        return str(job["result"]["version_id"])

    def stored(self, like: str, name: str, change: Callable[[dict[str, Any]], None], **report: Any) -> str:
        """A version like another, its calibration changed, with a report of its own."""
        with self.database.transaction() as session:
            row = store.get(session, like)
            job_id = f"job_{name}"
            calibration = {**row.calibration, "values": dict(row.calibration["values"])}
            change(calibration["values"])
            request = jobs.get(session, row.job_id).request
            copied = IDENTIFY.request(kind="identify", robot="arm", campaigns=request.campaigns)
            made = jobs.add(session, row.robot_id, copied)
            session.get_one(JobRow, made).id = job_id
            session.flush()
            new = NewVersion(calibration, report, row.covariance, row.campaigns, row.limits, None, "test")
            return store.add(session, row.robot_id, job_id, new)

    def activate(self, version: str, **wish: Any) -> httpx.Response:
        return self.client.post(f"/v1/versions/{version}/activate", json=wish or None)

    def campaigns(self) -> list[str]:
        found = self.client.get("/v1/robots/arm/campaigns").json()["campaigns"]
        return [one["id"] for one in found]

    def active(self) -> str | None:
        found: str | None = self.client.get("/v1/robots/arm").json()["active_version"]
        return found

    def log(self) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = self.client.get("/v1/robots/arm/activations").json()["activations"]
        return found


@pytest.fixture
def lab(client: httpx.Client, database: Database) -> Lab:
    client.post("/v1/robots", json={**ur10().document(), "controller_compensation": "none"}).raise_for_status()
    return Lab(client, database)


def codes(found: list[dict[str, Any]]) -> set[str]:
    return {one["code"] for one in found}


def test_a_better_version_is_activated_and_says_what_was_compared(lab: Lab) -> None:
    first, second, third = (lab.campaign(lab.readings(n, seed), seed) for n, seed in ((20, 1), (60, 2), (30, 3)))
    rough, good = lab.identify([first]), lab.identify([second])
    found = lab.activate(rough).raise_for_status().json()
    assert found["compared"]["campaigns"] == sorted([second, third])
    assert (found["compared"]["poses"], found["compared"]["rows"]) == (90, 90)
    assert found["compared"]["active"] is None
    assert found["compared"]["mean_mm"] < 0.5 * found["compared"]["registration_only"]["mean_mm"]
    compared = lab.activate(good).raise_for_status().json()["compared"]
    assert (compared["campaigns"], compared["poses"], compared["active_version"]) == ([third], 30, rough)
    assert compared["mean_mm"] == pytest.approx(NOISE_MM * np.sqrt(8 / np.pi), rel=0.3)
    assert compared["active"]["larger_by_mm"] < 0 < compared["active"]["margin_mm"]
    assert found["objections"] == []
    assert found["forced"] is False


def test_a_version_worse_than_the_active_one_is_refused_unless_forced(lab: Lab) -> None:
    good = lab.identify([lab.campaign(lab.readings(60, 1), 1)])
    coarse = lab.identify([lab.campaign(lab.readings(15, 2), 2, noise_mm=1.0)])
    judged = lab.campaign(lab.readings(40, 3), 3)
    lab.activate(good).raise_for_status()
    answer = lab.activate(coarse)
    refused = answer.json()
    assert (answer.status_code, refused["code"]) == (409, "activation_refused")
    assert codes(refused["context"]["objections"]) == {"worse_than_active"}
    assert refused["context"]["compared"]["campaigns"] == [judged]
    assert "was not fitted to (c (3))" in refused["detail"]
    assert "--force" in refused["detail"]
    assert good in refused["detail"]
    assert (lab.active(), len(lab.log())) == (good, 1)

    forced = lab.activate(coarse, force=True, reason="the arm was repaired").raise_for_status().json()
    assert forced["forced"]
    assert codes(forced["objections"]) == {"worse_than_active"}
    last = lab.log()[0]
    assert (last["forced"], last["reason"], last["actor"]) == (True, "the arm was repaired", "admin")
    assert codes(last["objections"]) == {"worse_than_active"}
    back = lab.client.post("/v1/robots/arm/rollback").raise_for_status().json()
    assert (back["id"], back["compared"]) == (good, None)
    assert lab.log()[0]["forced"] is False


def test_a_rollback_to_a_version_that_is_worse_is_never_refused(lab: Lab) -> None:
    coarse = lab.identify([lab.campaign(lab.readings(15, 2), 2, noise_mm=1.0)])
    good = lab.identify([lab.campaign(lab.readings(60, 1), 1)])
    lab.activate(coarse, force=True).raise_for_status()
    lab.campaign(lab.readings(40, 3), 3)
    lab.activate(good).raise_for_status()
    assert lab.client.post("/v1/robots/arm/rollback").raise_for_status().json()["id"] == coarse


@pytest.mark.parametrize("level", [1, 2])
def test_a_campaign_with_two_joints_exchanged_makes_no_version_that_can_be_activated(lab: Lab, level: int) -> None:
    right, q = lab.campaign(lab.readings(40, 1), 1), 0.4 * lab.readings(60, 2)
    points = 1e3 * lab.arm.poses(q)[0]
    order = [0, 2, 1, 3, 4, 5]
    rows = {f"q{j + 1}_deg": np.degrees(q[:, order[j]]).tolist() for j in range(6)}
    swapped = lab.upload(rows | {f"{axis}_mm": points[:, k].tolist() for k, axis in enumerate("xyz")}, piece=11)
    job = lab.outcome([swapped], level=level)
    if job["state"] == "failed":  # identify itself has seen it: then there is nothing to activate
        assert lab.client.get("/v1/robots/arm/versions").json()["versions"] == []
        return
    answer = lab.activate(job["result"]["version_id"])
    assert answer.json()["code"] == "activation_refused"
    assert "error_beyond_limit" in codes(answer.json()["context"]["objections"])
    assert "error_beyond_limit" in codes(job["result"]["objections"])
    assert answer.json()["context"]["compared"]["campaigns"] == [right]
    assert job["result"]["metrics"]["train"]["identified"]["mean_mm"] > 100.0


def test_a_version_worse_than_registration_is_refused_though_its_report_is_good(lab: Lab) -> None:
    wide = {"max_joint_deg": 5, "max_position_mm": 100}
    good = lab.identify([lab.campaign(lab.readings(60, 1), 1)], limits=wide)

    def bend(values: dict[str, float]) -> None:
        values["theta_offset_3"] += 0.02

    bent = lab.stored(good, "bent", bend)
    assert lab.activate(bent).json()["compared"] is None
    lab.campaign(lab.readings(40, 2), 2)
    bent = lab.stored(good, "bent_again", bend)
    assert codes(lab.activate(bent).json()["context"]["objections"]) == {"worse_than_registration"}


def test_without_rows_of_its_own_a_warning_stands_instead(lab: Lab) -> None:
    version = lab.identify([lab.campaign(lab.readings(40, 1), 1)])
    found = lab.activate(version).raise_for_status().json()
    assert (found["compared"], codes(found["warnings"])) == (None, {"nothing_to_compare"})


def test_poses_measured_again_in_another_campaign_do_not_count(lab: Lab) -> None:
    q = lab.readings(40, 1)
    version = lab.identify([lab.campaign(q, 1)])
    lab.campaign(q, 2)
    assert codes(lab.activate(version).json()["warnings"]) == {"nothing_to_compare"}
    lab.campaign(np.vstack([q, lab.readings(11, 3)]), 3)
    assert lab.activate(lab.stored(version, "again", lambda _: None)).json()["compared"]["poses"] == 11


def test_versions_split_by_rounded_readings_keep_their_split(lab: Lab) -> None:
    """Read-back noise parted repeats before poses had a distance; what such a version was fitted to stays told."""
    q = np.repeat(lab.readings(40, 1), 3, axis=0)
    q += np.radians(1e-4) * np.random.default_rng(2).normal(size=q.shape)
    campaign = lab.campaign(q, 1)
    version = lab.identify([campaign], validation=0.3, seed=5)
    # Stored in degrees, the readings come back with another last bit.
    with lab.database.reading() as session:
        archive = guard.Archive(session, store.get(session, version).robot_id)
        rows = archive.rows(campaign)
        assert rows is not None
        now = np.flatnonzero(archive.mark_fitted_rows(version, campaign))
    np.testing.assert_array_equal(now, split(rows, 0.3, 5)[0])
    with lab.database.engine.begin() as connection:  # as an earlier release stored it
        of_version = VersionRow.id == version
        (kept,) = connection.execute(select(VersionRow.report).where(of_version)).one()
        report = {k: v for k, v in kept.items() if k not in (store.POSES, store.SPLIT)}
        connection.execute(update(VersionRow).where(of_version).values(report=report))
    with lab.database.reading() as session:
        archive = guard.Archive(session, store.get(session, version).robot_id)
        before = np.flatnonzero(archive.mark_fitted_rows(version, campaign))
    groups = rounded_poses(rows.q)
    drawn = np.random.default_rng(5).permutation(groups.max() + 1)[: round(0.3 * (groups.max() + 1))]
    np.testing.assert_array_equal(before, np.flatnonzero(~np.isin(groups, drawn)))
    assert len(np.setdiff1d(before, now))


def test_the_held_out_poses_of_a_fraction_are_found_again(lab: Lab) -> None:
    q = np.repeat(lab.readings(40, 1), 2, axis=0)
    first, second = lab.campaign(q, 1), lab.campaign(lab.readings(30, 2), 2)
    version = lab.identify([first, second], validation=0.3, seed=5)
    metrics = lab.client.get(f"/v1/versions/{version}").json()["metrics"]
    assert metrics["validation"]["n"] < 60
    compared = lab.activate(version).raise_for_status().json()["compared"]
    assert (compared["poses"], compared["rows"]) == (21, metrics["validation"]["n"])
    other = lab.identify([first, second], validation=0.3, seed=6)
    with lab.database.reading() as session:
        archive = guard.Archive(session, store.get(session, other).robot_id)
        mine, both = archive.unseen([version]).rows, archive.unseen([version, other]).rows
    assert sum(len(rows) for rows in both.values()) < sum(len(rows) for rows in mine.values())


def test_a_search_and_an_identification_of_one_campaign_are_compared_where_neither_was_fitted(lab: Lab) -> None:
    campaign = lab.campaign(lab.readings(64, 1), 1)
    good = lab.identify([campaign], validation=0.25)
    lab.activate(good).raise_for_status()
    searched = lab.search(campaign, effects=["backlash"])
    compared = lab.activate(searched, force=True).raise_for_status().json()["compared"]
    assert (compared["poses"], compared["active"]["poses"], compared["active_version"]) == (16, 16, good)


def test_rows_of_the_version_it_continues_from_count_as_trained_on(lab: Lab) -> None:
    first, second, third = (lab.campaign(lab.readings(40, seed), seed) for seed in (1, 2, 3))
    parent = lab.identify([first])
    child = lab.identify([second], start=parent)
    assert lab.activate(child).json()["compared"]["campaigns"] == [third]


def test_rows_uploaded_after_the_fit_were_not_trained_on(lab: Lab) -> None:
    first = lab.campaign(lab.readings(40, 1), 1)
    version = lab.identify([first])
    q = lab.readings(12, 2)
    later = lab.client.get(f"/v1/campaigns/{lab.campaign(q, 2)}").json()
    rows = {f"q{j + 1}_deg": np.degrees(q[:, j]).tolist() for j in range(6)}
    points = 1e3 * lab.arm.poses(q)[0]
    rows |= {f"{axis}_mm": points[:, k].tolist() for k, axis in enumerate("xyz")}
    lab.client.post(f"/v1/campaigns/{first}/observations", json=rows).raise_for_status()
    compared = lab.activate(version).json()["compared"]
    assert compared["campaigns"] == sorted([first, later["id"]])
    assert compared["rows"] == 24


def test_when_the_active_one_knows_all_other_rows_registration_still_judges(lab: Lab) -> None:
    first, second = (lab.campaign(lab.readings(40, seed), seed) for seed in (1, 2))
    lab.activate(lab.identify([first])).raise_for_status()
    found = lab.activate(lab.identify([second])).raise_for_status().json()
    assert found["compared"]["campaigns"] == [first]
    assert (found["compared"]["active"], codes(found["warnings"])) == (None, {"active_not_compared"})


def test_where_no_pose_is_new_to_both_the_larger_held_out_error_is_asked_about(lab: Lab) -> None:
    first, second = lab.campaign(lab.readings(60, 1), 1), lab.campaign(lab.readings(60, 2), 2, noise_mm=0.3)
    good, coarse = lab.identify([first, second], validation=0.25, loss="huber"), lab.identify([second], validation=0.25)
    lab.activate(good).raise_for_status()
    everything = lab.identify([first, second])  # so that nothing is new to both of it and the others
    coarse = lab.stored(coarse, "coarse", lambda _: None, metrics=stored_errors(0.14))
    good = lab.stored(everything, "good", lambda _: None, metrics=stored_errors(0.032))
    lab.activate(good, force=True).raise_for_status()
    refused = lab.activate(coarse)
    assert refused.json()["code"] == "activation_refused"
    assert codes(refused.json()["context"]["objections"]) == {"larger_own_error"}
    for words in ("0.14 mm on 16 rows that it held out", "0.032 mm on 16 rows", good, "neither was fitted to"):
        assert words in refused.json()["detail"]
    forced = lab.activate(coarse, force=True, reason="the other is of last year").raise_for_status().json()
    assert codes(forced["objections"]) == {"larger_own_error"}
    back = lab.activate(good).raise_for_status().json()  # the smaller one is not asked about, and both numbers are said
    (said,) = [w["message"] for w in back["warnings"] if w["code"] == "own_errors_compared"]
    assert "0.032 mm" in said
    assert "0.14 mm" in said


def test_where_neither_held_rows_out_those_that_both_fitted_are_compared(lab: Lab) -> None:
    campaign = lab.campaign(lab.readings(60, 1), 1)
    good, coarse = lab.identify([campaign]), lab.identify([campaign], level=1, fix=["theta_offset_*"])
    lab.activate(good).raise_for_status()
    refused = lab.activate(coarse)
    assert codes(refused.json()["context"]["objections"]) >= {"larger_own_error"}
    assert "both fitted to 60 poses of c" in refused.json()["detail"]
    lab.activate(coarse, force=True, reason="a test").raise_for_status()
    back = lab.activate(good).raise_for_status().json()
    assert "own_errors_compared" in codes(back["warnings"])


def test_who_activates_is_told_that_somebody_else_just_did(lab: Lab) -> None:
    campaign = lab.campaign(lab.readings(60, 1), 1)
    first = lab.identify([campaign], validation=0.25)
    second = lab.stored(first, "second", lambda _: None)
    activation.activate(lab.database, first, "alice", ActivationWish())
    told = activation.activate(lab.database, second, "bob", ActivationWish()).warnings
    (said,) = [one.message for one in told if one.code == "activated_lately"]
    assert f"alice activated version {first} less than a minute ago" in said
    again = activation.activate(lab.database, first, "bob", ActivationWish()).warnings
    assert "activated_lately" not in {one.code for one in again}


def stored_errors(mean: float) -> dict[str, Any]:
    """Metrics of held-out rows with this mean error, mm."""
    stages = {
        "identified": {"mean_mm": mean, "rms_mm": 1.08 * mean},
        "registration_only": {"mean_mm": 0.9, "rms_mm": 1.0},
    }
    return {"validation": {"n": 16} | stages}


def test_campaigns_that_no_model_fits_are_named_and_left_out(lab: Lab) -> None:
    good = lab.identify([lab.campaign(lab.readings(60, 1), 1)])
    right, q = lab.campaign(lab.readings(30, 2), 2), lab.readings(40, 3)
    points = 1e3 * lab.arm.poses(q)[0]
    joints = {f"q{j + 1}_deg": np.degrees(q[:, j]).tolist() for j in range(6)}
    shuffled = np.random.default_rng(5).permutation(40)
    mixed = {
        lab.upload(joints | {f"{axis}_mm": rows[:, k].tolist() for k, axis in enumerate("xyz")}, piece=11)
        for rows in (points[shuffled], np.roll(points, 1, axis=0), points[:, [1, 0, 2]])
    }
    found = lab.activate(good).raise_for_status().json()
    assert found["compared"]["campaigns"] == [right]
    assert found["compared"]["mean_mm"] < 0.15
    said = [w["message"] for w in found["warnings"] if w["code"] == "campaign_fits_no_model"]
    assert {campaign for campaign in mixed for message in said if campaign in message} == mixed


def test_too_few_poses_new_to_both_leave_the_comparison_with_registration(lab: Lab) -> None:
    first, second = (lab.campaign(lab.readings(40, seed), seed) for seed in (1, 2))
    lab.campaign(lab.readings(5, 3), 3)
    lab.activate(lab.identify([first])).raise_for_status()
    found = lab.activate(lab.identify([second])).raise_for_status().json()
    assert found["compared"]["campaigns"] == [first]
    assert codes(found["warnings"]) == {"active_not_compared", "campaign_not_compared"}
    assert any("c (3)" in warning["message"] for warning in found["warnings"])


def test_a_version_that_predicts_nothing_at_all_is_refused(lab: Lab) -> None:
    good = lab.identify([lab.campaign(lab.readings(60, 1), 1)])
    lab.campaign(lab.readings(40, 2), 2)

    def blow_up(values: dict[str, float]) -> None:
        values["a_2"] = 1e200

    wild = lab.stored(good, "wild", blow_up)
    refused = lab.activate(wild).json()
    assert refused["code"] == "activation_refused"
    assert codes(refused["context"]["objections"]) == {"worse_than_registration", "another_arm", "cannot_correct"}
    assert "predicts campaign c (" in refused["detail"]


def test_what_a_version_needs_and_a_campaign_lacks_is_said(lab: Lab) -> None:
    q = lab.readings(60, 1)
    warm = np.random.default_rng(4).uniform(18.0, 30.0, len(q)).tolist()
    version = lab.identify([lab.campaign(q, 1, temperature_c=warm)], effects=["thermal_growth"])
    plain = lab.identify([lab.campaign(lab.readings(40, 2), 2)])
    bare = lab.campaign(lab.readings(20, 3), 3)
    found = lab.activate(version).raise_for_status().json()
    assert found["compared"] is None
    assert codes(found["warnings"]) == {"campaign_not_compared", "nothing_to_compare"}
    assert any("c (3)" in w["message"] and "temperature" in w["message"] for w in found["warnings"])
    found = lab.activate(plain).raise_for_status().json()
    assert found["compared"]["campaigns"] == [bare]
    assert found["compared"]["active"] is None
    assert "active_not_compared" in codes(found["warnings"])


def test_every_session_is_a_set_up_of_its_own(lab: Lab) -> None:
    version = lab.identify([lab.campaign(lab.readings(60, 1), 1)])
    q, moved = lab.readings(40, 2), some_arm()
    rng = np.random.default_rng(8)
    here = 1e3 * lab.arm.poses(q[:20])[0]
    there = 1e3 * ur10(base=some_pose(rng, 2.0), tool=some_pose(rng, 0.2)).moved(
        {s.name: s.value - t.value for s, t in zip(moved.steps, ur10().steps, strict=True) if s.value != t.value}
    ).poses(q[20:])[0]  # fmt: skip
    points = np.vstack([here, there])
    rows = {f"q{j + 1}_deg": np.degrees(q[:, j]).tolist() for j in range(6)} | {"session": [1] * 20 + [2] * 20}
    lab.upload(rows | {f"{axis}_mm": points[:, k].tolist() for k, axis in enumerate("xyz")})
    compared = lab.activate(version).raise_for_status().json()["compared"]
    assert compared["poses"] == 40
    assert compared["mean_mm"] < 0.1


WORSE_HELD_OUT = {"registration_only": {"mean_mm": 0.5}, "identified": {"mean_mm": 0.6}}


DOUBTFUL: tuple[tuple[dict[str, Any], str], ...] = (
    ({"warnings": [{"code": "worse_than_geometry", "message": "Held out: worse."}]}, "worse_than_geometry"),
    ({"warnings": [{"code": "heldout_worse_than_registration", "message": "W."}]}, "heldout_worse_than_registration"),
    ({"metrics": {"validation": WORSE_HELD_OUT}}, "heldout_worse"),
    ({"metrics": {"train": {"n": 9, "identified": {"mean_mm": 443.0}}}}, "error_beyond_limit"),
    ({"metrics": {"validation": {"n": 9, "identified": {"mean_mm": 51.0}}}}, "error_beyond_limit"),
)


def test_what_its_own_identification_found_refuses_it(lab: Lab) -> None:
    good = lab.identify([lab.campaign(lab.readings(40, 1), 1)])
    for k, (report, code) in enumerate(DOUBTFUL):
        doubtful = lab.stored(good, f"doubtful_{k}", lambda _: None, **report)
        answer = lab.activate(doubtful)
        assert answer.status_code == 409
        assert codes(answer.json()["context"]["objections"]) == {code}
        assert codes(lab.client.get(f"/v1/versions/{doubtful}").json()["objections"]) == {code}
    assert lab.client.get(f"/v1/versions/{good}").json()["objections"] == []
    assert lab.activate(doubtful, force=True).status_code == 200


def test_held_out_rows_that_are_worse_by_chance_do_not_refuse(lab: Lab) -> None:
    good = lab.identify([lab.campaign(lab.readings(40, 1), 1)])
    stages = {"registration_only": {"mean_mm": 0.769, "rms_mm": 0.84}, "identified": {"mean_mm": 0.778, "rms_mm": 0.85}}
    assert lab.activate(lab.stored(good, "even", lambda _: None, metrics={"validation": {"n": 35} | stages})).is_success
    many = lab.stored(good, "many", lambda _: None, metrics={"validation": {"n": 35_000} | stages})
    assert codes(lab.activate(many).json()["context"]["objections"]) == {"heldout_worse"}


def test_thousands_of_poses_are_thinned_and_that_is_said(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    version = lab.identify([lab.campaign(lab.readings(40, 1), 1)])
    lab.campaign(np.repeat(lab.readings(300, 2), 6, axis=0), 2)
    lab.campaign(lab.readings(100, 3), 3)
    monkeypatch.setattr(guard, "MOST_POSES", 100)
    found = lab.activate(version).raise_for_status().json()
    assert (found["compared"]["poses"], found["compared"]["rows"]) == (100, 75 * 4 + 25)
    assert codes(found["warnings"]) == {"poses_thinned"}


def test_a_version_activated_meanwhile_is_compared_with_too(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    good = lab.identify([lab.campaign(lab.readings(60, 1), 1)])
    coarse = lab.identify([lab.campaign(lab.readings(15, 2), 2, noise_mm=1.0)])
    lab.campaign(lab.readings(40, 3), 3)
    judge, asked = guard.judge, []

    def judged(database: Database, version: str) -> guard.Verdict:
        found = judge(database, version)
        asked.append(version)
        if asked == [coarse]:
            lab.activate(good).raise_for_status()
        return found

    monkeypatch.setattr(activation, "judge", judged)
    answer = lab.activate(coarse)
    assert codes(answer.json()["context"]["objections"]) == {"worse_than_active"}
    assert asked == [coarse, good, coarse]
    assert lab.active() == good
