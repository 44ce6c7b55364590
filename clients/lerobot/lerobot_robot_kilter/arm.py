"""Actions corrected by a version, and the true joints of what servos read: numbers as LeRobot has them, radians inside.

The true joints are those at which the nominal arm has its tool where the real one has it: what the correction undoes. So
an arm that has arrived observes what it was told.

The version that corrects an arm, from the server; and whether the arm's servos are still those it was measured with.
"""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kilter_client import Kilter
from kilter_client.bridges import correction
from kilter_client.bridges.correction import Correction, Guard
from kilter_client.errors import ConflictError, FileError, UsageError
from kilter_core.correct import LARGEST, OK, Stored, from_bytes
from kilter_files.formats import BY_RANGE, DEGREES, TICK_DEG, read_calibration, servo_name_for_joint
from kilter_files.ground import Floats

POSITION = ".pos"
REVERSAL_RAD = math.radians(1.5 * TICK_DEG)  # a servo that holds still reads either of two ticks
ROUNDS, NEAR_RAD = 12, 1e-7
SLOWEST = 1000  # cycles that a pause counts as at most


@dataclass(frozen=True)
class Pace:
    """How often actions come, how fast a correction may change, and over which time it comes in."""

    fps: float = 30.0
    rate_deg_s: float = 20.0
    ramp_s: float = 1.0


class CorrectedArm:
    """One arm: its version, the numbers of its servos, and what it has done until now.

    Args:
        found: the version.
        calibration: the file with the zeros of its servos.
        use_degrees: whether numbers are degrees, as ``use_degrees`` of LeRobot's configuration says, or parts of the range.
        pace: of the loop that sends actions.
        clock: seconds that never go back.

    Raises:
        ConflictError: the version is of another robot, or was measured with another calibration.
        FileError: the calibration is missing, is none, or has no servo for a joint.

    """

    def __init__(
        self,
        found: Used,
        calibration: Path,
        use_degrees: bool = True,
        pace: Pace = Pace(),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        refuse_other_calibration(found, calibration)
        self._servos = read_calibration(calibration)
        self._mode = DEGREES if use_degrees else BY_RANGE
        self.names = tuple(servo_name_for_joint(self._servos, joint) for joint in found.joints)
        self._program = found.stored.program
        n = self._program.n_joints
        rows = slice(self._program.moves + 1, self._program.moves + 1 + n)
        largest = float(self._program.array[rows, LARGEST].max())
        self._cycle_s, self._clock = 1.0 / pace.fps, clock
        guard = Guard(n, largest, math.radians(pace.rate_deg_s), pace.ramp_s, self._cycle_s)
        self._correction = Correction(found.stored, found.robot, guard, self._cycle_s)
        if self._correction.off:
            raise ConflictError(f"{self._correction.off}: activate a version of this robot.", code="foreign_version")
        self.reset_correction()

    def reset_correction(self) -> None:
        """Forget the past: the correction comes in anew."""
        self._correction.reset_to_zero()
        self._answered_s: float | None = None
        self._turned = self._side = np.zeros(0)
        self._known = np.zeros(self._program.n_joints)

    @property
    def state(self) -> dict[str, Any]:
        """What it does now: version, share that has come in, offsets, refused actions by their reason."""
        return self._correction.document()

    def command(self, action: Mapping[str, Any]) -> dict[str, Any]:
        """Return an action corrected, to the nearest tick; the gripper stays as it is.

        Raises:
            UsageError: a joint has no number: the correction of one depends on all.

        """
        wanted = self._angles(action, "action")
        now = self._clock()
        cycles = 1 if self._answered_s is None else round((now - self._answered_s) / self._cycle_s)
        self._answered_s = now
        offset = np.array(self._correction.step(wanted.tolist(), min(max(cycles, 1), SLOWEST)))
        # LeRobot cuts ticks off; with half a tick more it rounds.
        return dict(action) | self._numbers(wanted + offset, 0.5)

    def sent(self, action: Mapping[str, Any]) -> dict[str, Any]:
        """Return what was sent, perhaps clipped, as the action that it corrects."""
        offset = np.array(self._correction.offset)
        return dict(action) | self._numbers(self._angles(action, "action") - offset, -0.5)

    def true_observation(self, observation: Mapping[str, Any]) -> dict[str, Any]:
        """Return an observation with true joints; pictures and the gripper stay as they are."""
        reading = self._angles(observation, "observation")
        side = self._sides(reading)
        q = reading - self._known
        for _ in range(ROUNDS):
            told = self._program.correct_rows(q[None], direction=side[None])
            if told.status[0] != OK:  # outside the joint limits: the last offset goes on
                return dict(observation) | self._numbers(reading - self._known, 0.0)
            left = reading - told.q[0]
            q = q + left
            if np.abs(left).max() < NEAR_RAD:
                break
        self._known = reading - q
        return dict(observation) | self._numbers(q, 0.0)

    def _sides(self, reading: Floats) -> Floats:
        """Direction of the last motion of each joint, -1, 0 or 1, as its readings show it."""
        if not len(self._turned):
            self._turned, self._side = reading.copy(), np.zeros(len(reading))
        moved = reading - self._turned
        turned = np.abs(moved) > REVERSAL_RAD
        self._side = np.where(turned, np.sign(moved), self._side)
        on = turned | (moved * self._side > 0.0)
        self._turned = np.where(on, reading, self._turned)
        return self._side

    def _angles(self, numbers: Mapping[str, Any], what: str) -> Floats:
        missing = [name for name in self.names if name + POSITION not in numbers]
        if missing:
            raise UsageError(f"The {what} has no {missing[0]}{POSITION}: give all of {', '.join(self.names)}.")
        read = [np.array([numbers[name + POSITION]], dtype=np.float64) for name in self.names]
        angles = [self._servos.degrees(name, one, self._mode) for name, one in zip(self.names, read, strict=True)]
        return np.radians(np.concatenate(angles))

    def _numbers(self, q: Floats, ticks: float) -> dict[str, float]:
        """Numbers of the servos at these angles, that many ticks further in their own direction."""
        return {
            name + POSITION: self._servos.recorded_value(name, float(angle), self._mode, ticks)
            for name, angle in zip(self.names, np.degrees(q), strict=True)
        }


CONDITION = "calibration_sha256"


@dataclass(frozen=True)
class Used:
    """A version as it corrects: its robot, joints in order, program, and the servo calibration of each of its campaigns."""

    robot: str
    version_id: str
    joints: tuple[str, ...]
    stored: Stored
    calibrations: Mapping[str, str | None]


def fetch_used_version(robot: str, version: str | None = None, force: bool = False) -> Used:
    """Fetch what corrects a robot.

    Raises:
        ConflictError: no version is active, or the arm would be corrected twice.
        UsageError: no robot is named.

    """
    if not robot:
        raise UsageError("Say which robot of the Kilter server this arm is: --robot.kilter_robot=NAME.")
    found = correction.fetch_startup_version(robot, version, force)
    with Kilter() as kilter:
        joints = tuple(str(joint["name"]) for joint in kilter.robots.get(robot)["joints"])
        campaigns = [str(one["id"]) for one in kilter.versions.get(found.version_id, robot=robot)["campaigns"]]
        stated = {one: kilter.campaigns.get(one)["conditions"].get(CONDITION) for one in campaigns}
    return Used(robot, found.version_id, joints, from_bytes(found.program), stated)


def refuse_other_calibration(found: Used, calibration: Path) -> None:
    """Compare the calibration of the servos with that of the version's campaigns.

    Raises:
        FileError: the arm has no calibration.
        ConflictError: the campaigns were measured with another one, or nobody stated with which.

    """
    if not calibration.is_file():
        raise FileError(
            f"{calibration}: is missing. Give --robot.id the name under which the arm was calibrated, or calibrate and measure "
            "it as so101_follower first.",
            file=str(calibration),
        )
    own = hashlib.sha256(calibration.read_bytes()).hexdigest()
    for campaign, stated in found.calibrations.items():
        if stated is None:
            raise ConflictError(
                f"Campaign {campaign} of version {found.version_id} does not state with which calibration of the servos "
                "it was measured. Upload its rows again with --calibration JSON, and identify anew.",
                code="calibration_differs",
            )
        if stated != own:
            raise ConflictError(
                f"{calibration}: its SHA-256 is {own[:12]}, campaign {campaign} of version {found.version_id} was measured "
                f"with {stated[:12]}: with other zeros it is another arm. Put that calibration back, or measure it and "
                "identify anew.",
                code="calibration_differs",
            )
