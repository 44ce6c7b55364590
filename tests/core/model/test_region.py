"""Where planned poses may be, checked with the arm of another implementation; and the order they are driven in."""

from __future__ import annotations

import itertools
import tracemalloc

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.driving_order import driving_order
from kilter_core.errors import RobotError
from kilter_core.model import Calibration
from kilter_core.model.region import BESIDE_M, Hull, Region, arm_points
from kilter_core.types import Floats
from tests.core.truth import ur10

ROBOT = robot_from_document(ur10().document())
START = Calibration.nominal(ROBOT)
RNG = np.random.default_rng(3)


def test_the_tool_point_of_the_arm_is_where_the_other_implementation_has_it() -> None:
    q = RNG.uniform(-2.0, 2.0, (20, 6))
    points = arm_points(ROBOT, q)
    assert points.shape == (20, 7, 3)
    assert points[:, -1] == pytest.approx(ur10().poses(q)[0], abs=1e-9)
    assert np.ptp(points[:, 0], axis=0) == pytest.approx(np.zeros(3), abs=1e-12)  # the first joint stands still


def test_poses_stay_where_the_arm_was_driven() -> None:
    driven = np.array([0.3, -1.2, 1.0, -1.0, -1.5, 0.0]) + RNG.uniform(-0.4, 0.4, (60, 6))
    region = Region.from_calibration(START, driven)
    q = region.draw(200, RNG)
    assert (q >= driven.min(axis=0)).all()
    assert (q <= driven.max(axis=0)).all()
    # Along any direction the tool goes no farther than it was, but for the room beside the hull.
    tools, before = ur10().poses(q)[0], ur10().poses(driven)[0]
    for direction in RNG.normal(size=(50, 3)):
        u = direction / np.linalg.norm(direction)
        assert (tools @ u).max() <= (before @ u).max() + BESIDE_M + 1e-9
    assert region.holds(driven).mean() > 0.9
    assert not region.holds(driven + 1.0).any()


def test_no_point_of_the_arm_goes_below_the_floor() -> None:
    region = Region.from_calibration(START).above(0.15)
    q = region.draw(100, RNG)
    assert ur10().poses(q)[0][:, 2].min() >= 0.15 - 1e-9
    assert ur10().poses(Region.from_calibration(START).draw(100, RNG))[0][:, 2].min() < 0.15


def test_room_that_does_not_exist_is_said() -> None:
    with pytest.raises(RobotError, match="above 5000 mm"):
        Region.from_calibration(START).above(5.0).draw(3, RNG)


def test_a_hull_of_many_faces_is_asked_in_little_memory() -> None:
    """The elbow of an arm stays on a sphere: all places of it are corners of their hull."""
    rng = np.random.default_rng(8)
    corners = rng.normal(size=(1200, 3))
    corners /= np.linalg.norm(corners, axis=1, keepdims=True)
    hull = Hull.from_points(corners)
    points = rng.uniform(-1.2, 1.2, (20_000, 3))
    tracemalloc.start()
    inside = hull.holds(points)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(hull.half) > 2000  # all at once they took 650 MB
    assert peak < 40e6
    radius = np.linalg.norm(points, axis=1)
    assert inside[radius < 0.98].all()
    assert not inside[radius > 1.0 + 1.1 * BESIDE_M].any()


@pytest.mark.parametrize("rank", [0, 1, 2, 3])
def test_hulls_of_flat_clouds(rank: int) -> None:
    axes = np.linalg.qr(RNG.normal(size=(3, 3)))[0]
    inside = RNG.uniform(-1.0, 1.0, (400, rank)) @ axes[:, :rank].T + 5.0
    hull = Hull.from_points(inside)
    assert hull.holds(inside).all()
    assert hull.holds(inside.mean(axis=0)[None]).all()
    for k in range(3):
        assert not hull.holds((inside.mean(axis=0) + (2.0 if k < rank else 0.1) * axes[:, k])[None]).any()


def path_length(q: Floats, ranges: Floats) -> float:
    """Length of the path through ``q (N, n)`` in this order, in joint ranges."""
    return float(np.sum(np.max(np.abs(q[1:] - q[:-1]) / ranges, axis=1)))


def test_a_driving_order_is_as_short_as_the_shortest() -> None:
    ranges = np.array([2.0, 1.0])
    shorter = 0
    for _ in range(10):
        q = RNG.uniform(-1.0, 1.0, (7, 2)) * ranges
        best = min(path_length(q[[0, *p]], ranges) for p in itertools.permutations(range(1, 7)))
        found = path_length(q[driving_order(q, ranges)], ranges)
        assert best - 1e-12 <= found <= 1.3 * best
        shorter += found < 1.01 * best
    assert shorter >= 5
    q = RNG.uniform(-1.0, 1.0, (200, 6))
    order = driving_order(q, np.ones(6))
    assert sorted(order) == list(range(200))
    assert path_length(q[order], np.ones(6)) < 0.7 * path_length(q, np.ones(6))


def test_no_room_is_refused_with_what_leaves_none() -> None:
    whole = np.array([[[-9.0, -9.0, -9.0], [9.0, 9.0, 9.0]]])
    with pytest.raises(
        RobotError, match="out of the zones to keep out of, 50 are needed to choose from: keep out of less"
    ) as told:
        Region.from_calibration(START).outside(whole).draw(50, np.random.default_rng(1))
    assert told.value.context["field"] == "keep_out_mm"
    small = np.array([[0.2, 0.0, 0.2], [0.2001, 0.0001, 0.2001]])
    with pytest.raises(RobotError, match=r"take a larger box or go to the limits \(--anywhere\)"):
        Region.from_calibration(START, RNG.uniform(-0.2, 0.2, (40, START.robot.n_joints))).restrict_to_box(small).draw(
            50, np.random.default_rng(1)
        )
