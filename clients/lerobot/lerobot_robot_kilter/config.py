"""What ``--robot.type=kilter_so101`` is told: all that a follower is, and which version corrects it."""

from __future__ import annotations

from dataclasses import dataclass, fields

from lerobot.robots.config import RobotConfig
from lerobot.robots.so_follower import SO101FollowerConfig, SOFollowerConfig


@RobotConfig.register_subclass("kilter_so100")
@RobotConfig.register_subclass("kilter_so101")
@dataclass
class KilterSO101Config(RobotConfig, SOFollowerConfig):  # type: ignore[misc, unused-ignore]
    """An SO-100 or SO-101 follower and its robot at the Kilter server, which is found as the ``kilter`` command finds it."""

    # Name of the robot at the server.
    kilter_robot: str = ""
    # Id, beginning of an id or name of a version; None: the one that is active when the arm is connected.
    kilter_version: str | None = None
    # Correct although the server says that the controller does so already, or does not know.
    kilter_force: bool = False
    # How often actions come, per second: of your loop.
    kilter_fps: float = 30.0
    # How fast a correction may change, and over which time it comes in after connecting.
    kilter_rate_deg_s: float = 20.0
    kilter_ramp_s: float = 1.0

    @property
    def follower(self) -> SO101FollowerConfig:
        """The same arm as LeRobot's own."""
        own = {field.name: getattr(self, field.name) for field in fields(SO101FollowerConfig) if field.init}
        return SO101FollowerConfig(**own)
