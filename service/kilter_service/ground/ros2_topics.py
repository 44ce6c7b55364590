"""Which topics of ROS 2 belong to which robot, as the settings say it."""

from __future__ import annotations

import re
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

_TOPIC = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")


def checked_topic(topic: str) -> str:
    """Return ``topic`` when it is a full name of ROS 2, else raise ValueError naming the rule."""
    if not _TOPIC.fullmatch(topic):
        raise ValueError(f"{topic!r} is not a full topic name: write it as /arm_controller/joint_trajectory.")
    return topic


Topic = Annotated[str, AfterValidator(checked_topic)]


class RobotTopics(BaseModel):
    """Topics of one robot, each a pair: where the wanted joints come from, where the corrected ones go."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    joint_state: tuple[Topic, Topic] | None = Field(default=None, description="sensor_msgs/JointState")
    joint_trajectory: tuple[Topic, Topic] | None = Field(default=None, description="trajectory_msgs/JointTrajectory")
    joints: tuple[str, ...] = Field(default=(), description="joints in ROS, base to tool; default: the robot's own")

    @model_validator(mode="after")
    def _from_one_topic_to_another(self) -> RobotTopics:
        pairs = [pair for pair in (self.joint_state, self.joint_trajectory) if pair]
        if not pairs:
            raise ValueError("give joint_state or joint_trajectory as a pair of topics")
        if any(wanted == corrected for wanted, corrected in pairs):
            raise ValueError("wanted and corrected joints need different topics, or they would be corrected forever")
        return self
