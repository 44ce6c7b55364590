"""LeRobot's follower, corrected: it goes where it is told, and says where it is."""

from __future__ import annotations

import logging
from dataclasses import replace
from functools import cached_property
from typing import Any

from lerobot.robots.robot import Robot
from lerobot.robots.so_follower import SO101Follower

from kilter_client.errors import UsageError
from lerobot_robot_kilter.arm import CorrectedArm, Pace, fetch_used_version, refuse_other_calibration
from lerobot_robot_kilter.config import KilterSO101Config

log = logging.getLogger(__name__)


class KilterSO101(Robot):  # type: ignore[misc, unused-ignore]
    """A follower whose actions are corrected and whose observations are true.

    The arm is LeRobot's own ``so101_follower``, with its calibration and its cameras; it is ``self.follower``.
    """

    config_class = KilterSO101Config
    name = "kilter_so101"

    def __init__(self, config: KilterSO101Config) -> None:
        self.follower = SO101Follower(config.follower)
        super().__init__(replace(config, **{"calibration_dir": self.follower.calibration_dir}))
        self.config = config
        self.cameras = self.follower.cameras
        self.arm: CorrectedArm | None = None

    @property
    def bus(self) -> Any:
        """The bus of the servos, uncorrected."""
        return self.follower.bus

    @cached_property
    def observation_features(self) -> dict[str, Any]:
        """Those of the follower."""
        return dict(self.follower.observation_features)

    @cached_property
    def action_features(self) -> dict[str, Any]:
        """Those of the follower."""
        return dict(self.follower.action_features)

    @property
    def is_connected(self) -> bool:
        """Whether servos and cameras are connected."""
        return bool(self.follower.is_connected)

    @property
    def is_calibrated(self) -> bool:
        """Whether the servos hold the calibration of the file."""
        return bool(self.follower.is_calibrated)

    def connect(self, calibrate: bool = True) -> None:
        """Fetch the version, compare the calibration, and connect; nothing moves before.

        Raises:
            ConflictError: the version was measured with another calibration, none is active, or it would correct twice.

        """
        found = fetch_used_version(self.config.kilter_robot, self.config.kilter_version, self.config.kilter_force)
        refuse_other_calibration(found, self.calibration_fpath)
        self.follower.connect(calibrate)
        pace = Pace(self.config.kilter_fps, self.config.kilter_rate_deg_s, self.config.kilter_ramp_s)
        try:
            # Whoever calibrated anew while connecting has another arm now.
            self.arm = CorrectedArm(found, self.calibration_fpath, self.config.use_degrees, pace)
        except Exception:
            self.follower.disconnect()
            raise
        log.info("%s is corrected by version %s of robot %s", self, found.version_id, found.robot)

    def calibrate(self) -> None:
        """Calibrate the servos anew; the version that was measured before does not hold any more."""
        self.follower.calibrate()

    def configure(self) -> None:
        """Configure the servos."""
        self.follower.configure()

    def get_observation(self) -> dict[str, Any]:
        """Return true joints, and what the cameras see."""
        return self._connected_arm().true_observation(self.follower.get_observation())

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Correct an action and send it; returns what was sent, perhaps clipped, in joints as they were wanted."""
        arm = self._connected_arm()
        return arm.sent(self.follower.send_action(arm.command(action)))

    def disconnect(self) -> None:
        """Disconnect servos and cameras."""
        self.follower.disconnect()
        self.arm = None

    def _connected_arm(self) -> CorrectedArm:
        if self.arm is None:
            raise UsageError(f"{self} is not connected: call connect() first.")
        return self.arm
