"""The thesis's experiments: their arms owe Kilter nothing, and the pages say what the scripts find."""

from __future__ import annotations

import ast
import math
import re
from pathlib import Path

import numpy as np
import pytest

from kilter_core.identify.measured_rows import parameter_influence
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations
from tools import influence_and_tilting
from tools.thesis import arms
from tools.thesis import experiments as done
from tools.thesis.drawing import table
from tools.thesis_reproduction import MODELS, verdict

ROOT = Path(__file__).resolve().parents[2]
PAGES = ROOT / "docs/explanation"


def test_the_arms_share_no_code_with_kilter() -> None:
    tree = ast.parse((ROOT / "tools/thesis/arms.py").read_text(encoding="utf-8"))
    names = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    names |= {str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert not {name.partition(".")[0] for name in names} & {
        "kilter_core", "kilter_service", "kilter_files", "kilter_client", "tests", "tools",
    }  # fmt: skip


@pytest.mark.parametrize("label", influence_and_tilting.MAKES)
def test_the_arm_as_drawn_is_the_robot_that_kilter_is_given(label: str) -> None:
    make = influence_and_tilting.MAKES[label]
    robot = influence_and_tilting.robot_of(make)
    low, high = np.radians(np.array(make.limits_deg)).T
    q = np.random.default_rng(0).uniform(low, high, (20, make.n))
    model = RobotModel(robot)
    found = model.predict(Observations(q), model.values0()).position
    np.testing.assert_allclose(arms.Arm(make).positions(q), found, atol=1e-12)


def test_influence_of_an_independent_arm_is_that_of_the_identification() -> None:
    """+0.05 deg of every angle and +0.1 mm of every length, by moving the outside arm and by Kilter's analysis."""
    robot = done.katana(4)
    q, _ = done.poses(done.katana())
    outside = done.influence(q)
    ours = {"theta_offset_" + name[1:]: name for name in outside if name[0] == "q"}
    names = [*ours, *(name for name in outside if name[0] != "q")]
    inside = parameter_influence(Calibration.nominal(robot), Observations(q), names)
    for column, name in enumerate(names):
        np.testing.assert_allclose(inside.moved[:, column] * 1e3, outside[ours.get(name, name)], atol=1e-9)


def test_the_order_of_the_thesis_and_the_figures_of_the_page() -> None:
    """One arm, quickly: the same order on poses and on the circle, and the page's own row of ten poses."""
    calibrate, unseen = done.poses(done.katana())
    arm, found = done.models(0, calibrate)
    held = {name: done.mean_mm(c, arm, unseen) for name, c in found.items()}
    ring = {name: float(d.mean()) for name, d in done.along_circle(arm, found).items()}
    for error in (held, ring):
        full = max(error["full, tilt first"], error["full, together"])
        assert error["before"] > error["conventional"] > error["stiffness only"] > 3.0 * full
    page = (PAGES / "thesis-reproduction.md").read_text(encoding="utf-8")
    first = re.search(r"^\| 1 \| (.*) \|$", page, re.MULTILINE)
    assert first is not None
    said = [float(cell) for cell in first[1].split(" | ")]
    assert said == pytest.approx([done.errors_mm(found[n], arm, unseen[:1])[0] for n in MODELS], abs=2e-3)


def test_weights_and_tilting_together_as_the_page_says() -> None:
    """One arm of one make: tilting is what counts, weights on top of it change little and lose."""
    make = influence_and_tilting.MAKES["Katana 450"]
    robot = influence_and_tilting.robot_of(make)
    calibrate, unseen = influence_and_tilting.poses(robot, 30)
    error = influence_and_tilting.compared(robot, make, 1, calibrate, unseen)
    measured = error["tilting measured first, least squares"]
    assert error["no tilting, least squares"] > 10.0 * measured
    assert error["tilting measured first, influence"] == pytest.approx(measured, rel=0.25)
    assert error["tilting identified too, influence"] > 5.0 * error["tilting identified too, least squares"]


def test_noise_decides_no_verdict() -> None:
    assert [verdict(n, 20) for n in (20, 18, 12, 10)] == ["Holds.", "Holds.", "Holds for most arms.", "Does not hold."]
    assert table(["a", "b"], [["1", "2"]]).splitlines() == ["| a | b |", "| --- | --- |", "| 1 | 2 |"]


def test_tilting_of_a_stretched_arm_by_hand() -> None:
    """Joint 2 of an arm stretched level: its moment by hand, what yields and the play below it."""
    make = arms.KATANA
    q = np.zeros((1, 5))
    moment = arms.Arm(make).moments(q)[0, 1, 2]
    # The centres of links 4 and 5 lie straight above or below joint 4 here.
    lever = 0.1 * 1.03 + (0.19 + 0.104) * 0.9 + (0.19 + 0.139) * 1.0 + (0.19 + 0.139) * 0.8
    assert moment == pytest.approx(-9.80665 * lever, rel=1e-9)
    play = np.array([0.0, 1e-4, 0.0, 0.0, 0.0])
    tilting = arms.Tilting(np.zeros(5), play, np.zeros(5))
    still, tilted = (arms.Arm(make, tilting=t).positions(q)[0] for t in (None, tilting))
    assert tilted[2] < still[2]
    out = still - np.array([0.055, 0.055, 0.2015])  # joint 2 turns about the base's y
    reach = math.hypot(out[0], out[2])
    assert np.linalg.norm(tilted - still) == pytest.approx(1e-4 * reach, rel=1e-3)
