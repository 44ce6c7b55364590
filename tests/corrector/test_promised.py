"""What a corrector announces of a version: the bounds that its kernel keeps, and what was stored of its workspace."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace

import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.correct.program import CorrectionOptions, compile_program
from kilter_core.model import Calibration
from kilter_service.stream.corrector.active import Active, workspace_counts
from kilter_service.stream.corrector.queries import describe
from tests.core.truth import Arm, Step


def test_what_is_announced_are_the_bounds_of_the_program(ur10: Calibration, active_of: Callable[..., Active]) -> None:
    for task, at_limit, rate, acceleration in (("position", "saturate", 5.0, 250.0), ("pose", "refuse", 2.0, 40.0)):
        active = active_of(
            ur10,
            task=task,
            at_limit=at_limit,
            change_rad_s=math.radians(rate),
            change_rad_s2=math.radians(acceleration),
        )
        said = json.loads(active.announcement())
        assert (said["task"], said["at_limit"]) == (task, at_limit)
        assert (said["rate_deg_s"], said["acceleration_deg_s2"]) == (pytest.approx(rate), pytest.approx(acceleration))
        assert said["held_rows"] == ["x", "y", "z", "rx", "ry", "rz"][: 3 if task == "position" else 6]


def test_prismatic_joints_have_their_own(active_of: Callable[..., Active]) -> None:
    steps = (
        Step("rz", 0.0, 0, name="a"), Step("tx", 0.3, name="b"), Step("rz", 0.0, 1, name="c"),
        Step("tx", 0.2, name="d"), Step("tz", 0.0, 2, name="e"),
    )  # fmt: skip
    robot = robot_from_document(Arm(steps, 3).document())
    active = active_of(Calibration.nominal(robot), change_m_s=0.04, change_m_s2=2.0)
    said = json.loads(active.announcement())
    assert (said["rate_mm_s"], said["acceleration_mm_s2"]) == (pytest.approx(40.0), pytest.approx(2000.0))
    assert said["levers_mm"] == [500.0, 200.0, 1.0]
    program = compile_program(Calibration.nominal(robot), CorrectionOptions())
    assert json.loads(replace(active, program=program).announcement())["rate_mm_s"] == pytest.approx(25.0)


def test_the_workspace_is_what_was_stored_and_nothing_is_made_up(
    ur10: Calibration, active_of: Callable[..., Active]
) -> None:
    stored = {
        "poses": 400, "needed_deg": 0.7, "ok": 380, "damped": 15, "limited": 3,
        "refused": {"JOINT_LIMIT": 1, "CORRECTION_TOO_LARGE": 1}, "sentence": "...",
    }  # fmt: skip
    counts = {"poses": 400, "ok": 380, "damped": 15, "limited": 3, "refused": 2}
    assert workspace_counts(stored) == counts
    assert workspace_counts(None) is workspace_counts({}) is workspace_counts({"poses": 0}) is None
    active = replace(active_of(ur10), workspace=workspace_counts(stored))
    assert json.loads(describe("ur10", active, True))["workspace"] == counts
    assert json.loads(describe("ur10", active_of(ur10), True))["workspace"] is None
    assert json.loads(describe("ur10", None, True))["workspace"] is None
