"""What is told of a named effect is what the version stores, and the truth is inside its intervals, however large it is."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from kilter_client.cli.reports.gap_report import show_gap
from kilter_client.cli.terminal.output import number
from kilter_core.gap import GapOptions, effect_search, find_gap
from kilter_core.gap import effect_search as module
from kilter_core.gap.effect_search import refit_with_wider_priors
from kilter_core.gap.evidence.verdict import Judged
from kilter_core.gap.report.report import GapReport
from kilter_core.gap.search import events as renewal
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.linear.linearized import linearise_problem
from tests.blind.generator import cases
from tests.blind.parameters import intervals
from tests.blind.run import run_case
from tests.core.gap.sized_twins import LARGE, SMALL, Sized, sized
from tests.core.gap.time_twins import robot

FAR = 3.5  # standard deviations: one of two thousand amplitudes is farther from the truth


def searched(made: Sized, effect: str) -> tuple[GapReport, Judged]:
    """A search of all rows, so that the mean over them is known, for this effect alone."""
    quick = GapOptions(resamples=1, permutations=1, bootstraps=199, next_poses=0, effects=(effect,))
    report = find_gap(robot(), made.rows, quick, validation=0)
    (named,) = report.effects
    return report, named


WIRE = {"mm": 1e3, "deg": 180.0 / np.pi}  # other units are SI


@pytest.mark.parametrize("large", [pytest.param(False, marks=pytest.mark.slow), True])
def test_the_truth_is_inside_the_intervals_at_any_size(large: bool) -> None:
    inside = []
    for effect in SMALL:
        made = sized(effect, 2, LARGE[effect] if large else 1.0)
        told = searched(made, effect)[1].evidence.amplitudes
        assert len(told) == len(made.truth), effect
        for one, truth in zip(told, made.truth, strict=True):
            assert abs(one.value - truth) < FAR * one.sigma, (effect, one, truth)
            assert one.low < one.value < one.high
            inside.append(one.low <= truth <= one.high)
    assert sum(inside) >= 24  # of 28: fewer come once in a hundred where intervals hold 95 %


@pytest.mark.parametrize("revisited", [0, 8])
def test_where_rows_know_an_amount_less_well_than_its_prior_but_far_from_zero_they_are_believed(revisited: int) -> None:
    inside, far = 0, 0.0
    for seed in range(6):
        made = sized("zero_thermal", seed, 8.0, poses=30, revisited=revisited, noise_m=2e-4)
        (told,) = searched(made, "zero_thermal")[1].evidence.amplitudes
        assert told.sigma > 2e-5  # the prior's
        inside += told.low <= made.truth[0] <= told.high
        far += (told.value - made.truth[0]) / told.sigma
    assert inside >= 5
    assert abs(far / 6) < 1.6  # four deviations of the mean of six


@pytest.mark.parametrize(
    "name", ["0408-three-katana-30", pytest.param("0545-three-katana-118", marks=pytest.mark.slow)]
)
def test_the_component_that_rows_tell_says_how_large_the_other_may_be(name: str) -> None:
    """The prior told the other as a thousandth of what it was, three and five half-widths of its interval off."""
    case = next(case for case in cases(20261128, 600) if case.name == name)
    assert all(intervals([run_case(case)]))


@pytest.mark.parametrize("effect", ["base_step", "thermal_growth", "zero_thermal"])
def test_a_large_one_is_told_everywhere_as_it_is_stored(effect: str, capsys: pytest.CaptureFixture[str]) -> None:
    made = sized(effect, 1, LARGE[effect])
    report, named = searched(made, effect)
    kept = dict(zip(report.calibration.names, report.calibration.values, strict=True))
    sigma = dict(zip(report.stored.posterior.names, report.stored.posterior.sigma, strict=True))
    document = report.to_document()
    rows: list[dict[str, Any]] = document["effects"][0]["parameters"]
    for one, row in zip(named.evidence.amplitudes, rows, strict=True):
        assert one.value == pytest.approx(kept[row["name"]], rel=1e-9)
        assert one.sigma == pytest.approx(sigma[row["name"]], rel=1e-6)
    for row, truth in zip(rows, made.truth, strict=True):
        assert row["interval_low"] <= truth * WIRE.get(row["unit"], 1.0) <= row["interval_high"], row["name"]
    moved = 1e3 * float(np.sqrt(np.mean(made.moved**2)))
    assert document["effects"][0]["moves_mm"] == pytest.approx(moved, rel=0.03)
    gap = document["gap"]
    assert document["effects"][0]["gain_mm"] == pytest.approx(gap["before_mm"] - gap["after_mm"], rel=1e-3)  # all of it
    show_gap(document | {"figures": {}})  # which the service draws
    printed = capsys.readouterr().out
    assert "amplitudes as the search fitted them" in printed
    for row in rows:
        assert f"{number(row['value'], 4)} {row['unit']}" in printed


def test_how_far_a_station_moved_is_told_in_its_warning() -> None:
    made = sized("base_step", 1, LARGE["base_step"])
    report, _ = searched(made, "base_step")
    (warning,) = [w for w in report.warnings if w["code"] == "moved_once"]
    before = 1e3 * float(np.sqrt(np.mean(made.moved[made.moved > 0.0] ** 2)))
    told = float(warning["message"].split(", by ")[1].split(" mm")[0])
    assert told == pytest.approx(before, rel=0.05)
    # Nothing was held out, and every other test was passed: without the step the geometry would take it up.
    assert [e.id for e in report.calibration.model.effects] == ["base_step"]
    assert "not_settled" not in {w["code"] for w in report.warnings}


def test_a_step_that_failed_a_test_is_not_for_the_version() -> None:
    """A shape of the joint that failed one stays: it has no other day."""
    _, step = searched(sized("base_step", 1, LARGE["base_step"]), "base_step")
    _, curve = searched(sized("thermal_growth", 1, LARGE["thermal_growth"]), "thermal_growth")
    assert step.verdict == curve.verdict == "provisional"  # nothing was held out
    assert step.storable
    failed = replace(step, gates={**step.gates, "inclusion": False})
    untested = replace(step, gates={**step.gates, "inclusion": None})
    assert not failed.storable
    assert not untested.storable
    assert replace(curve, gates={**curve.gates, "inclusion": False}).storable


def test_an_amplitude_held_by_its_range_is_told_at_its_end_with_what_the_rows_ask_for() -> None:
    beyond = sized("thermal_growth", 3, 2.0 * LARGE["thermal_growth"])
    report, named = searched(beyond, "thermal_growth")
    (one,) = named.evidence.amplitudes
    assert one.value == 1e-4  # the largest that is physical
    assert one.low <= one.value < beyond.truth[0] < one.high
    assert abs(one.wanted - beyond.truth[0]) < FAR * one.sigma
    assert not named.gates["plausible"]
    assert any(w["code"] == "at_end_of_range" for w in report.warnings)


def test_what_the_rows_hardly_know_keeps_its_prior_and_no_fit_leaves_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """Curves that imitate each other ran away on a real arm when their priors were widened."""
    seen: list[SearchResult] = []
    monkeypatch.setattr(effect_search, "refit_with_wider_priors", lambda found: seen.append(found) or found)
    searched(sized("thermal_drift", 1, LARGE["thermal_drift"]), "thermal_drift")
    (found,) = seen
    prior = found.problem.settings.source.library_sigma[found.columns]
    better = refit_with_wider_priors(found)
    assert np.any(better.problem.settings.source.library_sigma[found.columns] > 2.0 * prior)
    assert better.problem.chi2 <= found.problem.chi2
    monkeypatch.setattr(module, "TOLD", 1e6)  # as if the rows hardly told them from zero
    assert refit_with_wider_priors(found) is found
    monkeypatch.setattr(module, "TOLD", 3.0)
    far = found.problem.values + 1e-3
    monkeypatch.setattr(renewal, "refit", lambda settings, *_: linearise_problem(settings, far))  # one that ran away
    assert refit_with_wider_priors(found) is found
