"""The headline of a result: what is said as certain, probable and open, and that it never says more than its evidence."""

from __future__ import annotations

from typing import Any

import pytest

from kilter_service.contract.headlines import count_noise_left, format_joints, format_range
from kilter_service.contract.jobs.drift import DriftResult
from kilter_service.contract.jobs.gap import GapResult
from kilter_service.contract.jobs.identify import IdentifyResult

GAP = {
    "before_mm": 0.65, "after_mm": 0.07, "noise_rms_mm": 0.0145, "validation_before_mm": 0.874,
    "validation_after_mm": 0.037, "validation_after_all_mm": 0.0681, "held_out_set_aside": 1,
}  # fmt: skip


def amount(name: str, low: float, high: float, unit: str = "deg") -> dict[str, Any]:
    return {"name": name, "value": (low + high) / 2, "unit": unit, "interval_low": low, "interval_high": high}


def effect(id_: str, joints: list[int] | None, verdict: str, **more: Any) -> dict[str, Any]:
    return {"id": id_, "joints": joints, "verdict": verdict, "moves_mm": 0.1, **more}


def class_claim(label: str, joints: list[int] | None, class_id: str = "joint_twist") -> dict[str, Any]:
    claim = {"said": "class", "words": f"{label}, in the shape of backlash load", "joints": joints}
    return {"claim": claim, "physical_class": {"id": class_id, "label": label}}


def search(effects: list[dict[str, Any]], verdict: str = "provisional", **more: Any) -> GapResult:
    about = {"gap": GAP, "noise": {"absolute": True}, "adequacy": {"held_out": {"poses": 40}}}
    return GapResult.model_validate({"verdict": verdict, "effects": effects, **about, **more})


TWIST = effect(
    "backlash_load", [2, 3, 4], "class_confirmed", alias_set=[],
    parameters=[amount(f"backlash_load_{k}", 0.04 + k / 500, 0.0412 + k / 500) for k in (2, 3, 4)],
    **class_claim("twist about the axis of joints 2, 3, 4 under load", [2, 3, 4]),
)  # fmt: skip


def test_a_class_is_named_by_its_class_with_joints_and_size() -> None:
    found = search([TWIST])
    assert found.headline is not None
    first, second = found.headline.splitlines()
    assert first == "Found: twist about the axis of joints 2-4 under load, like backlash load (0.044-0.050 deg)."
    assert second == (
        "Error on 40 unseen poses: 0.87 -> 0.037 mm rms (0.068 mm with 1 set aside). Measurement noise: 0.015 mm."
    )
    assert found.found is not None
    (row,) = found.found
    assert (row.effect, row.joints, row.size, row.sure) == (
        "twist about the axis under load, like backlash load", [2, 3, 4], "0.044-0.050 deg", "certain",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("verdict", "sure", "said"),
    [
        ("replicated", "certain", "Found: encoder scale of joint 2"),
        ("confirmed", "certain", "Found: encoder scale of joint 2"),
        ("provisional", "probable", "Probable, not proven: encoder scale of joint 2"),
        ("contradicted", "open", "Open: encoder scale of joint 2 (contradicted by unseen poses)"),
        ("a word of a later release", "open", "Open: encoder scale of joint 2"),
    ],
)
def test_three_words_say_how_sure_it_is(verdict: str, sure: str, said: str) -> None:
    claim = {"claim": {"said": "member", "words": "encoder_scale j2", "joints": [2]}}
    found = search([effect("encoder_scale", [2], verdict, **claim)])
    assert found.found is not None
    assert found.found[0].sure == sure
    assert said in str(found.headline)
    if sure != "certain":
        assert "Found" not in str(found.headline)


def test_a_shape_without_a_cause_is_open_whatever_its_verdict_says() -> None:
    found = search([effect("unknown_joint_curve", [3], "confirmed", empirical=True)], "unexplained")
    assert str(found.headline).startswith("Nothing is certain yet.")
    assert "Open: unknown joint curve of joint 3 (0.10 mm at the tool). Open: something else remains" in str(
        found.headline
    )


def test_joints_that_the_rows_do_not_show_are_open() -> None:
    claim = {"claim": {"said": "member", "words": "backlash all", "joints": [1, 2, 3]}, "seen_joints": [2, 3]}
    found = search([effect("backlash", [1, 2, 3], "confirmed", **claim)])
    assert [(row.joints, row.sure) for row in found.found or ()] == [([2, 3], "certain"), ([1], "open")]


def test_names_and_units_are_those_of_a_person() -> None:
    label = class_claim("reversal error of joint 2", [2], "joint_reversal")
    alike = [{"id": "friction_windup", "joints": [2]}]
    lag = effect(
        "backlash", [2], "class_confirmed", alias_set=alike, parameters=[amount("backlash_2", 0.03, 0.04)], **label
    )
    assert str(search([lag]).headline).startswith(
        "Found: reversal error of joint 2, like backlash or friction wind-up (0.030-0.040 deg)."
    )
    several = lag | {"alias_set": [*alike, {"id": "hardening", "joints": [2]}, {"id": "zero_step", "joints": [2]}]}
    assert "like backlash or friction wind-up or 2 others (" in str(search([several]).headline)
    member = {"claim": {"said": "member", "words": "x", "joints": None}}
    warm = effect(
        "thermal_growth", None, "confirmed", parameters=[amount("expansion", 5.5e-5, 6.1e-5, "1/K")], **member
    )
    assert "thermal growth (55-61 ppm/K)" in str(search([warm]).headline)
    curve = effect(
        "eccentricity", [3], "confirmed", claim={"said": "member", "words": "x", "joints": [3]}, moves_mm=0.14
    )
    assert "eccentricity of joint 3 (0.14 mm at the tool)" in str(search([curve]).headline)
    bump = effect("base_step", None, "confirmed", moves_mm=0.35, **member)
    assert "Found: a move of base or instrument (0.35 mm at the tool)." in str(search([bump]).headline)
    ripple = effect("stribeck", [2], "confirmed", claim={"said": "member", "words": "x", "joints": [2]}, moves_mm=None)
    assert "Found: Stribeck friction of joint 2." in str(search([ripple]).headline)


def test_rivals_that_do_as_well_are_named_and_too_many_say_nothing() -> None:
    rivals = [{"id": "axial_compliance", "joints": [2]}, {"id": "hardening", "joints": [2]}]
    one_of = effect("backlash_load", [2], "class_confirmed", alias_set=rivals, claim={"said": "one_of", "words": "x"})
    assert "backlash load or axial compliance or hardening of joint 2" in str(search([one_of]).headline)
    many = [{"id": f"effect_{k}", "joints": [2]} for k in range(25)]
    assert "an effect that these data cannot name" in str(search([TWIST | {"alias_set": many}]).headline)
    tilt = class_claim("tilt of the base or of joint 1 under load", [1], "joint_tilt")
    base = effect("radial_compliance", [1], "class_confirmed", **tilt)
    assert "tilt of the base or of joint 1 under load" in str(search([base]).headline)


def test_the_same_at_several_joints_is_said_once_over_its_whole_range() -> None:
    two = [
        effect("axial_compliance", [k], "provisional", parameters=[amount(f"compliance_{k}", k / 1e3, k / 800)],
               **class_claim(f"twist about the axis of joint {k} under load", [k]))
        for k in (2, 3)
    ]  # fmt: skip
    (row,) = search(two).found or []
    assert (row.joints, row.size) == ([2, 3], "0.0020-0.0038 deg")


def test_what_decides_is_what_the_search_proposes() -> None:
    weak = effect("hardening", [2], "provisional", to_confirm=["Measure more poses."])
    assert str(search([weak]).headline).endswith("To decide: Measure more poses.")
    poses = [{"change": "repeat these poses with 0.4 kg", "information_factor": 2.0}] * 12
    assert "To decide: repeat these poses with 0.4 kg (12 poses;" in str(search([weak], next_poses=poses).headline)
    told = {"enough": False, "instead": ["read a link-side encoder of joint 2", "x"]}
    said = str(search([weak], next_poses=poses, told_apart=told).headline)
    assert said.endswith("To decide: read a link-side encoder of joint 2.")


def test_results_of_earlier_releases_have_a_headline_too() -> None:
    old = GapResult.model_validate({"verdict": "closed", "effects": [{"id": "backlash", "joints": [1, 2]}]})
    assert old.headline == "Nothing that matters is missing: the model agrees with the measurements within their noise." \
        "\nOpen: backlash of joints 1, 2."  # fmt: skip
    assert GapResult().headline is None
    assert "headline" not in GapResult().model_dump()
    assert IdentifyResult().headline is None


def test_without_noise_nothing_is_said_to_be_closed() -> None:
    said = str(search([], "not_known", noise={"absolute": False}).headline)
    assert said.startswith("Nothing was found. Whether something is missing is open: the noise is not known")
    assert said.count("not known") == 1


def test_what_no_effect_explains_is_said_once() -> None:
    adequacy = {"held_out": {"poses": 28, "refuted": True, "left_mm": 0.19}}
    said = str(search([], "unexplained", adequacy=adequacy).headline)
    assert said.splitlines()[0] == "Something is missing (0.19 mm rms), and no known effect explains it."
    assert said.count("explain") == 1
    beside = str(search([TWIST], "unexplained", adequacy=adequacy).headline)
    assert "Open: something else remains (0.19 mm rms) that no known effect explains." in beside


def fit(mean_mm: float, noise_mm: float | None = 0.01, **more: Any) -> str:
    errors = {"mean_mm": mean_mm, "x_mm": 0.1, "y_mm": 0.1, "z_mm": 0.1}
    metrics = {
        "validation": {"n": 39, "left_out": 1, "registration_only": errors | {"mean_mm": 0.8}, "identified": errors}
    }
    about = {"metrics": metrics, "noise_mm": noise_mm, "noise": {"between_visits_mm": noise_mm}}
    return str(IdentifyResult.model_validate(about | more).headline)


def test_a_fit_says_its_error_beside_the_noise_and_what_it_cannot_determine() -> None:
    unknown = [{"name": "a", "identifiable": False}, {"name": "b", "identifiable": True}]
    assert fit(0.016, parameters=unknown).splitlines() == [
        "Mean error on 39 unseen rows (1 more set aside): 0.80 -> 0.016 mm. Before: nominal arm, base and tool fitted.",
        "Measurement noise: 0.016 mm. What is left is about the noise.",
        "Open: 1 of 2 parameters, which these poses cannot determine.",
    ]
    assert "Something is missing: 31 times the noise is left. `kilter gap` looks for it." in fit(0.5)
    assert "noise" not in fit(0.5, None).lower()


@pytest.mark.parametrize(("mean_mm", "noise_mm", "times"), [(0.016, 0.01, 1.0), (0.16, 0.01, 10.0), (0.16, None, None)])
def test_how_many_times_the_noise_is_left_is_counted_in_lengths(
    mean_mm: float, noise_mm: float | None, times: float | None
) -> None:
    errors = {"mean_mm": mean_mm, "x_mm": 0.1, "y_mm": 0.1, "z_mm": 0.1}
    found = IdentifyResult.model_validate(
        {"metrics": {"validation": {"n": 9, "identified": errors}}, "noise": {"between_visits_mm": noise_mm}}
    )
    left = count_noise_left(found.metrics, noise_mm, found.noise)
    assert left == (None if times is None else pytest.approx(times, rel=0.01))  # noise is 1.6 long on the average


def test_views_say_how_far_the_tool_is_off() -> None:
    tool = {"rms_mm": 0.16, "low_mm": 0.12, "high_mm": 0.21, "orientation_deg": 0.01}
    pixels = {"noise_px": 0.1, "between_views": 1.0, "train": tool, "validation": tool}
    said = IdentifyResult.model_validate({"metrics": {}, "pixels": pixels}).headline
    assert said == "Error of the tool in views held out: 0.16 mm rms (95 %: 0.12-0.21 mm)."


def test_a_check_says_what_it_found_and_what_to_do() -> None:
    assert DriftResult(sentence="Joint 2 moved.", remedy="Re-zero it.").headline == "Joint 2 moved.\nRe-zero it."


def test_ranges_are_rounded_outward_and_joints_are_counted_up() -> None:
    assert format_range(0.04612, 0.0638) == "0.046-0.064"
    assert format_range(1.9982, 2.0056) == "1.998-2.006"
    assert format_range(-0.0701, -0.0672) == "-0.071 to -0.067"
    assert format_range(-3.0, 12.4) == "-3 to 13"
    assert [format_joints(one) for one in ([2], [2, 3], [1, 3, 4, 5], [7, 8, 9])] == [
        "joint 2", "joints 2, 3", "joints 1, 3-5", "joints 7-9",
    ]  # fmt: skip
