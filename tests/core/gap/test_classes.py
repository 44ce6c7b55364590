"""Classes: a cause that holds another's shape, effects that cancel, and what is searched of the newer causes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.gap import GapOptions, find_gap
from kilter_core.gap.evidence.similarity.aliases import cancelling_members, find_aliases
from kilter_core.gap.evidence.similarity.testability import testability as judged
from kilter_core.gap.evidence.similarity.testability import untestable
from kilter_core.gap.report.report import effect_row
from kilter_core.gap.search.candidates import build_library, with_testable
from kilter_core.gap.search.forward_selection import SearchResult, search
from kilter_core.gap.search.linear.linearized import refit
from kilter_core.gap.search.prepare import Prepared, prepare_data
from kilter_core.gap.search.scan import Scorer
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.gap.simulated import campaign, katana
from tests.core.gap.test_smooth import measured

QUICK = GapOptions(resamples=20, permutations=5, bootstraps=499, next_poses=0)


def searched(rows: Observations, options: GapOptions) -> tuple[Prepared, SearchResult]:
    prepared = prepare_data(Calibration.nominal(katana()), rows, options)
    candidates = with_testable(prepared.library, judged(prepared.problem, prepared.library).able)
    scorer = Scorer.from_candidates(candidates, True, prepared.problem.settings.noise.freedom)
    limits = np.array([max(abs(p.lower), abs(p.upper)) for p in prepared.library.parameters])
    return prepared, search(prepared.problem.settings, prepared.problem, scorer, limits, options, lambda f, s: None)


def forced(found: SearchResult, *names: tuple[str, tuple[int, ...]]) -> SearchResult:
    """The hunt as if it had chosen these, at their own fit."""
    candidates = found.selector.scorer.candidates
    chosen = tuple(next(k for k, c in enumerate(candidates) if (c.id, c.joints) == name) for name in names)
    problem = refit(found.problem.settings, found.problem.values, found.selector.columns(chosen))
    return replace(found, problem=problem, chosen=chosen)


def test_a_drifting_first_joint_may_be_a_turning_base() -> None:
    """The axis of the first joint stands upright in the base, so one rate of the base's drift is the same motion."""
    effects = ("zero_drift", "drift", "backlash", "settling", "random_walk")
    rows = campaign(katana(), [("zero_drift", (0,), (5e-8,))], seed=3)
    report = find_gap(katana(), rows, replace(QUICK, effects=effects))
    (effect,) = (effect_row(j, report.library, report.misfit) for j in report.effects)
    assert (effect["id"], effect["joints"]) == ("zero_drift", [1])
    aliases = {a["id"]: a["correlation"] for a in effect["alias_set"]}
    assert aliases["drift"] > 0.999
    assert "random_walk" not in aliases  # it imitates anything: holding a shape says nothing
    assert effect["verdict"] == "class_confirmed"


def test_a_walk_in_more_pieces_is_no_other_cause() -> None:
    """A slow drift shows in few pieces as in many: that is one name, and its own alias would make it a class of itself."""
    options = replace(QUICK, effects=("random_walk", "drift"))
    rows = campaign(katana(), [("drift", None, (4e-8, 3e-8, 0.0, 0.0, 0.0, 0.0))], seed=3)
    _, found = searched(rows, options)
    candidates = found.selector.scorer.candidates
    walks = [k for k, c in enumerate(candidates) if c.id == "random_walk"]
    assert len(walks) > 1
    for walk in walks:
        problem = refit(found.problem.settings, found.problem.values, found.selector.columns((walk,)))
        rivals = find_aliases(replace(found, problem=problem, chosen=(walk,)), walk)
        assert "random_walk" not in {a.candidate.id for a in rivals}
        assert "drift" in {a.candidate.id for a in rivals}


def test_what_is_missing_is_said_in_words_that_effects_share() -> None:
    bare = replace(campaign(katana(), []), t=None, temperature_c=None)
    prepared = prepare_data(Calibration.nominal(katana()), bare, QUICK)
    rows = untestable(prepared.library, judged(prepared.problem, prepared.library), prepared.problem, bare)
    groups: dict[str, set[str]] = {}
    for row in rows:
        groups.setdefault(row.missing, set()).add(row.id)
    assert "" not in groups
    assert {"drift", "zero_drift", "settling", "random_walk"} <= groups["columns: t_s"]
    assert "thermal_growth" in groups["columns: temperature_c"]
    assert len(groups) < len(rows) / 2


def test_a_search_warns_of_poses_that_are_too_alike() -> None:
    robot, rng = katana(), np.random.default_rng(2)
    near = 0.3 + rng.uniform(-0.1, 0.1, (40, robot.n_joints))
    for q, warned in ((near, True), (campaign(robot, []).q, False)):
        rows = Observations(q, position=Calibration.nominal(robot).predict(Observations(q)).position)
        assert rows.position is not None
        noisy = replace(rows, position=rows.position + 3e-5 * rng.standard_normal((len(q), 3)))
        report = find_gap(robot, noisy, replace(QUICK, effects=("eccentricity",)), validation=0)
        assert ("poses_ill_conditioned" in {w["code"] for w in report.warnings}) == warned
    rows = campaign(robot, [], measured="markers")
    report = find_gap(robot, rows, replace(QUICK, effects=("eccentricity",)), validation=0)
    assert "poses_ill_conditioned" not in {w["code"] for w in report.warnings}


def test_a_drifting_third_joint_is_no_turning_base() -> None:
    options = replace(QUICK, effects=("zero_drift", "drift", "backlash"))
    report = find_gap(katana(), campaign(katana(), [("zero_drift", (2,), (4e-7,))], seed=4), options)
    without = find_gap(katana(), campaign(katana(), seed=4), options)
    (effect,) = (effect_row(j, report.library, report.misfit) for j in report.effects)
    assert (effect["id"], effect["joints"], effect["alias_set"]) == ("zero_drift", [3], [])
    # The drift is in the repeats too, and no common motion: only what the name leaves of them is noise.
    codes = {w["code"] for w in report.warnings}
    assert "repeats_drift" in codes
    assert not codes & {"drift_not_separated", "noise_too_large"}
    assert report.gap["noise_mm"] == pytest.approx(without.gap["noise_mm"], rel=0.05)
    # The clock alone does not say what went with it.
    assert (effect["verdict"], effect["claim"]["said"]) == ("class_confirmed", "class")


def test_effects_that_cancel_are_one_class() -> None:
    """A scale and a once-per-turn error fitted to a small quadratic curve over 35 degrees: each far larger than it."""
    effects = ("encoder_scale", "eccentricity", "backlash", "gravity_spring")
    rows = measured(katana(), lambda q: 8e-4 * (q / 0.3) ** 3, 2, half=np.radians(17.0))
    _, found = searched(rows, replace(QUICK, effects=effects))
    both = forced(found, ("encoder_scale", (1,)), ("eccentricity", (1,)))
    first, second = both.chosen
    (member,) = cancelling_members(both, first)
    assert (member.place, member.member) == (second, "sum of eccentricity j2 and encoder_scale j2")
    assert [a.place for a in cancelling_members(both, second)] == [first]
    assert {a.member for a in find_aliases(both, first) if a.place == second} == {
        "smooth error of joint 2"
    }  # says more


def test_effects_of_a_size_with_the_gap_are_none() -> None:
    rows = campaign(katana(), [("backlash", (1,), (2e-3,)), ("axial_compliance", (1,), (2e-4,))], seed=1)
    _, found = searched(rows, replace(QUICK, effects=("backlash", "axial_compliance")))
    both = forced(found, ("backlash", (1,)), ("axial_compliance", (1,)))
    assert not [a for k in both.chosen for a in cancelling_members(both, k)]


def test_settling_is_tried_at_several_paces_and_smooth_curves_up_to_each_order() -> None:
    rows = campaign(katana(), seed=2)
    library = build_library(katana(), rows)
    paces = {c.effects[0].tau_s / np.ptp(rows.t) for c in library.candidates if c.id == "settling"}  # type: ignore[attr-defined]
    assert len(paces) == 4
    assert min(paces) < 0.1
    assert max(paces) > 0.5
    curves = [c for c in library.candidates if c.id == "unknown_smooth_curve" and c.joints == (1,)]
    assert sorted(len(c.columns) for c in curves) == [2, 3, 4, 5]
    assert all(len(set(c.columns)) == len(c.columns) for c in curves)
    names = [p.name for p in library.parameters]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize(
    ("column", "needed"),
    [
        ("t", ("zero_drift", "settling", "random_walk")),
        ("temperature_c", ("zero_thermal", "link_growth", "column_bending")),
        ("direction", ("direction_compliance",)),
        ("payload_kg", ("tool_sag",)),
    ],
)
def test_without_its_column_a_cause_is_refused_with_the_remedy(column: str, needed: tuple[str, ...]) -> None:
    rows = replace(campaign(katana(), seed=2), **{column: None})
    library = build_library(katana(), rows)
    refused = {u.id: u for u in library.refused}
    assert set(needed) <= set(refused)
    assert all(column in refused[i].reason and refused[i].remedy for i in needed)
    assert not {c.id for c in library.candidates} & set(needed)


def test_one_moment_in_time_is_refused() -> None:
    rows = campaign(katana(), seed=2)
    library = build_library(katana(), replace(rows, t=np.zeros(len(rows))))
    assert "knots_s" in {u.id: u.reason for u in library.refused}["random_walk"]


HIDDEN = [
    ("zero_thermal", (2,), (1e-4,)),
    ("link_growth", (1,), (6e-5,)),
    ("column_bending", None, (3e-5, -4e-5)),
    ("hardening", (1,), (1e-5,)),
    ("direction_compliance", (1,), (8e-5,)),
    ("reading_tilt", (1,), (8e-5, -6e-5)),
    ("tool_sag", None, (1e-4,)),
]


@pytest.mark.parametrize("hidden", HIDDEN, ids=[h[0] for h in HIDDEN])
def test_a_new_cause_is_found_by_its_name(hidden: tuple[str, tuple[int, ...] | None, tuple[float, ...]]) -> None:
    """Among all of the library; the cases are strong, so the name must be right."""
    beside = [("axial_compliance", (1,), (3e-4,))] if hidden[0] == "hardening" else []
    rows = campaign(katana(), [*beside, hidden], seed=7, loads=(0.0, 0.5, 1.0))
    _, found = searched(rows, QUICK)
    candidates = found.selector.scorer.candidates
    named = {(candidates[k].id, candidates[k].joints) for k in found.chosen}
    listed = {(a.candidate.id, a.candidate.joints) for k in found.chosen for a in find_aliases(found, k)}
    assert (hidden[0], hidden[1]) in named | listed
