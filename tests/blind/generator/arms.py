"""The arms as they were drawn: joint placements, masses, limits, and the document that Kilter is given of each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.blind.generator.rigid import step

Floats = NDArray[np.float64]
Step = tuple[str, float]  # an elementary motion in mm or deg; ("joint", 0) is the turn of the next joint about z
SHORTEST_M = 0.05


@dataclass(frozen=True)
class Drawn:
    """An arm as drawn. Centres of mass ``com (n, 3)`` m are in the joint frames, which turn with the joints about z.

    ``neutral`` is the reading of joint 2 at which the arm stands upright, where a balancing spring pulls no moment.
    ``tool`` and ``base`` are x, y, z in mm without a turn.
    """

    name: str
    steps: tuple[Step, ...]
    mass: Floats
    com: Floats
    limits_deg: Floats
    gear: tuple[float | None, ...]
    payload_kg: float
    neutral: float
    tool: tuple[float, float, float]
    base: tuple[float, float, float]
    lowest_m: float
    form: dict[str, Any]
    com_frames: tuple[tuple[Step, ...], ...]  # from each joint frame to the frame its document gives the com in

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.mass)

    @cached_property
    def placements(self) -> Floats:
        """Placement (n + 2, 4, 4) of each joint on the frame of the one before, then flange and tool."""
        out, here = [], np.eye(4)
        for axis, amount in self.steps:
            if axis == "joint":
                out.append(here)
                here = np.eye(4)
            else:
                here = here @ _step(axis, amount)
        return np.stack([*out, here, _moved(self.tool)])

    @cached_property
    def base_placement(self) -> Floats:
        """Pose (4, 4) of the robot's foot in the nominal world."""
        return _moved(self.base)

    @cached_property
    def limits(self) -> Floats:
        """Joint limits (n, 2), rad."""
        return np.radians(self.limits_deg)

    @property
    def links(self) -> tuple[int, ...]:
        """Joints before a link that is long enough to bend; the last link, which carries little, left out."""
        lengths = np.linalg.norm(self.placements[1 : self.n, :3, 3], axis=1)
        return tuple(int(j) for j in np.flatnonzero(lengths > SHORTEST_M))

    def document(self, mass: Floats, com: Floats | None = None) -> dict[str, Any]:
        """Kilter's robot.json with the masses ``mass (n,)`` and centres ``com (n, 3)`` that its user believes in."""
        links = []
        for own, at, frame in zip(mass, self.com if com is None else com, self.com_frames, strict=True):
            away = np.eye(4)
            for axis, amount in frame:
                away = away @ _step(axis, amount)
            there = away[:3, :3].T @ (at - away[:3, 3])
            links.append({"mass_kg": float(own), "com_mm": [float(c) * 1e3 for c in there]})
        joints = [
            {"name": f"j{i + 1}", "limits_deg": [float(a), float(b)], "gear_ratio": gear}
            for i, ((a, b), gear) in enumerate(zip(self.limits_deg, self.gear, strict=True))
        ]
        frames = {k: dict(zip(("x_mm", "y_mm", "z_mm"), v, strict=True)) for k, v in self._frames().items()}
        return {"name": self.name, "joints": joints, "links": links, **frames, **self.form}

    def _frames(self) -> dict[str, tuple[float, float, float]]:
        return {"tool": self.tool, "base": self.base}


def _step(axis: str, amount: float) -> Floats:
    return step(axis, math.radians(amount) if axis[0] == "R" else amount * 1e-3)


def _moved(xyz: tuple[float, float, float]) -> Floats:
    out = np.eye(4)
    out[:3, 3] = np.array(xyz) * 1e-3
    return out


def katana() -> Drawn:
    """Katana 450 of the thesis (tables 3.1 and 4.2), with offsets between axes, as a real one has, drawn as zero."""
    named: list[tuple[str, str, float]] = [
        ("joint", "j1", 0.0), ("a_1", "Tx", 0.0), ("alpha_2", "Rx", 90.0), ("d_2", "Tz", 0.0),
        ("joint", "j2", 0.0), ("a_2", "Tx", 190.0), ("alpha_3", "Rx", 0.0), ("beta_3", "Ry", 0.0),
        ("joint", "j3", 0.0), ("a_3", "Tx", 139.0), ("alpha_34", "Rx", 0.0), ("beta_34", "Ry", 0.0),
        ("joint", "j4", 0.0), ("a_4", "Tx", 0.0), ("alpha_4", "Rx", -90.0), ("d_4", "Tz", 147.3),
        ("joint", "j5", 0.0), ("alpha_5", "Rx", 90.0), ("d_5", "Tz", 200.0),
    ]  # fmt: skip
    elements: list[dict[str, Any]] = []
    steps: list[Step] = []
    for name, axis, value in named:
        if name == "joint":
            elements.append({"joint": axis, "axis": "Rz"})
            steps.append(("joint", 0.0))
        else:
            elements.append({"name": name, "axis": axis, "value": value})
            steps.append((axis, value))
    return Drawn(
        name="blind-katana",
        steps=tuple(steps),
        mass=np.array([0.0, 1.03, 0.9, 1.0, 0.8]),
        com=np.array([[0, 0, 0], [100, 0, 0], [104, 0, 0], [0, 80, 0], [0, -70, 0]]) * 1e-3,
        limits_deg=np.array([[-169.5, 169.5], [-30, 102], [-122.5, 122.5], [-112, 112], [-168, 168]]),
        gear=(100.0, 100.0, 100.0, 100.0, 100.0),
        payload_kg=0.5,
        neutral=math.pi / 2,
        tool=(0.0, 0.0, 0.0),
        base=(55.0, 55.0, 201.5),
        lowest_m=-0.15,
        form={"convention": "chain", "elements": elements},
        com_frames=((),) * 5,
    )


def elbow() -> Drawn:
    """A six-axis elbow arm of 1.2 m reach, given to Kilter as a DH table."""
    d, a = [450.0, 0.0, 0.0, 520.0, 0.0, 95.0], [100.0, 550.0, 80.0, 0.0, 0.0, 0.0]
    alpha, offset = [-90.0, 0.0, -90.0, 90.0, -90.0, 0.0], [0.0, -90.0, 0.0, 0.0, 0.0, 0.0]
    steps: list[Step] = []
    for i in range(6):
        steps += [("Tz", d[i]), ("Rz", offset[i]), ("joint", 0.0), ("Tx", a[i]), ("Rx", alpha[i])]
    rows = [
        {"theta_offset_deg": offset[i], "d_mm": d[i], "a_mm": a[i], "alpha_deg": alpha[i], "type": "revolute"}
        for i in range(6)
    ]
    com = [[60, -10, -80], [260, 5, 90], [60, 40, 15], [0, 10, -180], [5, 25, 10], [0, 0, -30]]
    return Drawn(
        name="blind-elbow",
        steps=tuple(steps),
        mass=np.array([40.0, 31.0, 26.0, 14.0, 10.0, 2.4]),
        com=np.array(com) * 1e-3,
        limits_deg=np.array([[-170, 170], [-65, 120], [-105, 75], [-185, 185], [-118, 118], [-350, 350]]),
        gear=(121.0, 161.0, 145.0, 100.5, 80.0, 50.0),
        payload_kg=10.0,
        neutral=0.0,
        tool=(70.0, 0.0, 140.0),
        base=(0.0, 0.0, 0.0),
        lowest_m=-0.1,
        form={"convention": "dh", "rows": rows},
        com_frames=tuple((("Tx", a[i]), ("Rx", alpha[i])) for i in range(6)),
    )


def seven() -> Drawn:
    """A seven-axis arm (spherical shoulder, elbow, spherical wrist) of 0.9 m reach, given to Kilter as Craig's MDH."""
    alpha: Sequence[float] = (0.0, -90.0, 90.0, 90.0, -90.0, -90.0, 90.0)
    d: Sequence[float] = (340.0, 0.0, 400.0, 0.0, 390.0, 0.0, 120.0)
    steps: list[Step] = []
    for i in range(7):
        steps += [("Rx", alpha[i]), ("joint", 0.0), ("Tz", d[i])]
    rows = [
        {
            "alpha_deg": alpha[i],
            "a_mm": 0.0,
            "beta_deg": None,
            "theta_offset_deg": 0.0,
            "d_mm": d[i],
            "type": "revolute",
        }
        for i in range(7)
    ]
    com = [[0, -20, 240], [5, 60, 35], [0, 30, 310], [0, 65, 30], [3, 20, 250], [0, 15, 10], [0, 0, 80]]
    return Drawn(
        name="blind-seven",
        steps=tuple(steps),
        mass=np.array([5.4, 5.0, 3.8, 3.4, 2.4, 2.0, 0.7]),
        com=np.array(com) * 1e-3,
        limits_deg=np.array(
            [[-168, 168], [-118, 118], [-168, 168], [-118, 118], [-168, 168], [-118, 118], [-172, 172]]
        ),
        gear=(160.0, 160.0, 120.5, 120.5, 100.0, 100.0, 100.0),
        payload_kg=5.0,
        neutral=0.0,
        tool=(55.0, 0.0, 90.0),
        base=(0.0, 0.0, 0.0),
        lowest_m=0.0,
        form={"convention": "mdh", "rows": rows},
        com_frames=tuple((("Tz", d[i]),) for i in range(7)),
    )


ARMS = {"katana": katana, "elbow": elbow, "seven": seven}
