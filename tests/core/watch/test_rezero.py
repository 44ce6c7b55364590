"""Re-zeroing: the parameter that moved is found, the others stay, its interval holds; what is not carried is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import CoreError, OptionError
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.identify.uncertainty.predictive import Predictive
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.types import QUANTILE
from kilter_core.watch import check, rezero
from kilter_service.versions.drift.wire import rezero_sentence
from tests.core.watch.drifting import DriftingArm, some_arm, some_poses

NOISE = 5e-5
Fitted = tuple[DriftingArm, Calibration, Predictive]


@pytest.fixture(scope="module")
def fitted() -> Fitted:
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


def misfit(calibration: Calibration, arm: DriftingArm) -> float:
    """Mean error (m) of an arm on poses that nobody measured, without noise."""
    q = some_poses(60, np.random.default_rng(99))
    seen = arm.point(q)
    return float(np.linalg.norm(calibration.predict(Observations(q)).position - seen, axis=1).mean())


@pytest.mark.parametrize(
    ("change", "size", "causes"),
    [
        ("zero_3", 4e-3, []), ("zero_2", 5e-2, []), ("sag_2", 4e-5, []), ("zero_1", 4e-3, ["zero_1"]),
        ("zero_6", 2e-2, ["zero_6"]), ("base", 2e-3, []), ("tool", 2e-3, []),
    ],
)  # fmt: skip
def test_what_moved_is_changed_and_the_arm_is_accurate_again(
    change: str, size: float, causes: list[str], fitted: Fitted
) -> None:
    arm, calibration, known = fitted
    moved = arm.after(change, size)
    rows = moved.measured(some_poses(6, np.random.default_rng(1)), np.random.default_rng(2), NOISE)
    found = rezero(calibration, rows, known, causes)
    assert [one.name for one in found.causes] == [change]
    assert misfit(calibration, moved) > 5.0 * misfit(found.calibration, moved)
    assert misfit(found.calibration, moved) < 3.0 * NOISE
    again = moved.measured(some_poses(6, np.random.default_rng(3)), np.random.default_rng(4), NOISE)
    assert check(found.calibration, again, found.known).verdict == "ok"


def test_nothing_else_is_touched(fitted: Fitted) -> None:
    arm, calibration, known = fitted
    rng = np.random.default_rng(5)
    found = rezero(calibration, arm.after("zero_4", 8e-3).measured(some_poses(6, rng), rng, NOISE), known)
    model, values = calibration.model.absorb_frame_increments(calibration.values)
    changed = np.flatnonzero(np.abs(found.calibration.values - values) > 1e-12)
    assert [found.calibration.names[k] for k in changed] == ["theta_offset_4"]
    np.testing.assert_allclose(found.calibration.model.T_base, model.T_base, atol=1e-14)
    assert found.change[0] == pytest.approx(8e-3, abs=4.0 * found.sigma[0])


def test_the_interval_of_a_zero_holds_what_it_is(fitted: Fitted) -> None:
    """Over many fits too: the covariance that follows is that of the errors that were made."""
    off = []
    for seed in range(30):
        rng = np.random.default_rng(100 + seed)
        arm = some_arm(rng)
        robot = robot_from_document(arm.document())
        options = IdentifyOptions(
            effects=({"id": "axial_compliance", "joints": [2, 3]},), noise_mm=0.05, masses="as_stated"
        )
        first = identify(robot, arm.measured(some_poses(40, rng), rng, NOISE), options=options)
        moved = arm.after("zero_3", 5e-3)
        found = rezero(first.calibration, moved.measured(some_poses(5, rng), rng, NOISE), first.predictive)
        k = found.known.names.index("theta_offset_3")
        true = moved.zeros[2]
        value = found.calibration.values[found.calibration.names.index("theta_offset_3")]
        off.append((value - true) / np.sqrt(found.known.covariance[k, k]))
    assert np.mean(np.abs(off) <= QUANTILE) >= 0.83
    assert 0.6 < np.sqrt(np.mean(np.square(off))) < 1.5


def test_what_the_data_do_not_carry_is_refused(fitted: Fitted) -> None:
    arm, calibration, known = fitted
    rng = np.random.default_rng(6)
    q = some_poses(6, rng)

    def refused(moved: DriftingArm, *causes: str) -> str:
        with pytest.raises(CoreError) as no:
            rezero(calibration, moved.measured(q, rng, NOISE), known, causes)
        assert no.value.code == "rezero_not_carried", no.value.message
        return no.value.message

    assert "Nothing has moved" in refused(arm)
    assert "it is zero_1 or base" in refused(arm.after("zero_1", 3e-3))
    assert "The rows refute zero_2" in refused(arm.after("zero_4", 8e-3), "zero_2")
    assert "more has changed" in refused(arm.after("zero_4", 8e-3).after("zero_2", 3e-3), "zero_4", "zero_5")
    assert "do not tell these changes apart" in refused(arm.after("zero_1", 3e-3), "zero_1", "base")
    assert "do not show that zero_5 changed" in refused(arm.after("zero_4", 8e-3), "zero_4", "zero_5")
    both = rezero(
        calibration,
        arm.after("zero_4", 8e-3).after("zero_2", 3e-3).measured(q, rng, NOISE),
        known,
        ["zero_4", "zero_2"],
    )
    assert both.names == ("theta_offset_4", "theta_offset_2")
    four, two = both.changed_causes
    for one, true in ((four, 8e-3), (two, 3e-3)):  # what a check says of each alone takes up what the other did
        assert abs(one.change[0] - true) < 2.0 * one.u95[0]
    said = rezero_sentence(both, "ver_1", 6, "today")
    assert f"zero of joint 4 by {np.degrees(both.change[0]):.3g} deg" in said
    assert f"zero of joint 2 by {np.degrees(both.change[1]):.3g} deg" in said


def test_a_zero_beside_a_frame_is_told_as_it_was_changed(fitted: Fitted) -> None:
    arm, calibration, known = fitted
    rng = np.random.default_rng(8)
    moved = arm.after("zero_4", 8e-3).after("base", 2e-3)
    found = rezero(calibration, moved.measured(some_poses(10, rng), rng, NOISE), known, ["base", "zero_4"])
    base, zero = found.changed_causes
    assert abs(zero.change[0] - 8e-3) < 2.0 * zero.u95[0]
    assert base.size_u95[0] < 1e-3
    assert abs(np.linalg.norm(base.change[:3]) - 2e-3) < 2.0 * base.size_u95[0]


def test_a_cause_without_a_parameter_is_refused(fitted: Fitted) -> None:
    arm, calibration, known = fitted
    rng = np.random.default_rng(7)
    with pytest.raises(OptionError, match="the scale is the instrument's"):
        rezero(calibration, arm.after("scale", 1e-3).measured(some_poses(6, rng), rng, NOISE), known)
    with pytest.raises(OptionError, match="no cause 'zero_9'"):
        rezero(calibration, arm.measured(some_poses(6, rng), rng, NOISE), known, ["zero_9"])


@pytest.mark.parametrize("frames", [["base"], ["base", "tool"]])
def test_a_zero_is_changed_by_rows_of_a_tracker_that_stands_elsewhere(frames: list[str], fitted: Fitted) -> None:
    arm, calibration, known = fitted
    moved = arm.after("zero_3", 4e-3)
    rows = moved.measured(some_poses(12, np.random.default_rng(1)), np.random.default_rng(2), NOISE)
    assert rows.position is not None
    turned = Rotation.from_euler("xyz", [0.02, 0.3, -2.1]).apply(rows.position)
    elsewhere = replace(rows, position=turned + np.array([1.9, -1.2, 0.4]))
    found = rezero(calibration, elsewhere, known, new_setup=frames)
    assert [one.name for one in found.causes] == ["zero_3"]
    assert found.change == pytest.approx([4e-3], abs=4.0 * float(found.sigma[0]))
    np.testing.assert_allclose(found.calibration.model.T_base, calibration.model.T_base, atol=1e-14)
    assert misfit(found.calibration, moved) < 3.0 * NOISE  # where the instrument stood at the fit


def test_a_first_zero_looks_like_a_base_that_was_set_up_anew(fitted: Fitted) -> None:
    arm, calibration, known = fitted
    rows = arm.after("zero_1", 4e-3).measured(some_poses(8, np.random.default_rng(1)), np.random.default_rng(2), NOISE)
    with pytest.raises(CoreError, match="Nothing has moved"):
        rezero(calibration, rows, known, new_setup=["base"])
    with pytest.raises(OptionError, match="no cause 'base'"):
        rezero(calibration, rows, known, ["base"], new_setup=["base"])
