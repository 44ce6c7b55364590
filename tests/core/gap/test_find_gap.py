from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from kilter_core.errors import CancelledError, NotConvergedError, ObservationError, OptionError, TooFewPosesError
from kilter_core.gap import GapOptions, find_gap
from kilter_core.gap.options import GapOptions as Options
from kilter_core.gap.report.localization import localize
from kilter_core.gap.search import prepare
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.gap.simulated import campaign, katana

QUICK = GapOptions(resamples=20, permutations=5, bootstraps=499, next_poses=3)
BACKLASH = ("backlash", (1,), (3e-4,))


@pytest.fixture(scope="module")
def robot():
    return katana()


@pytest.fixture(scope="module")
def backlash(robot):
    return find_gap(robot, campaign(robot, [BACKLASH]), QUICK, validation=0.25)


def codes(report):
    return {w["code"] for w in report.warnings}


def test_nothing_hidden_nothing_named(robot):
    report = find_gap(robot, campaign(robot, seed=4), QUICK)
    assert (report.verdict, report.effects) == ("no_gap", ())
    assert any(row["id"] == "backlash" and row["smallest_detectable"] > 0 for row in report.smallest_detectable)
    assert report.calibration.model.effects == ()


def test_backlash_is_named_with_its_twin_and_its_size(backlash):
    (effect,) = backlash.to_document()["effects"]
    assert (effect["id"], effect["joints"], effect["verdict"]) == ("backlash", [2], "class_confirmed")
    assert {a["id"] for a in effect["alias_set"]} == {"friction_windup"}
    (p,) = effect["parameters"]
    assert p["unit"] == "deg"
    assert p["interval_low"] < np.degrees(3e-4) < p["interval_high"]
    assert effect["p_value"] < 1e-6
    assert backlash.verdict == "closed"
    said = "reversal error of joint 2, in the shape of backlash or friction_windup j2: confirmed"
    assert backlash.sentence.startswith(said)  # the hysteresis of a gear, in no library, does it as well
    assert "hysteresis of the gear" in effect["physical_class"]["outside"]


@pytest.mark.parametrize("measured", ["pose", "markers"])
def test_poses_and_markers_say_the_same(robot, measured):
    (effect,) = find_gap(robot, campaign(robot, [BACKLASH], seed=1, measured=measured), QUICK).effects
    assert (effect.evidence.candidate.label, effect.verdict) == ("backlash j2", "class_confirmed")


def test_the_gap_shrinks_on_held_out_poses(backlash):
    gap = backlash.gap
    assert gap["held_out"] == "validation observations"
    assert gap["validation_after_mm"] < 0.8 * gap["validation_before_mm"]
    assert gap["closure"] > 0.8


def test_the_version_holds_the_named_effect(robot, backlash):
    again = Calibration.from_document(robot, json.loads(json.dumps(backlash.calibration.to_document())))
    assert [e.id for e in again.model.effects] == ["backlash"]
    assert again.model.effects[0].joints == (1,)
    rows = campaign(robot, [BACKLASH])
    error = rows.position - again.predict(rows).position
    assert np.sqrt(np.mean(error**2)) < 3e-5


def test_where_names_the_direction_of_the_joint(backlash):
    assert any("direction of joint 2" in p.factor and p.p_value < 0.01 for p in backlash.where)


def test_the_name_vanishes_when_labels_are_shuffled(backlash):
    control = backlash.negative_control
    assert control["passed"]
    assert control["effects"][0]["shuffled"] == "direction"


def test_the_gap_bar_falls_step_by_step_and_no_label_comes_twice(robot):
    hidden = [
        ("second_harmonic", (4,), (8e-4, 5e-4)),
        ("backlash", (1,), (9e-4,)),
        ("eccentricity", (2,), (9e-4, 4e-4)),
    ]
    report = find_gap(robot, campaign(robot, hidden, poses=100), QUICK)
    bars = report.figures["gap_bar"]
    steps = [b["value"] for b in bars[:-1]]
    drops = -np.diff(steps)
    assert len(steps) == 4
    assert (drops > 0).all()
    assert len({b["label"] for b in bars}) == len(bars)
    ends = np.array([b["held_out_interval"] for b in bars[:-1]])
    held = [b["held_out"] for b in bars]
    assert np.all((ends[:, 0] < held[:-1]) & (held[:-1] < ends[:, 1]))
    assert ends[0, 0] > ends[-1, 1]  # the gap is closed beyond what the choice of poses explains
    assert held[-2] == pytest.approx(held[-1], rel=0.3)  # and what is left is noise, as 25 poses tell it
    assert bars[-1]["held_out_interval"] is None


def test_constant_temperature_and_what_nothing_shows_are_said_in_words(robot):
    rows = campaign(robot, seed=7)
    report = find_gap(robot, replace(rows, temperature_c=np.full(len(rows), 21.0)), QUICK)
    (why,) = [u for u in report.not_testable if u.id == "thermal_growth"]
    assert "constant" in why.reason
    assert why.remedy
    assert not [u for u in report.not_testable if "inf" in u.reason.split()]


def test_what_only_rounding_errors_show_is_said_to_show_at_no_size(robot):
    rows = replace(campaign(robot, loads=(0.0,)), payload_kg=None)
    report = find_gap(robot, rows, QUICK)
    (absorbed,) = [u for u in report.not_testable if u.id == "reading_tilt"]
    assert "at no size" in absorbed.reason, absorbed.reason
    assert not [u for u in report.not_testable if "e+1" in u.reason]


def test_the_document_is_plain_json(backlash):
    document = json.loads(json.dumps(backlash.to_document(), allow_nan=False))
    wanted = {
        "verdict", "effects", "where", "gap", "not_testable", "next_poses", "negative_control", "alias_matrix",
        "warnings", "figures",
    }  # fmt: skip
    assert wanted <= set(document)
    assert {"before_mm", "after_mm", "noise_mm", "validation_before_mm", "validation_after_mm", "closure"} <= set(
        document["gap"]
    )


def test_two_effects_of_different_kinds(robot):
    hidden = [("axial_compliance", (1,), (1.5e-4,)), ("second_harmonic", (4,), (8e-4, 5e-4))]
    report = find_gap(robot, campaign(robot, hidden, seed=4, poses=118), QUICK)
    said = {(j.evidence.candidate.id, j.evidence.candidate.joints) for j in report.effects}
    assert said == {("axial_compliance", (1,)), ("second_harmonic", (4,))}


def test_an_unknown_curve_is_never_a_physical_name(robot):
    report = find_gap(robot, campaign(robot, [("unknown_joint_curve", (1,), (2e-4, 2e-4))], seed=6), QUICK)
    assert report.verdict == "unexplained"
    assert all(j.verdict == "provisional" for j in report.effects)
    assert {j.evidence.candidate.id for j in report.effects} == {"unknown_joint_curve"}


def test_one_sided_approach_makes_backlash_untestable(robot):
    report = find_gap(robot, campaign(robot, [BACKLASH], one_sided=True), QUICK)
    assert report.effects == ()
    (why,) = [u for u in report.not_testable if u.id == "backlash"]
    assert "one side" in why.reason
    assert why.remedy


def test_no_direction_column(robot):
    report = find_gap(robot, replace(campaign(robot, [BACKLASH]), direction=None), QUICK)
    (why,) = [u for u in report.not_testable if u.id == "backlash"]
    assert "direction" in why.reason


def test_a_scale_of_the_tracker_is_untestable(robot):
    report = find_gap(robot, campaign(robot, seed=9), QUICK)
    assert any(u.id == "measurement_scale" and "absorb" in u.reason for u in report.not_testable)


def test_without_repeats_every_verdict_is_relative(robot):
    report = find_gap(robot, campaign(robot, [("backlash", (1,), (2e-3,))], revisits=0, poses=100), QUICK)
    assert "no_repeats" in codes(report)
    assert "relative" in report.sentence
    assert report.verdict == "provisional"
    # Both halves of the campaign name it with one amplitude, and are predicted better by it: that needs no noise.
    assert [(j.evidence.candidate.id, j.verdict) for j in report.effects] == [("backlash", "class_confirmed")]
    assert report.gap["noise_mm"] == pytest.approx(2e-2, rel=0.2)  # the gap itself is no noise


@pytest.mark.parametrize("moved", ["station", "side"])
def test_a_knock_between_visits_is_no_contrast_of_their_sides(robot, moved):
    """Third visits come from the other side of joint 2; the station moves half-way, or that side is 0.06 mm off."""
    poses, again = 60, 20
    rows = campaign(robot, poses=poses, revisits=again, loads=(0.0,), seed=3)
    sides = rows.direction.copy()
    sides[poses + again :, 1] *= -1.0
    off = rows.t > np.median(rows.t) if moved == "station" else np.arange(len(rows)) >= poses + again
    rows = replace(rows, direction=sides, position=rows.position + np.outer(off, [6e-5, 0.0, 0.0]))
    prepared = prepare.prepare_data(Calibration.nominal(robot), rows, replace(QUICK, noise_mm=0.02))
    places = localize(prepared.problem, prepared.visits.observations)
    (side,) = [p for p in places if p.factor == "contrast: direction of joint 2"]
    assert (side.p_value < 1e-4) == (moved == "side")


def test_repeats_from_other_sides_show_the_noise(robot):
    """Poses visited thrice with other poses before them come from other sides: "no pose was repeated" was said of them."""
    rows = campaign(robot, revisits=20, loads=(0.0,))
    sides = np.random.default_rng(3).choice([-1.0, 1.0], rows.q.shape)
    for one in (rows, replace(rows, direction=sides)):
        made = prepare.prepare_data(Calibration.nominal(robot), one, QUICK)
        assert "no_repeats" not in {w["code"] for w in made.warnings}
        assert 2e-5 / 1.3 < made.problem.settings.noise.coordinate < 1.3 * 2e-5


@pytest.mark.parametrize("approach_m", [0.0, 6e-5])
def test_repeats_without_leaving_the_pose_confirm_only_what_halves_bear_out(robot, approach_m):
    once = campaign(robot, [("backlash", (1,), (2e-3,))], revisits=0, noise_m=0.0)
    rng = np.random.default_rng(4)
    rows = replace(once.select(np.repeat(np.arange(len(once)), 3)), t=None)
    approach = np.repeat(rng.normal(0, 1, (len(once), 3)), 3, axis=0) * approach_m
    measured = rows.position + approach + 2e-5 * rng.standard_normal(rows.position.shape)
    # Of five shuffles one is a fifth already: one in sixty lets the name come back.
    report = find_gap(robot, replace(rows, position=measured), replace(QUICK, permutations=20))
    assert "no_re_approach" in codes(report)
    effect, *others = report.effects
    assert (effect.evidence.candidate.id, effect.verdict) == ("backlash", "class_confirmed")
    assert all(j.verdict == "provisional" for j in others)  # noise that is said too small lets a name pass by chance


def _mistaken(rows, mistake, rotation):
    """Rows with a mistake; ``rotation`` (N, 3, 3) is that of the flange, which the rows do not tell."""
    half = (np.arange(len(rows)) > len(rows) // 2)[:, None]
    return {
        "order of joints": lambda: replace(rows, q=rows.q[:, [0, 2, 1, 3, 4]]),
        "sign of a joint": lambda: replace(rows, q=rows.q * [-1, 1, 1, 1, 1]),
        "degrees for radians": lambda: replace(rows, q=np.degrees(rows.q)),
        "instrument moved half-way": lambda: replace(rows, position=rows.position + half * [0.1, 0.0, 0.0]),
        "tool changed half-way": lambda: replace(rows, position=rows.position + half * (rotation @ [0.1, 0.0, 0.0])),
        "another row's joints": lambda: replace(rows, q=np.roll(rows.q, 1, axis=0), pose_id=None),
        "millimetres for metres": lambda: replace(rows, position=rows.position * 1e3),
        "shuffled": lambda: replace(rows, q=np.random.default_rng(2).permutation(rows.q), pose_id=None),
    }[mistake]()


MISTAKES = {
    "order of joints": "Joints 2 and 3 look swapped",
    "sign of a joint": "joint 1 looks to count the other way round|Joint 1 looks to count the other way round",
    "degrees for radians": "Joints look like degrees declared as radians",
    "instrument moved half-way": r"The base, or the instrument, looks changed by 100 mm from row 57 on",
    "tool changed half-way": r"The tool looks changed by (99.\d|100) mm from row 57 on",
    "another row's joints": "one row below",
    "millimetres for metres": "millimetres declared as metres",
    "shuffled": "Joints and positions do not belong together",
}


# A search asks what an identification asks first: tests/core/identify/test_plausibility.py has every kind of mistake.
@pytest.mark.parametrize("mistake", ["sign of a joint", "tool changed half-way", "shuffled"])
def test_rows_of_another_robot_are_refused_with_what_was_mixed_up(robot, mistake):
    rotation = campaign(robot, seed=1, measured="pose").rotation
    with pytest.raises(ObservationError, match=MISTAKES[mistake]) as refused:
        find_gap(robot, _mistaken(campaign(robot, seed=1), mistake, rotation), QUICK)
    assert refused.value.code == "foreign_observations"


def test_a_residual_is_no_accusation_whatever_its_size(robot):
    """Rows that belong together under 35 mm of noise: the hunt goes on and says how much is left."""
    report = find_gap(robot, campaign(robot, seed=1, noise_m=2e-2), QUICK)
    assert "large_residual" in codes(report)
    assert not [j for j in report.effects if j.verdict in ("confirmed", "class_confirmed", "replicated")]
    assert "another robot" not in report.sentence
    json.dumps(report.to_document(), allow_nan=False)


def test_where_the_geometry_cannot_be_fitted_the_report_still_comes(robot, monkeypatch):
    real = prepare.estimate

    def endless(start, measurement, options):
        if not options.fix:
            raise NotConvergedError("no minimum")
        return real(start, measurement, options)

    monkeypatch.setattr(prepare, "estimate", endless)
    report = find_gap(robot, campaign(robot, seed=1), QUICK)
    assert "geometry_not_fitted" in codes(report)
    assert (report.effects, report.verdict) == ((), "no_gap")


def test_fewer_poses_than_geometry_needs(robot):
    with pytest.raises(TooFewPosesError, match="poses"):
        find_gap(robot, campaign(robot, poses=6, revisits=2), QUICK)


def test_copied_rows_are_no_repeats(robot):
    rows = campaign(robot, revisits=0)
    report = find_gap(robot, Observations.concatenate([rows, rows]), QUICK)
    assert {"copied_rows", "no_repeats"} <= codes(report)
    assert report.effects == ()


def test_outliers_are_set_aside_and_named(robot):
    rows = campaign(robot, seed=2)
    rows.position[[11, 60]] += 2e-3
    report = find_gap(robot, rows, QUICK)
    assert "outliers" in codes(report)
    assert report.verdict == "no_gap"


def test_the_hunt_goes_on_from_a_version(robot, backlash):
    rows = campaign(robot, [BACKLASH, ("eccentricity", (2,), (6e-4, 4e-4))], seed=12)
    report = find_gap(robot, rows, QUICK, start=backlash.calibration)
    assert [j.evidence.candidate.id for j in report.effects] == ["eccentricity"]
    assert {e.id for e in report.calibration.model.effects} == {"backlash", "eccentricity"}


def test_progress_rises_and_may_cancel(robot):
    seen = []
    find_gap(robot, campaign(robot, poses=40), QUICK, progress=lambda f, s: seen.append(f))
    assert seen == sorted(seen)
    assert 0.0 <= seen[0] < 0.1
    assert seen[-1] > 0.9

    def stop(fraction, stage):
        raise CancelledError("stopped")

    with pytest.raises(CancelledError):
        find_gap(robot, campaign(robot, poses=40), QUICK, progress=stop)


def test_options_are_checked():
    with pytest.raises(OptionError, match="alpha"):
        Options(alpha=2.0)
    with pytest.raises(OptionError, match="no option 'alhpa'"):
        Options.from_document({"alhpa": 0.01})
    assert Options.from_document({"alpha": 0.05, "effects": ["backlash"]}).effects == ("backlash",)


def test_an_unknown_effect_is_refused(robot):
    with pytest.raises(OptionError, match="no effect"):
        find_gap(robot, campaign(robot, poses=30), GapOptions(effects=("backlsh",)))


def test_what_was_refused_explains_as_much_as_a_fit_with_it(robot):
    hidden = [("axial_compliance", (1,), (1.5e-4,)), ("second_harmonic", (4,), (8e-4, 5e-4))]
    rows = campaign(robot, hidden, seed=4, poses=118)
    report = find_gap(robot, rows, replace(QUICK, max_effects=1), validation=0)
    named = [effect.evidence.candidate.id_and_joints() for effect in report.effects]
    assert len(named) == 1
    assert [row["p_value"] for row in report.refused] == sorted(row["p_value"] for row in report.refused)
    assert all(0.0 <= row["explains"] <= 1.0 and 0.0 < row["p_value"] <= 1.0 for row in report.refused)
    assert named[0] not in [{"id": row["id"], "joints": row["joints"]} for row in report.refused]

    def left(effects):
        fit = identify(robot, rows, None, IdentifyOptions(effects=effects)).fit
        return float(np.sum(fit.residual.points**2))

    asked = next(row for row in report.refused if (row["id"], row["joints"]) == ("axial_compliance", [2]))
    assert asked["explains"] > 0.9
    assert asked["p_value"] < 1e-6
    taken = 1.0 - left([*named, {"id": asked["id"], "joints": asked["joints"]}]) / left(named)
    assert asked["explains"] == pytest.approx(taken, abs=1e-3)
