"""Links that bend and grow: a beam integrated in small pieces, handbook deflections, a rod that gets warm."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from tests.core.effects.by_hand import G, effect_on, one_joint, tool_with
from tests.core.truth import Arm, Body, Step


def test_a_beam_under_a_tip_load_sags_by_the_handbook() -> None:
    arm, flexibility, load = one_joint("ry", length=0.8), 1.0 / 5000.0, 6.0 * G
    rows = Observations(np.zeros((1, 1)), payload_kg=np.array([6.0]))
    tool = tool_with(arm, effect_on(arm, "link_bending"), {"bending_1": flexibility}, rows)
    assert tool.position[0, 2] == pytest.approx(-load * 0.8**3 / 3.0 * flexibility, rel=1e-4)
    slope = math.atan2(-tool.rotation[0, 2, 0], tool.rotation[0, 0, 0])
    assert slope == pytest.approx(load * 0.8**2 / 2.0 * flexibility, rel=1e-4)


def test_a_beam_sags_by_its_own_weight() -> None:
    length, a, mass, flexibility = 0.8, 0.5, 4.0, 1.0 / 5000.0
    arm = replace(one_joint("ry", length=length), bodies=(Body(0, mass, np.array([a, 0.0, 0.0])),))
    tool = tool_with(arm, effect_on(arm, "link_bending"), {"bending_1": flexibility}, Observations(np.zeros((1, 1))))
    sag = mass * G * a**2 * (3.0 * length - a) / 6.0 * flexibility
    assert tool.position[0, 2] == pytest.approx(-sag, rel=1e-4)
    slope = math.atan2(-tool.rotation[0, 2, 0], tool.rotation[0, 0, 0])
    assert slope == pytest.approx(mass * G * a**2 / 2.0 * flexibility, rel=1e-4)


def test_the_centre_of_a_link_is_found_along_it() -> None:
    steps = (Step("rx", 0.0, 0, -1.0), Step("tz", -0.4), Step("ry", 0.3), Step("tx", 0.0, 1), Step("ty", 0.2))
    bodies = (Body(0, 3.0, np.array([0.1, 0.05, -0.15])), Body(1, 1.0, np.array([0.0, 0.5, 0.0])))
    effect = effect_on(Arm(steps, 2, bodies=bodies), "link_bending")
    np.testing.assert_allclose(effect.to_document()["centres_m"], [0.15, 0.2])  # the second one's is beyond its end
    with pytest.raises(OptionError, match="centres_m"):
        effect_on(Arm(steps, 2, bodies=bodies), "link_bending", centres_m=(0.1,))


def test_a_beam_loaded_aside_bends_as_its_pieces_do() -> None:
    length, flexibility, pieces = 0.8, 1e-6, 20000
    reach = np.array([0.2, 0.3, -0.1])
    arm = one_joint("ry", length=length, tool=tuple(reach))
    angle = 0.6
    rows = Observations(np.array([[angle]]), payload_kg=np.array([6.0]))
    tool = tool_with(arm, effect_on(arm, "link_bending"), {"bending_1": flexibility}, rows)
    # In the frame of the link: gravity turned back by the joint, curvature = moment across the beam over EI.
    force = 6.0 * G * np.array([math.sin(angle), 0.0, -math.cos(angle)])
    s = (np.arange(pieces) + 0.5) * length / pieces
    arms = np.array([length, 0.0, 0.0]) + reach - s[:, None] * np.array([1.0, 0.0, 0.0])
    bend = np.cross(arms, force) * flexibility * length / pieces
    bend[:, 0] = 0.0
    moved = np.cross(bend, arms).sum(axis=0)  # every piece turns all that lies beyond it
    back = np.array([[math.cos(angle), 0, -math.sin(angle)], [0, 1, 0], [math.sin(angle), 0, math.cos(angle)]])
    straight = np.array([length, 0.0, 0.0]) + reach
    np.testing.assert_allclose(back @ tool.position[0] - straight, moved, atol=2e-9)
    assert np.linalg.norm(moved) > 1e-5


def test_a_link_without_length_cannot_bend() -> None:
    arm = Arm((Step("rz", 0.0, 0), Step("rx", 1.0), Step("rz", 0.0, 1), Step("tx", 0.5)), 2)
    assert effect_on(arm, "link_bending").joints == (1,)
    with pytest.raises(OptionError, match="has no length"):
        effect_on(arm, "link_bending", joints=[0])


def test_a_straight_arm_grows_by_its_length() -> None:
    arm = Arm((Step("tz", 0.3), Step("rz", 0.0, 0), Step("tx", 0.5), Step("ry", 0.0, 1), Step("tx", 0.4)), 2)
    rows = Observations(np.array([[0.4, 0.0]] * 3), temperature_c=np.array([20.0, 30.0, 15.0]))
    tool = tool_with(arm, effect_on(arm, "thermal_growth"), {"expansion": 12e-6}, rows)
    grown = 1.0 + 12e-6 * np.array([0.0, 10.0, -5.0])
    np.testing.assert_allclose(np.linalg.norm(tool.position[:, :2], axis=1), 0.9 * grown, rtol=1e-12)
    np.testing.assert_allclose(tool.position[:, 2], 0.3 * grown, rtol=1e-12)


def test_a_bent_arm_keeps_its_angles_when_it_grows() -> None:
    arm = Arm((Step("rz", 0.0, 0), Step("tx", 0.5), Step("rz", 0.0, 1, -1.0), Step("ty", 0.4)), 2)
    rows = Observations(np.array([[0.4, 1.1]]), temperature_c=np.array([45.0]))
    effect = effect_on(arm, "thermal_growth", reference_c=20.0)
    tool, cold = tool_with(arm, effect, {"expansion": 2e-5}, rows), tool_with(arm, effect, {}, rows)
    np.testing.assert_allclose(tool.position, cold.position * (1.0 + 2e-5 * 25.0), rtol=1e-12)
    np.testing.assert_allclose(tool.rotation, cold.rotation, atol=1e-15)
