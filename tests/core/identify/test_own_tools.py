"""A marker that is mounted anew in every campaign: each has a tool of its own, and the arm is the same."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import OptionError
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.observations import Observations
from tests.core.campaigns import joints, measured, table_errors
from tests.core.truth import Arm, small_pose, ur10

Floats = NDArray[np.float64]
NOISE = 2e-5
NOISE_MM = np.sqrt(3) * NOISE * 1e3
OWN = IdentifyOptions(refit=("tool",))


class Lab:
    """One arm with hidden errors before one tracker; every campaign mounts the marker within ``apart_m`` and ``turned_rad``."""

    def __init__(self, apart_m: float, turned_rad: float = 0.0, bases: tuple[float, float] = (0.0, 0.0)) -> None:
        self.rng = np.random.default_rng(7)
        arm = ur10(tool=pin.SE3(np.eye(3), np.array([0.03, -0.02, 0.1])))
        self.robot = robot_from_document(arm.document())
        self.actual = arm.moved(table_errors(arm, self.rng))
        self.apart, self.bases = (apart_m, turned_rad), bases

    def rows(self, code: int, count: int, see: str = "position", new: bool = True) -> Observations:
        tool = self.actual.tool * (small_pose(self.rng, *self.apart) if new else pin.SE3.Identity())
        base = self.actual.base * small_pose(self.rng, *self.bases)
        there = Arm(self.actual.steps, self.actual.n, base, tool)
        found = measured(there, joints(there, count, self.rng), self.rng, NOISE, see)
        return replace(found, setup=np.full(count, code))


def rms(found: Any, block: str) -> float:
    return float(found.metrics[block]["identified"]["rms_mm"])


@pytest.mark.parametrize(("see", "turned"), [("position", 0.0), ("pose", 0.5), ("markers", 0.5)])
def test_remounted_markers_calibrate_as_one_and_predict_a_new_one(see: str, turned: float) -> None:
    lab = Lab(0.02, turned)
    train = Observations.concatenate([lab.rows(1, 60, see, new=False), lab.rows(2, 50, see), lab.rows(3, 50, see)])
    held = lab.rows(4, 30, see)
    found = identify(lab.robot, train, held, OWN)
    assert rms(found, "train") < 1.25 * NOISE_MM
    assert rms(found, "validation") < 1.3 * NOISE_MM
    assert [(f.code, f.use, f.which) for f in found.own_frames] == [
        (2, "train", "tool"), (3, "train", "tool"), (4, "validation", "tool"),
    ]  # fmt: skip
    assert all(5e-3 < f.moved < 0.2 for f in found.own_frames)
    document = found.to_document()
    assert document["base_refitted"] == []
    assert [f["setup"] for f in document["tool_refitted"]] == [2, 3, 4]
    assert not [name for name in found.free_names if name.startswith("setup_")]
    assert "setup_tools" not in str(found.calibration.to_document())
    shared = identify(lab.robot, replace(train, setup=None), replace(held, setup=None), IdentifyOptions())
    assert rms(shared, "train") > 20 * rms(found, "train")


def test_base_and_tool_may_both_be_new() -> None:
    lab = Lab(0.01, 0.0, (0.2, 0.3))
    train = Observations.concatenate([lab.rows(code, 60) for code in (1, 2)])
    found = identify(lab.robot, train, lab.rows(3, 40), IdentifyOptions(refit=("base", "tool")))
    assert rms(found, "train") < 1.25 * NOISE_MM
    assert rms(found, "validation") < 1.3 * NOISE_MM
    assert [(f.code, f.which) for f in found.own_frames] == [(2, "base"), (2, "tool"), (3, "base"), (3, "tool")]


def test_what_is_refused() -> None:
    lab = Lab(0.01)
    train = Observations.concatenate([lab.rows(code, 30) for code in (1, 2)])
    for wrong in (("marker",), ("tool", "tool")):
        with pytest.raises(OptionError, match="refit"):
            IdentifyOptions(refit=wrong)
    with pytest.raises(OptionError, match="least_squares"):
        identify(lab.robot, train, None, IdentifyOptions(refit=("tool",), method="kalman"))
    held = identify(lab.robot, train, None, IdentifyOptions(refit=("tool",), tool="fixed"))
    assert held.own_frames == ()
