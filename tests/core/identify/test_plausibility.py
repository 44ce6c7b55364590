"""Foreign rows are named, arms that are only bad are not: both sides of the rule, on arms that share no code with the core."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache
from itertools import combinations, pairwise, product
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.robot import Robot
from kilter_core.errors import ObservationError
from kilter_core.gap import find_gap
from kilter_core.identify import identify
from kilter_core.identify.plausibility import plausibility
from kilter_core.identify.plausibility.plausibility import refuse_foreign
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.blind.generator import generate
from tests.blind.generator.cases import Hidden, cases
from tests.blind.to_core import observations_of, robot_of
from tests.core.campaigns import joints, measured
from tests.core.real import WITH_TOOL, real_campaign
from tests.core.truth import Arm, Step, small_pose, some_arm, some_pose, ur10, with_bodies, with_hidden_errors

Floats = NDArray[np.float64]


def spread(names: str, *values: Iterable[Any]) -> pytest.MarkDecorator:
    """Every combination of the values, but what `make test` runs has each mistake on one arm, and each arm its mistakes.

    The first values are the arms, or whatever else the mistakes are to be spread over. `tools.lab slow` runs the others.
    """
    lengths = [len(list(one)) for one in values]
    rest = [list(one) for one in values]
    found = []
    for place in product(*map(range, lengths)):
        row = [one[k] for one, k in zip(rest, place, strict=True)]
        often = place[0] == sum(place[1:]) % lengths[0]
        found.append(pytest.param(*row, marks=() if often else pytest.mark.slow))
    return pytest.mark.parametrize(names, found)


TOOL = pin.SE3(np.eye(3), np.array([0.05, 0.02, 0.10]))


def column(rng: np.random.Generator) -> Arm:
    """A six-axis arm on a lift."""
    lift = (Step("tz", 0.2, 0, name="lift"),)
    moved = tuple(replace(s, joint=None if s.joint is None else s.joint + 1) for s in ur10().steps)
    return replace(with_bodies(replace(ur10(), steps=lift + moved, n=7), rng), limits=(-1.2, 1.2))


def seven(rng: np.random.Generator) -> Arm:
    return with_bodies(some_arm(np.random.default_rng(11), 7), rng)


ARMS: dict[str, Callable[[np.random.Generator], Arm]] = {
    "ur10": lambda rng: with_bodies(ur10(), rng),
    "seven axes": seven,
    "on a lift": column,
    "small ranges": lambda rng: replace(with_bodies(ur10(), rng), limits=(-0.3, 0.3)),
}


@cache
def campaign(arm: str, see: str = "position", poses: int = 60) -> tuple[Robot, Arm, Observations]:
    """A robot as drawn, as it is (errors no drawing has, an unknown place and tool), and what was seen of it."""
    rng = np.random.default_rng(3)
    drawn = ARMS[arm](rng)
    true = replace(with_hidden_errors(drawn, rng), base=some_pose(rng, 3.0), tool=TOOL * small_pose(rng, 0.02, 0.2))
    return (
        robot_from_document(drawn.document()), true, measured(true, joints(true, poses, rng), rng, 2e-5, see)
    )  # fmt: skip


def judged(robot: Robot, rows: Observations) -> tuple[dict[str, Any], ...]:
    return refuse_foreign(Calibration.nominal(robot), Measurement.from_observations(rows))


def accused(robot: Robot, rows: Observations) -> list[str]:
    with pytest.raises(ObservationError) as refused:
        judged(robot, rows)
    assert refused.value.code == "foreign_observations"
    assert "Remedy: " in refused.value.message
    looks: list[str] = refused.value.context["looks"]
    return looks


def wire(robot: Robot) -> Floats:
    return np.array([180.0 / np.pi if j.kind == "revolute" else 1e3 for j in robot.joints])


def columns(robot: Robot, rows: Observations, order: list[int]) -> Observations:
    """The rows with their joint columns in another order, as a file has them."""
    return replace(rows, q=(rows.q * wire(robot))[:, order] / wire(robot))


def told(rows: Observations, change: Callable[[Floats], Floats]) -> Observations:
    """The rows with other points."""
    if rows.markers is not None:
        return replace(rows, markers=change(rows.markers))
    assert rows.position is not None
    return replace(rows, position=change(rows.position))


@pytest.mark.parametrize("arm", ARMS)
@pytest.mark.parametrize("see", ["position", "pose", "markers"])
def test_a_real_arm_is_not_accused_and_costs_one_registration(
    arm: str, see: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_: object) -> None:
        raise AssertionError("the registration alone should do")

    monkeypatch.setattr(plausibility, "mix_ups", never)
    robot, _, rows = campaign(arm, see)
    assert judged(robot, rows) == ()


@spread("arm,pair", ARMS, [(0, 1), (1, 2), (2, 4), (3, 4), (0, 5)])
def test_two_joints_swapped(arm: str, pair: tuple[int, int]) -> None:
    robot, _, rows = campaign(arm)
    order = list(range(robot.n_joints))
    i, j = pair
    order[i], order[j] = j, i
    assert f"Joints {i + 1} and {j + 1} look swapped" in accused(robot, columns(robot, rows, order))


@spread("arm,order", ARMS, ["in reverse", "shifted"])
def test_joints_in_reverse_or_shifted_order(arm: str, order: str) -> None:
    robot, _, rows = campaign(arm)
    n = robot.n_joints
    if order == "in reverse":
        assert "The joints look to be in reverse order" in accused(robot, columns(robot, rows, list(range(n))[::-1]))
        return
    shifted = columns(robot, rows, [n - 1, *range(n - 1)])
    held = ", ".join(str(k) for k in (n, *range(1, n)))
    assert f"The columns of joints 1 to {n} look to hold joints {held}" in accused(robot, shifted)


@spread("arm,joint", ARMS, [0, 1, 4, 2])
def test_the_sign_of_a_joint(arm: str, joint: int) -> None:
    robot, _, rows = campaign(arm)
    turned = replace(rows, q=rows.q * np.where(np.arange(robot.n_joints) == joint, -1.0, 1.0))
    assert f"Joint {joint + 1} looks to count the other way round" in accused(robot, turned)


@spread("arm,which", ["ur10", "seven axes", "small ranges"], ["radians", "degrees", "one"])
def test_radians_and_degrees(arm: str, which: str) -> None:
    robot, _, rows = campaign(arm)
    one = np.where(np.arange(robot.n_joints) == 2, np.pi / 180.0, 1.0)
    times, sentence = {
        "radians": (np.pi / 180.0, "Joints look like radians declared as degrees"),
        "degrees": (180.0 / np.pi, "Joints look like degrees declared as radians"),
        "one": (one, "Joint 3 looks like radians declared as degrees"),
    }[which]
    assert sentence in accused(robot, replace(rows, q=rows.q * times))


def test_a_lift_in_the_other_unit() -> None:
    robot, _, rows = campaign("on a lift")
    lift = np.where(np.arange(robot.n_joints) == 0, 1e3, 1.0)
    assert "Joint 1 looks like millimetres declared as metres" in accused(robot, replace(rows, q=rows.q * lift))


@spread(
    "arm,unit",
    ARMS,
    [
        (1e3, "millimetres declared as metres (factor 1000)"),
        (1e-3, "metres declared as millimetres (factor 1000)"),
        (1.0 / 0.0254, "inches declared as metres (factor 39.3701)"),
        (0.0254, "metres declared as inches (factor 39.3701)"),
        (1.0 / 25.4, "inches declared as millimetres (factor 25.4)"),
        (25.4, "millimetres declared as inches (factor 25.4)"),
    ],
)
def test_units_of_length(arm: str, unit: tuple[float, str]) -> None:
    times, sentence = unit
    robot, _, rows = campaign(arm)
    assert f"Positions look like {sentence}" in accused(robot, told(rows, lambda p: p * times))


@spread("arm,degrees", ["ur10", "seven axes", "on a lift"], [90, -90, 180])
def test_the_zero_of_a_joint(arm: str, degrees: int) -> None:
    robot, _, rows = campaign(arm)
    off = np.where(np.arange(robot.n_joints) == 2, np.radians(degrees), 0.0)
    assert f"The zero of joint 3 looks {degrees} degrees off" in accused(robot, replace(rows, q=rows.q - off))


def test_two_mix_ups_together() -> None:
    robot, _, rows = campaign("ur10")
    both = told(columns(robot, rows, [0, 2, 1, 3, 4, 5]), lambda p: p * 1e3)
    (looks, *_) = accused(robot, both)
    assert "Positions look like millimetres declared as metres (factor 1000), and joints 2 and 3 look swapped" in looks
    off = np.radians([0.0, 90.0, 0.0, 90.0, 0.0, 0.0])
    (looks, *_) = accused(robot, replace(rows, q=rows.q - off))
    assert looks == "The zero of joint 2 looks 90 degrees off, and the zero of joint 4 looks 90 degrees off"


@spread("see,arm", ["position", "markers"], ["ur10", "seven axes", "small ranges"])
def test_left_handed_coordinates(see: str, arm: str) -> None:
    robot, _, rows = campaign(arm, see)
    for mirrored in (told(rows, lambda p: p * [1.0, -1.0, 1.0]), told(rows, lambda p: p[..., [1, 0, 2]])):
        assert any(s.startswith("The positions look left-handed") for s in accused(robot, mirrored))


def test_measurements_of_another_row() -> None:
    robot, _, rows = campaign("ur10")
    assert accused(robot, replace(rows, q=np.roll(rows.q, 1, axis=0))) == [
        "Each measurement looks to be of the joints one row below"
    ]
    assert accused(robot, replace(rows, q=rows.q[::-1])) == [
        "Joints and measurements look to be in opposite order of rows"
    ]


@spread("what,see", ["tool", "base"], ["position", "pose", "markers"])
def test_tool_or_base_changed_during_the_campaign(what: str, see: str) -> None:
    words = {"tool": "The tool looks changed", "base": "The base, or the instrument, looks changed"}[what]
    robot, true, rows = campaign("ur10", see)
    rng = np.random.default_rng(5)
    moved = pin.SE3(pin.exp3(np.array([0.0, 0.0, 0.1])), np.array([0.05, 0.0, 0.04]))
    other = replace(true, tool=true.tool * moved) if what == "tool" else replace(true, base=moved * true.base)
    late = measured(other, rows.q, rng, 2e-5, see)
    cut = 37
    (looks, *_) = accused(robot, Observations.concatenate([rows.select(slice(cut)), late.select(slice(cut, None))]))
    assert looks.startswith(words)
    row = int(looks.split(" row ")[1].split()[0])
    assert abs(row - (cut + 1)) <= 3


def test_a_session_with_swapped_columns() -> None:
    robot, _, rows = campaign("ur10")
    session = np.arange(len(rows)) % 3
    swapped = np.where((session == 1)[:, None], rows.q[:, [0, 2, 1, 3, 4, 5]], rows.q)
    assert "Joints 2 and 3 look swapped in session 1" in accused(robot, replace(rows, q=swapped, session=session))


TURNS = Rotation.from_matrix


@spread(
    "arm,convention",
    ["ur10", "seven axes"],
    [
        (lambda R: R.transpose(0, 2, 1), "The orientation looks transposed"),
        (lambda R: Rotation.from_quat(TURNS(R).as_quat()[:, [1, 2, 3, 0]]).as_matrix(), "in the order xyzw, read as wxyz"),
        (lambda R: Rotation.from_euler("ZXZ", TURNS(R).as_euler("ZYX")).as_matrix(), "look to be ZYX, read as ZXZ"),
        (lambda R: Rotation.from_euler("ZXZ", TURNS(R).as_euler("XYZ")).as_matrix(), "look to be XYZ, read as ZXZ"),
        (lambda R: Rotation.from_euler("ZXZ", TURNS(R).as_euler("xyz")).as_matrix(), "look to be roll, pitch, yaw"),
        (lambda R: Rotation.from_euler("XYZ", TURNS(R).as_euler("ZYX")).as_matrix(), "look to be ZYX, read as XYZ"),
        (lambda R: Rotation.from_euler("ZYX", TURNS(R).as_euler("ZXZ")).as_matrix(), "look to be ZXZ"),
        (lambda R: Rotation.from_euler("x", 90, degrees=True).as_matrix() @ R, "rotated by 90 degrees about x"),
    ],
)  # fmt: skip
def test_conventions_of_orientation(arm: str, convention: tuple[Callable[[Floats], Floats], str]) -> None:
    change, sentence = convention
    robot, _, rows = campaign(arm, "pose")
    assert any(sentence in s for s in accused(robot, replace(rows, rotation=change(rows.rotation))))


def test_a_joint_that_only_the_orientation_sees() -> None:
    """The last joint with the measured point on its axis."""
    rng = np.random.default_rng(8)
    true = replace(with_hidden_errors(ur10(), rng), tool=pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.1])))
    rows = measured(true, joints(true, 60, rng), rng, 2e-5, "pose")
    turned = replace(rows, q=rows.q * [1, 1, 1, 1, 1, -1])
    assert "Joint 6 looks to count the other way round" in accused(robot_from_document(ur10().document()), turned)


@pytest.mark.parametrize(("axis", "angle"), [("x", 90), ("-z", 90), ("y", 180)])
def test_a_tool_turned_by_a_right_angle_is_warned_about(axis: str, angle: int) -> None:
    rng = np.random.default_rng(9)
    sign = -1.0 if axis[0] == "-" else 1.0
    turn = Rotation.from_euler(axis[-1], sign * angle, degrees=True).as_matrix()
    true = replace(with_hidden_errors(ur10(), rng), tool=TOOL * pin.SE3(turn, np.zeros(3)))
    rows = measured(true, joints(true, 60, rng), rng, 2e-5, "pose")
    robot = robot_from_document(ur10(tool=TOOL).document())
    (warning,) = judged(robot, rows)
    assert (warning["code"], warning["angle_deg"]) == ("orientation_right_angle", angle)
    assert warning["axis"].lstrip("-") == axis[-1]
    assert axis == warning["axis"] or angle == 180
    straight = replace(with_hidden_errors(ur10(), rng), tool=TOOL)
    assert judged(robot, measured(straight, rows.q, rng, 2e-5, "pose")) == ()


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(k, marks=pytest.mark.slow) for k in range(2, 12))])
@pytest.mark.parametrize("kind", ["errors", "compliant", "drawn wrong", "few"])
def test_bad_arms_are_not_accused(seed: int, kind: str) -> None:
    """Errors of 20 mm, 30 to 60 mm of one compliance, joints 15 mm and 2 degrees from the drawing, few poses."""
    rng = np.random.default_rng(100 + seed)
    n = int(rng.choice([5, 6, 7]))
    drawn = replace(with_bodies(some_arm(rng, n, prismatic=seed % 3 == 0), rng), limits=(-1.0, 1.0))
    big = {"errors": (8e-3, 5e-3), "drawn wrong": (8e-3, 2e-2)}.get(kind, (5e-4, 1e-3))
    true = replace(with_hidden_errors(drawn, rng, *big), base=some_pose(rng, 3.0), tool=some_pose(rng, 0.3))
    q = joints(true, 14 if kind == "few" else 60, rng)
    rows = measured(true, bent(true, q, rng) if kind == "compliant" else q, rng, 2e-5, ("position", "pose")[seed % 2])
    judged(robot_from_document(drawn.document()), replace(rows, q=q))


def bent(arm: Arm, q: Floats, rng: np.random.Generator) -> Floats:
    """Joint angles when the joint that gravity works on most gives way, by up to 30 to 60 mm at the tool."""
    torque = arm.torques(q)
    lever = np.linalg.norm(arm.joint_jacobians(q)[:, :3], axis=1)
    joint = int(np.argmax(torque.std(axis=0) * lever.mean(axis=0)))
    largest = np.abs(lever[:, joint] * torque[:, joint]).max()
    out = q.copy()
    out[:, joint] += rng.uniform(0.03, 0.06) / largest * torque[:, joint]
    return np.asarray(out)


@cache
def blind(robot: str) -> tuple[Robot, Observations]:
    """A campaign of the blind benchmark with hidden effects: repeats, outliers, two loads."""
    case = next(c for c in cases(7, 25, (60,)) if c.hidden)
    made = generate(
        replace(case, robot=robot, hidden=(Hidden("axial_compliance", (1,)),), lam=(400.0,), undecidable=())
    )
    return robot_of(made), observations_of(made.columns)


@pytest.mark.parametrize("all_pairs", [False, pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.parametrize("robot", [pytest.param("katana", marks=pytest.mark.slow), "elbow", "seven"])
def test_campaigns_of_the_blind_benchmark(all_pairs: bool, robot: str) -> None:
    drawn, rows = blind(robot)
    n = drawn.n_joints
    assert judged(drawn, rows) == ()
    joints = range(n - 1)  # the last joint hardly moves the point
    for i, j in combinations(joints, 2) if all_pairs else pairwise(joints):
        order = list(range(n))
        order[i], order[j] = j, i
        assert f"Joints {i + 1} and {j + 1} look swapped" in accused(drawn, columns(drawn, rows, order))
    for i in joints if all_pairs else joints[::2]:
        turned = replace(rows, q=rows.q * np.where(np.arange(n) == i, -1.0, 1.0))
        assert any(f"oint {i + 1} looks to count the other way round" in s for s in accused(drawn, turned))


@pytest.mark.parametrize("name", WITH_TOOL)
def test_real_campaigns_are_not_accused(shared_data: Any, name: str) -> None:
    robot, rows = real_campaign(shared_data, name)
    assert {w["code"] for w in judged(robot, rows)} <= {"orientation_right_angle"}


@pytest.mark.parametrize("name", [pytest.param(WITH_TOOL[0], marks=pytest.mark.slow), *WITH_TOOL[1:]])  # two of one arm
def test_real_campaigns_with_a_mix_up_are(shared_data: Any, name: str) -> None:
    robot, rows = real_campaign(shared_data, name)
    n = robot.n_joints
    assert any("Joints 3 and 4 look swapped" in s
               for s in accused(robot, columns(robot, rows, [0, 1, 3, 2, *range(4, n)])))  # fmt: skip
    assert "Positions look like millimetres declared as metres (factor 1000)" in accused(
        robot, told(rows, lambda p: p * 1e3)
    )
    turned = replace(rows, q=rows.q * np.where(np.arange(n) == 2, -1.0, 1.0))
    assert "Joint 3 looks to count the other way round" in accused(robot, turned)


def test_identify_and_gap_refuse_before_any_fit() -> None:
    robot, _, rows = campaign("ur10")
    swapped = columns(robot, rows, [0, 2, 1, 3, 4, 5])
    for job in (identify, find_gap):
        with pytest.raises(ObservationError, match="Joints 2 and 3 look swapped") as refused:
            job(robot, swapped)
        assert refused.value.code == "foreign_observations"
        assert refused.value.context["before_mm"] > 100 * refused.value.context["after_mm"]
