"""ABB Externally Guided Motion: protobuf over UDP. The controller asks; the answer echoes its number and has whole joints, deg.

Joint guidance (``EGMRunJoint``): the controller has no plan of its own and goes where it is told.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

from kilter_client.bridges import protobuf
from kilter_client.bridges.loop import Request, radians
from kilter_client.bridges.plan import Setpoints

PORT = 6510
AXES = 6
HEADER, FEEDBACK, PLANNED, MCI = 1, 2, 2, 5  # fields of EgmRobot, and of EgmSensor: header and planned
JOINTS, SEQUENCE, TIME, KIND, STATE = 1, 1, 2, 3, 1
CORRECTION, RUNNING = 3, 3  # kind of a message; state of the motion


class EgmWire:
    """Messages for an arm of ``signs`` (n,): +1 where an axis has the direction of the robot's joint, -1 where the opposite."""

    def __init__(self, signs: Sequence[float], setpoints: Setpoints) -> None:
        self._signs, self._setpoints = tuple(signs), setpoints
        self._told: tuple[float, ...] | None = None  # the last joints that were answered

    @property
    def counts(self) -> Counter[str]:
        """What of the plan was not followed."""
        return self._setpoints.counts

    def read(self, data: bytes) -> Request | None:
        """Return a request; None when it is not the message of a robot."""
        try:
            header = protobuf.read_message(data, HEADER)
            stamp = None if header is None else protobuf.read_number(header, SEQUENCE)
            if header is None or stamp is None:
                return None
            state = protobuf.read_message(data, MCI)
            moving = state is None or protobuf.read_number(state, STATE) == RUNNING
            return Request(stamp, self._joints(data), None, moving, protobuf.read_number(header, TIME) or 0)
        except ValueError:
            return None

    def _joints(self, data: bytes) -> tuple[float, ...] | None:
        joints = protobuf.read_message(data, FEEDBACK, JOINTS)
        degrees = [] if joints is None else protobuf.read_doubles(joints, JOINTS)
        good = len(degrees) == len(self._signs) and all(map(math.isfinite, degrees))
        if not good:  # the plan goes on: it needs the arm's joints at its beginning only
            self._setpoints.counts["joints_unusable"] += 1
            return None
        return radians(degrees, self._signs)

    def cycles(self, stamps: int) -> int | None:
        """Return the cycles between sequence numbers so far apart: as many."""
        return stamps

    def wanted_joints(self, request: Request, cycles: int, fresh: bool) -> Sequence[float] | None:
        """Return the setpoint: of the plan, and where the arm stands when the controller begins.

        The arm stands while cycles are lost, so that none of them has passed for the plan: it would have to jump. Where
        answers do not come to the controller, or it does not follow them, the plan waits for the arm.
        """
        if fresh:
            self._told = None
            return self._setpoints.start_from_joints(request.joints)
        if self._told is not None and request.joints is not None and self._setpoints.is_far(self._told, request.joints):
            self._setpoints.counts["arm_behind"] += 1
            return self._setpoints.at
        return self._setpoints.step(1)

    def answer(self, request: Request, offset: Sequence[float]) -> bytes:
        """Return the answer; nothing before it is known where the arm stands."""
        if self._setpoints.at is None:
            return b""
        self._told = tuple(q + one for q, one in zip(self._setpoints.at, offset, strict=True))
        degrees = [math.degrees(sign * q) for sign, q in zip(self._signs, self._told, strict=True)]
        header = (
            protobuf.number(SEQUENCE, request.stamp)
            + protobuf.number(TIME, request.clock)
            + protobuf.number(KIND, CORRECTION)
        )
        joints = protobuf.message(JOINTS, protobuf.doubles(JOINTS, degrees))
        return protobuf.message(HEADER, header) + protobuf.message(PLANNED, joints)
