"""The same as steps of a LeRobot pipeline, for scripts that make their own loop around an arm."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lerobot.processor import ObservationProcessorStep, ProcessorStepRegistry, RobotActionProcessorStep

from lerobot_robot_kilter.arm import CorrectedArm, Pace, fetch_used_version


@dataclass
class _OfVersion:
    """A step made by a version: the robot's name at the server, the file of the servos' calibration, the version.

    Without ``version`` the one that is active when the step is made.
    """

    robot: str
    calibration: str
    version: str | None = None
    use_degrees: bool = True
    force: bool = False
    fps: float = 30.0
    rate_deg_s: float = 20.0
    ramp_s: float = 1.0
    arm: CorrectedArm = field(init=False, repr=False)

    def __post_init__(self) -> None:
        found = fetch_used_version(self.robot, self.version, self.force)
        pace = Pace(self.fps, self.rate_deg_s, self.ramp_s)
        self.arm = CorrectedArm(found, Path(self.calibration), self.use_degrees, pace)
        self.version = found.version_id

    def get_config(self) -> dict[str, Any]:
        """What makes the step again; the version by its id."""
        return {
            name: value
            for name, value in vars(self).items()
            if name in _OfVersion.__dataclass_fields__ and name != "arm"
        }

    def reset(self) -> None:
        """Forget the past, as between episodes: the correction comes in anew."""
        self.arm.reset_correction()

    def transform_features(self, features: Any) -> Any:
        """Features stay what they are."""
        return features


@ProcessorStepRegistry.register("kilter_correct_action")
@dataclass
class KilterCorrectAction(_OfVersion, RobotActionProcessorStep):  # type: ignore[misc, unused-ignore]
    """Corrects actions on their way to the arm."""

    def action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Return the action corrected."""
        return self.arm.command(action)


@ProcessorStepRegistry.register("kilter_true_joints")
@dataclass
class KilterTrueJoints(_OfVersion, ObservationProcessorStep):  # type: ignore[misc, unused-ignore]
    """Makes true joints of what the servos read."""

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Return the observation with true joints."""
        return self.arm.true_observation(observation)
