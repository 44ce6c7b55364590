"""A payload far from what was stated: named beside the effect of the load that shows it, and never without one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.gap import GapOptions, find_gap
from kilter_core.gap.report.report import GapReport
from kilter_core.observations import Observations
from tests.core.gap.simulated import Hidden, campaign, katana

QUICK = GapOptions(
    effects=("axial_compliance", "backlash", "payload_error"),
    resamples=20,
    permutations=10,
    bootstraps=499,
    next_poses=0,
)
SOFT: Hidden = ("axial_compliance", (1, 2), (8e-5, 1.2e-4))


def told(
    stated_kg: float, hidden: tuple[Hidden, ...], loads: tuple[float, ...] = (0.0, 2.0), seed: int = 6
) -> Observations:
    """Rows of a campaign with these loads, the last of which its user says weighs ``stated_kg``."""
    rows = campaign(katana(), hidden, poses=120, revisits=25, noise_m=1e-5, seed=seed, loads=loads)
    kg = rows.payload_kg
    return replace(rows, payload_kg=np.where(kg == loads[-1], stated_kg, kg))


def names(report: GapReport) -> list[str]:
    return [j.evidence.candidate.id for j in report.effects]


def test_a_payload_twice_as_heavy_as_stated_is_named_beside_the_compliance_that_shows_it() -> None:
    report = find_gap(katana(), told(1.0, (SOFT,)), QUICK)
    (payload,) = [row for row in report.to_document()["effects"] if row["id"] == "payload_error"]
    assert set(names(report)) == {"axial_compliance", "payload_error"}
    mass = next(p for p in payload["parameters"] if p["name"] == "payload_mass")
    assert mass["value"] == pytest.approx(1.0, abs=2.0 * mass["sigma"])
    assert mass["sigma"] < 0.25
    assert mass["seen"]
    # Links of masses that nobody would believe predict as well, so that held-out poses may not gain.
    assert [name for name, passed in payload["gates"].items() if not passed] in ([], ["held_out"])
    assert "mass_far_from_stated" not in {w["code"] for w in report.warnings}
    assert "payload_error" in [e.id for e in report.calibration.model.effects]


def test_a_payload_within_its_prior_is_not_named() -> None:
    report = find_gap(katana(), told(1.9, (SOFT,)), QUICK)
    assert set(names(report)) == {"axial_compliance"}


def test_without_an_effect_of_the_load_it_cannot_be_tested_and_says_so() -> None:
    report = find_gap(katana(), told(1.0, (("backlash", (1,), (6e-4,)),)), QUICK)
    assert names(report) == ["backlash"]
    (said,) = [row for row in report.to_document()["not_testable"] if row["id"] == "payload_error"]
    assert "effects of the load" in said["reason"]


def test_one_load_alone_shows_no_error_of_it() -> None:
    report = find_gap(katana(), told(1.0, (SOFT,), loads=(2.0,)), QUICK)
    assert "payload_error" not in names(report)
    (said,) = [row for row in report.to_document()["not_testable"] if row["id"] == "payload_error"]
    assert "two loads" in said["reason"]


def test_a_set_tried_in_vain_does_not_stop_the_hunt() -> None:
    """Beside one compliance alone the masses bend so far that the second seems to replace it; the re-fit says no."""
    report = find_gap(katana(), told(1.0, (SOFT,), loads=(0.0, 1.5)), QUICK)
    found = {
        j for e in report.effects if e.evidence.candidate.id == "axial_compliance" for j in e.evidence.candidate.joints
    }
    assert found == {1, 2}
