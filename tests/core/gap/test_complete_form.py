"""A DH chain lacks a rotation near parallel axes: the search says which, and does not say it of a complete arm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.arm.chain import Axis
from kilter_core.arm.robot import Robot
from kilter_core.gap import GapOptions, effect_verdicts, find_gap
from kilter_core.gap.search.linear.complete_form import MissingDirection, incomplete_warnings, missing_directions
from kilter_core.gap.search.prepare import prepare_data
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.gap.time_twins import DH, NOISE_M, TOOL
from tests.core.gap.time_twins import robot as complete

HIDDEN_DEG = 0.04
POSES = 80


def robot() -> Robot:
    """The arm in plain DH: the second angle between parallel axes (beta) is no parameter."""
    arm = complete()
    kept = [k for k, e in enumerate(arm.chain.elements) if not (e.name or "").startswith("beta")]
    elements = tuple(arm.chain.elements[k] for k in kept)
    links = tuple(replace(link, element=sum(k <= link.element for k in kept) - 1) for link in arm.links)
    return replace(arm, chain=replace(arm.chain, elements=elements), links=links)


def rows(hidden_deg: float, seed: int, coupled: float = 0.0) -> Observations:
    """Plain DH in numpy: axis 3 is rotated about y before it, and joint 3 follows joint 2 by ``coupled``."""
    rng = np.random.default_rng([seed, 5])
    q = rng.uniform(-2.0, 2.0, (POSES, 6))
    points = []
    for pose in q:
        T = np.eye(4)
        for j, (offset, d, a, alpha) in enumerate(DH):
            if j == 2:
                b = np.radians(hidden_deg)
                T = T @ np.array(
                    [[np.cos(b), 0, np.sin(b), 0], [0, 1, 0, 0], [-np.sin(b), 0, np.cos(b), 0], [0, 0, 0, 1]]
                )
            t = pose[j] + offset + (coupled * np.sin(pose[1]) if j == 2 else 0.0)
            c, s, ca, sa = np.cos(t), np.sin(t), np.cos(alpha), np.sin(alpha)
            T = T @ np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]])
        points.append((T @ [*TOOL, 1.0])[:3])
    return Observations(q=q, position=np.array(points) + rng.normal(0.0, NOISE_M, (POSES, 3)))


@pytest.mark.parametrize("seed", [1, 2])
def test_the_missing_rotation_is_named_with_its_size(seed: int) -> None:
    problem = prepare_data(Calibration.nominal(robot()), rows(HIDDEN_DEG, seed), GapOptions()).problem
    found = missing_directions(problem, ())
    assert [(d.joint, d.axis.name) for d in found] == [(2, "RY")]
    assert np.degrees(found[0].angle) == pytest.approx(HIDDEN_DEG, rel=0.1)
    (warning,) = incomplete_warnings(found)
    assert "rotation of axis 3 about y" in warning["message"]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_complete_arm_lacks_nothing(seed: int) -> None:
    problem = prepare_data(Calibration.nominal(robot()), rows(0.0, seed), GapOptions()).problem
    assert missing_directions(problem, ()) == ()


def test_a_search_says_it_in_its_headline_and_names_no_effect_for_it() -> None:
    report = find_gap(robot(), rows(HIDDEN_DEG, 1), GapOptions())
    assert "lacks the rotation of axis 3 about y" in report.sentence
    assert "geometry_incomplete" in [w["code"] for w in report.warnings]
    assert {e.verdict for e in report.effects} <= {"provisional"}
    assert "confirmed" not in report.sentence


def test_nothing_is_confirmed_that_a_missing_rotation_explains_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    """A coupling that is there, and a rotation that would do as well: the headline must not say both."""
    arm, measured = robot(), rows(0.0, 1, coupled=1e-3)
    options = GapOptions(effects=("joint_coupling",), resamples=20, permutations=5, bootstraps=499, next_poses=0)
    (plain,) = find_gap(arm, measured, options).effects
    assert "complete_geometry" not in plain.gates
    one = MissingDirection(2, Axis.RY, 1e-3, 1e-9)
    monkeypatch.setattr(effect_verdicts, "missing_directions", lambda *_: (one,))
    report = find_gap(arm, measured, options)
    row = report.to_document()["effects"][0]
    assert (row["verdict"], row["gates"]["complete_geometry"]) == ("provisional", False)
    assert any("complete chain" in told for told in row["to_confirm"])


def test_a_coupling_of_joints_is_not_taken_for_a_rotation_that_is_missing() -> None:
    report = find_gap(robot(), rows(0.0, 1, coupled=1e-3), GapOptions())
    assert "geometry_incomplete" not in [w["code"] for w in report.warnings]
