"""Families of joints: what a version stores of joints that show nothing, and where a fit would leave what is physical.

Loads and deflections are those of the blind generator, nothing of which is computed by what is tested.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.gap import GapOptions, GapReport, find_gap
from kilter_core.gap.effect_search import _shown_members
from kilter_core.gap.search import candidates
from kilter_core.gap.search.candidates import FAMILY
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.linear.linearized import estimate_linear_parameters
from kilter_core.gap.search.prepare import Prepared, prepare_data
from kilter_core.gap.search.scan import Null, Scorer
from kilter_core.gap.search.select import Selector
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.gap import many_joints
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


def test_one_family_in_twenty_keeps_a_joint_that_has_nothing() -> None:
    """Play at two joints of seven under noise of its own, 300 times: five joints more are asked each time."""
    made = many_joints.campaign(0, 7, {})
    robot, rows = robot_from_document(made.document), Observations(**made.columns)
    options = GapOptions(effects=("backlash",))
    prepared = prepare_data(Calibration.nominal(robot), rows, options)
    family = next(k for k, c in enumerate(prepared.library.candidates) if c.level == FAMILY)
    rng, W = np.random.default_rng(1), prepared.problem.W
    strong = W[:, [1, 4]] @ np.array([15.0, -15.0])
    kept = [_kept(prepared, family, strong + rng.standard_normal(len(W))) for _ in range(300)]
    assert all({1, 4} <= joints for joints in kept)
    assert sum(joints != {1, 4} for joints in kept) <= 25


@pytest.mark.parametrize("size", [3.0, 6.0])
def test_intervals_hold_where_joints_of_a_family_imitate_each_other(size: float) -> None:
    """Radial compliance at all of seven joints, 60 times: what is told of those that stay must not presume the others zero."""
    made = many_joints.campaign(0, 7, {})
    robot, rows = robot_from_document(made.document), Observations(**made.columns)
    prepared = prepare_data(Calibration.nominal(robot), rows, GapOptions(effects=("radial_compliance",)))
    problem, every = prepared.problem, prepared.library.candidates
    family = next(k for k, c in enumerate(every) if c.level == FAMILY)
    columns, rng, inside = list(every[family].columns), np.random.default_rng(1), list[bool]()
    for _ in range(60):
        y = size * problem.W[:, columns].sum(axis=1) + rng.standard_normal(len(problem.W))
        kept = _kept(prepared, family, y)
        own = [k for k, j in zip(columns, every[family].joints or (), strict=True) if j in kept]
        y = y - problem.U @ (problem.U.T @ y)
        values, covariance = estimate_linear_parameters(replace(problem, y=y, c=problem.W.T @ y), own)
        inside += (np.abs(values - size / problem.size[own]) < 1.96 * np.sqrt(np.diag(covariance))).tolist()
    assert np.mean(inside) > 0.92


def _kept(prepared: Prepared, family: int, y: np.ndarray) -> set[int]:
    """Joints of a family that is the only name, where these are the data."""
    problem = prepared.problem
    y = y - problem.U @ (problem.U.T @ y)
    scorer = Scorer.from_candidates(prepared.library.candidates, problem.settings.trusted, np.inf)
    selector = Selector(scorer, problem.rows, np.full(len(problem.A), np.inf))
    problem = replace(problem, y=y, c=problem.W.T @ y)
    columns = list(scorer.candidates[family].columns)
    values = problem.values.copy()
    values[len(values) - len(problem.A) + np.array(columns)] = estimate_linear_parameters(problem, columns)[0]
    problem = replace(problem, values=values)
    found = SearchResult(problem, selector, (family,), Null(np.ones(1), None), 1e-4, ())
    return {effect.joints[0] for effect, _ in _shown_members(found, scorer.candidates[family])}
