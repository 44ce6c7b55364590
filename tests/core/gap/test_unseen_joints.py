"""Families of joints: what a version stores of joints that show nothing, and where a fit would leave what is physical.

Loads and deflections are those of the blind generator, nothing of which is computed by what is tested.
"""

from __future__ import annotations

import numpy as np
import pytest

from kilter_core.gap import GapOptions, GapReport, find_gap
from kilter_core.gap.search import candidates
from kilter_core.model import Calibration
from tests.core.off_zero import OffZero, soft_elbow

# Gravity puts little load on the last joint, and its gear is stiff: five joints show their compliance, it does not.
SOFT = {1: 4e-6, 2: 6e-6, 3: 5e-6, 4: 8e-6}
QUICK = GapOptions(effects=("axial_compliance", "backlash"), resamples=10, permutations=5, bootstraps=499, next_poses=0)


def searched(twin: OffZero, seed: int) -> GapReport:
    return find_gap(twin.robot, twin.rows(60, seed), QUICK, validation=twin.rows(30, seed + 50))


@pytest.mark.parametrize("seed", [1, 3])
def test_a_family_stores_nothing_of_a_joint_that_does_not_show_it(seed: int) -> None:
    twin = soft_elbow(axial_compliance=(tuple(SOFT), tuple(SOFT.values())))
    report = searched(twin, seed)
    (effect,) = report.effects
    assert effect.evidence.candidate.label == "axial_compliance j2,3,4,5"
    assert effect.evidence.seen_joints == tuple(SOFT)
    found = Calibration.from_document(twin.robot, report.calibration.to_document())
    values = dict(zip(found.names, found.values, strict=True))
    sigma = dict(zip(report.stored.posterior.names, report.stored.posterior.sigma, strict=True))
    assert not {"compliance_1", "compliance_6"} & set(values)
    for j, true in SOFT.items():
        assert abs(values[f"compliance_{j + 1}"] - true) < 3.5 * sigma[f"compliance_{j + 1}"]
    told = report.to_document()
    (warning,) = [w for w in told["warnings"] if w["code"] == "unseen_stays_nominal"]
    assert (warning["effect"], warning["joints"]) == ("axial_compliance", [6])
    (remedy,) = [u["remedy"] for u in told["not_testable"] if u["id"] == "axial_compliance" and u["joints"] == [6]]
    assert remedy[1:] in warning["message"]


def test_no_refit_leaves_an_amplitude_beyond_what_is_physical(monkeypatch: pytest.MonkeyPatch) -> None:
    twin = soft_elbow(axial_compliance=(tuple(SOFT), tuple(SOFT.values())))
    kind = candidates.EFFECTS["axial_compliance"]
    per_joint = kind.per_joint

    def stiffer(self, robot, stem, unit, sigma, lower, upper, text, rotates=False):
        return per_joint(self, robot, stem, unit, sigma, lower, min(upper, 5e-6), text, rotates)

    monkeypatch.setattr(kind, "per_joint", stiffer)
    report = searched(twin, 1)
    values = dict(zip(report.calibration.names, report.calibration.values, strict=True))
    named = {name: v for name, v in values.items() if name.startswith("compliance_")}
    assert named["compliance_3"] == 5e-6
    assert all(0.0 <= v <= 5e-6 for v in named.values())
    held = {w["parameter"] for w in report.warnings if w["code"] == "at_end_of_range"}
    assert held == {name for name, v in named.items() if v == 5e-6}
    assert all(p["plausible"] for p in report.stored.parameters() if p["name"] in named)
    assert np.isfinite(report.gap["after_mm"])
