"""A forearm that is read against the horizontal, in a URDF: poses by a walk through the file that shares nothing with it."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from kilter_files.ground.errors import UsageError
from kilter_files.robots.read import Described, read_robot

Floats = NDArray[np.float64]
URDF = """<robot name="r">
<link name="base"/><link name="a"/><link name="b"/><link name="c"/><link name="d"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="a"/><origin xyz="0 0 0.3" rpy="0 0 0.2"/>
  <axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<joint name="j2" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0.05 0 0" rpy="0.4 0 0"/>
  <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
<joint name="j3" type="revolute"><parent link="b"/><child link="c"/><origin xyz="0 0 0.44" rpy="0 0.7 0"/>
  <axis xyz="0 {sign} 0"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
<joint name="tip" type="fixed"><parent link="c"/><child link="d"/><origin xyz="0.3 0.1 0.05" rpy="0 0 0"/></joint>
</robot>"""


def tip_pose(text: str, q: dict[str, float]) -> Floats:
    """The pose (4, 4) of link d in link base; mimic joints as the URDF states them."""
    joints = {joint.find("child").get("link"): joint for joint in ElementTree.fromstring(text).findall("joint")}
    pose, link = np.eye(4), "d"
    while link != "base":
        joint = joints[link]
        here = np.eye(4)
        origin, axis, mimic = joint.find("origin"), joint.find("axis"), joint.find("mimic")
        if origin is not None:
            here[:3, 3] = np.array(origin.get("xyz").split(), dtype=float)
            here[:3, :3] = Rotation.from_euler("xyz", np.array(origin.get("rpy").split(), dtype=float)).as_matrix()
        if joint.get("type") != "fixed":
            value = q[joint.get("name")] if mimic is None else float(mimic.get("multiplier")) * q[mimic.get("joint")]
            turned = np.eye(4)
            turned[:3, :3] = Rotation.from_rotvec(value * np.array(axis.get("xyz").split(), dtype=float)).as_matrix()
            here = here @ turned
        pose, link = here @ pose, joint.find("parent").get("link")
    return pose


@pytest.mark.parametrize("sign", [1, -1])
def test_a_forearm_keeps_its_orientation_while_the_lower_arm_moves(tmp_path: Path, sign: int) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(URDF.format(sign=sign))
    made = read_robot(path, Described("r", follows=["j3 = j2"]))["urdf"]
    for j1, j2, read in np.random.default_rng(2 + sign).uniform(-1.5, 1.5, (5, 3)):
        drawn = tip_pose(path.read_text(), {"j1": j1, "j2": j2, "j3": read - sign * j2})
        assert tip_pose(made, {"j1": j1, "j2": j2, "j3": read}) == pytest.approx(drawn, abs=1e-12)
        held = tip_pose(made, {"j1": j1, "j2": 0.0, "j3": read})
        assert tip_pose(made, {"j1": j1, "j2": j2, "j3": read})[:3, :3] == pytest.approx(held[:3, :3], abs=1e-12)


@pytest.mark.parametrize(
    ("follows", "said"),
    [
        ("j3=j1", "must come after and be parallel to j1's"),
        ("j2=j3", "must come after and be parallel to j3's"),
        ("tip=j2", "must come after and be parallel to j2's"),
        ("j4=j2", "There is no joint 'j4'. There are: j1, j2"),
        ("j3=j2:linkage", "Leave linkage out, or make a chain of the file first with `kilter robot convert`"),
    ],
)
def test_couplings_that_a_urdf_cannot_have(tmp_path: Path, follows: str, said: str) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(URDF.format(sign=1))
    with pytest.raises(UsageError, match=said):
        read_robot(path, Described("r", follows=[follows]))


def test_a_turned_joint_of_a_urdf_is_refused_with_the_remedy(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(URDF.format(sign=1))
    with pytest.raises(UsageError, match="reverse the axis of the joint instead"):
        read_robot(path, Described("r", turned=["j3"]))
