"""Messages of ROS 2 in, corrected messages out; by the same rules as the stream and the trajectory query.

A message that cannot be corrected is counted and not passed on: ROS has no status beside the numbers, and uncorrected
numbers on the corrected topic would be the wrong ones.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from kilter_core.correct.walker import side_by_side, walk_from_rest
from kilter_core.errors import ObservationError
from kilter_core.types import Floats
from kilter_service.stream.corrector import wire
from kilter_service.stream.corrector.active import Active
from kilter_service.stream.corrector.stream import Stream
from kilter_service.stream.corrector.wire import Flag, Status
from kilter_service.stream.ros2 import cdr
from kilter_service.stream.ros2.names import Attachment

OTHER_PUBLISHER_NS = 1_000_000_000  # a second publisher is followed when the first was silent for this long


class RefusedError(Exception):
    """A message that is not passed on; its text is the name under which it is counted."""


def joint_columns(names: Sequence[str], joints: Sequence[str]) -> list[int]:
    """Where in the message each joint of the robot is.

    Raises:
        RefusedError: a joint is missing or named twice.

    """
    if not joints or any(names.count(joint) != 1 for joint in joints):
        raise RefusedError("JOINT_NAMES")
    return [names.index(joint) for joint in joints]


class Relay(ABC):
    """One topic on its way: corrects its messages, and counts what became of them."""

    def __init__(self, joints: Sequence[str] = ()) -> None:
        self.counts: Counter[str] = Counter()
        self._joints = tuple(joints)

    def answer(
        self, data: bytes, attachment: Attachment | None, arrival_ns: int, active: Active | None
    ) -> bytes | None:
        """Corrected message; None: it is not corrected."""
        try:
            out = self._correct_message(data, attachment, arrival_ns, active)
        except cdr.CdrError:
            self.counts[Status.BAD_FRAME.name] += 1
        except RefusedError as refused:
            self.counts[str(refused)] += 1
        else:
            self.counts[Status.OK.name] += 1
            return out
        return None

    @abstractmethod
    def _correct_message(
        self, data: bytes, attachment: Attachment | None, arrival_ns: int, active: Active | None
    ) -> bytes:
        """The message with corrected joints; velocities, accelerations and efforts stay as they are."""


class StateRelay(Relay):
    """Setpoints as ``JointState``, one by one; other joints in the message, such as a gripper's, pass unchanged."""

    def __init__(self, joints: Sequence[str] = ()) -> None:
        super().__init__(joints)
        self._stream = Stream()
        self._gid: bytes | None = None
        self._heard_ns = 0
        self._seq = 0

    def _correct_message(
        self, data: bytes, attachment: Attachment | None, arrival_ns: int, active: Active | None
    ) -> bytes:
        state = cdr.decode_joint_state(data)
        if active is None:
            raise RefusedError(Status.NO_VERSION.name)
        columns = joint_columns(state.head.names, self._joints or active.joint_names)
        if len(state.position) != len(state.head.names):
            raise cdr.CdrError("every joint needs a position")
        flags = self._follow_publisher(attachment, arrival_ns)
        values = state.position[columns]
        if len(state.velocity) == len(state.position):
            values = np.concatenate([values, state.velocity[columns]])
            flags |= Flag.QD
        sec, nanosec = state.head.stamp
        stamp = max(0, sec * 1_000_000_000 + nanosec)
        self._seq = attachment.seq if attachment else self._seq + 1
        sent = attachment.sent_ns if attachment else (stamp or arrival_ns)
        frame = wire.encode_setpoints(
            values[None], joints=len(columns), seq=self._seq, t_send_ns=sent, t_apply_ns=0, flags=flags
        )
        raw = self._stream.answer(frame, arrival_ns, active)
        answer = wire.decode_answer(raw) if raw else None
        if answer is None or answer.status != Status.OK:
            raise RefusedError(answer.status.name if answer else Status.BAD_FRAME.name)
        position = state.position.copy()
        position[columns] = answer.values[0]
        return cdr.encode_joint_state(replace(state, position=position))

    def _follow_publisher(self, attachment: Attachment | None, arrival_ns: int) -> int:
        """Flags of this frame: a new publisher begins a sequence. Two at once would move the arm between them."""
        gid = attachment.gid if attachment else b""
        if gid != self._gid:
            if self._gid is not None and arrival_ns - self._heard_ns < OTHER_PUBLISHER_NS:
                raise RefusedError("OTHER_PUBLISHER")
            self._gid, self._heard_ns = gid, arrival_ns
            return int(Flag.RESET)
        self._heard_ns = arrival_ns
        return 0


class TrajectoryRelay(Relay):
    """Whole motions as ``JointTrajectory``: the arm rests at the first point, every point is corrected or none."""

    def _correct_message(
        self, data: bytes, attachment: Attachment | None, arrival_ns: int, active: Active | None
    ) -> bytes:
        trajectory = cdr.decode_joint_trajectory(data)
        if active is None:
            raise RefusedError(Status.NO_VERSION.name)
        positions = corrected_positions(trajectory, active, self._joints or active.joint_names)
        return cdr.encode_joint_trajectory(replace(trajectory, positions=positions))


def corrected_positions(trajectory: cdr.JointTrajectory, active: Active, joints: Sequence[str]) -> Floats:
    """Positions (N, J) as the trajectory query gives them; ``joints`` are the names of the robot's.

    Raises:
        RefusedError: joints missing, times that go back, or a point that is refused.

    """
    names = trajectory.head.names
    columns = joint_columns(names, joints)
    if trajectory.positions.shape[1] != len(names):
        if not len(trajectory.time):
            return trajectory.positions  # the empty trajectory tells a controller to stop
        raise RefusedError(Status.BAD_FRAME.name)
    motion = (trajectory.velocities, trajectory.accelerations)
    qd, qdd = (part[:, columns] if part.shape[1] == len(names) else None for part in motion)
    values, width = side_by_side(trajectory.positions[:, columns], qd, qdd)
    try:
        walked = walk_from_rest(active.program, values, width, trajectory.t)
    except ObservationError as error:
        raise RefusedError(Status.SEQ_BACK.name) from error
    if walked.refusal is not None:
        raise RefusedError(Status(walked.refusal.status).name)
    positions = trajectory.positions.copy()
    positions[:, columns] = walked.q
    return positions
