"""An ABB controller as the bridge meets it: asks every cycle in the protobuf messages that a public client library has.

It goes where it is told, and says where it stands. It shares no code with Kilter.
"""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from ABBRobotEGM._egm_protobuf import egm_pb2
from numpy.typing import NDArray

Floats = NDArray[np.float64]
RUNNING, STOPPED, DATA, CORRECTION = 3, 2, 2, 3


@dataclass
class EgmPeer:
    """A controller whose arm stands at ``joints`` (n,) deg."""

    port: int
    joints: Floats
    cycle_s: float = 0.012
    running: bool = False  # EGMRunJoint has begun
    sequence: int = 0
    each_cycle: Callable[[int], None] | None = None
    rows: list[tuple[bool, bool, Floats]] = field(default_factory=list)  # answered, running, joints (n,) deg

    def __post_init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(("127.0.0.1", self.port))
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> EgmPeer:
        """Begin to ask."""
        self._thread.start()
        return self

    def stop(self) -> None:
        """Ask no more."""
        self._stop.set()
        self._thread.join(10)
        self._socket.close()

    def wait(self, cycles: int, seconds: float = 60.0) -> None:
        """Wait until so many more cycles are over."""
        wanted, end = len(self.rows) + cycles, time.monotonic() + seconds
        while len(self.rows) < wanted:
            assert self._thread.is_alive()
            assert time.monotonic() < end, "the controller does not get on"
            time.sleep(0.01)

    def answered(self) -> NDArray[np.bool_]:
        """Which cycles had their answer in time."""
        return np.array([row[0] for row in self.rows])

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

    def _run(self) -> None:
        begin = time.monotonic()
        for cycle in range(1_000_000):
            if self._stop.is_set():
                return
            if self.each_cycle is not None:
                self.each_cycle(cycle)
            running = self.running
            self.rows.append((self._ask(), running, self.joints.copy()))
            self.sequence += 1
            time.sleep(max(0.0, begin + (cycle + 1) * self.cycle_s - time.monotonic()))

    def _ask(self) -> bool:
        end = time.monotonic() + self.cycle_s
        try:
            self._socket.send(self.message())
            while True:
                self._socket.settimeout(max(1e-4, end - time.monotonic()))
                if self._take(self._socket.recv(2048)):
                    return True
        except (TimeoutError, ConnectionError):
            return False

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
