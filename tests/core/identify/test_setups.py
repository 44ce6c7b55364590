"""Set-ups with a frame each: sheets laid anew, in training and in validation, on an arm that shares no code with core."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import OptionError, TooFewPosesError
from kilter_core.identify import Folds, IdentifyOptions, identify
from kilter_core.observations import Observations
from tests.core.campaigns import joints, measured, table_errors
from tests.core.truth import Arm, small_pose, some_pose, ur10

Floats = NDArray[np.float64]
NOISE = 2e-5


class Lab:
    """One arm with hidden errors, seen from a new frame in every set-up."""

    def __init__(self, apart_m: float, turned_rad: float, seed: int = 4) -> None:
        self.rng = np.random.default_rng(seed)
        arm = ur10()
        self.robot = robot_from_document(arm.document())
        self.actual = arm.moved(table_errors(arm, self.rng))
        self.apart = (apart_m, turned_rad)

    def rows(self, code: int | None, count: int, see: str = "position", **columns: Any) -> Observations:
        base = self.actual.base * small_pose(self.rng, *self.apart)
        there = Arm(self.actual.steps, self.actual.n, base, self.actual.tool)
        found = measured(there, joints(there, count, self.rng), self.rng, NOISE, see, **columns)
        return found if code is None else replace(found, setup=np.full(count, code))


def rms(found: Any, block: str = "validation") -> float:
    return float(found.metrics[block]["identified"]["rms_mm"])


SEEN_AS_NOISE_MM = 1.25 * NOISE * np.sqrt(3) * 1e3


@pytest.mark.parametrize("see", ["position", "pose", "markers"])
@pytest.mark.parametrize("apart", [(1e-3, 3e-3), (0.3, 1.0)])
def test_several_sheets_calibrate_as_one_and_predict_a_new_one(see: str, apart: tuple[float, float]) -> None:
    lab = Lab(*apart)
    train = Observations.concatenate([lab.rows(code, 50, see) for code in (1, 2, 3)])
    held = Observations.concatenate([lab.rows(code, 30, see) for code in (4, 5)])
    found = identify(lab.robot, train, held, IdentifyOptions())
    assert rms(found, "train") < SEEN_AS_NOISE_MM
    assert rms(found) < SEEN_AS_NOISE_MM
    assert found.metrics["validation"]["registration_only"]["rms_mm"] > 10 * rms(found)
    assert [(frame.code, frame.use) for frame in found.own_frames] == [
        (2, "train"), (3, "train"), (4, "validation"), (5, "validation"),
    ]  # fmt: skip
    assert not [name for name in found.free_names if name.startswith("setup_")]
    assert found.covariance.shape == (len(found.free_names),) * 2
    assert "setup_frames" not in str(found.calibration.to_document())


def test_one_base_for_all_sheets_keeps_an_error_of_the_frames() -> None:
    lab = Lab(1e-3, 3e-3)
    train = Observations.concatenate([lab.rows(code, 50) for code in (1, 2)])
    held = lab.rows(3, 30)
    own = rms(identify(lab.robot, train, held, IdentifyOptions()))
    shared = replace(train, setup=None), replace(held, setup=None)
    assert rms(identify(lab.robot, *shared, IdentifyOptions())) > 10 * own


def test_the_frames_found_are_the_frames_there() -> None:
    lab = Lab(1e-3, 3e-3)
    first, second = lab.rows(1, 60), lab.rows(2, 60)
    # The second sheet again, moved by 2 mm and 5 mrad about the base's origin.
    turn = np.array([[np.cos(5e-3), -np.sin(5e-3), 0], [np.sin(5e-3), np.cos(5e-3), 0], [0, 0, 1]])
    assert second.position is not None
    moved = replace(second, position=second.position @ turn.T + [2e-3, 0, 0], setup=np.full(60, 3))
    found = identify(lab.robot, Observations.concatenate([first, second]), moved, IdentifyOptions())
    again = identify(lab.robot, Observations.concatenate([first, moved]), second, IdentifyOptions())
    assert rms(found) == pytest.approx(rms(again), rel=0.05)
    np.testing.assert_allclose(
        found.calibration.values[6:], again.calibration.values[6:], atol=1e-7,
        err_msg="where a sheet lies must not change what is found of the arm",
    )  # fmt: skip


def test_sigmas_count_what_the_frames_cost() -> None:
    """Each of many short sheets tells less of the arm than the same rows in one frame; the sigmas must say so."""
    lab = Lab(0.0, 0.0)
    one = lab.rows(None, 80)
    many = replace(one, setup=np.arange(80) // 5)
    names = identify(lab.robot, one, None, IdentifyOptions()).free_names
    sigma = {
        key: np.sqrt(np.diag(identify(lab.robot, rows, None, IdentifyOptions()).covariance))
        for key, rows in (("one", one), ("many", many))
    }
    arm = [k for k, name in enumerate(names) if not name.startswith(("base", "tool"))]
    assert np.all(sigma["many"][arm] > 0.95 * sigma["one"][arm])
    assert np.any(sigma["many"][arm] > 1.2 * sigma["one"][arm])


def test_poses_held_out_of_known_sheets_keep_the_frames_of_the_fit() -> None:
    lab = Lab(0.2, 0.5)
    train = Observations.concatenate([lab.rows(code, 60) for code in (1, 2)])
    for validation in (0.3, Folds(4)):
        found = identify(lab.robot, train, validation, IdentifyOptions())
        assert rms(found) < 1.4 * SEEN_AS_NOISE_MM
        assert [frame.use for frame in found.own_frames] == ["train"]


def test_intervals_are_those_of_the_arm() -> None:
    lab = Lab(1e-3, 3e-3)
    train = Observations.concatenate([lab.rows(code, 40) for code in (1, 2)])
    found = identify(lab.robot, train, None, IdentifyOptions(level=1, intervals="bootstrap"))
    rows = found.to_document()["parameters"]
    assert len(rows) == len(found.free_names)
    assert all(row["lower"] <= row["value"] <= row["upper"] for row in rows)


def test_what_cannot_fit_several_frames_is_refused_and_one_frame_is_a_way_out() -> None:
    lab = Lab(1e-3, 3e-3)
    train = Observations.concatenate([lab.rows(code, 50) for code in (1, 2)])
    for options in (IdentifyOptions(method="kalman"), IdentifyOptions(base="removed")):
        with pytest.raises(OptionError, match=r'"refit": \[\]'):
            identify(lab.robot, train, None, options)
    few = Observations.concatenate([lab.rows(1, 60), lab.rows(2, 3)])
    with pytest.raises(TooFewPosesError, match="has 3 poses, 4 are needed"):
        identify(lab.robot, few, None, IdentifyOptions())
    identify(lab.robot, replace(few, setup=None), None, IdentifyOptions())


def test_a_base_that_is_believed_is_not_refitted() -> None:
    lab = Lab(1e-3, 3e-3)
    found = identify(lab.robot, lab.rows(1, 60), lab.rows(2, 30), IdentifyOptions(base="fixed"))
    assert found.own_frames == ()
    assert rms(found) > 0.3


@pytest.mark.parametrize("refit", ["base", ("marker",), ("base", "base")])
def test_other_refits_are_refused(refit: Any) -> None:
    with pytest.raises(OptionError, match="refit is"):
        IdentifyOptions(refit=refit)


def test_a_far_frame_is_no_matter_of_the_start() -> None:
    lab = Lab(0.0, 0.0)
    train = Observations.concatenate([lab.rows(1, 60), lab.rows(2, 60)])
    far = some_pose(np.random.default_rng(1), 5.0)
    assert train.position is not None
    moved = np.where((train.setup == 2)[:, None], train.position @ far.rotation.T + far.translation, train.position)
    found = identify(lab.robot, replace(train, position=moved), lab.rows(3, 30), IdentifyOptions())
    assert rms(found) < SEEN_AS_NOISE_MM
