"""Eleven mix-ups on five builds of arms are refused; genuine campaigns, also of few moving joints, are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import ObservationError
from kilter_core.evaluate import evaluate
from kilter_core.identify import identify
from kilter_core.identify.plausibility.believable import reach
from kilter_core.identify.plausibility.belonging import refuse_mixed_up
from kilter_core.model import Calibration
from tests.core.campaigns import measured
from tests.core.truth import some_pose, ur10
from tests.mix_ups.arms import BUILDS
from tests.mix_ups.campaigns import MIXED, genuine, inverted
from tests.mix_ups.score import bounds, is_worn, of_few_joints, said

NAMED = {
    "two joints swapped": "swapped",
    "radians declared as degrees": "like radians declared as degrees",
    "one joint in radians": "like radians declared as degrees",
    "millimetres declared as metres": "millimetres declared as metres",
    "inches declared as millimetres": "inches declared as millimetres",
    "shifted by one row": "of the joints one row below",
    "a joint read with the one before": " looks read as joint ",
    "shuffled": "Joints and positions do not belong together",
}


# What the joints are like and how many: `python -m tools.lab mix-ups` draws from all builds.
@pytest.mark.parametrize("build", [pytest.param(b, marks=[pytest.mark.slow] * (b in ("5R", "7R"))) for b in BUILDS])
def test_mix_ups_are_refused(build: str) -> None:
    g = genuine(list(BUILDS).index(build) + 50, build)
    assert said(g) == ""
    for name, mix in MIXED.items():
        text = said(g, mix(g, np.random.default_rng(1)))
        assert NAMED.get(name, "Remedy: ") in text, f"{name}: {text}"


@pytest.mark.parametrize("seed", range(100, 140))
def test_genuine_campaigns_are_not_accused(seed: int) -> None:
    g = genuine(seed, moving=of_few_joints(seed) or (3 if seed % 2 else None))
    assert said(g) == "", g.kind


@pytest.mark.slow
def test_two_hundred_mix_ups_and_a_thousand_genuine_campaigns() -> None:
    accused = [seed for seed in range(2000, 3000)
               if said(genuine(seed, moving=of_few_joints(seed), worn=is_worn(seed)))]  # fmt: skip
    assert not accused
    missed = [
        (seed, build, name)
        for seed in range(5)
        for build in BUILDS
        for name, mix in MIXED.items()
        if not said((g := genuine(900 + seed, build)), mix(g, np.random.default_rng(seed)))
    ]
    assert bounds(len(missed), 250)[1] < 0.03, missed


@pytest.mark.parametrize("build", ["6R", "SCARA"])
def test_poses_that_are_inverted_are_named(build: str) -> None:
    g = genuine(61, build, see="pose")
    assert "The poses look inverted" in said(g, inverted(g))


@pytest.mark.parametrize(("seed", "joint", "sign"), [(62, 5, 1.0), (62, 5, -1.0), (63, 4, 1.0)])
def test_coupled_wrists_are_named_by_the_orientation_too(seed: int, joint: int, sign: float) -> None:
    """The tool point on the last axis: its place says nothing of that joint."""
    g, rng = genuine(seed, "6R", see="pose"), np.random.default_rng(seed)
    rows = measured(replace(g.pair.true, tool=pin.SE3.Identity()), g.rows.q, rng, 5e-5, "pose")
    coupled = rows.q + sign * np.outer(rows.q[:, joint - 1], np.arange(6) == joint)
    word, undo = ("plus", "minus") if sign > 0 else ("minus", "plus")
    text = said(g, replace(rows, q=coupled))
    assert f"Joint {joint + 1} looks read as joint {joint + 1} {word} joint {joint}" in text
    assert f"upload joint {joint + 1} {undo} joint {joint} in its column" in text


def test_rows_shifted_by_one_are_named_whatever_is_held_out() -> None:
    """Every second row alone shows nothing of the row above: the whole campaign is asked before a quarter is held out."""
    g = genuine(11, "6R", see="position")
    rows = replace(g.rows, q=np.roll(g.rows.q, 1, axis=0))
    with pytest.raises(ObservationError, match="joints one row below") as refused:
        identify(g.robot, rows, 0.25)
    assert refused.value.code == "foreign_observations"


def test_a_refit_of_few_joints_ends_no_worse_than_it_started() -> None:
    """A head of two axes that meet: its flange moves on a sphere, where the linear start collapsed."""
    for seed in range(4):
        g = genuine(7000 + 5 * seed, "7R", moving=2, see="position")
        found = evaluate(Calibration.nominal(g.robot), g.rows, ["base", "tool"])
        assert found["identified"]["rms_mm"] < 5.0
        assert found["identified"]["rms_mm"] <= found["nominal"]["rms_mm"]


def test_an_arm_that_was_never_mastered_is_not_called_another() -> None:
    """Zeros off by 20 degrees leave hundreds of millimetres, and belong to the rows: a fit finds them."""
    g = genuine(21, "6R", see="position")
    off = np.radians([0.0, 20.0, -15.0, 10.0, 0.0, 0.0])
    rows = replace(g.rows, q=g.rows.q + off)
    assert refuse_mixed_up(Calibration.nominal(g.robot), rows) == ()
    assert 0.3 < reach(g.robot) < 4.0


@pytest.mark.parametrize("degrees", [-12.0, 12.0])
def test_a_wrong_zero_that_another_unit_would_explain_is_a_wrong_zero(degrees: float) -> None:
    """The tool point is on the last axis: were joint 6 still, a tool beside the axis would look like a zero of joint 5."""
    rng, arm = np.random.default_rng(3), ur10()
    q = rng.uniform(-1.5, 1.5, (60, 6))
    mastered = q + np.radians(degrees) * (np.arange(6) == 4)
    rows = replace(measured(replace(arm, base=some_pose(rng, 2.0)), mastered, rng, 5e-5), q=q)
    robot = robot_from_document(arm.document())
    assert refuse_mixed_up(Calibration.nominal(robot), rows) == ()
    wrong = replace(rows, q=np.where(np.arange(6) == 4, np.degrees(q), q))
    with pytest.raises(ObservationError, match="Joint 5 looks like degrees declared as radians"):
        refuse_mixed_up(Calibration.nominal(robot), wrong)


@pytest.mark.parametrize("seed", range(200, 220))
def test_arms_in_use_are_not_accused(seed: int) -> None:
    g = genuine(seed, moving=of_few_joints(seed), worn=True)
    assert said(g) == "", g.kind


def test_what_no_reading_explains_is_refused_without_a_name() -> None:
    """Reversed columns, signs and zeros at once: no pair of mix-ups undoes them."""
    g = genuine(31, "6R", see="position")
    with pytest.raises(ObservationError, match="Joints and positions do not belong together") as refused:
        refuse_mixed_up(Calibration.nominal(g.robot), replace(g.rows, q=-g.rows.q[:, ::-1] + 0.7))
    assert refused.value.code == "foreign_observations"
