"""Circle point analysis on arms that Pinocchio moves, one joint at a time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.arm.conversions.tables import screws_of_chain
from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import CoreError
from kilter_core.identify import identify
from kilter_core.model import RobotModel
from kilter_core.observations import Observations
from kilter_core.procedures.circle_points import robot_from_circles
from tests.core.campaigns import MARKERS, joints, measured, table_errors
from tests.core.truth import Arm, Step, some_arm, some_pose, ur10

Floats = NDArray[np.float64]
NOISE = 2e-5
HOME = np.array([0.4, -1.2, 1.1, -0.6, -1.0, 0.3])


def circles(
    arm: Arm, home: Floats, see: str = "markers", arc: float = 1.5, rows: int = 25, noise: float = NOISE
) -> tuple[Floats, Floats]:
    """Readings and points (N, m, 3): every joint in turn over ``arc`` about the home pose."""
    rng = np.random.default_rng(2)
    q = []
    for j in range(arm.n):
        block = np.tile(home, (rows, 1))
        reach = arc if arm.moving[j].axis[0] == "r" else 0.3
        block[:, j] += np.linspace(-reach / 2, reach / 2, rows)
        q.append(block)
    q = np.concatenate(q)
    position, rotation = arm.poses(q)
    body = MARKERS if see == "markers" else np.array([[0.05, -0.03, 0.02]])
    points = position[:, None] + np.einsum("nij,mj->nmi", rotation, body)
    return q, points + rng.normal(0.0, noise, points.shape)


def slides(arm: Arm) -> NDArray[np.bool_]:
    return np.array([step.axis[0] == "t" for step in arm.moving])


def middle(arm: Arm, q: Floats) -> Floats:
    position, rotation = arm.poses(q)
    return position + rotation @ MARKERS.mean(axis=0)


def predicted(document: dict[str, Any], q: Floats) -> tuple[Floats, Floats]:
    model = RobotModel(robot_from_document(document))
    found = model.predict(Observations(q), model.values0())
    return found.position, found.rotation


def test_a_ur10_nobody_drew_is_found_and_then_calibrated_to_the_noise() -> None:
    rng = np.random.default_rng(0)
    arm = ur10(base=some_pose(rng, 3.0), tool=some_pose(rng, 0.2))
    arm = arm.moved(table_errors(arm, rng))
    q, points = circles(arm, HOME)
    found = robot_from_circles(q, slides(arm), points, name="unknown")
    assert (found.document["name"], found.document["convention"]) == ("unknown", "chain")
    assert found.rms < 3e-4
    elsewhere = joints(arm, 60, rng)
    gap = np.linalg.norm(predicted(found.document, elsewhere)[0] - middle(arm, elsewhere), axis=1)
    assert gap.max() < 2e-3
    train, held = (measured(arm, joints(arm, n, rng), rng, NOISE, "markers") for n in (60, 40))
    robot = robot_from_document(found.document)
    block = identify(robot, train, held).metrics["validation"]
    assert block["nominal"]["rms_mm"] < 3.0
    # Its own parameters need not be complete; as mcpc they are.
    whole = robot_from_circles(q, slides(arm), points, name="unknown", convention="mcpc").document
    block = identify(robot_from_document(whole), train, held).metrics["validation"]
    assert block["identified"]["rms_mm"] < 1.2 * NOISE * np.sqrt(3) * 1e3


def test_axes_are_pinocchio_s_within_what_the_report_says() -> None:
    arm = ur10(base=some_pose(np.random.default_rng(1), 3.0))
    q, points = circles(arm, HOME, "point", arc=1.0)
    found = robot_from_circles(q, slides(arm), points, name="a", convention="poe", frame="device")
    robot = robot_from_document(arm.document())
    true = screws_of_chain(robot.chain).compose_with_poses(robot.T_base, np.eye(4))
    mine = screws_of_chain(robot_from_document(found.document).chain)
    for k, axis in enumerate(found.axes):
        assert axis.arc == pytest.approx(1.0)
        tilt = np.linalg.norm(np.cross(mine.direction[k], true.direction[k]))
        assert mine.direction[k] @ true.direction[k] > 0.999
        # Axes further out are carried to zero by those before, whose errors come on top.
        assert tilt < 5.0 * np.sqrt(sum(f.sigma_rad**2 for f in found.axes[: k + 1]))
        off = np.cross(mine.point[k] - true.point[k], true.direction[k])
        assert np.linalg.norm(off) < 5.0 * sum(f.sigma_m + 1.5 * f.sigma_rad for f in found.axes[: k + 1])
        assert 0 < axis.sigma_rad < 0.02
    assert np.array_equal(robot_from_document(found.document).T_base, np.eye(4))


@pytest.mark.parametrize("seed", range(6))
def test_any_arm_turning_or_sliding_without_noise_is_found_exactly(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 7))
    arm = some_arm(rng, n, prismatic=True)
    q, points = circles(arm, rng.uniform(-0.5, 0.5, n), noise=0.0)
    for frame, convention in (("axis", "chain"), ("device", "cpc")):
        found = robot_from_circles(q, slides(arm), points, name="a", convention=convention, frame=frame)
        elsewhere = rng.uniform(-2, 2, (20, n))
        position, _ = predicted(found.document, elsewhere)
        np.testing.assert_allclose(position, middle(arm, elsewhere), atol=1e-7)


def test_the_base_stands_on_the_first_axis_level_with_the_second() -> None:
    # A UR10 in the device's own frame: its base frame is 127.3 mm below the shoulder.
    q, points = circles(ur10(), HOME, noise=0.0)
    base = robot_from_circles(q, slides(ur10()), points, name="a").document["base"]
    assert base["z_mm"] == pytest.approx(127.3, abs=1e-4)
    assert [base[k] for k in ("x_mm", "y_mm", "rx_deg", "ry_deg")] == pytest.approx([0, 0, 0, 0], abs=1e-4)


def test_joints_may_stand_elsewhere_for_each_circle_and_markers_hide() -> None:
    arm, rng = ur10(), np.random.default_rng(4)
    parts = [circles(arm, HOME + rng.uniform(-0.4, 0.4, 6)) for _ in range(6)]
    rows = [np.arange(25 * j, 25 * (j + 1)) for j in range(6)]
    q = np.concatenate([part[0][rows[j]] for j, part in enumerate(parts)])
    points = np.concatenate([part[1][rows[j]] for j, part in enumerate(parts)])
    points[::7, 1] = np.nan
    found = robot_from_circles(q, slides(arm), points, name="a")
    elsewhere = joints(arm, 40, rng)
    assert np.abs(predicted(found.document, elsewhere)[0] - middle(arm, elsewhere)).max() < 3e-3


def refused(q: Floats, points: Floats, arm: Arm) -> tuple[str, str]:
    with pytest.raises(CoreError) as error:
        robot_from_circles(q, slides(arm), points, name="a")
    return error.value.code, error.value.message


def test_what_shows_no_axis_is_refused_by_joint() -> None:
    arm = ur10()
    q, points = circles(arm, HOME)
    assert refused(*circles(arm, HOME, arc=np.radians(25)), arm)[0] == "arc_too_short"
    enough, there = circles(arm, HOME, arc=np.radians(30))
    robot_from_circles(enough, slides(arm), there, name="a")
    short = (q[:, 2] == HOME[2]) | (np.abs(q[:, 2] - HOME[2]) < np.radians(13))
    code, message = refused(q[short], points[short], arm)
    assert (code, "Joint 3" in message, "short arc" in message) == ("arc_too_short", True, True)
    still = q[:, 4] == HOME[4]
    code, message = refused(q[still], points[still], arm)
    assert (code, "Joint 5 never moves alone" in message) == ("joint_constant", True)
    few = np.ones(len(q), dtype=bool)
    few[25:50] = np.arange(25) % 12 == 0
    assert refused(q[few], points[few], arm)[0] == "too_few_poses"
    wrong = q.copy()
    wrong[75:100, 3] = HOME[3] + 2 * (q[75:100, 3] - HOME[3])
    code, message = refused(wrong, points, arm)
    assert (code, "joint 4" in message, "another unit" in message) == ("circle_not_round", True, True)


def horizontal(ratio: float = -1.0, tail: bool = False) -> Arm:
    """FANUC's third joint is read against the horizontal: moving the second keeps the forearm's direction."""
    steps = [
        Step("rz", 0.0, 0), Step("tz", 0.5), Step("tx", 0.1), Step("ry", 0.0, 1), Step("tz", 0.6), Step("ry", 0.0, 1, -1.0),
        Step("ry", 0.0, 2, ratio), Step("tx", 0.7),
    ]  # fmt: skip
    if tail:
        steps += [Step("rx", 0.0, 3), Step("tx", 0.1), Step("ry", 0.0, 4), Step("tx", 0.12)]
    return Arm(tuple(steps), 5 if tail else 3)


def test_a_joint_that_carries_another_along_is_named_by_markers() -> None:
    q, points = circles(horizontal(), np.array([0.2, 0.3, 0.4]), arc=1.2)
    with pytest.raises(CoreError, match=r"another joint moved along. It is joint 3, .*--follows j3=j2") as refused:
        robot_from_circles(q, np.zeros(3, dtype=bool), points, name="f")
    assert (refused.value.code, refused.value.context) == ("circle_not_round", {"joint": 2, "follower": 3})


@pytest.mark.parametrize("ratio", [-1.0, 1.0])
@pytest.mark.parametrize("see", ["markers", "point"])
def test_uncoupled_joints_give_the_arm(ratio: float, see: str) -> None:
    """The remedy works: elsewhere, with all joints moved, the arm is where Pinocchio has it."""
    rng = np.random.default_rng(1)
    plain = horizontal(ratio, tail=True)
    arm = Arm(plain.steps, plain.n, some_pose(rng, 1.0), some_pose(rng, 0.1))
    q, points = circles(arm, np.array([0.2, 0.3, 0.4, -0.5, 0.6]), see)
    found = robot_from_circles(q, np.zeros(5, dtype=bool), points, name="f", follows={2: 1})
    assert found.rms < 3e-4
    elsewhere = rng.uniform(-1.2, 1.2, (40, 5))
    position, rotation = arm.poses(elsewhere)
    body = MARKERS.mean(axis=0) if see == "markers" else np.array([0.05, -0.03, 0.02])
    gap = np.linalg.norm(predicted(found.document, elsewhere)[0] - (position + rotation @ body), axis=1)
    assert gap.max() < 2e-3


@pytest.mark.parametrize(
    ("follows", "words"),
    [({1: 2}, "both must be revolute"), ({6: 1}, "the rows have 6 joints"), ({1: 0}, "the axes are not parallel")],
)
def test_followers_that_cannot_be_are_refused(follows: dict[int, int], words: str) -> None:
    q, points = circles(ur10(), HOME)
    with pytest.raises(CoreError, match=rf"Joint \d cannot follow joint \d: .*{words}"):
        robot_from_circles(q, np.zeros(6, dtype=bool), points, name="f", follows=follows)


def test_another_unit_is_no_coupling() -> None:
    arm = ur10()
    q, points = circles(arm, HOME)
    q[25:50, 1] = HOME[1] + 2 * (q[25:50, 1] - HOME[1])
    assert "another unit" in refused(q, points, arm)[1]
