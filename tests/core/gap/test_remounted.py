"""A marker that was mounted again between two sessions, on an arm that Pinocchio drew: stated, and so not named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import OptionError
from kilter_core.gap import GapOptions, find_gap
from kilter_core.gap.check import check_gap
from kilter_core.observations import Observations
from tests.core.soft_arm import NOISE_M, scene

MOVED_M = np.array([1.2e-3, -0.8e-3, 0.5e-3])
SPIN = np.array([8e-3, -5e-3, 6e-3])  # rad
TRIANGLE_M = np.array([[0.0, 0.0, 0.0], [0.11, 0.02, 0.03], [-0.03, 0.12, -0.02]])
ASKED = GapOptions(
    resamples=10, permutations=5, bootstraps=499, next_poses=0, refit=("tool",),
    effects=("axial_compliance", "eccentricity", "tool_step", "session_shift"),
)  # fmt: skip


@pytest.fixture(scope="module")
def remounted():
    """Two sessions of one arm: the reflector of the second sits elsewhere on the tool."""
    made = scene(4)
    session = 1 + made.pose % 2
    turned = made.built.poses(made.q)[1]
    shifts = np.einsum("nij,j->ni", turned, MOVED_M) * (session == 2)[:, None]
    rows = Observations(
        q=made.q, position=made.measured + shifts, direction=made.direction, payload_kg=made.payload_kg,
        pose_id=made.pose, session=session,
    )  # fmt: skip
    return robot_from_document(made.drawn.document()), rows


def test_a_tool_of_each_session_is_found_beside_what_the_arm_lacks(remounted):
    robot, rows = remounted
    report = find_gap(robot, rows, ASKED, validation=0)
    assert {j.evidence.candidate.id for j in report.effects} == {"axial_compliance"}
    found = {row["name"]: row for row in report.stored.parameters()}
    for axis, true in zip("xyz", MOVED_M, strict=True):
        row = found[f"session_2_{axis}"]
        assert abs(row["value"] - 1e3 * true) < 4.0 * row["sigma"] < 0.2


def test_markers_that_were_mounted_anew_may_have_rotated(remounted):
    """With a place alone for each session the rotation was left to whatever else moves three reflectors apart."""
    robot, rows = remounted
    made = scene(4)
    turned = made.built.poses(made.q)[1]
    late = (rows.session == 2)[:, None, None]
    nests = np.where(late, TRIANGLE_M @ pin.exp3(SPIN).T + MOVED_M, TRIANGLE_M)
    seen = made.measured[:, None] + np.einsum("nij,nmj->nmi", turned, nests)
    seen += NOISE_M * np.random.default_rng(9).standard_normal(seen.shape)
    report = find_gap(robot, replace(rows, position=None, markers=seen), ASKED, validation=0)
    assert {j.evidence.candidate.id for j in report.effects} == {"axial_compliance"}
    found = {row["name"]: row for row in report.stored.parameters()}
    turn = [found[f"session_2_{place}"] for place in ("rx", "ry", "rz")]  # about axes that the markers' shape has
    size = float(np.linalg.norm([row["value"] for row in turn]))
    assert abs(size - np.degrees(np.linalg.norm(SPIN))) < 4.0 * max(row["sigma"] for row in turn) < 0.03


def test_one_session_has_no_tool_of_its_own(remounted):
    robot, rows = remounted
    for one in (replace(rows, session=None), rows.select(rows.session == 1)):
        for ask in (find_gap, check_gap):
            with pytest.raises(OptionError, match="needs two of them") as refused:
                ask(robot, one, ASKED, validation=0)
            assert refused.value.context["option"] == "refit"


@pytest.mark.parametrize("refit", [("base",), ("tool", "tool"), ("marker",)])
def test_only_the_tool_is_refitted(refit):
    with pytest.raises(OptionError, match=r'give \["tool"\]'):
        GapOptions(refit=refit)
