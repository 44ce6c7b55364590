"""What a URDF says beside its geometry: mimics of mimics, limits, zero offsets of drivers, joints that hold nothing."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import RobotError
from kilter_core.model import RobotModel
from kilter_core.observations import Observations
from kilter_service.robots.documents import core_document
from kilter_service.robots.importers.urdf import chain_document

LIMIT = '<limit lower="-2" upper="2.5" effort="1" velocity="1"/>'


def joint(k: int, more: str = LIMIT, kind: str = "revolute") -> str:
    return (
        f'<joint name="j{k}" type="{kind}"><parent link="l{k - 1}"/><child link="l{k}"/><origin xyz="0.1 0 0.3"/>'
        f'<axis xyz="0 {k % 2} {1 - k % 2}"/>{more}</joint>'
    )


def arm(*joints: str, more: str = "", links: int = 8) -> str:
    names = "".join(f'<link name="l{k}"><inertial><mass value="2"/></inertial></link>' for k in range(links))
    return f'<robot name="r">{names}{"".join(joints)}{more}</robot>'


def mimic(of: str, multiplier: float, offset: float = 0.0) -> str:
    return f'{LIMIT}<mimic joint="{of}" multiplier="{multiplier}" offset="{offset}"/>'


def notes(*joints: str, more: str = "") -> list[str]:
    posted = {"name": "r", "convention": "urdf", "urdf": arm(*joints, more=more), "base_link": "l0", "tip_link": "l3"}
    return core_document(posted).notes


def tip(angles: list[float]) -> np.ndarray:
    """Position of the last link by the angles of all joints."""
    turn, at = Rotation.identity(), np.zeros(3)
    for k, angle in enumerate(angles, 1):
        at = at + turn.apply([0.1, 0.0, 0.3])
        turn = turn * Rotation.from_rotvec(angle * np.array([0, k % 2, 1 - k % 2]))
    return at + turn.apply(np.zeros(3))


@pytest.mark.parametrize(
    ("third", "fourth"), [(("j2", -1.0, 0.1), ("j3", 0.5, -0.05)), (("j4", 2.0, 0.2), ("j1", -0.3, 0.1))]
)
def test_a_mimic_of_a_mimic_follows_the_joint_at_the_end(
    third: tuple[str, float, float], fourth: tuple[str, float, float]
) -> None:
    text = arm(joint(1), joint(2), joint(3, mimic(*third)), joint(4, mimic(*fourth)), joint(5))
    robot = robot_from_document(chain_document(text, "l0", "l5", "r").document)
    assert sorted(one.name for one in robot.joints) == ["j1", "j2", "j5"]
    q = {one.name: value for one, value in zip(robot.joints, (0.4, -0.7, 1.1), strict=True)}
    rules = {"j3": third, "j4": fourth}

    def angle(name: str) -> float:
        return rules[name][1] * angle(rules[name][0]) + rules[name][2] if name in rules else q[name]

    model = RobotModel(robot)
    found = model.predict(Observations(np.array([[q[one.name] for one in robot.joints]])), model.values0()).position[0]
    np.testing.assert_allclose(found, tip([angle(f"j{k}") for k in range(1, 6)]), atol=1e-12)


@pytest.mark.parametrize(
    ("second", "third", "said"),
    [
        (LIMIT, mimic("end", 1.0), "joint j3 mimics 'end', which is fixed"),
        (LIMIT, mimic("j3", 1.0), "joint j3 mimics 'j3', which is itself"),
        (mimic("j3", 1.0), mimic("j2", 1.0), "joint j. mimics 'j.', which follows it in turn"),
        (LIMIT, mimic("nobody", 1.0), "joint j3 mimics 'nobody', which is not in the URDF"),
    ],
)
def test_a_mimic_of_nothing_that_moves_is_refused_by_name(second: str, third: str, said: str) -> None:
    end = '<joint name="end" type="fixed"><parent link="l3"/><child link="l4"/></joint>'
    with pytest.raises(RobotError, match=said):
        chain_document(arm(joint(1), joint(2, second), joint(3, third), more=end), "l0", "l3", "r")


def test_zero_offsets_and_soft_limits_that_are_not_used_are_named() -> None:
    calibrated = joint(2, LIMIT + '<calibration rising="0.0898604"/>')
    soft = joint(3, LIMIT + '<safety_controller soft_lower_limit="-1" soft_upper_limit="1" k_velocity="10"/>')
    offset, range_ = notes(joint(1, LIMIT + '<calibration rising="0.0"/>'), calibrated, soft)
    assert offset.startswith("j2: <calibration> (rising 5.14862 deg) is not used")
    assert range_.startswith("j3: soft limits of its <safety_controller> (lower -57.2958 deg, upper 57.2958 deg)")


@pytest.mark.parametrize(
    ("lower", "upper", "said"),
    [
        ("1.5", "-1.5", "swapped (lower 85.9437 deg"),
        ("-inf", "2", "one side only"),
        ("-inf", "inf", None),
        ("-INF", "1e999", None),
    ],
)
def test_infinite_limits_are_none_and_swapped_ones_are_named(lower: str, upper: str, said: str | None) -> None:
    limit = f'<limit lower="{lower}" upper="{upper}" effort="1" velocity="1"/>'
    found = notes(joint(1), joint(2, limit), joint(3))
    assert len(found) == (said is not None)
    assert said is None or (found[0].startswith("j2: ") and said in found[0])
    document = chain_document(arm(joint(1), joint(2, limit), joint(3)), "l0", "l3", "r").document
    assert "limits_deg" not in document["joints"][1]


def test_a_limit_that_is_no_number_is_refused() -> None:
    with pytest.raises(RobotError, match="joint j2: lower='nan' is not 1 numbers"):
        chain_document(arm(joint(1), joint(2, LIMIT.replace("-2", "nan")), joint(3)), "l0", "l3", "r")


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_joints_that_hold_nothing_matter_only_within_the_chain(kind: str) -> None:
    root = f'<joint name="root" type="{kind}"><parent link="l6"/><child link="l0"/></joint>'
    carried = f'<joint name="carried" type="{kind}"><parent link="l3"/><child link="l7"/></joint>'
    text = arm(joint(1), joint(2), joint(3), more=root + carried)
    document = chain_document(text, "l0", "l3", "r").document
    assert document == chain_document(arm(joint(1), joint(2), joint(3)), "l0", "l3", "r").document
    assert notes(joint(1), joint(2), joint(3), more=root + carried) == [
        f"carried is {kind}: what hangs on it is not part of the arm"
    ]
    with pytest.raises(RobotError, match=f"joint root is '{kind}' and lies between 'l6' and 'l3'"):
        chain_document(text, "l6", "l3", "r")


def tip_of(text: str) -> np.ndarray:
    model = RobotModel(robot_from_document(chain_document(text, "l0", "l3", "r").document))
    q = np.array([[0.4, -0.7, 1.1]])
    return model.predict(Observations(q), model.values0()).position[0]


def test_a_quaternion_says_an_origin_as_well_as_angles_do() -> None:
    yaw, pitch, roll = 0.3, float(np.pi / 2), -0.2
    turned = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    origin = '<origin xyz="0.1 0 0.3"/>'
    ways = [f'rpy="{roll!r} {pitch!r} {yaw!r}"', f'quat_xyzw="{" ".join(map(str, turned.as_quat()))}"']
    plain = arm(joint(1), joint(2), joint(3))
    texts = [plain.replace(origin, f'<origin xyz="0.1 0 0.3" {way}/>') for way in (*ways, " ".join(ways))]
    found = [tip_of(text) for text in texts]
    np.testing.assert_allclose(found[1:], [found[0]] * 2, atol=1e-12)
    assert np.linalg.norm(found[0] - tip_of(plain)) > 0.1


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ('quat_xyzw="0 0 0 0.5"', "joint j1: quat_xyzw has a length other than 1"),
        ('quat_xyzw="0 0 1"', "joint j1: quat_xyzw='0 0 1' is not 4 numbers"),
        ('quat_xyzw="0 0 0 1" rpy="0 0 0.1"', "joint j1: rpy and quat_xyzw are two rotations"),
    ],
)
def test_a_quaternion_that_cannot_be_is_refused(given: str, said: str) -> None:
    with pytest.raises(RobotError, match=said):
        tip_of(arm(joint(1), joint(2), joint(3)).replace('<origin xyz="0.1 0 0.3"/>', f"<origin {given}/>"))
