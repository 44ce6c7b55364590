"""ISO 9283 poses: in the cube, on its diagonal planes, reached, and every joint moving."""

from __future__ import annotations

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.errors import RobotError
from kilter_core.plan.d_optimal import Cube, five_poses, iso_poses, largest_cube
from tests.core.truth import Arm, Step, ur10

# The Katana of eq. 4.2 to 4.5 with the attachment of table 5.1, in its nominal base.
KATANA = Arm(
    (
        Step("rz", 0.0, 0), Step("rx", np.pi / 2), Step("rz", 0.0, 1), Step("tx", 0.190),
        Step("rz", 0.0, 2), Step("tx", 0.139), Step("rz", 0.0, 3), Step("rx", -np.pi / 2), Step("tz", 0.1473),
        Step("rz", 0.0, 4), Step("rx", np.pi / 2), Step("tz", 0.330),
    ),
    5,
)  # fmt: skip
BASE = np.array([0.055, 0.055, 0.2015])


@pytest.mark.parametrize("seed", [0, 1])
def test_katana_poses_stand_on_the_diagonal_planes_of_a_cube(seed: int) -> None:
    robot = robot_from_document(preset_document("katana450-chapter5"))
    q = iso_poses(robot, 118, seed)
    points = KATANA.poses(q)[0] + BASE
    lower, upper = robot.limits.T
    assert ((q > lower) & (q < upper)).all()
    # The planes of one cube: for its centre and side, some pair of coordinates is equal or opposite.
    low, high = points.min(axis=0), points.max(axis=0)
    side = float(np.max(high - low))
    assert side > 0.15
    centre, spread = _fit_centre(points)
    assert spread < 1e-6
    assert np.max(np.abs(points - centre)) <= side / 2 * 1.1
    moved = np.abs(np.diff(q, axis=0))
    assert (moved > np.radians(0.05)).all()


def _fit_centre(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre from the planes y±z and x±z taken in turn, and the largest distance of a point from its plane."""
    y_minus_z, y_plus_z = points[0::4] @ [0, 1, -1], points[1::4] @ [0, 1, 1]
    x_minus_z, x_plus_z = points[2::4] @ [1, 0, -1], points[3::4] @ [1, 0, 1]
    families = (y_minus_z, y_plus_z, x_minus_z, x_plus_z)
    level = np.array([np.median(f) for f in families])
    A = np.array([[0, 1, -1], [0, 1, 1], [1, 0, -1], [1, 0, 1.0]])
    centre = np.linalg.lstsq(A, level, rcond=None)[0]
    return centre, max(float(np.max(np.abs(f - m))) for f, m in zip(families, level, strict=True))


def test_points_lie_on_the_four_planes_within_the_cube() -> None:
    cube = Cube(np.array([1.0, 2.0, 3.0]), 0.5)
    points = cube.on_diagonals(400, np.random.default_rng(0)) - cube.centre
    assert np.max(np.abs(points)) <= 0.25
    x, y, z = points.T
    on = np.stack([np.isclose(y, z), np.isclose(y, -z), np.isclose(x, z), np.isclose(x, -z)])
    assert on.any(axis=0).all()
    assert (on.sum(axis=1) >= 100).all()


@pytest.mark.parametrize("plane", range(4))
def test_the_five_poses_lie_as_the_standard_says(plane: int) -> None:
    """Centre, and a tenth of the diagonal's length from the ends of both diagonals of one plane."""
    side = 0.3
    cube = Cube(np.array([0.1, 0.2, 0.3]), side)
    p1, p2, p3, p4, p5 = cube.five(plane)
    assert p1 == pytest.approx(cube.centre)
    diagonal = np.sqrt(3.0) * side
    for one, other in ((p2, p4), (p3, p5)):
        assert np.linalg.norm(one - other) == pytest.approx(0.8 * diagonal)
        assert (one + other) / 2 == pytest.approx(cube.centre)
        assert np.abs(one - cube.centre) == pytest.approx(np.full(3, 0.4 * side))
    normal = np.cross(p2 - p1, p3 - p1)
    assert np.dot(normal, p4 - p1) == pytest.approx(0.0, abs=1e-12)
    assert sorted(np.abs(normal / np.linalg.norm(normal))) == pytest.approx([0.0, np.sqrt(0.5), np.sqrt(0.5)])


def test_the_katana_reaches_its_five_poses_and_moves_every_joint_between_them() -> None:
    robot = robot_from_document(preset_document("katana450-chapter5"))
    q = five_poses(robot)
    p = KATANA.poses(q)[0] + BASE
    assert np.linalg.norm(p[1] - p[3]) == pytest.approx(np.linalg.norm(p[2] - p[4]), abs=1e-6)
    assert (p[1] + p[3]) / 2 == pytest.approx(p[0], abs=1e-6)
    assert np.linalg.norm(p[1] - p[3]) > 0.15
    lower, upper = robot.limits.T
    assert ((q > lower) & (q < upper)).all()
    assert (np.abs(np.diff(q[::-1], axis=0)) > np.radians(0.05)).all()


def test_the_largest_cube_of_a_full_box_is_most_of_it() -> None:
    points = np.random.default_rng(1).uniform([0, 0, 0], [1, 1, 1], (20_000, 3))
    cube = largest_cube(points)
    assert cube.side > 0.55
    assert np.max(np.abs(cube.centre - 0.5)) <= (1.0 - cube.side) / 2 + 0.05


def test_limits_are_needed_and_said_so() -> None:
    arm = ur10()
    document = arm.document()
    document["joints"] = [{"name": joint["name"]} for joint in document["joints"]]
    with pytest.raises(RobotError, match="limits"):
        iso_poses(robot_from_document(document), 10)
