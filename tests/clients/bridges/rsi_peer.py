"""A KUKA controller as the bridge meets it: it asks every cycle, adds the offsets AK to its axes, and counts late answers.

It shares no code with Kilter, and follows the protocol that public simulators of the interface have: a ``Rob`` element
with AIPos, ASPos, Delay and IPOC out, a ``Sen`` element with AK and the same IPOC back.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from tests.clients.bridges.udp_peer import Floats, UdpPeer

AXES = [f"A{k}" for k in range(1, 7)]
Path = Callable[[float], Floats]  # time s -> axes (6,) deg


@dataclass
class RsiPeer(UdpPeer):
    """A controller that moves along ``path``; offsets stay as they are where no answer comes in time."""

    path: Path
    setpoints: bool = True  # ASPos is sent; else AIPos alone
    late: int = 0  # what the controller reports as Delay D
    ipoc: int = 1000
    offset: Floats = field(default_factory=lambda: np.zeros(6))

    def wanted(self) -> Floats:
        """Setpoints (N, 6) deg."""
        return np.array([row[1] for row in self.rows])

    def offsets(self) -> Floats:
        """Offsets in force (N, 6) deg."""
        return np.array([row[2] for row in self.rows])

    def _cycle(self, cycle: int) -> tuple[bool, Floats, Floats]:
        """Answered, wanted (6,) and offset (6,)."""
        wanted = self.path(cycle * self.cycle_s)
        answered = self._exchange(self.message(wanted))
        self.late += not answered
        row = answered, wanted, self.offset.copy()
        self.ipoc += round(1000 * self.cycle_s)
        return row

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

    def _take(self, answer: bytes) -> bool:
        root = ET.fromstring(answer)
        ipoc, axes = root.find("IPOC"), root.find("AK")
        assert root.tag == "Sen"
        assert ipoc is not None
        assert axes is not None
        if int(ipoc.text or "") != self.ipoc:  # its own cycle ended without it, and counted it
            return False
        self.offset = np.array([float(axes.attrib[a]) for a in AXES])
        return True
