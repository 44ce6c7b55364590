"""A controller that asks over UDP every cycle, in whatever messages: it shares no code with Kilter."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
GUARD_S = 240.0  # conditions are counted in cycles: this only ends a test that would wait for ever
SO_TIMESTAMPNS = 35  # Linux: with each packet comes when it arrived


@dataclass
class UdpPeer:
    """Asks ``port`` each ``cycle_s``, and keeps a row of each cycle that begins with whether an answer came in time."""

    port: int
    cycle_s: float = field(default=0.012, kw_only=True)
    rows: list[tuple[Any, ...]] = field(default_factory=list, kw_only=True)

    def __post_init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self._socket.connect(("127.0.0.1", self.port))
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> Self:
        """Begin to ask."""
        self._thread.start()
        return self

    def stop(self) -> None:
        """Ask no more."""
        self._stop.set()
        if self._thread.ident is not None:  # it was started
            self._thread.join(10)
        self._socket.close()

    def wait(self, cycles: int, seconds: float = GUARD_S) -> None:
        """Wait until so many more cycles are over."""
        wanted, end = len(self.rows) + cycles, time.monotonic() + seconds
        while len(self.rows) < wanted:
            assert self._thread.is_alive()
            assert time.monotonic() < end, "the controller does not get on"
            time.sleep(0.01)

    def wait_answered(self, cycles: int, seconds: float = GUARD_S) -> None:
        """Wait until so many more cycles had their answer in time, however many a busy machine makes late meanwhile."""
        wanted = self._counted() + cycles
        end = time.monotonic() + seconds
        while self._counted() < wanted:
            assert self._thread.is_alive()
            assert time.monotonic() < end, f"of {len(self.rows)} cycles {self._counted()} were answered in time"
            time.sleep(0.01)

    def _counted(self) -> int:
        return sum(bool(row[0]) for row in list(self.rows))

    def until(self, condition: Callable[[Self], bool], seconds: float = GUARD_S) -> None:
        """Wait for something that the controller sees."""
        end = time.monotonic() + seconds
        while not condition(self):
            assert time.monotonic() < end, self.rows[-1:]
            time.sleep(0.01)

    def answered(self) -> NDArray[np.bool_]:
        """Which cycles had their answer in time."""
        return np.array([row[0] for row in self.rows])

    def _run(self) -> None:
        begin = time.monotonic()
        for cycle in range(1_000_000):
            if self._stop.is_set():
                return
            self.rows.append(self._cycle(cycle))
            time.sleep(max(0.0, begin + (cycle + 1) * self.cycle_s - time.monotonic()))

    def _cycle(self, cycle: int) -> tuple[Any, ...]:
        """One cycle: its row."""
        raise NotImplementedError

    def _exchange(self, message: bytes) -> bool:
        """Ask; whether the answer came within the cycle: when it arrived counts, for this thread may be held up itself."""
        end, sent_s = time.monotonic() + self.cycle_s, time.time()
        try:
            self._socket.send(message)
            while True:
                self._socket.settimeout(max(1e-4, end - time.monotonic()))
                answer, ancillary, _, _ = self._socket.recvmsg(2048, 64)
                seconds, nanoseconds = struct.unpack("qq", ancillary[0][2])
                if self._take(answer):
                    return bool(seconds + 1e-9 * nanoseconds - sent_s <= self.cycle_s)
        except (TimeoutError, ConnectionError):
            return False

    def _take(self, answer: bytes) -> bool:
        """Take what an answer says; False: it is of an earlier cycle."""
        raise NotImplementedError
