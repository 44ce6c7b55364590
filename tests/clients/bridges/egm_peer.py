"""An ABB controller as the bridge meets it: asks every cycle in the protobuf messages that a public client library has.

It goes where it is told, and says where it stands. It shares no code with Kilter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from ABBRobotEGM._egm_protobuf import egm_pb2

from tests.clients.bridges.udp_peer import Floats, UdpPeer

RUNNING, STOPPED, DATA, CORRECTION = 3, 2, 2, 3


@dataclass
class EgmPeer(UdpPeer):
    """A controller whose arm stands at ``joints`` (n,) deg."""

    joints: Floats
    running: bool = False  # EGMRunJoint has begun
    sequence: int = 0
    each_cycle: Callable[[int], None] | None = None

    def positions(self) -> Floats:
        """Where the arm stood (N, n) deg."""
        return np.array([row[2] for row in self.rows])

    def message(self) -> bytes:
        """The request of this cycle."""
        robot = egm_pb2.EgmRobot()
        robot.header.seqno, robot.header.tm, robot.header.mtype = self.sequence, 1000 + self.sequence, DATA
        robot.feedBack.joints.joints.extend(self.joints.tolist())
        robot.planned.joints.joints.extend(self.joints.tolist())
        robot.mciState.state = RUNNING if self.running else STOPPED
        robot.mciConvergenceMet = False
        robot.utilizationRate = 12.5
        content: bytes = robot.SerializeToString()
        return content

    def _cycle(self, cycle: int) -> tuple[bool, bool, Floats]:
        """Answered, running, and joints (n,) deg."""
        if self.each_cycle is not None:
            self.each_cycle(cycle)
        running = self.running
        row = self._exchange(self.message()), running, self.joints.copy()
        self.sequence += 1
        return row

    def _take(self, answer: bytes) -> bool:
        sensor = egm_pb2.EgmSensor()
        sensor.ParseFromString(answer)
        assert sensor.header.mtype == CORRECTION
        if sensor.header.seqno != self.sequence:
            return False
        assert sensor.header.tm == 1000 + self.sequence
        told = np.array(sensor.planned.joints.joints)
        assert told.shape == self.joints.shape
        if self.running:
            self.joints = told
        else:
            assert np.allclose(told, self.joints, atol=1e-12)  # an arm that stands is told to stand
        return True
