"""Wrong readings in a hunt: many of them, alike, are found and leave the geometry as good as without; effects are not."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from kilter_core.gap import GapOptions, find_gap
from kilter_core.gap.search.events import refit_with_updated_noise
from kilter_core.gap.search.linear.linearized import refit
from kilter_core.gap.search.prepare import prepare_data
from kilter_core.model import Calibration
from tests.core.gap.simulated import campaign, katana

ROBOT = katana()
QUICK = GapOptions(resamples=10, permutations=3, bootstraps=299, next_poses=1)
PHYSICAL = ("backlash", "axial_compliance", "eccentricity", "second_harmonic", "encoder_scale")


def prepared(rows, effects=PHYSICAL):
    start = Calibration.nominal(ROBOT)
    return prepare_data(start, rows, GapOptions(effects=effects))


def aside(made, count):
    """Rows (N,) that the hunt leaves out."""
    out = np.ones(count, dtype=bool)
    out[made.kept] = ~made.problem.settings.used[made.visits.visit]
    return out


def off(made, other, rows):
    """Rms difference (m) of what two geometries predict."""
    each = [m.problem.settings.source.model.predict(rows, m.problem.values).position for m in (made, other)]
    return float(np.sqrt(np.mean((each[0] - each[1]) ** 2)))


def spoilt(rows, share, seed, alike=True):
    rng = np.random.default_rng(seed)
    bad = rng.permutation(len(rows))[: round(share * len(rows))]
    shift = np.array([5e-4, 0.0, 0.0]) if alike else 5e-4 * rng.normal(size=(len(bad), 3))
    position = rows.position.copy()
    position[bad] += shift
    return replace(rows, position=position), np.isin(np.arange(len(rows)), bad)


@pytest.mark.parametrize("revisits", [0, 20])
@pytest.mark.parametrize(("share", "alike"), [(0.15, True), (0.3, True), (0.15, False)])
def test_wrong_readings_are_found_and_do_not_bend_the_geometry(revisits, share, alike):
    rows = campaign(ROBOT, seed=5, revisits=revisits, poses=100)
    wrong, bad = spoilt(rows, share, 1, alike)
    made = prepared(wrong)
    found = aside(made, len(rows))
    assert found[bad].mean() > 0.9
    assert not found[~bad].any()
    assert off(made, prepared(rows), rows) < 6e-6
    assert "outliers" in {w["code"] for w in made.warnings}


@pytest.mark.parametrize("seed", range(5, 8))
def test_wrong_readings_in_one_block_of_time_are_found_although_their_repeats_seem_to_drift(seed):
    """A reflector that sat badly for a while: poses measured in and out of the block differ by 25 times the noise."""
    rows = campaign(ROBOT, seed=seed, revisits=20, poses=100)
    bad = np.isin(np.arange(len(rows)), np.argsort(rows.t)[round(0.4 * len(rows)) :][: round(0.15 * len(rows))])
    made = prepared(replace(rows, position=rows.position + np.outer(bad, [5e-4, 0.0, 0.0])))
    assert np.array_equal(aside(made, len(rows)), bad)
    assert off(made, prepared(rows), rows) < 6e-6
    noise = made.problem.settings.noise
    assert noise.coordinate == pytest.approx(2e-5, rel=0.2)
    assert {w["code"] for w in made.warnings} == {"outliers"}


def test_as_many_held_out_rows_may_be_wrong_as_rows_of_the_search():
    """A tenth of all readings is wrong: what is held out is judged by the others, and an error counts as before."""
    rows, bad = spoilt(campaign(ROBOT, (("backlash", (2,), (8e-4,)),), seed=5, revisits=20, poses=150), 0.12, 1)
    held = rows.pose_groups() >= 100
    report = find_gap(
        ROBOT, rows.select(~held), replace(QUICK, effects=("backlash",)), validation=rows.select(held)
    ).to_document()
    assert [(e["id"], e["joints"], e["gates"]["held_out"]) for e in report["effects"]] == [("backlash", [3], True)]
    assert report["gap"]["held_out_set_aside"] == bad[held].sum() > 3
    gap, wrong, every = report["gap"], bad[held].sum(), held.sum()
    with_them = np.sqrt(((every - wrong) * gap["validation_after_mm"] ** 2 + wrong * 0.5**2) / every)
    assert gap["validation_after_all_mm"] == pytest.approx(with_them, rel=0.05)
    assert gap["validation_after_all_mm"] > 3 * gap["validation_after_mm"]
    assert [one["row"] for one in report["set_aside"]] == np.flatnonzero(bad[~held]).tolist()
    assert [one["row"] for one in report["held_aside"]] == np.flatnonzero(bad[held]).tolist()
    assert min(one["residual_mm"] for one in report["set_aside"]) > 0.1
    assert report["gap"]["validation_after_mm"] < 0.05 < 0.1 < report["gap"]["validation_before_mm"] < 0.2


STRUCTURE = {
    "play beyond an elbow": lambda o: 2e-3 * (o.q[:, 1] > np.quantile(o.q[:, 1], 0.8)),
    "a bump": lambda o: 1e-3 * np.exp(-(((o.q[:, 2] - 0.3) / 0.15) ** 2)),
    "a load that yields": lambda o: 1e-3 * (o.payload_kg > 0.5) * (o.q[:, 1] > 0.0),
}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", STRUCTURE)
@pytest.mark.parametrize("revisits", [0, 20])
def test_no_effect_is_taken_for_wrong_readings(kind, seed, revisits):
    """Effects that no library has, of a millimetre at some of the poses: what follows from the pose is no outlier."""
    rows = campaign(ROBOT, seed=seed, revisits=revisits, poses=100)
    moved = rows.position + np.outer(STRUCTURE[kind](rows), [0.6, -0.5, 0.6])
    made = prepared(replace(rows, position=moved))
    assert not aside(made, len(rows)).any()


@pytest.mark.parametrize("hidden", [("backlash", (1,), (1e-2,)), ("second_harmonic", (4,), (8e-3, 5e-3))])
def test_no_effect_of_the_library_is_either(hidden):
    rows = campaign(ROBOT, [hidden], seed=3, poses=100)
    assert not aside(prepared(rows), len(rows)).any()


HIDDEN = [("backlash", (1,), (1e-2,)), ("second_harmonic", (4,), (4e-4, 3e-4))]


@pytest.mark.parametrize("share", [0.0, 0.15])
def test_without_repeats_the_noise_shrinks_with_every_name_and_wrong_readings_come_out(share):
    """The first effect is a hundred times the noise: frozen at the first fit it hides the second and all wrong readings."""
    rows, bad = spoilt(campaign(ROBOT, HIDDEN, seed=0, revisits=0, poses=100), share, 0)
    report = find_gap(ROBOT, rows, replace(QUICK, effects=PHYSICAL), validation=0)
    assert {j.evidence.candidate.label for j in report.effects} == {"backlash j2", "second_harmonic j5"}
    assert report.gap["noise_mm"] == pytest.approx(0.02, rel=0.15)
    assert [w["visits"] for w in report.warnings if w["code"] == "outliers"] == ([int(bad.sum())] if share else [])
    steps = [s["chi2_per_freedom"] for s in report.gap["steps"]]
    assert steps == sorted(steps, reverse=True)
    assert all(j.verdict == "provisional" for j in report.effects)


def test_a_visit_set_aside_comes_back_when_what_is_named_explains_it():
    rows = campaign(ROBOT, [HIDDEN[0]], seed=1, poses=100)
    made = prepared(rows)
    problem = made.problem
    good = np.ones(len(problem.settings.used), dtype=bool)
    good[[3, 8, 20]] = False
    (k,) = [k for k, p in enumerate(made.library.parameters) if p.name == "backlash_2"]
    without = refit(replace(problem.settings, used=good), problem.values, [k])
    assert refit_with_updated_noise(without, [k]).settings.used.all()
    assert refit_with_updated_noise(problem, [k]) is problem


def test_the_same_rows_give_the_same_hunt():
    rows, _ = spoilt(campaign(ROBOT, HIDDEN, seed=2, revisits=0, poses=60), 0.1, 3)
    one, other = (find_gap(ROBOT, rows, replace(QUICK, effects=PHYSICAL)).to_document() for _ in range(2))
    assert json.dumps(one, sort_keys=True) == json.dumps(other, sort_keys=True)


@pytest.mark.parametrize("seed", range(3))
def test_wrong_readings_among_half_of_the_few_repeats_do_not_pass_for_noise(seed):
    """Three of six repeats are off by 25 times the noise: what all other visits leave is too small for such a noise."""
    rows = campaign(ROBOT, seed=seed, revisits=6, poses=100).select(np.arange(106))
    bad = np.isin(np.arange(len(rows)), [100, 102, 104])  # of the six that come again
    made = prepared(replace(rows, position=rows.position + np.outer(bad, [5e-4, 0.0, 0.0])))
    assert np.array_equal(aside(made, len(rows)), bad)
    assert made.problem.settings.noise.coordinate == pytest.approx(2e-5, rel=0.5)


def test_noise_of_repeats_that_were_set_aside_but_for_two_is_that_of_the_fit():
    """It stayed that of all four: seven times as large, and nothing was ever significant."""
    rows = campaign(ROBOT, seed=1, revisits=4, poses=100).select(np.arange(104))
    bad = np.isin(np.arange(len(rows)), [100, 102])
    made = prepared(replace(rows, position=rows.position + np.outer(bad, [5e-4, 0.0, 0.0])))
    assert np.array_equal(aside(made, len(rows)), bad)
    assert made.problem.settings.noise.coordinate == pytest.approx(2e-5, rel=0.3)
    assert not made.problem.settings.trusted
    (warning,) = [w for w in made.warnings if w["code"] == "no_repeats"]
    assert "fewer than three" in warning["message"]


def test_rows_of_a_visit_that_was_set_aside_say_nothing_of_the_noise_of_a_row():
    rng = np.random.default_rng(3)
    twice = np.sort([*range(72), 7, 23, 51])  # three visits of two shots
    rows = campaign(ROBOT, seed=2, revisits=12, poses=60).select(twice)
    position = rows.position + 2e-5 * rng.normal(size=(len(rows), 3)) * (np.diff(twice, prepend=-1) == 0)[:, None]
    position[[8, 25]] += [6e-4, 0.0, 0.0]  # the second shots of two
    made = prepared(replace(rows, position=position))
    assert set(np.flatnonzero(aside(made, len(rows)))) == {7, 8, 24, 25}
    assert made.problem.settings.noise.coordinate == pytest.approx(2e-5, rel=0.3)
    assert made.problem.settings.noise.within is None
