"""A KUKA controller as the bridge meets it: it asks every cycle, adds the offsets AK to its axes, and counts late answers.

It shares no code with Kilter, and follows the protocol that public simulators of the interface have: a ``Rob`` element
with AIPos, ASPos, Delay and IPOC out, a ``Sen`` element with AK and the same IPOC back.
"""

from __future__ import annotations

import socket
import threading
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
AXES = [f"A{k}" for k in range(1, 7)]
Path = Callable[[float], Floats]  # time s -> axes (6,) deg


@dataclass
class RsiPeer:
    """A controller that moves along ``path``; offsets stay as they are where no answer comes in time."""

    port: int
    path: Path
    cycle_s: float = 0.012
    setpoints: bool = True  # ASPos is sent; else AIPos alone
    late: int = 0  # what the controller reports as Delay D
    ipoc: int = 1000
    offset: Floats = field(default_factory=lambda: np.zeros(6))
    rows: list[tuple[bool, Floats, Floats]] = field(default_factory=list)  # answered, wanted (6,), offset (6,)

    def __post_init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(("127.0.0.1", self.port))
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> RsiPeer:
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

    def until(self, condition: Callable[[RsiPeer], bool], seconds: float = 30.0) -> None:
        """Wait for something that the controller sees."""
        end = time.monotonic() + seconds
        while not condition(self):
            assert time.monotonic() < end, self.rows[-1:]
            time.sleep(0.01)

    def answered(self) -> NDArray[np.bool_]:
        """Which cycles had their answer in time."""
        return np.array([row[0] for row in self.rows])

    def wanted(self) -> Floats:
        """Setpoints (N, 6) deg."""
        return np.array([row[1] for row in self.rows])

    def offsets(self) -> Floats:
        """Offsets in force (N, 6) deg."""
        return np.array([row[2] for row in self.rows])

    def _run(self) -> None:
        begin = time.monotonic()
        for cycle in range(1_000_000):
            if self._stop.is_set():
                return
            wanted = self.path(cycle * self.cycle_s)
            self.rows.append((self._ask(wanted), wanted, self.offset.copy()))
            self.ipoc += round(1000 * self.cycle_s)
            time.sleep(max(0.0, begin + (cycle + 1) * self.cycle_s - time.monotonic()))

    def message(self, wanted: Floats) -> bytes:
        """The request of this cycle."""
        root = ET.Element("Rob", {"TYPE": "KUKA"})
        ET.SubElement(root, "RIst", {"X": "0.0", "Y": "0.0", "Z": "0.0", "A": "0.0", "B": "0.0", "C": "0.0"})
        ET.SubElement(root, "AIPos", {a: repr(float(v)) for a, v in zip(AXES, wanted + self.offset, strict=True)})
        if self.setpoints:
            ET.SubElement(root, "ASPos", {a: repr(float(v)) for a, v in zip(AXES, wanted, strict=True)})
        ET.SubElement(root, "Delay", {"D": str(self.late)})
        ET.SubElement(root, "IPOC").text = str(self.ipoc)
        return ET.tostring(root)

    def _ask(self, wanted: Floats) -> bool:
        """Ask for the offsets of this cycle; whether they came within it. Later answers are dropped."""
        end = time.monotonic() + self.cycle_s
        try:
            self._socket.send(self.message(wanted))
            while True:
                self._socket.settimeout(max(1e-4, end - time.monotonic()))
                if self._take(self._socket.recv(2048)):
                    return True
        except (TimeoutError, ConnectionError):
            self.late += 1
            return False

    def _take(self, answer: bytes) -> bool:
        root = ET.fromstring(answer)
        ipoc, axes = root.find("IPOC"), root.find("AK")
        assert root.tag == "Sen"
        assert ipoc is not None
        assert axes is not None
        if int(ipoc.text or "") != self.ipoc:
            self.late += 1
            return False
        self.offset = np.array([float(axes.attrib[a]) for a in AXES])
        return True
