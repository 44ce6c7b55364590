"""A search with encoders on the links beside the tool: it names apart what the tool alone mixes up."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.gap import find_gap
from kilter_core.gap.options import GapOptions
from kilter_core.observations import Observations
from tests.core.measurement.test_together import ARM, JOINT_RAD, campaign

CANDIDATES = ("axial_compliance", "radial_compliance", "encoder_scale", "eccentricity", "second_harmonic")
HIDDEN = {("radial_compliance", 1), ("axial_compliance", 2), ("axial_compliance", 3)}


def report(rows: Observations) -> dict[str, Any]:
    robot = robot_from_document(ARM.document())
    return find_gap(robot, rows, GapOptions(permutations=30, effects=CANDIDATES)).to_document()


def named(document: dict[str, Any]) -> set[tuple[str, int]]:
    return {(effect["id"], joint) for effect in document["effects"] for joint in effect["joints"]}


@pytest.fixture(scope="module")
def rows() -> Observations:
    return campaign(120, again=30)[0]


def test_links_and_tool_name_what_the_tool_alone_does_not(rows: Observations) -> None:
    both, alone = report(rows), report(replace(rows, link_q=None))
    assert named(both) == HIDDEN
    assert named(alone) != HIDDEN
    assert both["verdict"] == "closed"
    # The gap is that of the tool, whatever was measured beside it.
    assert both["gap"]["before_mm"] == pytest.approx(alone["gap"]["before_mm"], rel=1e-3)
    assert both["gap"]["noise_mm"] == pytest.approx(0.1, rel=0.2)
    tool, links = both["measurements"]
    assert [(k["kind"], k["unit"]) for k in (tool, links)] == [("points", "mm"), ("link_encoders", "deg")]
    for kind, true, size in ((tool, 0.1, 3.0), (links, np.degrees(JOINT_RAD), 1.0)):
        assert kind["repeats"] == pytest.approx(true, rel=0.2)
        assert kind["noise"] == pytest.approx(true, rel=0.2)
        for where in ("", "validation_"):
            assert kind[f"{where}before"] > 2.0 * kind[f"{where}after"]
            assert kind[f"{where}after"] == pytest.approx(true * np.sqrt(size), rel=0.25)
    assert tool["after"] == pytest.approx(both["gap"]["after_mm"], rel=1e-6)
    assert tool["validation_before"] == pytest.approx(both["gap"]["validation_before_mm"], rel=1e-6)
    (one,) = alone["measurements"]
    assert (one["kind"], one["after"]) == ("points", pytest.approx(alone["gap"]["after_mm"], rel=1e-6))


def test_readings_that_are_missing_count_for_nothing(rows: Observations) -> None:
    link = rows.link_q.copy()  # type: ignore[union-attr]
    link[::2] = np.nan
    position = rows.position.copy()  # type: ignore[union-attr]
    position[5] = np.nan
    found = report(replace(rows, link_q=link, position=position))
    assert named(found) == HIDDEN
    assert "rows_without_tool" in {warning["code"] for warning in found["warnings"]}
