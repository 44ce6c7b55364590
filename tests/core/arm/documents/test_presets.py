"""Presets against outside descriptions of the same arms: joints of public URDF files, put together by Pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document, preset_names
from kilter_core.model import Calibration
from kilter_core.observations import Observations

Floats = NDArray[np.float64]
Origin = tuple[float, float, float, float, float, float]  # x, y, z m and roll, pitch, yaw rad: Rz Ry Rx
HALF = np.pi / 2

# Origin of each joint, its axis, and the flange behind the last, as the arms' URDF files have them: ur_description of
# Universal Robots (default kinematics), franka_description, iiwa_stack, kuka_experimental and abb of ROS-Industrial.
Z = (0.0, 0.0, 1.0)
Joints = list[tuple[Origin, tuple[float, float, float]]]


def ur(d1: float, a2: float, a3: float, d4: float, d5: float, d6: float) -> tuple[Joints, Origin]:
    origins: list[Origin] = [
        (0, 0, d1, 0, 0, 0), (0, 0, 0, HALF, 0, 0), (a2, 0, 0, 0, 0, 0), (a3, 0, d4, 0, 0, 0), (0, -d5, 0, HALF, 0, 0),
        (0, d6, 0, HALF, np.pi, np.pi),
    ]  # fmt: skip
    return [(origin, Z) for origin in origins], (0, 0, 0, 0, 0, 0)


ARMS: dict[str, tuple[Joints, Origin]] = {
    "ur3e": ur(0.15185, -0.24355, -0.2132, 0.13105, 0.08535, 0.0921),
    "ur5e": ur(0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
    "ur10e": ur(0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
    "panda": (
        [
            ((0, 0, 0.333, 0, 0, 0), Z), ((0, 0, 0, -HALF, 0, 0), Z), ((0, -0.316, 0, HALF, 0, 0), Z),
            ((0.0825, 0, 0, HALF, 0, 0), Z), ((-0.0825, 0.384, 0, -HALF, 0, 0), Z), ((0, 0, 0, HALF, 0, 0), Z),
            ((0.088, 0, 0, HALF, 0, 0), Z),
        ],
        (0, 0, 0.107, 0, 0, 0),
    ),
    "iiwa14": (
        [
            ((0, 0, 0.1575, 0, 0, 0), Z), ((0, 0, 0.2025, HALF, 0, np.pi), Z), ((0, 0.2045, 0, HALF, 0, np.pi), Z),
            ((0, 0, 0.2155, HALF, 0, 0), Z), ((0, 0.1845, 0, -HALF, np.pi, 0), Z), ((0, 0, 0.2155, HALF, 0, 0), Z),
            ((0, 0.081, 0, -HALF, np.pi, 0), Z),
        ],
        (0, 0, 0.045, np.pi, np.pi, np.pi),
    ),
    "kr6-r900": (
        [
            ((0, 0, 0.4, 0, 0, 0), (0, 0, -1)), ((0.025, 0, 0, 0, 0, 0), (0, 1, 0)), ((0.455, 0, 0, 0, 0, 0), (0, 1, 0)),
            ((0, 0, 0.035, 0, 0, 0), (-1, 0, 0)), ((0.42, 0, 0, 0, 0, 0), (0, 1, 0)), ((0.08, 0, 0, 0, 0, 0), (-1, 0, 0)),
        ],
        (0, 0, 0, 0, HALF, 0),
    ),
    "irb120": (
        [
            ((0, 0, 0, 0, 0, 0), Z), ((0, 0, 0.29, 0, 0, 0), (0, 1, 0)), ((0, 0, 0.27, 0, 0, 0), (0, 1, 0)),
            ((0, 0, 0.07, 0, 0, 0), (1, 0, 0)), ((0.302, 0, 0, 0, 0, 0), (0, 1, 0)), ((0.072, 0, 0, 0, 0, 0), (1, 0, 0)),
        ],
        (0, 0, 0, 0, HALF, 0),
    ),
    # SO-ARM100's so101_new_calib.urdf, so101_leader_new_calib.urdf and so100.urdf, whose right angles are rounded to five
    # digits, and the model of the Koch arm in the MuJoCo menagerie
    "so101": (
        [
            ((0.0207909, -0.0230745, 0.0948817, -np.pi, 0, HALF), Z), ((-0.0303992, -0.0182778, -0.0542, -HALF, -HALF, 0), Z),
            ((-0.11257, -0.028, 0, 0, 0, HALF), Z), ((-0.1349, 0.0052, 0, 0, 0, -HALF), Z),
            ((0, -0.0611, 0.0181, HALF, 0, np.pi), Z),
        ],
        (-0.0079, -0.000218121, -0.0981274, HALF, 0, HALF),
    ),
    "so101-leader": (
        [
            ((0.0388353, -8.97657e-09, 0.0624, np.pi, 0, -np.pi), Z), ((-0.0303992, -0.0182778, -0.0542, -HALF, -HALF, 0), Z),
            ((-0.11257, -0.028, 0, 0, 0, HALF), Z), ((-0.1349, 0.0052, 0, 0, 0, -HALF), Z),
            ((0, -0.0611, 0.0181, HALF, 0.0486795, np.pi), Z),
        ],
        (-0.04883983673, 4.24709659e-07, -0.06746695884, 0, np.pi, 0),
    ),
    "so100": (
        [
            ((0, -0.0452, 0.0165, HALF, 0, 0), (0, 1, 0)), ((0, 0.1025, 0.0306, -1.8, 0, 0), (1, 0, 0)),
            ((0, 0.11257, 0.028, HALF, 0, 0), (1, 0, 0)), ((0, 0.0052, 0.1349, -1, 0, 0), (1, 0, 0)),
            ((0, -0.0601, 0, 0, HALF, 0), (0, 1, 0)),
        ],
        (0, 0, 0, 0, 0, 0),
    ),
    "koch": (
        [
            ((0.012, 0, 0.0409, 0, 0, 0), (0, 0, -1)), ((0, -0.0209, 0.0154, 0, 0, 0), (0, 1, 0)),
            ((-0.0148, 0.0065, 0.1083, 0, 0, 0), (0, -1, 0)), ((-0.10048, 5e-05, 0.0026999, 0, 0, 0), (0, 1, 0)),
            ((-0.045, 0.013097, 0, 0, 0, 0), (1, 0, 0)),
        ],
        (0, 0, 0, 0, 0, 0),
    ),
}  # fmt: skip

ARMS["lekiwi"] = ARMS["so101"]  # LeKiwi carries an SO-101

# Limits (deg) of the data sheets, and the mass (kg) of the moving links where there is a public one.
LIMITS = {
    "ur3e": [(-360, 360)] * 6, "ur5e": [(-360, 360)] * 6, "ur10e": [(-360, 360)] * 6,
    "panda": [(-166, 166), (-101, 101), (-166, 166), (-176, -4), (-166, 166), (-1, 215), (-166, 166)],
    "iiwa14": [(-170, 170), (-120, 120)] * 3 + [(-175, 175)],
    "kr6-r900": [(-170, 170), (-190, 45), (-120, 156), (-185, 185), (-120, 120), (-350, 350)],
    "irb120": [(-165, 165), (-110, 110), (-110, 70), (-160, 160), (-120, 120), (-400, 400)],
    "so101": [(-109.9999, 109.9999), (-100, 100), (-96.8299, 96.8299), (-94.9998, 94.9998), (-160.0002, 160.0002)],
    "so101-leader": [(-109.9999, 109.9999), (-100, 100), (-96.8299, 96.8299), (-94.9998, 94.9998), (-157.211, 162.7893)],
    "so100": [(-114.5916, 114.5916), (0, 200.5352), (-179.9993, 0), (-143.2394, 68.7549), (-179.9993, 179.9993)],
    "koch": [(-126.0507, 126.0507), (-89.9544, 34.3775), (-89.9544, 83.0789), (-114.5916, 114.5916), (-179.9087, 179.9087)],
}  # fmt: skip
LIMITS["lekiwi"] = LIMITS["so101"]
MASSES = {"ur3e": 8.7985, "ur5e": 17.7, "ur10e": 29.104, "panda": 16.062, "iiwa14": 0.0, "kr6-r900": 0.0, "irb120": 0.0,
          "so101": 0.485, "so101-leader": 0.51, "so100": 0.609, "koch": 0.226, "lekiwi": 0.485}  # fmt: skip


def placed(origin: Origin) -> pin.SE3:
    return pin.SE3(pin.rpy.rpyToMatrix(*origin[3:]), np.array(origin[:3], dtype=float))


def outside(name: str, q: Floats) -> tuple[Floats, Floats]:
    """Flange positions and turns of the URDF's arm."""
    joints, flange = ARMS[name]
    model, parent = pin.Model(), 0
    for k, (origin, axis) in enumerate(joints):
        parent = model.addJoint(
            parent, pin.JointModelRevoluteUnaligned(np.array(axis, dtype=float)), placed(origin), f"j{k}"
        )
    data, poses = model.createData(), []
    for row in q:
        pin.forwardKinematics(model, data, row)
        poses.append((data.oMi[parent] * placed(flange)).homogeneous)
    out = np.array(poses)
    return out[:, :3, 3], out[:, :3, :3]


@pytest.mark.parametrize("name", ARMS)
def test_the_flange_is_where_the_public_urdf_has_it(name: str) -> None:
    robot = robot_from_document(preset_document(name))
    q = np.random.default_rng(5).uniform(*robot.limits.T, (50, robot.n_joints))
    found = Calibration.nominal(robot).predict(Observations(q))
    position, rotation = outside(name, q)
    assert np.abs(found.position - position).max() < 1e-9
    assert np.abs(found.rotation - rotation).max() < 1e-9


@pytest.mark.parametrize("name", ARMS)
def test_limits_masses_and_source_are_stated(name: str) -> None:
    document = preset_document(name)
    robot = robot_from_document(document)
    np.testing.assert_allclose(np.degrees(robot.limits), LIMITS[name], atol=1e-9)
    assert sum(link.mass for link in robot.links) == pytest.approx(MASSES[name], abs=1e-3)
    assert len(document["source"]) > 40
    assert document["name"] == name


def test_every_preset_has_a_source_and_says_its_own_name() -> None:
    assert set(ARMS) < set(preset_names())
    for name in preset_names():
        document = preset_document(name)
        assert (document["name"], bool(document["source"])) == (name, True)


def test_joints_of_lekiwi_are_named_as_its_calibration_names_the_servos() -> None:
    # lerobot/robots/lekiwi/lekiwi.py: one bus for arm and wheels, so the arm's servos carry a prefix
    servos = ["arm_shoulder_pan", "arm_shoulder_lift", "arm_elbow_flex", "arm_wrist_flex", "arm_wrist_roll"]
    assert [joint["name"] for joint in preset_document("lekiwi")["joints"]] == servos
