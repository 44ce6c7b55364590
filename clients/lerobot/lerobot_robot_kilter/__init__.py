"""A LeRobot follower that goes where it is told: ``--robot.type=kilter_so101``.

LeRobot imports this package by itself, because its name begins with ``lerobot_robot_``.
"""

from lerobot_robot_kilter.config import KilterSO101Config
from lerobot_robot_kilter.follower import KilterSO101
from lerobot_robot_kilter.steps import KilterCorrectAction, KilterTrueJoints

__all__ = ["KilterCorrectAction", "KilterSO101", "KilterSO101Config", "KilterTrueJoints"]
