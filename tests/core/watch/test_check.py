"""The check on arms that a simulator in plain numpy moves: false alarms, small steps, the cause, large steps, bad input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import ObservationError, OptionError, TooFewPosesError
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.identify.uncertainty.predictive import Predictive
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.watch import Check, check
from tests.core.watch.drifting import DriftingArm, some_arm, some_poses

NOISE = 5e-5
STEP = float(np.radians(0.03))
EXACT = Predictive((), np.zeros((0, 0)), 0.0, NOISE)
SIZES = {
    **{f"zero_{k}": 2e-3 for k in range(1, 7)}, "sag_2": 3e-5, "sag_3": 8e-5, "base": 1e-3, "tool": 1e-3, "scale": 5e-4,
}  # fmt: skip


def perfect(rng: np.random.Generator) -> tuple[DriftingArm, Calibration]:
    """An arm that is exactly as it is described."""
    arm = replace(some_arm(rng), zeros=np.zeros(6), compliance=np.zeros(6))
    return arm, Calibration.nominal(robot_from_document(arm.document()))


@pytest.fixture(scope="module")
def fitted() -> tuple[DriftingArm, Calibration, Predictive]:
    """An arm with zeros and sag, and what 80 poses tell of it."""
    rng = np.random.default_rng(0)
    arm = some_arm(rng)
    options = IdentifyOptions(
        effects=({"id": "axial_compliance", "joints": [2, 3]},), noise_mm=0.05, masses="as_stated"
    )
    found = identify(
        robot_from_document(arm.document()), arm.measured(some_poses(80, rng), rng, NOISE), options=options
    )
    assert found.predictive is not None
    return arm, found.calibration, found.predictive


def named(found: Check) -> list[str]:
    return [one.cause.name for one in found.causes]


@pytest.mark.parametrize(("arms", "most"), [(3, 2), pytest.param(8, 3, marks=pytest.mark.slow)])
def test_an_arm_that_has_not_moved_alarms_once_in_a_thousand_checks_at_most(arms: int, most: int) -> None:
    rng = np.random.default_rng(1)
    chances: list[float] = []
    for _ in range(arms):
        arm, calibration = perfect(rng)
        rows = [arm.measured(some_poses(5, rng), rng, NOISE) for _ in range(120)]
        chances.extend(check(calibration, seen, EXACT).p_value for seen in rows)
    assert sum(p <= 1e-3 for p in chances) <= most
    assert 0.01 < np.mean(np.array(chances) <= 0.05) <= 0.05  # neither too often, nor a number that says nothing


def test_what_a_version_does_not_know_of_itself_is_no_alarm(
    fitted: tuple[DriftingArm, Calibration, Predictive],
) -> None:
    arm, calibration, known = fitted
    rng = np.random.default_rng(2)
    verdicts = [check(calibration, arm.measured(some_poses(5, rng), rng, NOISE), known).verdict for _ in range(150)]
    assert verdicts.count("ok") >= 149


def test_a_noise_that_few_rows_told_raises_no_more_alarms() -> None:
    rng = np.random.default_rng(20)
    freedom, chances, certain = 20.0, [], []
    arm, calibration = perfect(rng)
    for _ in range(400):
        told = NOISE * float(np.sqrt(rng.chisquare(freedom) / freedom))
        rows = arm.measured(some_poses(5, rng), rng, NOISE)
        known = Predictive((), np.zeros((0, 0)), 0.0, told, freedom)
        chances.append(check(calibration, rows, known).p_value)
        certain.append(check(calibration, rows, replace(known, freedom=float("inf"))).p_value)
    assert sum(p <= 0.01 for p in certain) >= 12  # by chi-square, of 4 that are meant
    assert sum(p <= 0.01 for p in chances) <= 9
    assert sum(p <= 0.1 for p in chances) >= 10  # and it still says something
    stated = check(calibration, rows, known, noise=NOISE)
    assert stated.p_value == check(calibration, rows, EXACT).p_value
    assert check(calibration, rows, known).smallest["zero_2"] > stated.smallest["zero_2"]
    read = Predictive.from_document({**known.to_document(), "names": ["d_1"], "matrix": [[0.0]]})
    assert read is not None
    assert read.freedom == freedom


@pytest.mark.parametrize("joint", [1, 2, 3, 4, 5])
def test_a_step_of_an_encoder_by_a_thirtieth_of_a_degree_is_seen_within_three_checks(joint: int) -> None:
    rng = np.random.default_rng(10 + joint)
    seen = 0
    for _ in range(40):
        arm, calibration = perfect(rng)
        moved = arm.after(f"zero_{joint}", STEP)
        seen += any(
            check(calibration, moved.measured(some_poses(6, rng), rng, NOISE), EXACT).verdict != "ok" for _ in range(3)
        )
    assert seen >= 38


@pytest.mark.parametrize("change", list(SIZES))
def test_the_cause_or_its_class_is_right(change: str, fitted: tuple[DriftingArm, Calibration, Predictive]) -> None:
    arm, calibration, known = fitted
    rng = np.random.default_rng(3)
    moved = arm.after(change, SIZES[change])
    found = [check(calibration, moved.measured(some_poses(6, rng), rng, NOISE), known) for _ in range(25)]
    assert sum(change in named(one) for one in found) == 25
    if change not in ("zero_1", "zero_6"):  # which a base or a tool of the same look contains
        assert sum(one.verdict == "moved" for one in found) >= 23


@pytest.mark.parametrize("change", ["zero_1", "zero_3", "zero_6", "sag_2", "scale"])
def test_a_small_change_is_never_said_to_be_another_single_one(change: str) -> None:
    rng = np.random.default_rng(4)
    wrong = alarms = 0
    for _ in range(60):
        arm, calibration = perfect(rng)
        moved = arm.after(change, SIZES[change] * rng.uniform(0.1, 0.8))
        found = check(calibration, moved.measured(some_poses(6, rng), rng, NOISE), EXACT)
        alarms += found.verdict != "ok"
        wrong += found.verdict == "moved" and named(found) != [change]
    assert alarms >= 20
    assert wrong <= 1


def test_the_change_is_as_large_as_it_was_and_its_interval_holds() -> None:
    rng = np.random.default_rng(5)
    off = []
    for _ in range(100):
        arm, calibration = perfect(rng)
        size = float(rng.uniform(1e-3, 5e-2))
        found = check(calibration, arm.after("zero_2", size).measured(some_poses(6, rng), rng, NOISE), EXACT)
        one = next(one for one in found.judged if one.cause.name == "zero_2")
        off.append(abs(one.change[0] - size) / one.u95[0])
    assert 0.90 <= np.mean(np.array(off) <= 1.0) <= 0.99


@pytest.mark.parametrize("frame", ["base", "tool"])
def test_how_far_a_frame_moved_has_an_interval_that_holds(frame: str) -> None:
    rng = np.random.default_rng(51)
    off, rotated = [], []
    for _ in range(100):
        arm, calibration = perfect(rng)
        size = float(rng.uniform(1e-3, 5e-3))
        found = check(calibration, arm.after(frame, size).measured(some_poses(6, rng), rng, NOISE), EXACT)
        one = next(one for one in found.judged if one.cause.name == frame)
        off.append(abs(np.linalg.norm(one.change[:3]) - size) / one.size_u95[0])  # a shift along a unit vector
        if frame == "base":
            turn = size * np.linalg.norm([1.2, 0.9, -0.4])
            rotated.append(abs(np.linalg.norm(one.change[3:]) - turn) / one.size_u95[1])
    assert 0.90 <= np.mean(np.array(off) <= 1.0) <= 0.99
    assert np.mean(np.array(rotated or [0.0]) <= 1.0) >= 0.90
    assert len(next(one for one in found.judged if one.cause.name == "zero_2").size_u95) == 0


@pytest.mark.parametrize(("change", "size"), [("zero_1", 0.06), ("base", 0.05), ("tool", 0.05), ("zero_2", 0.06)])
def test_a_large_change_bends_no_verdict(change: str, size: float) -> None:
    rng = np.random.default_rng(6)
    arm, calibration = perfect(rng)
    for _ in range(10):
        found = check(calibration, arm.after(change, size).measured(some_poses(6, rng), rng, NOISE), EXACT)
        assert change in named(found)
        assert named(found) in ([change], ["base", change], [change, "base"])


def test_the_smallest_change_is_seen_with_95_percent() -> None:
    rng = np.random.default_rng(7)
    seen = {"zero_2": 0, "scale": 0, "zero_5": 0}
    arm, calibration = perfect(rng)
    for _ in range(60):
        q = some_poses(5, rng)
        smallest = check(calibration, arm.measured(q, rng, NOISE), EXACT).smallest
        for change in seen:
            moved = arm.after(change, smallest[change])
            seen[change] += check(calibration, moved.measured(q, rng, NOISE), EXACT).verdict != "ok"
    assert all(count >= 53 for count in seen.values()), seen


def test_an_instrument_set_up_anew_is_no_alarm_and_hides_no_zero_but_the_first() -> None:
    rng = np.random.default_rng(8)
    arm, calibration = perfect(rng)
    anew = replace(arm, base=arm.after("base", 0.4).base)
    rows = anew.measured(some_poses(6, rng), rng, NOISE)
    assert check(calibration, rows, EXACT, new_setup=["base"]).verdict == "ok"
    moved = anew.after("zero_3", 2e-3).measured(some_poses(6, rng), rng, NOISE)
    found = check(calibration, moved, EXACT, new_setup=["base"])
    assert "zero_3" in named(found)
    assert "zero_1" in [one.name for one in found.unseen]


def test_a_reflector_on_the_last_axis_does_not_show_its_zero() -> None:
    rng = np.random.default_rng(9)
    arm, _ = perfect(rng)
    tool = arm.tool.copy()
    tool[:2, 3] = 0.0
    on_axis = replace(arm, tool=tool)
    calibration = Calibration.nominal(robot_from_document(on_axis.document()))
    found = check(calibration, on_axis.measured(some_poses(6, rng), rng, NOISE), EXACT)
    assert found.unseen[0].name == "zero_6"
    assert "zero_6" not in found.smallest


def test_repeats_of_a_pose_share_what_the_model_lacks() -> None:
    rng = np.random.default_rng(10)
    arm, calibration = perfect(rng)
    known = Predictive((), np.zeros((0, 0)), 5e-4, NOISE)
    q = some_poses(5, rng)
    once = check(calibration, arm.measured(q, rng, NOISE), known).smallest["zero_2"]
    often = check(calibration, arm.measured(np.repeat(q, 20, axis=0), rng, NOISE), known).smallest["zero_2"]
    assert often == pytest.approx(once, rel=0.02)


def test_a_whole_campaign_may_serve() -> None:
    rng = np.random.default_rng(11)
    arm, calibration = perfect(rng)
    rows = arm.after("zero_4", STEP).measured(some_poses(2000, rng), rng, NOISE)
    found = check(calibration, rows, EXACT)
    assert named(found) == ["zero_4"]
    assert found.poses == 500


@pytest.mark.parametrize(
    ("count", "repeats", "said"), [(2, 1, "2 poses"), (1, 5, "the 5 rows repeat one pose"), (2, 3, "repeat 2 poses")]
)
def test_too_few_poses_are_refused(count: int, repeats: int, said: str) -> None:
    rng = np.random.default_rng(12)
    arm, calibration = perfect(rng)
    q = np.repeat(some_poses(count, rng), repeats, axis=0)
    with pytest.raises(TooFewPosesError, match=said):
        check(calibration, arm.measured(q, rng, NOISE), EXACT)


def test_rows_of_another_arm_are_refused() -> None:
    rng = np.random.default_rng(13)
    _, calibration = perfect(rng)
    other, _ = perfect(rng)
    other = replace(other, rows=other.rows + np.array([0.1, 0.2, 0.0]))
    with pytest.raises(ObservationError) as refused:
        check(calibration, other.measured(some_poses(6, rng), rng, NOISE), EXACT)
    assert refused.value.code == "rows_of_another_arm"
    assert refused.value.context["misfit_m"] > 0.02


def test_what_is_missing_is_said() -> None:
    rng = np.random.default_rng(14)
    arm, calibration = perfect(rng)
    rows = arm.measured(some_poses(5, rng), rng, NOISE)
    with pytest.raises(OptionError, match="noise"):
        check(calibration, rows, Predictive((), np.zeros((0, 0)), 0.0, 0.0))
    with pytest.raises(OptionError, match="new_setup"):
        check(calibration, rows, EXACT, new_setup=["tool"])
    with pytest.raises(ObservationError, match="measured position"):
        check(calibration, Observations(q=rows.q), EXACT)


def test_another_tool_is_refused(fitted: tuple[DriftingArm, Calibration, Predictive]) -> None:
    arm, calibration, known = fitted
    rng = np.random.default_rng(15)
    rows = arm.measured(some_poses(5, rng), rng, NOISE)
    assert rows.position is not None
    markers = rows.position[:, None, :] + np.array([[0.0, 0.0, 0.0], [0.03, 0.0, 0.0], [0.0, 0.04, 0.0]])
    with pytest.raises(ObservationError) as refused:
        check(calibration, Observations(q=rows.q, markers=markers), known)
    assert refused.value.code == "tool_not_stated"
    marked = replace(calibration, marker_points=np.array([[0.0, 0.0, 0.0], [0.03, 0.0, 0.0], [0.0, 0.04, 0.0]]))
    with pytest.raises(ObservationError, match="Measure these markers"):
        check(marked, rows, known)


def test_an_arm_that_is_warmer_has_not_moved() -> None:
    rng = np.random.default_rng(16)
    verdicts, small = [], []
    for _ in range(60):
        arm, calibration = perfect(rng)
        warm = float(rng.uniform(-10.0, 10.0))
        grown = replace(
            arm, rows=arm.rows * np.array([1.0 + 12e-6 * warm, 1.0 + 12e-6 * warm, 1.0]),
            zeros=rng.normal(0.0, 5e-6, 6) * warm,
        )  # fmt: skip
        rows = replace(grown.measured(some_poses(5, rng), rng, NOISE), temperature_c=np.full(5, 25.0 + warm))
        verdicts.append(check(calibration, rows, EXACT, fitted_c=(25.0, 25.0)).verdict)
        small.append(check(calibration, rows, EXACT).verdict)
    assert verdicts.count("ok") == 60
    assert small.count("ok") < 60  # where nobody stated the temperature of the fit


def test_what_is_summed_over_a_season_is_a_straight_line_over_the_temperature(
    fitted: tuple[DriftingArm, Calibration, Predictive],
) -> None:
    arm, calibration, known = fitted
    q, temperatures = some_poses(6, np.random.default_rng(21)), np.linspace(12.0, 36.0, 13)
    made = []
    for warm in temperatures - 23.0:
        rows = arm.after("zero_4", 3e-6 * warm).measured(q, np.random.default_rng(0), 0.0)
        made.append(
            check(calibration, replace(rows, temperature_c=np.full(6, 23.0 + warm)), known, fitted_c=(22.0, 24.0))
        )
    assert {found.verdict for found in made} == {"ok"}
    bent = {
        True: 0.0,
        False: 0.0,
    }  # the largest deviation from a line, in standard deviations of a check within the fit
    for name in (f"zero_{joint}" for joint in (1, 2, 3, 4, 5)):
        each = [next(one for one in found.judged if one.cause.name == name) for found in made]
        for summed in bent:
            values = [float((one.summed if summed else one.change)[0]) for one in each]
            line = np.polyval(np.polyfit(temperatures, values, 1), temperatures)
            bent[summed] = max(bent[summed], float(np.abs(values - line).max() / each[6].sigma[0]))
    assert bent[True] < 0.02
    assert bent[False] > 10.0 * bent[True]  # the change itself, which allows for the expansion beyond the fit


def test_rows_at_a_far_temperature_are_refused() -> None:
    rng = np.random.default_rng(17)
    arm, calibration = perfect(rng)
    rows = replace(arm.measured(some_poses(4, rng), rng, NOISE), temperature_c=np.array([21.0, 22.0, 41.0, 22.0]))
    with pytest.raises(
        ObservationError, match="Row 3 was measured at 41 deg C, and the version at 21 to 24 deg C"
    ) as no:
        check(calibration, rows, EXACT, fitted_c=(21.0, 24.0))
    assert no.value.code == "another_temperature"
