"""Arms with the errors the thesis measured, from its equations and Pinocchio. Nothing of Kilter is used here.

Loads are Pinocchio's; the tilting is thesis eq. 5.15 to 5.19, coded from the printed equations as corrected in
docs/explanation/thesis-equations.md; tilts enter as finite turns right after their joints.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Floats = NDArray[np.float64]

GRAVITY = 9.80665
# Elements in order (thesis eq. 4.2 to 4.7): name, motion, mm or deg. A name like "q2" is the turn of joint 2.
CHAPTER_4: tuple[tuple[str, str, float], ...] = (
    ("q1", "rz", 0), ("alpha_2", "rx", 90),
    ("q2", "rz", 0), ("a_2", "tx", 190), ("alpha_3", "rx", 0), ("beta_3", "ry", 0),
    ("q3", "rz", 0), ("a_3", "tx", 139),
    ("q4", "rz", 0), ("beta_4", "ry", 0), ("alpha_4", "rx", -90), ("d_4", "tz", 147.3),
    ("q5", "rz", 0), ("beta_5", "ry", 0), ("alpha_5", "rx", 90), ("d_5", "tz", 200),
)  # fmt: skip
# Tables 3.2 (geometry: mm, deg), 4.3 (clearance and backlash, deg) and 4.4 (stiffness, kgf m/deg).
GEOMETRY: Mapping[str, float] = {
    "q1": -0.061, "q2": 0.0232, "q3": -0.057, "q4": 0.0641, "q5": -0.121, "a_2": 0.003, "a_3": 0.01, "d_4": 0.002,
    "d_5": 0.001, "alpha_2": -0.08, "alpha_3": 0.003, "beta_3": 0.0021, "beta_4": 0.0013, "alpha_4": -0.01,
    "alpha_5": 0.03,
}  # fmt: skip
CLEARANCE_DEG = (0.022, 0.024, 0.017, 0.015, 0.018)
BACKLASH_DEG = (0.063, 0.061, 0.057, 0.046, 0.051)
STIFFNESS_KGFM_DEG = (122.0, 90.0, 75.0, 78.0, 80.0)
USUAL_DEG = 0.06  # of an angle the tables do not name
HIDDEN_MM, HIDDEN_DEG = 0.01, 0.002  # standard deviations of errors after every joint that no model has a name for


@dataclass(frozen=True)
class Make:
    """A make of arm: ``elements`` in order; of every joint the link's mass kg and its centre mm in the joint frame."""

    elements: tuple[tuple[str, str, float], ...]
    mass: tuple[float, ...]
    com_mm: tuple[tuple[float, float, float], ...]
    limits_deg: tuple[tuple[float, float], ...]

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.mass)


KATANA = Make(
    CHAPTER_4, (0.0, 1.03, 0.9, 1.0, 0.8), ((0, 0, 0), (100, 0, 0), (104, 0, 0), (0, 80, 0), (0, -70, 0)),  # table 4.2
    ((-169.5, 169.5), (-30, 102), (-122.5, 122.5), (-112, 112), (-168, 168)),
)  # fmt: skip
# A six-axis elbow arm: the UR10's table as published, with Hayati's rotation where two axes are parallel.
ELBOW = Make(
    (
        ("d_1", "tz", 127.3), ("q1", "rz", 0), ("a_1", "tx", 0), ("alpha_1", "rx", 90),
        ("q2", "rz", 0), ("a_2", "tx", -612), ("alpha_2", "rx", 0), ("beta_2", "ry", 0),
        ("q3", "rz", 0), ("a_3", "tx", -572.3), ("alpha_3", "rx", 0), ("beta_3", "ry", 0), ("d_4", "tz", 163.941),
        ("q4", "rz", 0), ("a_4", "tx", 0), ("alpha_4", "rx", 90), ("d_5", "tz", 115.7),
        ("q5", "rz", 0), ("a_5", "tx", 0), ("alpha_5", "rx", -90), ("d_6", "tz", 92.2), ("q6", "rz", 0),
    ),
    (7.0, 13.0, 4.0, 2.0, 2.0, 0.4),
    ((0, 0, -30), (-306, 0, 60), (-286, 0, 20), (0, 30, 0), (0, 0, -10), (0, 0, -20)), ((-170, 170),) * 6,
)  # fmt: skip
# The Katana with its elbow axis turned by 60 degrees against its shoulder: no two axes are parallel but by chance.
SKEWED = Make(
    (
        ("q1", "rz", 0), ("alpha_2", "rx", 90), ("q2", "rz", 0), ("a_2", "tx", 190), ("alpha_3", "rx", -60),
        ("q3", "rz", 0), ("a_3", "tx", 139), ("alpha_4", "rx", 60), ("q4", "rz", 0), ("beta_4", "ry", 0),
        ("alpha_5", "rx", -90), ("d_4", "tz", 147.3), ("q5", "rz", 0), ("alpha_6", "rx", 90), ("d_5", "tz", 200),
    ),
    KATANA.mass, KATANA.com_mm, KATANA.limits_deg,
)  # fmt: skip


@dataclass(frozen=True)
class Tilting:
    """Clearance and backlash (n,) rad and compliance (n,) rad/(N m) of the joints."""

    clearance: Floats
    backlash: Floats
    compliance: Floats


def measured_tilting(n: int = 5) -> Tilting:
    """Tables 4.3 and 4.4, from the first joint on again where there are more joints."""
    stiffness = np.resize(STIFFNESS_KGFM_DEG, n) * GRAVITY * 180.0 / math.pi
    return Tilting(np.radians(np.resize(CLEARANCE_DEG, n)), np.radians(np.resize(BACKLASH_DEG, n)), 1.0 / stiffness)


@dataclass(frozen=True)
class Arm:
    """A built arm: ``errors`` in m and rad by element, six ``hidden (n, 6)`` after every joint, and how it tilts."""

    make: Make = KATANA
    errors: Mapping[str, float] = field(default_factory=dict)
    hidden: Floats | None = None
    tilting: Tilting | None = None
    tool_m: float = 0.130  # chapter 5's attachment; 0 for chapters 3 and 4
    base_m: tuple[float, float, float] = (0.055, 0.055, 0.2015)  # eq. 4.7

    def positions(self, q: Floats) -> Floats:
        """Tool points (N, 3) m at readings ``q (N, n)``."""
        turns, lean = self._deflections(q)
        T = np.tile(np.eye(4), (len(q), 1, 1))
        T[:, :3, 3] = self.base_m
        hidden = np.zeros((self.make.n, 6)) if self.hidden is None else self.hidden
        for name, axis, value in self.make.elements:
            amount = np.full(len(q), _si(axis, value) + self.errors.get(name, 0.0))
            j = _joint(name)
            if j is None:
                T = T @ motion(axis, amount)
                continue
            T = T @ motion(axis, amount + q[:, j] + turns[:, j])
            for k, way in enumerate(("rx", "ry")):
                T = T @ motion(way, lean[:, j, k])
            for k, way in enumerate(("tx", "ty", "tz", "rx", "ry", "rz")):
                T = T @ motion(way, np.full(len(q), hidden[j, k]))
        return np.asarray((T @ np.array([0.0, 0.0, self.tool_m, 1.0]))[:, :3])

    def moments(self, q: Floats) -> Floats:
        """Load moments (N, n, 3) N m in the joint frames at rest, of the arm as drawn: what outboard links do to a joint."""
        model, n = _pinocchio(self.make), self.make.n
        data, none = model.createData(), np.zeros(n)
        out = np.empty((len(q), n, 3))
        for row, joints in enumerate(q):
            pin.rnea(model, data, joints, none, none)
            # data.f is what the parent does to hold the link: the load is its opposite.
            out[row] = [-data.f[j + 1].angular for j in range(n)]
        return out

    def _deflections(self, q: Floats) -> tuple[Floats, Floats]:
        """Turns (N, n) about the axes and leans (N, n, 2) about x and y of the joint frames."""
        if self.tilting is None:
            return np.zeros(q.shape), np.zeros((*q.shape, 2))
        eta = self.moments(q)
        x, y, z = eta[:, :, 0], eta[:, :, 1], eta[:, :, 2]
        both = np.abs(x) + np.abs(y)
        gamma = np.abs(x) * (math.pi / 2) / np.where(both > 0.0, both, 1.0)  # eq. 5.16
        r = np.tan(self.tilting.clearance)  # in units of L/2, eq. 5.15 corrected
        about_x = np.sign(x) * r * np.sin(gamma) / np.sqrt(1.0 + (r * np.sin(gamma)) ** 2)  # eq. 5.17
        about_y = np.sign(y) * r * np.cos(gamma) / np.sqrt(1.0 + (r * np.cos(gamma)) ** 2)  # eq. 5.18
        turns = np.sign(z) * self.tilting.backlash + z * self.tilting.compliance  # eq. 5.19
        loaded = both > 1e-9
        return np.where(np.abs(z) > 1e-9, turns, 0.0), np.stack([about_x, about_y], 2) * loaded[:, :, None]


def built(seed: int, make: Make = KATANA, **fields: Any) -> Arm:
    """An arm of this make: the thesis's errors, each between a half and three halves of its size, either way round.

    Clearance, backlash and compliance vary by a fifth; every joint has six small errors that no table names.
    """
    rng = np.random.default_rng(seed)
    errors = {}
    for name, axis, _ in make.elements:
        unnamed = 0.0 if make is KATANA else 0.005 if axis[0] == "t" else USUAL_DEG
        size = _si(axis, GEOMETRY.get(name, unnamed))
        errors[name] = size * rng.uniform(0.5, 1.5) * rng.choice([-1.0, 1.0])
    hidden = rng.normal(size=(make.n, 6)) * np.array([HIDDEN_MM * 1e-3] * 3 + [math.radians(HIDDEN_DEG)] * 3)
    usual = measured_tilting(make.n)
    tilting = Tilting(*(v * rng.uniform(0.8, 1.2, make.n) for v in (usual.clearance, usual.backlash, usual.compliance)))
    return replace(Arm(make, errors, hidden, tilting), **fields)


def motion(axis: str, amount: Floats) -> Floats:
    """Elementary motions (N, 4, 4): tx, ty, tz m, rx, ry, rz rad."""
    out = np.tile(np.eye(4), (len(amount), 1, 1))
    k = "xyz".index(axis[1])
    if axis[0] == "t":
        out[:, k, 3] = amount
        return out
    a, b = (k + 1) % 3, (k + 2) % 3
    out[:, a, a] = out[:, b, b] = np.cos(amount)
    out[:, b, a] = np.sin(amount)
    out[:, a, b] = -out[:, b, a]
    return out


def _si(axis: str, value: float) -> float:
    return value * 1e-3 if axis[0] == "t" else math.radians(value)


def _joint(name: str) -> int | None:
    return int(name[1:]) - 1 if name[0] == "q" else None


def _pinocchio(make: Make) -> pin.Model:
    model, placement, parent = pin.Model(), np.eye(4), 0
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    for name, axis, value in make.elements:
        j = _joint(name)
        if j is None:
            placement = placement @ motion(axis, np.array([_si(axis, value)]))[0]
            continue
        parent = model.addJoint(parent, pin.JointModelRZ(), pin.SE3(placement[:3, :3], placement[:3, 3]), name)
        inertia = pin.Inertia(make.mass[j], np.array(make.com_mm[j]) * 1e-3, np.zeros((3, 3)))
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
        placement = np.eye(4)
    return model
