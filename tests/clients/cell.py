"""A cell of its own making: an arm of seven axes on a rail, with what a real one has, in plain numpy, without Kilter.

The joints move in turn through the poses of a list; play leaves each on the side that it came from. Stamps are on the
cell's clock, and a tracker reads the ball at the tool from where it stands.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]
H = float(np.pi / 2)
# name, origin m, roll pitch yaw rad, kg of its link, centre of that mass m; all axes are z but the rail's, which is x
JOINTS = (
    ("E1", (0.0, 0.0, 0.5), (0.0, 0.0, 0.0), 90.0, (0.0, 0.0, 0.1)),
    ("A1", (0.1, 0.0, 0.2), (0.0, 0.0, 0.0), 40.0, (0.0, 0.05, 0.2)),
    ("A2", (0.0, 0.0, 0.3), (H, 0.0, 2 * H), 30.0, (0.0, 0.25, 0.0)),
    ("A3", (0.0, 0.42, 0.0), (H, 0.0, 2 * H), 20.0, (0.0, 0.0, 0.2)),
    ("A4", (0.0, 0.0, 0.38), (H, 0.0, 0.0), 15.0, (0.0, 0.2, 0.0)),
    ("A5", (0.0, 0.4, 0.0), (-H, 2 * H, 0.0), 10.0, (0.0, 0.0, 0.15)),
    ("A6", (0.0, 0.06, 0.34), (H, 0.0, 0.0), 6.0, (0.0, 0.03, 0.0)),
    ("A7", (0.0, 0.12, 0.06), (-H, 2 * H, 0.0), 2.0, (0.0, 0.0, 0.02)),
)  # fmt: skip
NAMES = tuple(name for name, *_ in JOINTS)
N = len(JOINTS)
BALL = (0.06, 0.02, 0.14)  # m in the frame of the last joint
LOWER = np.array([0.0, *np.radians([-150, -70, -150, -100, -150, -100, -160])])
UPPER = np.array([2.4, *np.radians([150, 70, 150, 100, 150, 100, 160])])
GRAVITY = np.array([0.0, 0.0, -9.81])
AXES = np.array([[1.0, 0.0, 0.0], *[[0.0, 0.0, 1.0]] * (N - 1)])


def urdf() -> str:
    """The cell as its integrator drew it."""
    rows = ['<robot name="cell"><link name="floor"/>']
    for k, (name, xyz, rpy, kg, centre) in enumerate(JOINTS):
        kind, (x, y, z) = ("prismatic" if k == 0 else "revolute"), AXES[k]
        rows.append(
            f'<link name="link_{name}"><inertial><origin xyz="{_text(centre)}"/><mass value="{kg}"/></inertial></link>'
            f'<joint name="{name}" type="{kind}"><parent link="{f"link_{NAMES[k - 1]}" if k else "floor"}"/>'
            f'<child link="link_{name}"/><origin xyz="{_text(xyz)}" rpy="{_text(rpy)}"/><axis xyz="{x} {y} {z}"/>'
            f'<limit lower="{LOWER[k]}" upper="{UPPER[k]}" effort="1" velocity="1"/></joint>'
        )
    rows.append(
        f'<link name="ball"/><joint name="holder" type="fixed"><parent link="link_A7"/><child link="ball"/>'
        f'<origin xyz="{_text(BALL)}"/></joint></robot>'
    )
    return "".join(rows)


def _text(values: tuple[float, ...]) -> str:
    return " ".join(repr(float(value)) for value in values)


def frame(xyz: Floats, rotation: Rotation) -> Floats:
    """Transform (4, 4)."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation.as_matrix(), xyz
    return T


@dataclass(frozen=True)
class Cell:
    """The real cell: errors of each origin (N, 6) m and rad, of the zeros (N,) rad or m, its springs, play, base and tracker.

    ``soft (N,)`` rad/N m gives way under gravity; ``play (N,)`` rad is what a joint lags behind on either side; ``moved``
    (4, 4) is the arm's stand, ``station`` (4, 4) the stand of the tracker, both in the frame of the floor.
    """

    origins: Floats = field(default_factory=lambda: np.zeros((N, 6)))
    zeros: Floats = field(default_factory=lambda: np.zeros(N))
    soft: Floats = field(default_factory=lambda: np.zeros(N))
    play: Floats = field(default_factory=lambda: np.zeros(N))
    ball: Floats = field(default_factory=lambda: np.array(BALL))
    moved: Floats = field(default_factory=lambda: np.eye(4))
    station: Floats = field(default_factory=lambda: np.eye(4))

    def frames(self, q: Floats) -> list[Floats]:
        """Frames (4, 4) of the links at joints (N,)."""
        T, out = self.moved, []
        for k, (_, xyz, rpy, *_) in enumerate(JOINTS):
            off = frame(self.origins[k, :3], Rotation.from_rotvec(self.origins[k, 3:]))
            T = T @ frame(np.array(xyz), Rotation.from_euler("xyz", rpy)) @ off
            angle = q[k] + self.zeros[k]
            slides = k == 0
            own = (
                frame(AXES[k] * angle, Rotation.identity())
                if slides
                else frame(np.zeros(3), Rotation.from_rotvec(AXES[k] * angle))
            )
            T = T @ own
            out.append(T)
        return out

    def ball_at(self, q: Floats, side: Floats) -> Floats:
        """Where the ball is (3,) m, for joints (N,) that came from the sides (N,) -1 or 1."""
        frames = self.frames(q)
        torque = np.zeros(N)
        for k in range(1, N):
            axis, at = frames[k][:3, :3] @ AXES[k], frames[k][:3, 3]
            for j in range(k, N):
                centre = (frames[j] @ np.array([*JOINTS[j][4], 1.0]))[:3]
                torque[k] += axis @ np.cross(centre - at, JOINTS[j][3] * GRAVITY)
        there = self.frames(q + self.soft * torque - self.play * side)[-1]
        return np.asarray((there @ np.array([*self.ball, 1.0]))[:3])

    def driven(self, q: Floats, begin: Floats | None = None) -> Floats:
        """Where the ball comes to rest (M, 3) m, along joints (M, N) one after the other."""
        before = np.vstack([(LOWER + UPPER) / 2 if begin is None else begin, q[:-1]])
        side = np.ones(N)
        out = []
        for row, last in zip(q, before, strict=True):
            side = np.where(np.abs(row - last) > 1e-9, np.sign(row - last), side)
            out.append(self.ball_at(row, side))
        return np.array(out)

    def seen(self, points: Floats, rng: np.random.Generator, noise: float = 2e-5) -> Floats:
        """What the tracker reads (M, 3) m."""
        inverse = np.linalg.inv(self.station)
        return np.asarray(points @ inverse[:3, :3].T + inverse[:3, 3] + rng.normal(0.0, noise, points.shape))

    def after(self, **changes: Floats) -> Cell:
        """The cell with something else about it."""
        return replace(self, **changes)


def real_cell(rng: np.random.Generator) -> Cell:
    """A cell as it comes: origins 0.2 mm and 0.3 mrad off, zeros 1 mrad, a soft shoulder, play in the elbow."""
    origins = rng.normal(0.0, 1.0, (N, 6)) * np.array([2e-4] * 3 + [3e-4] * 3)
    zeros = np.array([0.0, *rng.normal(0.0, 1e-3, N - 1)])
    soft, play = np.zeros(N), np.zeros(N)
    soft[2], play[4] = 1.5e-6, 2.5e-4
    station = frame(np.array([3.1, -2.2, 0.4]), Rotation.from_euler("xyz", [0.01, -0.02, 1.9]))
    return Cell(origins, zeros, soft, play, np.array(BALL) + rng.normal(0.0, 4e-4, 3), station=station)


def poses(count: int, rng: np.random.Generator) -> Floats:
    """Joints (count, N) well inside the limits."""
    return np.asarray(rng.uniform(LOWER + 0.05 * (UPPER - LOWER), UPPER - 0.05 * (UPPER - LOWER), (count, N)))


def shown(q: Floats) -> Floats:
    """Joints (M, N) as the controller shows them: mm and degrees."""
    return np.asarray(np.hstack([q[:, :1] * 1e3, np.degrees(q[:, 1:])]))


def file_of(q: Floats, seen: Floats, begin: datetime, minutes: float, hidden: tuple[int, ...] = ()) -> str:
    """A file as the lab writes it: stamps, joints by their names, X, Y, Z in mm, empty where the ball was not to be seen."""
    rows = [";".join(("Time", *NAMES[1:], NAMES[0], "X", "Y", "Z"))]
    for k, (joints, point) in enumerate(zip(shown(q), seen * 1e3, strict=True)):
        stamp = begin + timedelta(minutes=minutes * k)
        place = ["", "", ""] if k in hidden else [f"{value:.4f}" for value in point]
        rows.append(
            ";".join([stamp.strftime("%Y-%m-%d %H:%M:%S"), *(f"{v:.5f}" for v in [*joints[1:], joints[0]]), *place])
        )
    return "\n".join(rows) + "\n"
